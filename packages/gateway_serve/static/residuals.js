// Residuals by ECU and monitor: those of a cause first, its lead before its symptoms, then the nearest to a fault. The
// first are plotted, others when they are opened. What is not seen is not made: there may be tens of thousands of tests.

import { get } from "/static/api.js";
import { arrange, byId, make, number, Paged, place, say } from "/static/dom.js";
import { Plot } from "/static/plot.js";
import { Nearness, Series } from "/static/series.js";

const PLOTS = 3;
const SORT_MS = 2000;
// From this many tests on only how near they came is kept of those that are not drawn, and lists are short.
const MANY = 200;
const MOST_GROUPS = 6;
const MOST_ROWS = 3;
const PAGE = 25;

export class Residuals {
  constructor() {
    this.place = byId("residuals");
    this.faults = [];
    this.groups = new Map();
    this.busy = false;
    this.told = false;  // the past
    this.sorted = -Infinity;  // at once
    this.ranks = new Map();  // fault -> place by its cause
    this.wanted = "";
    this.found = new Paged(make("ul", { class: "plain" }), PAGE);
    this.rest = folded(PAGE);
    this.list = make("div");
    for (const kind of ["pointerenter", "focusin"]) this.place.addEventListener(kind, () => (this.busy = true));
    for (const kind of ["pointerleave", "focusout"]) this.place.addEventListener(kind, () => (this.busy = false));
    this.place.addEventListener("keydown", (event) => this.move(event));
    byId("find-test").addEventListener("input", () => this.seek(byId("find-test").value));
  }

  begin(described) {
    const ids = described.map((fault) => fault.id).join();
    if (ids === this.ids) return;
    this.ids = ids;
    for (const fault of this.faults) fault.plot?.close();
    this.groups = new Map();
    this.many = described.length > MANY;
    this.faults = described.map((fault, index) => this.row(fault, index));
    this.byId = new Map(this.faults.map((row) => [row.fault.id, row]));
    byId("find-test").parentElement.hidden = described.length < PAGE;
    this.place.replaceChildren(this.found.list, this.found.more, this.list, this.rest.element);
    this.sorted = -Infinity;  // at once
  }

  row(fault, index) {
    const owner = fault.ecu ? `ECU ${fault.ecu}` : fault.monitor;
    const row = { fault, index, owner, nearest: null, open: false, chosen: null, plot: null, element: null, threshold: null };
    row.make = () => row.element ?? this.made(row);
    row.series = this.many ? null : new Series();
    row.far = this.many ? new Nearness() : null;
    if (!this.groups.has(owner)) this.groups.set(owner, newGroup(owner, this.many));
    this.groups.get(owner).rows.push(row);
    return row;
  }

  made(row) {
    const { fault, owner } = row;
    const name = fault.ecu ? fault.id.slice(fault.id.indexOf(".") + 1) : fault.id.slice(fault.monitor.length + 1);
    row.fill = make("span");
    row.bar = make("span", { class: "bar", "aria-hidden": "true" }, row.fill);
    row.near = make("span", { class: "near" }, "–");
    row.place = make("div", { class: "plot", role: "img" });
    row.readout = make("div", { class: "readout" });
    row.more = make("div", { hidden: true }, row.place, row.readout);
    // What is read out says what is seen, and more.
    row.spoken = make("span", { class: "unseen" });
    const called = make("span", { class: "called", title: fault.description }, name, make("small", {}, fault.dtc));
    row.button = make("button", { type: "button", "aria-expanded": "false", onclick: () => {
      row.chosen = !row.open;
      this.show(row, row.chosen);
    } }, make("span", { class: "unseen" }, `${owner}, `), called, row.bar, row.near, row.spoken);
    row.element = make("li", { class: "fault", "data-fault": fault.id }, row.button, row.more);
    this.meter(row);
    return row.element;
  }

  seek(text) {
    this.wanted = text.trim().toLowerCase();
    const found = this.wanted ? this.faults.filter(({ fault }) => `${fault.id} ${fault.dtc} ${fault.ecu}`.toLowerCase().includes(this.wanted)) : [];
    this.list.hidden = this.rest.element.hidden = this.wanted !== "";
    if (!this.wanted) this.sort();
    this.found.show(found);
    if (this.wanted && !found.length) this.found.list.replaceChildren(make("li", { class: "none" }, "No test of that name."));
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
    row.make();
    row.more.hidden = !open;
    row.button.setAttribute("aria-expanded", String(open));
    if (open) {
      row.series ??= new Series();
      row.plot = new Plot(row.place, row.fault.id, row.fault.unit);
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
      row.series = this.many && !row.open ? null : new Series();
      row.far &&= new Nearness();
    }
  }

