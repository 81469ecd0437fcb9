// Small helpers: elements from texts, never from markup.

export function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

// A name of parts, which may be broken between them.
export function parts(text) {
  return text.split(/(?<=[._])/).flatMap((part, k) => (k ? [document.createElement("wbr"), part] : [part]));
}

// Puts elements first in their parent, in this order; those that are there already are not touched.
export function arrange(parent, elements) {
  elements.forEach((element, k) => {
    if (parent.children[k] !== element) parent.insertBefore(element, parent.children[k] ?? null);
  });
}

// Has a parent have these elements, and no others.
export function place(parent, elements) {
  arrange(parent, elements);
  while (parent.children.length > elements.length) parent.lastElementChild.remove();
}

// A list of which the first elements are there; more are made when they are asked for. Things have make().
export class Paged {
  constructor(list, most) {
    Object.assign(this, { list, most, page: most, all: [] });
    this.more = make("button", { type: "button", class: "further", hidden: true, onclick: () => {
      this.most += 2 * this.page;
      this.show(this.all);
    } });
  }

  show(all) {
    this.all = all;
    place(this.list, all.slice(0, this.most).map((each) => each.make()));
    this.more.hidden = all.length <= this.most;
    if (!this.more.hidden) say(this.more, `${all.length - this.most} more`);
  }
}

export const byId = (id) => document.getElementById(id);

// Sets a text only where it changed: screen readers and selections stay calm.
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return Number(value.toPrecision(digits)).toLocaleString("en", { maximumSignificantDigits: digits, useGrouping: false });
}

// A gateway's time [ms]: the clock's, or seconds of a simulation.
export function clock(ms) {
  if (ms === null || ms === undefined) return "–";
  if (ms < 1e11) return `${(ms / 1000).toFixed(3)} s`;
  const date = new Date(ms);
  const two = (n, width = 2) => String(n).padStart(width, "0");
  return `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}.${two(date.getMilliseconds(), 3)}`;
}
