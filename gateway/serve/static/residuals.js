// Residuals by monitor: those of a cause first, its lead before its symptoms, then the nearest to a fault. The
// first are plotted, others when they are opened.

import { get } from "/static/api.js";
import { arrange, byId, make, number, say } from "/static/dom.js";
import { Plot } from "/static/plot.js";
import { Series } from "/static/series.js";

const PLOTS = 3;
const SORT_MS = 2000;

export class Residuals {
  constructor() {
    this.place = byId("residuals");
    this.faults = [];
    this.groups = new Map();
    this.busy = false;
    this.told = false;  // the past
    this.sorted = -Infinity;  // at once
    this.ranks = new Map();  // fault -> place by its cause
    for (const kind of ["pointerenter", "focusin"]) this.place.addEventListener(kind, () => (this.busy = true));
    for (const kind of ["pointerleave", "focusout"]) this.place.addEventListener(kind, () => (this.busy = false));
    this.place.addEventListener("keydown", (event) => this.move(event));
  }

  begin(described) {
    const ids = described.map((fault) => fault.id).join();
    if (ids === this.ids) return;
    this.ids = ids;
    for (const fault of this.faults) fault.plot?.close();
    this.groups = new Map();
    this.faults = described.map((fault, index) => this.row(fault, index));
    this.place.replaceChildren(...[...this.groups.values()].map((group) => group.element));
    this.sorted = -Infinity;  // at once
  }

  row(fault, index) {
    let group = this.groups.get(fault.monitor);
    if (!group) {
      const list = make("ul", { class: "plain" });
      const quiet = make("ul", { class: "plain" });
      const summary = make("summary", { class: "muted" }, "tests");
      const others = make("details", {}, summary, quiet);
      const near = make("span", { class: "muted" });
      const title = make("div", { class: "title" }, make("h3", {}, fault.monitor), near);
      group = { element: make("div", { class: "group" }, title, list, others), list, quiet, summary, others, near, rows: [], nearest: 0 };
      this.groups.set(fault.monitor, group);
    }
    const name = fault.id.slice(fault.monitor.length + 1);
    const fill = make("span");
    const bar = make("span", { class: "bar", "aria-hidden": "true" }, fill);
    const near = make("span", { class: "near" }, "–");
    const plot = make("div", { class: "plot", role: "img" });
    const readout = make("div", { class: "readout" });
    const more = make("div", { hidden: true }, plot, readout);
    // What is read out says what is seen, and more.
    const [of, spoken] = [make("span", { class: "unseen" }, `${fault.monitor}, `), make("span", { class: "unseen" })];
    const called = make("span", { class: "called", title: fault.description }, name, make("small", {}, fault.dtc));
    const button = make("button", { type: "button", "aria-expanded": "false" }, of, called, bar, near, spoken);
    const element = make("li", { class: "fault", "data-fault": fault.id }, button, more);
    const row = { fault, index, group, element, button, bar, fill, near, spoken, more, place: plot, readout,
      series: new Series(), nearest: null, open: false, chosen: null, plot: null };
    button.addEventListener("click", () => {
      row.chosen = !row.open;
      this.show(row, row.chosen);
    });
    group.rows.push(row);
    group.quiet.append(element);
    return row;
  }

