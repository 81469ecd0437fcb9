// Causes, and the trouble codes that each explains; of a code: status bits, detection counter, evidence in words, freeze
// frames, recordings, clear.

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
    this.cases = new Map();
    this.unfolded = new Set();
  }

  show(memory, bits) {
    this.bits = bits;
    const error = byId("memory-error");
    error.hidden = !memory.error && memory.stored;
    say(error, memory.error || (memory.stored ? "" : "The fault memory cannot be written; more is known than is shown."));
    byId("clear").disabled = !memory.entries.length;
    const focused = document.activeElement?.closest?.("[data-dtc]");
    this.rows = new Map(memory.entries.map((entry) => [entry.fault, this.kept(entry) ?? this.row(entry)]));
    const elements = memory.cases.map((told) => this.case(told));
    this.cases = new Map(elements.map((element) => [element.key, element]));
    place(this.place, elements.length ? elements : [make("p", { class: "none" }, "No trouble codes.")]);
    if (focused && !focused.isConnected) this.rows.get(focused.fault)?.querySelector("button").focus();
  }

  // A cause with the code that stands for it; the others are folded below. A cause that is not proven folds nothing.
  case(told) {
    const key = `${told.proven} ${told.proven ? told.components.join() : told.faults.join()}`;
    const element = this.cases.get(key) ?? this.newCase(key);
    element.className = `case${told.proven ? " proven" : ""}${told.failing ? " failing" : ""}`;
    say(element.head, told.text);
    element.head.hidden = !told.text;
    const rows = told.faults.map((fault) => this.rows.get(fault));
    const folds = told.proven && rows.length > 1;
    place(element.list, folds ? rows.slice(0, 1) : rows);
    place(element.folded, folds ? rows.slice(1) : []);
    element.more.hidden = !folds;
    say(element.summary, `${rows.length - 1} more that it explains`);
    return element;
  }

  newCase(key) {
    const [head, list, folded] = [make("h3", { class: "cause" }), make("div"), make("div")];
    const summary = make("summary", { class: "muted" });
    const more = make("details", { open: this.unfolded.has(key) }, summary, folded);
    more.addEventListener("toggle", () => (more.open ? this.unfolded.add(key) : this.unfolded.delete(key)));
    return Object.assign(make("section", {}, head, list, more), { key, head, list, folded, summary, more });
  }

  // The row that is there, where nothing of it has changed: a button about to be pressed stays under the finger.
  kept(entry) {
    const row = this.rows.get(entry.fault);
    return row?.told === JSON.stringify(entry) ? row : null;
  }

  row(entry) {
    const failing = Boolean(entry.status & 1);
    const id = `more-${entry.dtc}`;
    const more = make("div", { class: "more", id, hidden: !this.open.has(entry.dtc) });
    const state = make("span", { class: `pill ${failing ? "bad" : "warning"}` }, `${failing ? "failing" : "stored"}${entry.hold === "held" ? ", held" : ""}`);
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
    for (const element of this.rows.values()) element.counter(residuals.counter(element.fault) ?? 0);
  }
}

// Has a parent have these elements, and no others.
function place(parent, elements) {
  arrange(parent, elements);
  while (parent.children.length > elements.length) parent.lastElementChild.remove();
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
