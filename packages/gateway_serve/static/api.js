// What the server is asked: with the tokens that this tab has. Tokens come after the address's #, which no server sees.

const tokens = { read: "", control: "" };

for (const name of Object.keys(tokens)) tokens[name] = sessionStorage.getItem(name) ?? "";
const given = new URLSearchParams(location.hash.slice(1));
for (const name of Object.keys(tokens)) {
  if (given.has(name)) keepToken(name, given.get(name));
}
if (given.has("read") || given.has("control")) history.replaceState(null, "", location.pathname);

export function keepToken(name, token) {
  tokens[name] = token;
  sessionStorage.setItem(name, token);
}

export const mayChange = () => tokens.control !== "";

function headers(token) {
  return token ? { authorization: `Bearer ${token}` } : {};
}

export async function get(path) {
  const answer = await fetch(path, { headers: headers(tokens.read || tokens.control), cache: "no-store" });
  if (!answer.ok) throw Object.assign(new Error(await answer.text()), { status: answer.status });
  return answer;
}

export async function post(path, body) {
  const answer = await fetch(path, {
    method: "POST",
    headers: { "content-type": "application/json", ...headers(tokens.control) },
    body: JSON.stringify(body),
  });
  if (!answer.ok) throw Object.assign(new Error((await answer.text()).trim()), { status: answer.status });
  return answer.json();
}

// One stream of events: opened again for as long as the page is there.
export async function listen(take, lost) {
  for (let wait = 200; ; wait = Math.min(wait * 2, 3000)) {
    try {
      const answer = await get("/api/stream");
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      let heard = "";
      for (;;) {
        const { value, done } = await withLimit(reader.read(), 15000);
        if (done) break;
        wait = 200;
        heard += value;
        const parts = heard.split("\n\n");
        heard = parts.pop();
        for (const part of parts) {
          const kind = /^event: (.*)$/m.exec(part);
          const data = /^data: (.*)$/m.exec(part);
          if (kind && data) await take(kind[1], JSON.parse(data[1]));
          if (kind?.[1] === "state") await new Promise((done) => setTimeout(done, 20));  // the verdict is drawn
        }
      }
      lost("the page's server has ended");
    } catch (error) {
      if (error.status === 401) {
        lost("token");
        return;
      }
      lost("the page's server is not reached");
    }
    await new Promise((done) => setTimeout(done, wait));
  }
}

function withLimit(promise, ms) {
  return Promise.race([promise, new Promise((_, no) => setTimeout(() => no(new Error("silent")), ms))]);
}
