// The columns of one residual: 50 ms for a minute, 500 ms for ten; least and greatest value of each are exact.

const FIELDS = ["t", "low", "high", "threshold", "ratio"];
const FINE_MS = 62000;
const COARSE_MS = 605000;
const COLUMN_MS = 500;

const columns = () => Object.fromEntries(FIELDS.map((name) => [name, []]));

export class Series {
  fine = columns();
  coarse = columns();

  load(found) {
    for (const name of ["fine", "coarse"]) {
      const mine = this[name];
      const before = mine.t.length ? mine.t[0] : Infinity;
      const old = found[name].t.findIndex((t) => t >= before);
      const count = old < 0 ? found[name].t.length : old;
      for (const field of FIELDS) mine[field] = found[name][field].slice(0, count).concat(mine[field]);
    }
  }

  add(t, low, high, threshold, ratio) {
    push(this.fine, t, low, high, threshold, ratio);
    const c = this.coarse;
    const end = c.t.length - 1;
    if (end >= 0 && Math.floor(c.t[end] / COLUMN_MS) === Math.floor(t / COLUMN_MS)) {
      c.t[end] = t;
      c.low[end] = Math.min(c.low[end], low);
      c.high[end] = Math.max(c.high[end], high);
      c.threshold[end] = threshold;
      c.ratio[end] = Math.max(c.ratio[end], ratio);
    } else {
      push(c, t, low, high, threshold, ratio);
    }
    trim(this.fine, t - FINE_MS);
    trim(c, t - COARSE_MS);
  }

  // The columns between two times [ms], and how wide they are.
  between(from, to) {
    const fine = to - from <= 61000 && (!this.coarse.t.length || from >= (this.fine.t[0] ?? Infinity) - 1000);
    const kept = fine || to - from <= 61000 ? this.fine : this.coarse;
    const first = lower(kept.t, from);
    const end = lower(kept.t, to + 1);
    const part = Object.fromEntries(FIELDS.map((name) => [name, kept[name].slice(first, end)]));
    part.width = kept === this.fine ? 50 : COLUMN_MS;
    return part;
  }

  nearest(from, to) {
    const part = this.between(from, to).ratio;
    return part.length ? part.reduce((a, b) => Math.max(a, b), 0) : null;
  }
}

function push(kept, ...values) {
  FIELDS.forEach((name, k) => kept[name].push(values[k]));
}

function trim(kept, before) {
  if (kept.t.length && kept.t[0] < before - 3000) {
    const count = lower(kept.t, before);
    for (const name of FIELDS) kept[name].splice(0, count);
  }
}

function lower(times, t) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < t) low = middle + 1;
    else high = middle;
  }
  return low;
}
