"""Events of the JSON contract on stdout: as text for people, or as JSON Lines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gateway.cli.dtc_words import advice, against, others
from gateway.cli.lines import HANG, Lines, number
from gateway.cli.present import print_json
from gateway.faults.catalogue import FaultDefinition
from gateway.faults.status import Status

#: Causes that are less probable are not printed.
LEAST_TOLD = 0.01
#: Columns of the names of a DTC's parts.
_LABEL = 10


class EventPrinter:
    """Prints events of the JSON contract as they come.

    Args:
        as_json: JSON Lines instead of text.
        start_ns: time stamp that people see as zero.
        log: name of the log that they are of, for each line of JSON; None: there is one log, which needs no name.

    Attributes:
        failures: how many DTCs were set.
        definition: id of a fault -> its definition, for its meaning and what to do; None: not known.
    """

    def __init__(self, *, as_json: bool, start_ns: int = 0, log: str | None = None) -> None:
        self._json = as_json
        self._more = {} if log is None else {"log": log}
        self.start_ns = start_ns
        self.failures = 0
        self.definition: Callable[[str], FaultDefinition | None] = lambda fault: None
        self._explained: set[str] = set()
        self._statuses: dict[str, int] = {}
        self._before = 0  # status of the DTC that is printed
        self._advised: dict[str, str] = {}
        self._lines = Lines()

    def __call__(self, event: dict[str, Any]) -> None:
        """Print one event."""
        if event["event"] == "dtc":
            self._before, self._statuses[event["fault"]] = self._statuses.get(event["fault"], 0), event["status"]
            self.failures += bool(event["status"] & Status.TEST_FAILED) and not self._only_confirmed(event)
        if self._json:
            print_json({**event, **self._more})
        elif (shown := getattr(self, f"_on_{event['event']}", None)) is not None:  # others are for programs
            shown(event)

    def _only_confirmed(self, event: dict[str, Any]) -> bool:
        """Return whether a DTC failed before: its confirmation has waited for its explanation."""
        risen = event["status"] & ~self._before
        return bool(self._before & Status.TEST_FAILED and risen & Status.CONFIRMED_DTC)

    def _time(self, event: dict[str, Any]) -> str:
        return f"{(event['t_ns'] - self.start_ns) / 1e9:10.4f} s"

    def _on_dtc(self, event: dict[str, Any]) -> None:
        failed = bool(event["status"] & Status.TEST_FAILED)
        if self._only_confirmed(event):
            mark = f"DTC {event['dtc']} confirmed"
            self._lines.print(f"{self._time(event)}  {mark}  {event['fault']}", mark=mark, colour="bold red")
            return
        colour, word = ("bold red", "SET") if failed else ("green", "healed")
        mark = f"DTC {event['dtc']} {word}"
        lost = "" if event["stored"] else "  NOT STORED"
        self._lines.print(
            f"{self._time(event)}  {mark}  {event['fault']}{lost}{self._aside(event)}", mark=mark, colour=colour
        )
        if failed:
            self._explain(event)
        if status := self._status(event):
            self._part("status", status)

    def _explain(self, event: dict[str, Any]) -> None:
        """Print the meaning of a DTC that was set, its evidence, and what to do; fixed parts only once."""
        definition = self.definition(event["fault"])
        explained = event["fault"] in self._explained
        self._explained.add(event["fault"])
        if definition is not None and not explained:
            self._part("meaning", definition.description)
        self._part("evidence", self._evidence(event, "" if definition is None else definition.tested), style="dim")
        if definition is not None and not explained:
            text = advice(definition)
            first = self._advised.setdefault(text, event["dtc"])
            self._part("to do", text if first == event["dtc"] else f"as for {first}")

    def _part(self, label: str, text: str, *, style: str = "") -> None:
        self._lines.print(f"{'':{HANG}}{label:{_LABEL}}{text}", hang=HANG + _LABEL, style=style)

    def _aside(self, event: dict[str, Any]) -> str:
        """Return more words for the line with the DTC, after two spaces."""
        return ""

    def _status(self, event: dict[str, Any]) -> str:
        """Return how the DTC is stored; "": not to be told."""
        return f"0x{event['status']:02X}  fdc {event['fdc']:+d}  occurrence {event['occurrence']}"

    def _evidence(self, event: dict[str, Any], tested: str) -> str:
        """Return the evidence of a DTC that was set."""
        return "  ".join([against(event["evidence"], tested), *others(event["evidence"], tested)])

    def _on_step(self, event: dict[str, Any]) -> None:
        from gateway.cli.trace import text_of  # noqa: PLC0415 - few want it

        print("\n".join(text_of(event, self.start_ns, self._lines.width)))

    def _on_diagnosis(self, event: dict[str, Any]) -> None:
        for group in event["groups"]:
            mark = "cause" if group["cause"] else "not isolated"
            self._lines.print(f"{self._time(event)}  {mark}  of {', '.join(group['failed'])}", mark=mark, colour="bold")
            for one in group["causes"]:
                if one["probability"] >= LEAST_TOLD:
                    self._part(f"{100 * one['probability']:.3g} %", " and ".join(one["components"]) or "false alarm")
            if group["waits_for"]:
                self._part("waits", f"for {', '.join(one['test'] for one in group['waits_for'][:3])}")
            if group["apart_by"] and not group["cause"]:
                self._part("apart by", ", ".join(group["apart_by"][:3]))

    def _on_symptoms(self, event: dict[str, Any]) -> None:
        mark = f"symptoms {event['state']}"
        by = f"  by {' and '.join(event['cause'])}" if event["cause"] else ""
        self._lines.print(f"{self._time(event)}  {mark}  {', '.join(event['faults'])}{by}", mark=mark, colour="bold")

    def _on_stored(self, event: dict[str, Any]) -> None:
        self._lines.print(f"{self._time(event)}  stored  {', '.join(event['faults'])}")

    def _on_ecu_dtc(self, event: dict[str, Any]) -> None:
        mark = f"ECU {event['ecu']}"
        text = f"{event['dtc']} {event['state']}, status 0x{event['status']:02X}"
        self._lines.print(f"{self._time(event)}  {mark}  {text}", mark=mark, colour="bold")

    def _on_security(self, event: dict[str, Any]) -> None:
        mark = f"security {event['kind']}"
        data = "  ".join(f"{name} {value}" for name, value in event["context"].items())
        text = f"{event['sensor']}, {event['count']} times  {data}".rstrip()
        self._lines.print(f"{self._time(event)}  {mark}  {text}", mark=mark, colour="bold red")

    def _on_clear(self, event: dict[str, Any]) -> None:
        gone = ", ".join(event["faults"]) or "no entry was there"
        self._lines.print(f"{self._time(event)}  cleared: {gone}")

    def _on_monitor_off(self, event: dict[str, Any]) -> None:
        mark = "monitor switched off"
        told = f"{event['monitor']} (type {event['type']}, {event['file']}): {event['reason']}"
        self._lines.print(f"{self._time(event)}  {mark}  {told}", mark=mark, colour="bold red")

    def _on_short_frames(self, event: dict[str, Any]) -> None:
        lost = f"; not in them: {', '.join(event['signals'])}" if event["signals"] else ""
        told = (
            f"{event['bus']}.{event['message']}: {event['length']} bytes, its database says {event['database']}{lost}"
        )
        self._lines.print(f"{self._time(event)}  short frames  {told}", mark="short frames", colour="bold")

    def _on_other_software(self, event: dict[str, Any]) -> None:
        of = f"{event['bus']}.{event['message']}"
        text = f"{of}: {event['what']} {event['now']:g}, as checked {event['learned']:g}, ever since it came"
        self._lines.print(f"{self._time(event)}  other software  {text}", mark="other software", colour="bold")

    def _on_activity(self, event: dict[str, Any]) -> None:
        mark = f"bus {event['bus']} {event['activity']}"
        self._lines.print(f"{self._time(event)}  {mark}  it was {event['before']}", mark=mark)

    def _on_lossy(self, event: dict[str, Any]) -> None:
        mark = f"bus {event['bus']} loses {'frames' if event['lossy'] else 'no more frames'}"
        text = f"about {100 * event['share']:.2g} % did not come: the bus, the host or the recorder loses them"
        self._lines.print(f"{self._time(event)}  {mark}  {text if event['lossy'] else ''}".rstrip(), mark=mark)

    def _on_source(self, event: dict[str, Any]) -> None:
        of = f"{event['bus']}.{event['message']}: source address 0x{event['source']:02X}"
        silent = event["silent_ms"]
        text = f"{of} {f'silent for {silent:.0f} ms' if silent else 'sends it, too'}"
        self._lines.print(f"{self._time(event)}  source  {text}", mark="source", colour="bold" if silent else "")

    def _on_reporter(self, event: dict[str, Any]) -> None:
        mark = f"reporter {event['reporter']} {event['state']}"
        faults = f"; {', '.join(event['faults'])}" if event["faults"] else ""
        colour = "green" if event["state"] == "back" else "bold red"
        self._lines.print(f"{self._time(event)}  {mark}  {event['reason']}{faults}", mark=mark, colour=colour)

    def _on_intervention(self, event: dict[str, Any]) -> None:
        how = "" if event["outcome"] == "done" else f", refused 0x{event['nrc']:02X}"
        by = event["protocol"] + (f" {event['address']:X} on {event['bus']}" if event["bus"] else "")
        self._lines.print(f"{self._time(event)}  tester: {event['action']} by {by}{how}")

    def _on_config(self, event: dict[str, Any]) -> None:
        self._lines.print(f"configuration {event['state']} {event['reason']}".rstrip())

    def _on_log(self, event: dict[str, Any]) -> None:
        for note in event["notes"]:
            self._lines.print(f"log: {note}", hang=5)

    def _on_clock(self, event: dict[str, Any]) -> None:
        self.start_ns += round(event["step_s"] * 1e9)  # the seconds that people see go on evenly
        text = f"{self._time(event)}  clock set by {event['step_s']:+.6f} s"
        self._lines.print(text, mark="clock set", colour="bold red")

    def _on_memory(self, event: dict[str, Any]) -> None:
        colour = "green" if event["state"] == "written" else "bold red"
        aside = f"; put aside: {event['aside']}" if event.get("aside") else ""
        mark = f"fault memory {event['state']}"
        text = f"{event['file']} {event['reason']}{aside}".rstrip()
        self._lines.print(f"{self._time(event)}  {mark}  {text}", mark=mark, colour=colour)

    def _on_bus(self, event: dict[str, Any]) -> None:
        if event["state"] in ("open", "lost"):
            colour = "green" if event["state"] == "open" else "bold red"
            mark = f"bus {event['bus']} {event['state']}"
            text = f"{self._time(event)}  {mark}  {event['reason'] or event['uri']}"
            self._lines.print(text, mark=mark, colour=colour)
        elif event["state"] == "failing":
            times = event["driver_errors"]
            self._lines.print(
                f"{event['bus']}: {times} exceptions of its driver so far, after which it was tried again"
            )
        elif event["overflow"]:
            self._lines.print(f"{event['bus']}: {event['overflow']} frames lost before they were read")

    def _on_summary(self, event: dict[str, Any]) -> None:
        print_ = self._lines.print
        print_(
            f"{event['frames']} frames, {event['decoded']} decoded, {event['events']} events"
            f" in {event['seconds']:.3f} s ({event['frames_per_s']:,.0f} frames/s)"
        )
        for name, values in event["monitors"].items():
            print_(f"{name}: " + readings(values), hang=2)
        odd = {k: v for k, v in event["counters"].items() if v and k not in {"frames", "decoded"}}
        if odd:
            print_("counters: " + readings(odd), hang=2)
        for name, counts in event["buses"].items():
            if counts:
                print_(f"bus {name}: " + readings(counts), hang=2)
        for case in event["causes"]:
            if case["proven"]:
                explained = f"explains {', '.join(case['faults'])}"
                print_(f"cause: {case['text']}  {explained}", mark="cause", colour="bold", hang=7)
        print_("DTCs: " + (", ".join(event["dtcs"]) or "none"), hang=6)


def readings(values: dict[str, float]) -> str:
    """Return numbers with their names."""
    return "  ".join(f"{name} {number(value)}" for name, value in values.items())
