// Trouble codes: status bits, detection counter, evidence in words, freeze frames, recordings, clear.

import { get } from "/static/api.js";
import { arrange, byId, clock, make, number, parts, say } from "/static/dom.js";

const SHORT = ["failed now", "failed this cycle", "pending", "confirmed", "not tested since clear", "failed since clear",
  "not tested this cycle", "warning lamp"];
const BAD = new Set([0, 3, 7]);

export class Dtcs {
  constructor(clear) {
    this.place = byId("dtcs");
    this.clear = clear;
    this.open = new Set();
    this.rows = new Map();
  }

  show(memory, bits) {
    this.bits = bits;
    const error = byId("memory-error");
    error.hidden = !memory.error && memory.stored;
    say(error, memory.error || (memory.stored ? "" : "The fault memory cannot be written; more is known than is shown."));
    byId("clear").disabled = !memory.entries.length;
    const focused = document.activeElement?.closest?.("[data-dtc]");
    const order = [...memory.entries].sort((a, b) => (b.status & 1) - (a.status & 1) || b.last_ns - a.last_ns);
    this.rows = new Map(order.map((entry) => [entry.fault, this.kept(entry) ?? this.row(entry)]));
    const elements = order.length ? [...this.rows.values()] : [make("p", { class: "none" }, "No trouble codes.")];
    arrange(this.place, elements);
    while (this.place.children.length > elements.length) this.place.lastElementChild.remove();
    if (focused && !focused.isConnected) this.rows.get(focused.fault)?.querySelector("button").focus();
  }

  // The row that is there, where nothing of it has changed: what somebody is about to press stays under the finger.
  kept(entry) {
    const row = this.rows.get(entry.fault);
    return row?.told === JSON.stringify(entry) ? row : null;
  }

  row(entry) {
    const failing = Boolean(entry.status & 1);
    const id = `more-${entry.dtc}`;
    const more = make("div", { class: "more", id, hidden: !this.open.has(entry.dtc) });
    const state = make("span", { class: `pill ${failing ? "bad" : "warning"}` }, failing ? "failing" : "stored");
    const button = make("button", { type: "button", "aria-expanded": String(this.open.has(entry.dtc)), "aria-controls": id },
      make("span", { class: "code" }, entry.dtc), make("span", { class: "fault-name" }, ...parts(entry.fault)), state,
      make("span", { class: "what" },
        `${entry.description ?? ""} · ${entry.occurrence}× · ${clock(entry.last_ns / 1e6)}`));
    button.addEventListener("click", () => {
      more.hidden = !more.hidden;
      button.setAttribute("aria-expanded", String(!more.hidden));
      if (more.hidden) this.open.delete(entry.dtc);
      else this.open.add(entry.dtc);
    });
    const chips = SHORT.map((text, k) => make("li", {
      class: `bit${entry.status >> k & 1 ? " set" : ""}${BAD.has(k) ? " bad" : ""}`, title: `${this.bits[k]}: ${entry.status >> k & 1}`,
    }, text, make("span", { class: "unseen" }, entry.status >> k & 1 ? ": yes" : ": no")));
    const fill = make("span");
    const value = make("span", { class: "number" });
    const counter = make("div", { class: "counter-row" }, make("span", {}, "Detection counter"),
      make("span", { class: "bar plain", "aria-hidden": "true" }, fill), value);
    this.fill(more, entry);
    const element = make("article", { class: `dtc${failing ? " failing" : ""}`, "data-dtc": entry.dtc },
      button, make("ul", { class: "bits plain", "aria-label": `Status 0x${entry.status.toString(16).padStart(2, "0")}` }, ...chips),
      counter, more);
    element.counter = (fdc) => {
      fill.style.width = `${Math.max(fdc, 0) / 127 * 100}%`;
      say(value, fdc > 0 ? `+${fdc}` : String(fdc));
      fill.parentElement.classList.toggle("failed", fdc === 127);
    };
    element.fault = entry.fault;
    element.told = JSON.stringify(entry);
    return element;
  }

  fill(more, entry) {
    more.append(make("ul", {}, ...entry.words.map((text) => make("li", {}, text))));
    if (Object.keys(entry.inputs).length) more.append(table("What its monitor saw then", entry.inputs));
    for (const frame of entry.freeze_frames) {
      const which = { 1: "first failure", 2: "latest failure" }[frame.record] ?? "an earlier failure";
      const title = `Freeze frame, ${which}, ${clock(frame.t_ns / 1e6)}`;
      if (Object.keys(frame.signals).length) more.append(table(title, frame.signals));
      else more.append(make("p", { class: "muted" }, `${title}: no signals are configured for it.`));
    }
    const buttons = make("div", { class: "buttons" });
    for (let k = 1; k <= entry.recordings; k += 1) {
      const text = entry.recordings > 1 ? `Recording ${k}` : "Recording";
      buttons.append(make("button", { type: "button", onclick: () => download(entry.dtc, k) }, `${text} (candump log)`));
    }
    buttons.append(make("button", { type: "button", onclick: () => this.clear(entry.dtc) }, `Clear ${entry.dtc}`));
    more.append(buttons);
  }

  counters(residuals) {
    for (const element of this.place.children) element.counter?.(residuals.counter(element.fault) ?? 0);
  }
}

function table(title, values) {
  const rows = Object.entries(values).map(([name, value]) =>
    make("tr", {}, make("th", { scope: "row" }, ...parts(name)), make("td", { class: "number" }, number(value, 6))));
  return make("table", {}, make("caption", { class: "muted" }, title), make("tbody", {}, ...rows));
}

async function download(dtc, k) {
  const answer = await get(`/api/recording/${dtc}/${k}`);
  const url = URL.createObjectURL(await answer.blob());
  make("a", { href: url, download: `${dtc}-${k}.log` }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}
