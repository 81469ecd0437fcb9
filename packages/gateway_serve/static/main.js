// The page: messages of the stream go to its parts; drawing has its own pace.

import { get, keepToken, listen, mayChange, post } from "/static/api.js";
import { byId, clock, say } from "/static/dom.js";
import { Dtcs } from "/static/dtcs.js";
import { drawing } from "/static/plot.js";
import { Residuals } from "/static/residuals.js";
import { Messages } from "/static/messages.js";
import { showBuses, showCycle, showInjected, showLog, showVehicle, textOf } from "/static/tables.js";

const DRAW_MS = 200;
const state = {
  connected: false, reason: "", bits: [],
  memory: { entries: [], summary: { causes: [], not_judged: {} }, cycles: {}, ecu_dtcs: [], restarts: { count: 0 }, readiness: [], stored: true, error: "" },
  on: true, ecus: [], events: [], messages: { messages: [], left_out: 0 }, latest: 0, came: 0, paused: false, end: 0, zero: 0, asked: null,
};
const residuals = new Residuals();
const dtcs = new Dtcs((dtc) => askClear(dtc));
const messages = new Messages();

// What comes

const takes = {
  state(told) {
    Object.assign(state, { hello: told.hello, connected: told.connected, reason: told.reason, memory: told.memory,
      bits: told.bits, events: told.events, messages: told.messages, ecus: told.ecus });
    say(byId("name"), told.hello.name || "gateway");
    document.title = told.hello.name ? `${told.hello.name} – gateway` : "gateway";
    say(byId("version"), told.hello.version ? `gateway ${told.hello.version}` : "");
    showBuses(told.buses);
    showOff(told.monitoring);
    messages.show(state.messages);
    showMemory();
    showEvents();
    showLink();
  },
  // Of tens of thousands of tests: after the verdict is there.
  async tests(told) {
    await drawing();
    const texts = told.texts;
    residuals.begin(told.tests.map(([id, dtc, monitor, ecu, description, unit]) =>
      ({ id, dtc, monitor, ecu, description: texts[description], unit: texts[unit] })));
    residuals.forget();
    residuals.now(told.latest);
    for (const now of told.latest) state.latest = Math.max(state.latest, now.t_ms ?? 0);
    residuals.rank(state.memory.summary.causes);
  },
  monitoring: (told) => showOff(told),
  link(told) {
    Object.assign(state, told);
    showLink();
  },
  history: (told) => residuals.past(told),
  tick(tick) {
    state.latest = tick.t;
    state.came = performance.now();
    residuals.tick(tick);
  },
  event(event) {
    if (event.event === "monitor") return;
    state.events.push(event);
    if (state.events.length > 300) state.events.shift();
    if (event.event === "dtc" && event.status & 1) {
      say(byId("announce"), textOf(event));
      if (byId("freeze").checked && !state.paused) state.asked = { at: event.t_ms, dtc: event.dtc };
    }
    soon(showEvents);
  },
  memory(memory) {
    state.memory = memory;
    showMemory();
  },
  buses: (buses) => soon(() => showBuses(buses), "buses"),
  ecus(ecus) {
    state.ecus = ecus;
    soon(showMemory);
  },
  messages(told) {
    state.messages = told;
    messages.take(told, state.latest);
    if (!state.paused) messages.show(told);
  },
};

const waiting = new Map();
function soon(work, name = work.name) {
  if (!waiting.size) setTimeout(() => { const all = [...waiting.values()]; waiting.clear(); all.forEach((f) => f()); }, 100);
  waiting.set(name, work);
}

function showEvents() {
  showLog(state.events);
  showInjected(state.events);
}

function showMemory() {
  dtcs.show(state.memory, state.bits);
  dtcs.counters(residuals);
  residuals.rank(state.memory.summary.causes);
  showCycle(state.memory);
  showVehicle(state.ecus, state.memory.ecu_dtcs);
  showVerdict();
}

function showOff(told) {
  state.on = told.on;
  const off = [["dtcs", "test results do not count (0x85)"], ["receive", "nothing is received (0x28)"], ["send", "nothing is sent (0x28)"]]
    .filter(([name]) => !told[name]).map(([, text]) => text);
  byId("off").hidden = !off.length;
  const title = told.on ? "Communication is switched off" : "Monitoring is switched off";
  say(byId("off"), off.length ? `${title}: ${off.join(", ")}. By ${told.by.join("; ")}.` : "");
  showLink();
}

function showLink() {
  const pill = byId("link");
  const [text, kind] = !state.connected ? ["gateway not reached", "bad"]
    : ended() ? ["ended", "warning"]
    : state.on ? ["monitoring", "good"] : ["monitoring off", "bad"];
  say(pill, text);
  pill.className = `pill ${kind}`;
  pill.title = state.reason || ended();
  showVerdict();
}

// What the gateway says of a demo that is over; "": it goes on.
const ended = () => state.hello?.ended ?? "";

function few(kinds) {
  const rest = kinds.slice(4).reduce((sum, kind) => sum + kind.count, 0);
  return [...kinds.slice(0, 4).map((kind) => `• ${kind.text}`), ...(rest ? [`• ${rest} more`] : [])];
}