  past({ faults, end }) {
    for (const [index, found] of Object.entries(faults)) {
      const row = this.faults[index];
      if (!row || row.loaded) continue;
      row.far?.load(found);
      if (!row.series) continue;
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
        row.series?.add(tick.t, low, high, threshold, ratio);
        row.far?.add(tick.t, ratio);
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
    return this.byId?.get(id)?.fdc;
  }

  redraw(view) {
    const due = performance.now() - this.sorted > SORT_MS;
    for (const row of this.faults) {
      if (!due && !row.element?.isConnected) continue;
      row.nearest = (row.far ?? row.series).nearest(view.from, view.to);
      if (row.element) this.meter(row);
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
    say(row.spoken, near === null ? " no test in this window" : " times the limit");
  }

  describe(row, part, view) {
    const [low, high] = [Math.min(...part.low), Math.max(...part.high)];
    const unit = row.fault.unit ? ` ${row.fault.unit}` : "";
    const facts = part.t.length
      ? `between ${number(low)} and ${number(high)}${unit} against ${number(row.threshold)}${unit}`
      : "no test in this window";
    row.place.setAttribute("aria-label", `${row.fault.description}: ${facts}`);
    const shown = part.t.length
      ? [`latest ${number(row.last)}${unit}`, `least ${number(low)}${unit}`, `greatest ${number(high)}${unit}`,
        `limit ${number(row.threshold)}${unit}`, `detection counter ${row.fdc ?? 0}`, "time in seconds"]
      : [`no test in the last ${view.seconds} s`];
    if (part.t.length && row.plot.beyond) shown.unshift("values beyond the axis");
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
      group.nearest = group.rows.reduce((near, row) => Math.max(near, key(row)), -1);
    }
    const groups = [...this.groups.values()].sort((a, b) => {
      const [first, second] = [rank(a.rows[0]), rank(b.rows[0])];
      return (first === second ? 0 : first - second) || b.nearest - a.nearest;
    });
    const most = this.many ? MOST_GROUPS : Infinity;
    place(this.list, groups.slice(0, most).map((group) => group.make()));
    this.rest.show(groups.slice(most), (count) => `${count} more ECUs and monitors`);
    const near = this.faults.filter((row) => row.nearest > 0).sort(before);
    // Of many that show the same, one: a dead ECU is one picture.
    const first = new Map(near.toReversed().map((row) => [`${row.owner} ${row.fault.description}`, row]));
    const wanted = new Set((this.many ? near.filter((row) => first.get(`${row.owner} ${row.fault.description}`) === row) : near).slice(0, PLOTS));
    for (const row of this.faults) {
      if (row.chosen === null) this.show(row, wanted.has(row));
    }
  }

  recolour() {
    for (const row of this.faults) row.plot?.draw();
  }
}

// A monitor, or the messages of an ECU: the tests nearest to a fault, and the others behind a click.
function newGroup(owner, many) {
  const group = { owner, rows: [], nearest: 0, element: null };
  group.make = () => {
    group.element ??= built(group, many);
    group.update();
    return group.element;
  };
  return group;
}

function built(group, many) {
  const list = make("ul", { class: "plain" });
  const others = folded(PAGE, "ul", !many);
  const near = make("span", { class: "muted" });
  group.update = () => {
    const kept = (row, k) => (row.nearest !== null && (!many || k < MOST_ROWS)) || row.chosen;
    const told = group.rows.filter(kept);
    const rest = group.rows.filter((row, k) => !kept(row, k));
    const quiet = rest.filter((row) => row.nearest === null).length;
    place(list, told.map((row) => row.make()));
    others.show(rest, (count) => (quiet < count ? `${count} more${quiet ? `, ${quiet} of them not tested in this window` : ""}`
      : told.length ? `${count} more not tested in this window` : `${count} tests, none in this window`));
    say(near, group.nearest >= 1 ? "failed in this window" : "");
  };
  const title = make("div", { class: "title" }, make("h3", {}, group.owner), near);
  return make("div", { class: "group" }, title, list, others.element);
}

// What is folded; its elements are made when it is opened, a page at a time, or at once where they are few.
function folded(page, kind = "div", eager = false) {
  const list = make(kind, { class: "plain" });
  const paged = new Paged(list, eager ? Infinity : page);
  const summary = make("summary", { class: "muted" });
  const element = make("details", { hidden: true }, summary, list, paged.more);
  let all = [];
  const update = () => {
    if (eager || element.open) paged.show(all);
  };
  element.addEventListener("toggle", update);
  return {
    element,
    show(things, text) {
      all = things;
      element.hidden = !all.length;
      say(summary, text(all.length));
      update();
    },
  };
}
