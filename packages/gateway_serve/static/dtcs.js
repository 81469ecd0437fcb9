// Causes, and the trouble codes that each explains; of a code: status bits, detection counter, evidence in words, freeze
// frames, recordings, clear.

import { get } from "/static/api.js";
import { byId, clock, make, number, Paged, parts, place, say } from "/static/dom.js";

const SHORT = ["failed now", "failed this cycle", "pending", "confirmed", "not tested since clear", "failed since clear",
  "not tested this cycle", "warning lamp"];
const BAD = new Set([0, 3, 7]);
// Causes, and codes of one cause, of which more wait until they are asked for.
const PAGE = 10;

export class Dtcs {
  constructor(clear) {
    this.causes = new Paged(byId("dtcs"), PAGE);
    byId("dtcs").after(this.causes.more);
    this.clear = clear;
    this.open = new Set();
    this.entries = new Map();
    this.rows = new Map();
    this.cases = new Map();
    this.unfolded = new Set();
    byId("find-code").addEventListener("input", () => this.showCases());
  }

  show(memory, bits) {
    this.bits = bits;
    const error = byId("memory-error");
    error.hidden = !memory.error && memory.stored;
    say(error, memory.error || (memory.stored ? "" : "The fault memory cannot be written; more is known than is shown."));
    byId("clear").disabled = !memory.entries.length;
    byId("find-code").parentElement.hidden = memory.entries.length <= PAGE;
    const focused = document.activeElement?.closest?.("[data-dtc]");
    this.entries = new Map(memory.entries.map((entry) => [entry.fault, entry]));
    for (const fault of this.rows.keys()) if (!this.entries.has(fault)) this.rows.delete(fault);
    this.told = memory.summary.causes;
    this.showCases();
    if (focused && !focused.isConnected) this.rows.get(focused.fault)?.querySelector("button").focus();
  }

  showCases() {
    const wanted = byId("find-code").value.trim().toLowerCase();
    const fits = (entry) => `${entry.dtc} ${entry.fault} ${entry.description}`.toLowerCase().includes(wanted);
    const things = wanted ? [...this.entries.values()].filter(fits).map((entry) => ({ make: () => this.rowOf(entry.fault) }))
      : this.told.map((told) => ({ make: () => this.case(told) }));
    const none = { make: () => make("p", { class: "none" }, wanted ? "No code of that name." : "No trouble codes.") };
    this.causes.show(things.length ? things : [none]);
    const keys = new Set(this.told.map(keyOf));
    for (const key of this.cases.keys()) if (!keys.has(key)) this.cases.delete(key);
  }

  // A cause with the code that stands for it; the others are folded below. A cause that is not proven folds only many.
  case(told) {
    const key = keyOf(told);
    if (!this.cases.has(key)) this.cases.set(key, this.newCase(key));
    const element = this.cases.get(key);
    element.className = `case${told.proven ? " proven" : ""}${told.failing ? " failing" : ""}`;
    say(element.head, told.text || (told.faults.length > PAGE ? told.symptoms[0].text : ""));
    element.head.hidden = !element.head.textContent;
    const faults = told.faults.map((fault) => ({ make: () => this.rowOf(fault) }));
    const folds = faults.length > (told.proven ? 1 : PAGE);
    place(element.list, (folds ? faults.slice(0, 1) : faults).map((each) => each.make()));
    element.more.hidden = !folds;
    element.told = folds ? faults.slice(1) : [];
    element.update();
    const kinds = told.symptoms.filter((kind) => kind.count > 3).map((kind) => kind.text);
    say(element.summary, `${faults.length - 1} more${told.proven ? " that it explains" : ""}${kinds.length ? `; in all ${kinds.join("; ")}` : ""}`);
    return element;
  }

  newCase(key) {
    const [head, list, folded] = [make("h3", { class: "cause" }), make("div"), make("div")];
    const [summary, paged] = [make("summary", { class: "muted" }), new Paged(folded, PAGE)];
    const more = make("details", { open: this.unfolded.has(key) }, summary, folded, paged.more);
    const element = Object.assign(make("section", {}, head, list, more), { key, head, list, folded, summary, more, told: [] });
    element.update = () => {
      if (more.open || element.told.length < PAGE) paged.show(element.told);
    };
    more.addEventListener("toggle", () => {
      if (more.open) this.unfolded.add(key);
      else this.unfolded.delete(key);
      element.update();
    });
    return element;
  }

  // The row that is there, where nothing of it has changed: a button about to be pressed stays under the finger.
  rowOf(fault) {
    const entry = this.entries.get(fault);
    const row = this.rows.get(fault);
    if (row?.told === JSON.stringify(entry)) return row;
    this.rows.set(fault, this.row(entry));
    return this.rows.get(fault);
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

const keyOf = (told) => `${told.proven} ${told.proven ? told.components.join() : told.faults[0]}`;

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