  move(event) {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step || event.target.tagName !== "BUTTON") return;
    const buttons = [...this.place.querySelectorAll(".fault > button")];
    buttons[buttons.indexOf(event.target) + step]?.focus();
    event.preventDefault();
  }

  show(row, open) {
    if (row.open === open) return;
    row.open = open;
    row.more.hidden = !open;
    row.button.setAttribute("aria-expanded", String(open));
    if (open) {
      row.plot = new Plot(row.place, row.fault.id);
      this.load(row);
    } else {
      row.plot.close();
      row.plot = null;
    }
  }

  // Asks for the past of a fault that the stream did not bring: it brings those that are nearest to a failure.
  async load(row) {
    if (row.loaded || !this.told) return;
    row.loaded = true;
    const series = row.series;  // there may be another by the time of the answer
    try {
      const found = await (await get(`/api/history?faults=${row.index}`)).json();
      series.load(found[row.index]);
    } catch {
      row.loaded = false;
    }
  }

  // Takes the cases that fail, in the order in which they are to be read.
  rank(cases) {
    const faults = cases.filter((each) => each.failing).flatMap((each) => each.faults);
    if (faults.join() === [...this.ranks.keys()].join()) return;
    this.ranks = new Map(faults.map((fault, place) => [fault, place]));
    this.sorted = -Infinity;  // at once
  }

  // Before a page's first tick, and after the server has started again.
  forget() {
    this.told = false;
    for (const row of this.faults) {
      row.loaded = false;
      row.series = new Series();
    }
  }

  past({ faults, end }) {
    for (const [index, found] of Object.entries(faults)) {
      const row = this.faults[index];
      if (!row || row.loaded) continue;
      row.loaded = true;
      row.series.load(found);
    }
    this.sorted = -Infinity;  // at once
    if (!end) return;
    this.told = true;
    for (const row of this.faults) if (row.open) this.load(row);
  }

  tick(tick) {
    for (const [index, fdc, count, failed, low, high, last, threshold, ratio, worst, numbers] of tick.rows) {
      const row = this.faults[index];
      if (!row) continue;
      row.fdc = fdc;
      if (numbers) {
        row.series.add(tick.t, low, high, threshold, ratio);
        Object.assign(row, { last, threshold });
      }
    }
  }

  // What was known when the page came, before the next tick.
  now(latest) {
    for (const { fault, fdc, value, threshold } of latest) {
      if (this.faults[fault]) Object.assign(this.faults[fault], { fdc, last: value, threshold });
    }
  }

  counter(id) {
    return this.faults.find((row) => row.fault.id === id)?.fdc;
  }

  redraw(view) {
    const due = performance.now() - this.sorted > SORT_MS;
    for (const row of this.faults) {
      row.nearest = row.series.nearest(view.from, view.to);
      this.meter(row);
    }
    if (due && !this.busy) this.sort();
    for (const row of this.faults) {
      if (!row.plot) continue;
      const part = row.series.between(view.from, view.to);
      row.plot.update(part, view.zero, view.from, view.to);
      this.describe(row, part, view);
    }
  }

  meter(row) {
    const near = row.nearest;
    row.fill.style.width = `${Math.min(near ?? 0, 1.5) / 1.5 * 100}%`;
    row.bar.className = `bar${near >= 1 ? " failed" : near >= 0.8 ? " near-limit" : ""}`;
    say(row.near, near === null ? "–" : near >= 10 ? "> 10" : near.toFixed(2));
    say(row.spoken, near === null ? " no test in this window" : " of what is allowed");
  }

  describe(row, part, view) {
    const [low, high] = [Math.min(...part.low), Math.max(...part.high)];
    const facts = part.t.length
      ? `between ${number(low)} and ${number(high)} against ${number(row.threshold)}`
      : "no test in this window";
    row.place.setAttribute("aria-label", `${row.fault.description}: ${facts}`);
    const shown = part.t.length
      ? [`latest ${number(row.last)}`, `least ${number(low)}`, `greatest ${number(high)}`, `limit ${number(row.threshold)}`,
        `detection counter ${row.fdc ?? 0}`, "time in seconds"]
      : [`no test in the last ${view.seconds} s`];
    say(row.readout, shown.join(" · "));
  }

  sort() {
    this.sorted = performance.now();
    const key = (row) => row.nearest ?? -1;
    const rank = (row) => this.ranks.get(row.fault.id) ?? Infinity;
    const before = (a, b) => {
      const [first, second] = [rank(a), rank(b)];
      return (first === second ? 0 : first - second) || key(b) - key(a) || a.index - b.index;
    };
    for (const group of this.groups.values()) {
      group.rows.sort(before);
      const quiet = group.rows.filter((row) => row.nearest === null && !row.chosen);
      const told = group.rows.filter((row) => !quiet.includes(row));
      arrange(group.list, told.map((row) => row.element));
      arrange(group.quiet, quiet.map((row) => row.element));
      group.others.hidden = !quiet.length;
      say(group.summary, told.length ? `${quiet.length} more not tested in this window` : `${quiet.length} tests, none in this window`);
      group.nearest = Math.max(...group.rows.map(key));
      say(group.near, group.nearest >= 1 ? "failed in this window" : "");
    }
    const groups = [...this.groups.values()].sort((a, b) => {
      const [first, second] = [rank(a.rows[0]), rank(b.rows[0])];
      return (first === second ? 0 : first - second) || b.nearest - a.nearest;
    });
    arrange(this.place, groups.map((group) => group.element));
    const wanted = new Set([...this.faults].filter((row) => row.nearest > 0)
      .sort(before).slice(0, PLOTS));
    for (const row of this.faults) {
      if (row.chosen === null) this.show(row, wanted.has(row));
    }
  }

  recolour() {
    for (const row of this.faults) row.plot?.draw();
  }
}
