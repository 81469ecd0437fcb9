// Messages on the buses, a page of them at a time; a signal that is pressed is plotted from then on.

import { arrange, byId, make, number, parts, say } from "/static/dom.js";
import { Plot } from "/static/plot.js";
import { Series } from "/static/series.js";

const PAGE = 20;
const MOST_PLOTS = 4;
// Classes of the cells of a row.
const CELLS = ["hide-small", "mono number", "", "number", "number hide-small", "number hide-small", "mono"];
// How often messages are told.
const PACE_MS = 1000;

export class Messages {
  constructor() {
    this.page = 0;
    this.body = make("tbody");
    this.rows = new Map();
    this.all = { messages: [], left_out: 0 };
    this.plots = new Map();  // bus, message and signal -> plot
    for (const [id, step] of [["earlier", -1], ["later", 1]]) {
      byId(id).addEventListener("click", () => {
        this.page += step;
        this.show(this.all);
      });
    }
    byId("find").addEventListener("input", () => (this.page = 0));
  }

  show(told) {
    this.all = told;
    const messages = told.messages;
    const wanted = byId("find").value.trim().toLowerCase();
    const found = messages.filter((m) => !wanted || [m.name, m.id, m.bus, m.sender, ...m.signals.map((s) => s[0])].join(" ").toLowerCase().includes(wanted));
    const pages = Math.max(Math.ceil(found.length / PAGE), 1);
    this.page = Math.min(Math.max(this.page, 0), pages - 1);
    const first = this.page * PAGE;
    byId("pager").hidden = pages === 1;
    byId("earlier").disabled = this.page === 0;
    byId("later").disabled = this.page === pages - 1;
    say(byId("page-text"), `${first + 1} to ${Math.min(first + PAGE, found.length)} of ${found.length}${told.left_out ? `; ${told.left_out} more identifiers are not told` : ""}`);
    const place = byId("messages");
    if (!found.length) {
      place.replaceChildren(make("p", { class: "none" }, messages.length ? "None of that name." : "No frames yet."));
      return;
    }
    if (!this.body.isConnected) {
      const head = ["Bus", "Id", "Message", "Period", "Least, greatest", "Count", "Signals (press one to plot it)"];
      const titles = head.map((text, k) => make("th", { scope: "col", class: CELLS[k] }, text));
      place.replaceChildren(make("table", {}, make("thead", {}, make("tr", {}, ...titles)), this.body));
    }
    const shown = found.slice(first, first + PAGE).map((m) => this.row(m));
    this.rows = new Map(shown.map((row) => [row.key, row]));
    arrange(this.body, shown);
    while (this.body.children.length > shown.length) this.body.lastElementChild.remove();
  }

  // The row that is there, with new texts: a signal about to be pressed stays under the finger.
  row(m) {
    const key = [m.bus, m.id, m.name, ...m.signals.map((signal) => signal[0])].join();
    const row = this.rows.get(key) ?? this.newRow(m, key);
    const late = m.expected_ms && m.period_ms > 1.5 * m.expected_ms;
    row.children[3].classList.toggle("warn", Boolean(late));
    say(row.children[3], m.period_ms === null ? "–" : `${number(m.period_ms, 3)} ms`);
    say(row.children[4], m.period_ms === null ? "–" : `${number(m.shortest_ms, 3)}, ${number(m.longest_ms, 3)}`);
    say(row.children[5], String(m.count));
    if (!m.signals.length) say(row.children[6], m.data);
    m.signals.forEach(([name, value, unit], k) => {
      const element = row.signals[k];
      say(element, `${name} ${typeof value === "number" ? number(value) : value ?? "–"}${unit ? ` ${unit}` : ""}`);
      element.disabled = typeof value !== "number";
      element.setAttribute("aria-pressed", String(this.plots.has(element.dataset.signal)));
    });
    return row;
  }

  newRow(m, key) {
    const signals = m.signals.map(([name, , unit]) => {
      const full = `${m.bus}.${m.name}.${name}`;
      return make("button", { type: "button", class: "signal", "data-signal": full, title: "plot it", onclick: () => this.toggle(full, unit) });
    });
    const texts = [[m.bus], [m.id], parts(m.name ?? "unknown"), [], [], [], signals];
    const row = make("tr", {}, ...texts.map((text, k) => make("td", { class: k === 6 && signals.length ? "signals" : CELLS[k] }, ...text)));
    return Object.assign(row, { key, signals });
  }

  toggle(key, unit) {
    const known = this.plots.get(key);
    if (known) this.close(key);
    else {
      if (this.plots.size >= MOST_PLOTS) this.close(this.plots.keys().next().value);
      const place = make("div", { class: "plot", role: "img", "aria-label": `${key} over time` });
      const element = make("div", { "data-plot": key }, make("p", { class: "called" }, `${key}${unit ? ` [${unit}]` : ""}`), place);
      byId("signal-plots").append(element);
      this.plots.set(key, { element, series: new Series(), plot: new Plot(place, key, unit) });
      this.take(this.all, this.latest);
    }
    this.show(this.all);
  }

  close(key) {
    const { plot, element } = this.plots.get(key);
    plot.close();
    element.remove();
    this.plots.delete(key);
  }

  // Keeps the latest values of what is plotted; t: the gateway's time [ms].
  take(told, t) {
    this.latest = t;
    if (!this.plots.size) return;
    for (const m of told.messages) {
      for (const [name, value] of m.signals) {
        const plotted = this.plots.get(`${m.bus}.${m.name}.${name}`);
        if (plotted && typeof value === "number") plotted.series.add(t, value, value, NaN, 0);
      }
    }
  }

  redraw(view) {
    for (const { series, plot } of this.plots.values()) {
      const part = Object.assign(series.between(view.from, view.to), { width: PACE_MS });
      plot.update(part, view.zero, view.from, view.to);
    }
  }

  recolour() {
    for (const { plot } of this.plots.values()) plot.draw();
  }
}
