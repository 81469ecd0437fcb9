// The columns of one residual: 50 ms for a minute, 500 ms for ten; least and greatest value of each are exact.

const FIELDS = ["t", "low", "high", "threshold", "ratio"];
const FINE_MS = 62000;
const COARSE_MS = 605000;
const COLUMN_MS = 500;
const FAR_MS = 5000;

const columns = () => Object.fromEntries(FIELDS.map((name) => [name, []]));

export class Series {
  fine = columns();
  coarse = columns();

  // What the server has kept goes before what has come since.
  load(found) {
    const [fine, coarse] = [unpacked(found.fine), unpacked(found.coarse)];
    const began = this.fine.t[0] ?? Infinity;
    // A coarse column is told when it is full; the beginning of the next one is in fine ones.
    for (let k = lower(fine.t, (coarse.t.at(-1) ?? -Infinity) + 1); fine.t[k] < began; k++) {
      widen(coarse, ...FIELDS.map((name) => fine[name][k]));
    }
    for (const [mine, told] of [[this.fine, fine], [this.coarse, coarse]]) {
      const count = lower(told.t, mine.t[0] ?? Infinity);
      for (const name of FIELDS) mine[name] = told[name].slice(0, count).concat(mine[name]);
    }
  }

  add(t, low, high, threshold, ratio) {
    push(this.fine, t, low, high, threshold, ratio);
    widen(this.coarse, t, low, high, threshold, ratio);
    trim(this.fine, t - FINE_MS);
    trim(this.coarse, t - COARSE_MS);
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

// How near one test came to its limit, in columns of 5 s: what is kept of tests that are not drawn, where there are many.
export class Nearness {
  slots = [];
  ratios = [];

  add(t, ratio) {
    const slot = Math.floor(t / FAR_MS);
    const end = this.slots.length - 1;
    if (this.slots[end] === slot) {
      this.ratios[end] = Math.max(this.ratios[end], ratio);
      return;
    }
    this.slots.push(slot);
    this.ratios.push(ratio);
    if (this.slots.length > COARSE_MS / FAR_MS) {
      this.slots.shift();
      this.ratios.shift();
    }
  }

  // What the server has kept goes before what has come since.
  load(found) {
    const { t, ratio } = unpacked(found.coarse);
    const [slots, ratios] = [this.slots, this.ratios];
    [this.slots, this.ratios] = [[], []];
    t.forEach((time, k) => this.add(time, ratio[k]));
    slots.forEach((slot, k) => this.add(slot * FAR_MS, ratios[k]));
  }

  nearest(from, to) {
    let best = null;
    for (let k = this.slots.length - 1; k >= 0 && (this.slots[k] + 1) * FAR_MS > from; k--) {
      if (this.slots[k] * FAR_MS <= to) best = Math.max(best ?? 0, this.ratios[k]);
    }
    return best;
  }
}

// Columns as the server packs them: base64 of float64, all times, then all least values, and so on.
function unpacked(text) {
  const all = new Float64Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
  const count = all.length / FIELDS.length;
  return Object.fromEntries(FIELDS.map((name, k) => [name, [...all.subarray(k * count, (k + 1) * count)]]));
}

// Add to the last column if it is of the same half second, else begin another.
function widen(kept, t, low, high, threshold, ratio) {
  const end = kept.t.length - 1;
  if (end < 0 || Math.floor(kept.t[end] / COLUMN_MS) !== Math.floor(t / COLUMN_MS)) {
    push(kept, t, low, high, threshold, ratio);
    return;
  }
  kept.t[end] = t;
  kept.low[end] = Math.min(kept.low[end], low);
  kept.high[end] = Math.max(kept.high[end], high);
  kept.threshold[end] = threshold;
  kept.ratio[end] = Math.max(kept.ratio[end], ratio);
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
