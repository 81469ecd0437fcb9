// Buses, operation cycle and events.

import { byId, clock, make, number, Paged, parts, say } from "/static/dom.js";

const fact = (name, value) => make("span", {}, `${name} `, make("b", {}, value));

export function showBuses(buses) {
  byId("buses").replaceChildren(...buses.map((bus) => {
    const open = bus.state === "open";
    const fill = make("span");
    const load = make("span", { class: `bar plain${bus.load > 0.9 ? " failed" : bus.load > 0.7 ? " near-limit" : ""}`,
      "aria-hidden": "true" }, fill);
    fill.style.width = `${Math.min(bus.load ?? 0, 1) * 100}%`;
    const errors = Object.entries(bus.errors).filter(([name]) => name !== "lost").map(([name, count]) => `${name} ${count}`);
    const facts = [
      bus.load === null ? fact("load", bus.bitrate ? "–" : "bit rate not configured") : fact("load", `${(bus.load * 100).toFixed(1)} %`),
      bus.kbit_per_s === null ? null : fact("", `${number(bus.kbit_per_s, 3)} kbit/s`),
      bus.frames_per_s === null ? null : fact("", `${number(bus.frames_per_s, 4)} frames/s`),
      ...[["received", "received"], ["sent", "sent"], ["frames lost", "overflow"], ["times lost", "losses"]]
        .filter(([, key]) => key in bus).map(([name, key]) => fact(name, String(bus[key]))),
      bus.activity ? fact("", bus.activity) : null,
      fact("errors", errors.join(", ") || "none"),
    ];
    if (bus.filtered) facts.push(make("span", {}, "load of the received frames only"));
    const state = make("span", { class: `pill ${open ? "good" : "bad"}` }, bus.state ?? "unknown");
    return make("div", { class: "bus" }, make("div", { class: "line" }, make("h3", {}, bus.bus), state),
      make("p", { class: "muted mono" }, bus.reason || bus.uri || ""), bus.load === null ? null : load,
      make("div", { class: "facts" }, ...facts.filter((each) => each)));
  }));
}

const table = (titles, rows) => make("table", {}, make("thead", {}, make("tr", {}, ...titles.map((text) => make("th", { scope: "col" }, text)))),
  make("tbody", {}, ...rows));

// Other ECUs: how they answer, and their trouble codes.
export function showVehicle(ecus, dtcs) {
  byId("vehicle-card").hidden = !ecus.length && !dtcs.length;
  const answers = ecus.map((ecu) => make("tr", {}, make("th", { scope: "row" }, ecu.ecu),
    make("td", {}, { obd: "classic", obd_on_uds: "on UDS" }[ecu.speaks] ?? "-"), ...["requests", "answers", "refused", "absent", "yielded"].map((name) => make("td", { class: "number" }, String(ecu[name]))),
    make("td", {}, Object.entries(ecu.not_asked).map(([request, why]) => `${request}: ${why}`).join("; "))));
  byId("ecus").replaceChildren(...(answers.length ? [table(["ECU", "OBD", "Requests", "Answers", "Refused", "No answer", "Gave way", "Not asked any more"], answers)] : []));
  const rows = dtcs.map((each) => make("tr", {}, make("th", { scope: "row" }, each.ecu), make("td", { class: "mono" }, each.dtc),
    make("td", {}, make("span", { class: `pill ${each.there ? "bad" : "good"}` }, each.there ? "there" : "went")),
    make("td", { class: "mono" }, `0x${each.status.toString(16).toUpperCase().padStart(2, "0")}`), make("td", { class: "number" }, String(each.came)),
    make("td", {}, clock(each.first_ns / 1e6)), make("td", {}, clock(each.last_ns / 1e6))));
  byId("vehicle").replaceChildren(rows.length ? table(["ECU", "DTC", "State", "Status", "Came", "First", "Last"], rows)
    : make("p", { class: "none" }, "No trouble codes of other ECUs."));
}

const readiness = new Paged(make("tbody"), 8);

