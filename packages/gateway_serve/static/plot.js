// One residual over time: a column for each bucket, from its least to its greatest value, and the limit.

let loaded = null;

// Loads what draws, once: after the verdict is there, for it is large.
export function drawing() {
  const script = (src) => new Promise((done, failed) => {
    document.head.append(Object.assign(document.createElement("script"), { src, onload: done, onerror: failed }));
  });
  loaded ??= script("/bokeh/bokeh.min.js").then(() => script("/bokeh/bokeh-api.min.js"));
  return loaded;
}

// Times the limit at which an axis ends.
const FAR = 10;

const colour = (name) => {
  const probe = document.createElement("span");
  probe.style.color = `var(--${name})`;
  document.body.append(probe);
  const found = getComputedStyle(probe).color;
  probe.remove();
  return found;
};

export class Plot {
  constructor(place, title, unit = "") {
    this.unit = unit;
    this.place = place;
    this.title = title;
    this.source = new globalThis.Bokeh.ColumnDataSource({ data: { x: [], low: [], high: [], width: [], colour: [] } });
    this.limit = new globalThis.Bokeh.ColumnDataSource({ data: { x: [], y: [] } });
    this.x = new globalThis.Bokeh.Range1d({ start: -30, end: 0 });
    this.y = new globalThis.Bokeh.Range1d({ start: 0, end: 1 });
    this.draw();
  }

  async draw() {
    const ink = colour("muted");
    this.good = colour("band");
    this.bad = colour("bad");
    const edge = colour("edge");
    const figure = globalThis.Bokeh.Plotting.figure({
      height: 160, sizing_mode: "stretch_width", tools: "", toolbar_location: null, x_range: this.x, y_range: this.y,
      background_fill_color: null, border_fill_color: null, outline_line_color: null, min_border: 4, min_border_left: 56,  // times are below each other then
      name: this.title,
    });
    for (const axis of [...figure.xaxis, ...figure.yaxis]) {
      axis.axis_line_color = edge;
      axis.major_tick_line_color = edge;
      axis.minor_tick_line_color = null;
      axis.major_label_text_color = ink;
      axis.axis_label_text_color = ink;
      axis.major_label_text_font = axis.axis_label_text_font = "system-ui, sans-serif";
      axis.major_label_text_font_size = axis.axis_label_text_font_size = "12px";
      axis.axis_label_text_font_style = "normal";
      axis.axis_label_standoff = 2;
    }
    for (const grid of [...figure.xgrid, ...figure.ygrid]) grid.grid_line_color = edge;
    figure.vbar({
      x: { field: "x" }, width: { field: "width" }, top: { field: "high" }, bottom: { field: "low" },
      fill_color: { field: "colour" }, line_color: { field: "colour" }, line_width: 1.4, fill_alpha: 0.75, source: this.source,
    });
    figure.line({
      x: { field: "x" }, y: { field: "y" }, line_color: this.bad, line_dash: [6, 4], line_width: 1.8, source: this.limit,
    });
    for (const axis of figure.yaxis) axis.axis_label = this.unit || null;
    this.view?.remove?.();
    this.place.replaceChildren();
    this.view = await globalThis.Bokeh.Plotting.show(figure, this.place);
  }

  // Columns as Series.between gives them; times relative to zero [ms].
  update(part, zero, from, to) {
    // A column begins where the one before it ended: on a busy machine a look comes late, and says more.
    const spans = part.t.map((t, k) => {
      const gap = k ? t - part.t[k - 1] : part.width;
      return gap < 8 * part.width ? gap : part.width;
    });
    const seconds = part.t.map((t, k) => (t - zero - spans[k] / 2) / 1000);
    const colours = part.ratio.map((ratio) => (ratio >= 1 ? this.bad : this.good));
    const width = spans.map((span) => span / 1000);
    this.x.setv({ start: (from - zero) / 1000, end: (to - zero) / 1000 });
    const limits = part.threshold.filter(Number.isFinite);
    let least = Math.min(...part.low, ...limits);
    let most = Math.max(...part.high, ...limits);
    // A limit is to be seen beside values that are far beyond it: the axis ends before these, and the line below says so.
    const end = FAR * Math.max(...limits.map(Math.abs));
    this.beyond = end > 0 && Math.max(Math.abs(least), Math.abs(most)) > end;
    if (this.beyond) [least, most] = [Math.max(least, -end), Math.min(most, end)];
    if (Number.isFinite(least)) {
      const room = (most - least || Math.abs(most) || 1) * 0.08;
      const [low, high] = [least - room, most + room];
      // Only where it is needed: an axis that moves with each value cannot be read.
      const span = this.y.end - this.y.start;
      if (low < this.y.start || high > this.y.end || high - low < span * 0.6) this.y.setv({ start: low, end: high });
    }
    const [low, high] = this.beyond ? [part.low.map((y) => Math.max(Math.min(y, 0.97 * end), -end)), part.high.map((y) => Math.max(Math.min(y, end), -0.97 * end))]
      : [part.low, part.high];
    this.source.data = { x: seconds, low, high, width, colour: colours };
    this.limit.data = { x: seconds, y: part.threshold };
  }

  close() {
    this.view?.remove?.();
    this.place.replaceChildren();
  }
}