// What the server has summed up, as every other door of the gateway says it.
function showVerdict() {
  const place = byId("verdict");
  const found = state.memory.summary;
  const kinds = { "faults": "bad", "stored": "warning", "no faults": "good" };
  let lines = found.causes.slice(0, 3).flatMap((cause) => [
    `${cause.line.replace(/^cause: /, "")}, ${cause.failing ? "since" : "stored, from"} ${clock(cause.since_ns / 1e6)}`,
    ...few(cause.symptoms.slice(cause.probability ? 0 : 1)),
  ]);
  const rest = found.causes.slice(3).reduce((sum, cause) => sum + cause.faults.length, 0);
  if (rest) lines.push(`and ${rest} more faults, listed below`);
  for (const [why, count] of Object.entries(found.not_judged)) lines.push(`Not judged: ${count} of ${found.tests} tests, ${why}.`);
  let [kind, text] = [kinds[found.verdict] ?? "", found.title];
  if (!state.connected) [kind, text, lines] = ["", "The gateway is not reached", [state.reason]];
  else if (ended()) lines.unshift(`${ended()} Nothing is monitored any more.`);
  place.className = `verdict ${kind}`;
  say(byId("verdict-text"), text);
  say(byId("verdict-more"), lines.join("\n"));
}

// What is drawn

function view() {
  const seconds = Number(byId("window").value);
  const running = Math.min(performance.now() - state.came, 1000);
  const end = state.paused ? state.end : state.latest + (state.connected ? running : 0);
  return { from: end - seconds * 1000, to: end, zero: state.paused ? state.zero : end, seconds };
}

function draw() {
  const seconds = Number(byId("window").value);
  if (state.asked && state.latest >= state.asked.at + Math.min(seconds * 300, 3000)) {
    const { at, dtc } = state.asked;
    pause(true, at + Math.min(seconds * 300, 3000), at, `Frozen at ${clock(at)}, when ${dtc} failed. Time 0 is the failure.`);
    state.asked = null;
  }
  if (!document.hidden) {
    residuals.redraw(view());
    messages.redraw(view());
    dtcs.counters(residuals);
  }
  setTimeout(draw, DRAW_MS);
}

function pause(on, end = state.latest, zero = end, why = `Paused at ${clock(end)}. Monitoring goes on.`) {
  Object.assign(state, { paused: on, end, zero });
  const button = byId("pause");
  button.setAttribute("aria-pressed", String(on));
  say(button, on ? "Go on" : "Pause");
  byId("frozen").hidden = !on;
  say(byId("frozen"), on ? why : "");
}

// What is asked

function ask(title, text, yes, work) {
  const dialog = byId("dialog");
  say(byId("dialog-title"), title);
  say(byId("dialog-text"), text);
  say(byId("dialog-yes"), yes);
  byId("dialog-error").hidden = true;
  byId("dialog-token-row").hidden = mayChange();
  let more = {};
  byId("dialog-yes").onclick = async () => {
    const token = byId("dialog-token").value;
    if (token) keepToken("control", token);
    byId("dialog-token").value = "";
    try {
      await work(more);
      dialog.close();
    } catch (error) {
      byId("dialog-error").hidden = false;
      say(byId("dialog-error"), error.status === 401 ? "This needs the control token, which the gateway said at its start." : error.message);
      if (error.status === 409 && error.message.includes("force overrides")) {
        more = { force: true, why: "asked twice" };
        say(byId("dialog-yes"), `${yes} all the same`);
      }
      if (error.status === 401) {
        keepToken("control", "");
        byId("dialog-token-row").hidden = false;
        byId("dialog-token").focus();
      }
    }
  };
  dialog.showModal();
}

function askClear(dtc) {
  const what = dtc ?? "all trouble codes";
  ask(`Clear ${what}?`, `${dtc ? "Its" : "Their"} freeze frames, evidence and recordings are gone then, for testers too.`, "Clear",
    (more) => post("/api/clear", dtc ? { dtc, ...more } : more));
}

byId("clear").addEventListener("click", () => askClear(null));
byId("cycle").addEventListener("click", () => ask("Begin a new operation cycle?",
  "The running one ends, as at key off and on: counters of confirming, healing and aging go on.", "New cycle",
  (more) => post("/api/cycle", more)));
byId("pause").addEventListener("click", () => pause(!state.paused));
byId("find").addEventListener("input", () => messages.show(state.messages));
document.addEventListener("keydown", (event) => {
  if (event.key === "p" && !event.target.closest("input, select, dialog") && !event.ctrlKey && !event.metaKey) pause(!state.paused);
});

const THEMES = ["auto", "light", "dark"];
function theme(name) {
  localStorage.setItem("theme", name);
  if (name === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = name;
  say(byId("theme"), `Theme: ${name}`);
  residuals.recolour();
  messages.recolour();
}
byId("theme").addEventListener("click", () => {
  theme(THEMES[(THEMES.indexOf(localStorage.getItem("theme") ?? "auto") + 1) % THEMES.length]);
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => residuals.recolour());
theme(localStorage.getItem("theme") ?? "auto");

async function begin() {
  try {
    await get("/api/history?faults=");
  } catch (error) {
    if (error.status === 401) {
      const token = prompt("Token for reading this page");
      if (token) keepToken("read", token);
    }
  }
  listen((kind, told) => takes[kind]?.(told), (why) => takes.link({ connected: false, reason: why }));
  draw();
}
begin();