export function showCycle(memory) {
  const cycles = Object.entries(memory.cycles).map(([name, c]) => `${name}: number ${c.number}, ${c.open ? "running" : "ended"}`);
  if (memory.restarts.count) cycles.push(`restarts after a death: ${memory.restarts.count}, ${memory.restarts.in_a_row} in a row`);
  say(byId("cycle-text"), cycles.join("; ") || "unknown");
  const rows = memory.readiness.map((row) => ({ make: () => {
    const ready = row.this_cycle === row.tests;
    return make("tr", {}, make("th", { scope: "row" }, ...parts(row.monitor)),
      make("td", { class: "number" }, `${row.this_cycle} of ${row.tests}`),
      make("td", { class: "number" }, `${row.since_clear} of ${row.tests}`),
      make("td", {}, make("span", { class: `pill ${ready ? "good" : ""}` }, ready ? "ready" : "not yet")));
  } }));
  const titles = ["Monitor", "This cycle", "Since clear", ""].map((t, k) => make("th", { scope: "col", class: k && k < 3 ? "number" : "" }, t || make("span", { class: "unseen" }, "Ready")));
  byId("readiness").replaceChildren(make("table", {}, make("thead", {}, make("tr", {}, ...titles)), readiness.list), readiness.more);
  readiness.show(rows);
}

export function textOf(event) {
  switch (event.event) {
    case "dtc": return `${event.dtc} ${event.status & 1 ? "failed" : "healed"}: ${event.fault}`;
    case "diagnosis": return told(event.groups);
    case "symptoms": return `symptoms ${event.state}: ${few(event.faults)}`;
    case "ecu_dtc": return `ECU ${event.ecu}: ${event.dtc} ${event.state}`;
    case "security": return `security: ${event.kind} (${event.count}) seen by ${event.sensor}`;
    case "clear": return `cleared: ${few(event.faults) || "no entry was there"}`;
    case "cycle": return `operation cycle ${event.cycle} ${event.state} (${event.number})`;
    case "intervention": return `${event.protocol === "local" ? "this machine" : `tester ${event.protocol}`}: ${event.action}${event.outcome === "done" ? "" : ", refused"}`;
    case "bus": return `bus ${event.bus} ${event.state}${event.reason ? `: ${event.reason}` : ""}`;
    case "activity": return `bus ${event.bus} ${event.activity}`;
    case "other_software": {
      const is = event.what === "timeout" ? "never came" : `${event.what} ${event.now}, as checked ${event.learned}`;
      return `${event.bus}.${event.message}: ${is}: another software of its ECU`;
    }
    case "lossy": return `bus ${event.bus} loses ${event.lossy ? `frames, about ${number(100 * event.share, 2)} %` : "no more frames"}`;
    case "clock": return `the clock was set by ${number(event.step_s)} s`;
    case "memory": return `fault memory ${event.state} ${event.reason}`;
    case "restart": return `restart ${event.count}, ${event.in_a_row} in a row: ${event.reason}`;
    case "reporter": return `reporter ${event.reporter} ${event.state}: ${event.reason}`;
    case "config": return `configuration ${event.state} ${event.reason}`;
    case "injected": return `injected: ${event.text}`;
    default: return event.event;
  }
}

function told(groups) {
  if (!groups.length) return "nothing is left to explain";
  return groups.map((group) => `${group.cause ? `cause: ${group.cause.join(" and ")}` : "not isolated"}, of ${few(group.failed)}`).join("; ");
}

const few = (faults) => `${faults.slice(0, 3).join(", ")}${faults.length > 3 ? ` and ${faults.length - 3} more` : ""}`;

// The latest events; DTCs in a row that did the same are one line.
export function showLog(events) {
  const rows = [];
  for (const event of events) {
    const kind = event.event === "dtc" ? `${event.status & 1}${event.fault.split(".").at(-1)}` : null;
    const last = rows.at(-1);
    if (kind && last?.kind === kind && event.t_ms - last.since < 1000) last.count += 1;
    else rows.push({ kind, event, since: event.t_ms, count: 1 });
  }
  const shown = rows.reverse().slice(0, 100).map(({ event, count }) => make("li", {}, make("time", {}, clock(event.t_ms)),
    make("span", {}, `${textOf(event)}${count > 1 ? ` and ${count - 1} more like it` : ""}`)));
  byId("log").replaceChildren(...(shown.length ? shown : [make("li", { class: "none" }, "Nothing has happened yet.")]));
}

export function showInjected(events) {
  const found = events.filter((event) => event.event === "injected");
  byId("injected-card").hidden = !found.length;
  byId("injected").replaceChildren(...found.slice(-12).reverse().map((event) =>
    make("li", {}, make("time", { class: "muted" }, clock(event.t_ms)), ` ${event.text}`)));
}
