"""Events of the JSON contract on stdout: as text for people, or as JSON Lines."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice
from typing import Any

from gateway.cli.dtc_words import advice, against, others
from gateway.cli.lines import HANG, Lines, number
from gateway.cli.present import print_json
from gateway.faults.catalogue import FaultDefinition
from gateway.faults.fault_groups import MOST_NAMED
from gateway.faults.status import Status
from gateway.faults.summary import WHOLE, counted, folded, in_lines

#: Causes that are less probable are not printed.
LEAST_TOLD = 0.01
#: Time for which DTCs that are like the one before wait for each other: that one is told in full, these in short [ns].
TOGETHER_NS = 1_000_000_000
#: Lines about monitors, and codes in a row, that a summary has.
MOST_MONITORS, MOST_CODES = 6, 10
#: Changes of a DTC -> colour.
SET, CONFIRMED, HEALED = "SET", "confirmed", "healed"
_COLOURS = {SET: "bold red", CONFIRMED: "bold red", HEALED: "green"}
#: Columns of the names of a DTC's parts.
_LABEL = 10
#: Key of a DTC's status before, which the printer adds.
_BEFORE = "before"


class EventPrinter:
    """Prints events of the JSON contract as they come.

    Args:
        as_json: JSON Lines instead of text.
        start_ns: time stamp that people see as zero.
        log: name of the log that they are of, for each line of JSON; None: there is one log, which needs no name.
        every: print each DTC, and each fault of a cause, by itself, however many are alike.

    Attributes:
        failures: how many DTCs were set.
        definition: id of a fault -> its definition, for its meaning and what to do; None: not known.
        ecus: ECU that sends the message of a test, by the fault's id without its last part.
    """

    def __init__(self, *, as_json: bool, start_ns: int = 0, log: str | None = None, every: bool = False) -> None:
        self._json, self._every = as_json, every
        self._more = {} if log is None else {"log": log}
        self.start_ns = start_ns
        self.failures = 0
        self.definition: Callable[[str], FaultDefinition | None] = lambda fault: None
        self.ecus: Mapping[str, str] = {}
        self._explained: set[str] = set()
        self._kept: list[dict[str, Any]] = []  # DTCs that wait for others
        self._kind: tuple[str, str] = ("", "")  # of the latest DTC: what became of it, and what its fault shows
        self._told_ns, self._kept_s = 0, 0.0
        self._causes: dict[tuple[str, ...], frozenset[str]] = {}  # told explanations, and of which faults
        self._statuses: dict[str, int] = {}
        self._advised: dict[str, str] = {}
        self._lines = Lines()

    def __call__(self, event: dict[str, Any]) -> None:
        """Print one event."""
        if event["event"] == "dtc":
            before, self._statuses[event["fault"]] = self._statuses.get(event["fault"], 0), event["status"]
            event = {**event, _BEFORE: before}
            self.failures += self._word(event) == SET
        if self._json:
            print_json({k: v for k, v in event.items() if k != _BEFORE} | self._more)
        elif (shown := getattr(self, f"_on_{event['event']}", None)) is not None:  # others are for programs
            if event["event"] == "diagnosis" and not self._every:
                event = {**event, "groups": [group for group in event["groups"] if self._is_news(group)]}
                if not event["groups"]:
                    return
            if event["event"] != "dtc":
                self.flush()
            elif not self._every and self._waits(event):
                return
            shown(event)

    def _waits(self, event: dict[str, Any]) -> bool:
        """Keep a DTC if one of its kind was told right before; those that follow are told together."""
        definition = self.definition(event["fault"])
        kind = (self._word(event), "" if definition is None else definition.description.partition(": ")[0])
        if kind != self._kind or event["t_ns"] - self._told_ns > TOGETHER_NS:
            self.flush()
            self._kind, self._told_ns = kind, event["t_ns"]
            return False
        if not self._kept:
            self._told_ns, self._kept_s = event["t_ns"], time.monotonic()
        self._kept.append(event)
        return True

    def look(self) -> None:
        """Tell what waits, if nothing has come for a while that would have it told."""
        if self._kept and time.monotonic() - self._kept_s > TOGETHER_NS / 1e9:
            self.flush()

    def flush(self) -> None:
        """Tell the DTCs that wait: a few by their names and values, more by ECU and kind."""
        kept, self._kept = self._kept, []
        if len(kept) <= (1 if self._kind[0] == HEALED else MOST_NAMED):
            for event in kept:
                self._head(event)
                if self._kind[0] == SET:
                    definition = self.definition(event["fault"])
                    text = against(event["evidence"], "" if definition is None else definition.tested)
                    self._part("evidence", text, style="dim")
            return
        mark, lost = f"DTC {self._kind[0]}", sum(not event["stored"] for event in kept)
        text = "; ".join(self._folded(event["fault"] for event in kept))
        until = f", until {(kept[-1]['t_ns'] - self.start_ns) / 1e9:.4f} s{f'; {lost} NOT STORED' if lost else ''}"
        self._lines.print(
            f"{self._time(kept[0])}  {mark}  likewise {text}{until}", mark=mark, colour=_COLOURS[self._kind[0]]
        )

    def _word(self, event: Mapping[str, Any]) -> str:
        """Return what became of a DTC."""
        if not event["status"] & Status.TEST_FAILED:
            return HEALED
        return CONFIRMED if self._is_only_confirmed(event) else SET

    def _folded(self, faults: Iterable[str]) -> list[str]:
        """Return faults for people: a few by their names, more by ECU and kind."""
        named = list(faults)
        if self._every or len(named) <= MOST_NAMED:
            return [", ".join(named)]
        return [each.text for each in folded([self._entry(fault) for fault in named], self.ecus)]

    def _entry(self, fault: str) -> dict[str, Any]:
        definition = self.definition(fault)
        told = ("", "") if definition is None else (str(definition.dtc), definition.description)
        return {"fault": fault, "dtc": told[0], "description": told[1]}

    def _is_only_confirmed(self, event: Mapping[str, Any]) -> bool:
        """Return whether a DTC failed before: its confirmation has waited for its explanation."""
        return bool(event[_BEFORE] & Status.TEST_FAILED and event["status"] & ~event[_BEFORE] & Status.CONFIRMED_DTC)

    def _time(self, event: dict[str, Any]) -> str:
        return f"{(event['t_ns'] - self.start_ns) / 1e9:10.4f} s"

    def _on_dtc(self, event: dict[str, Any]) -> None:
        self._head(event)
        if self._word(event) == SET:
            self._explain(event)
            if status := self._status(event):
                self._part("status", status)

    def _head(self, event: dict[str, Any]) -> None:
        word = self._word(event)
        mark, lost = f"DTC {event['dtc']} {word}", "" if event["stored"] else "  NOT STORED"
        self._lines.print(
            f"{self._time(event)}  {mark}  {event['fault']}{lost}{self._aside(event)}", mark=mark, colour=_COLOURS[word]
        )

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
        from gateway.cli.step_lines import text_of  # noqa: PLC0415 - few want it

        print("\n".join(text_of(event, self.start_ns, self._lines.width)))

    def _on_diagnosis(self, event: dict[str, Any]) -> None:
        for group in event["groups"]:
            mark = "cause" if group["cause"] else "not isolated"
            of = "; ".join(self._folded(group["failed"]))
            self._lines.print(f"{self._time(event)}  {mark}  of {of}", mark=mark, colour="bold")
            for one in group["causes"]:
                if one["probability"] >= LEAST_TOLD:
                    self._part(f"{100 * one['probability']:.3g} %", " and ".join(one["components"]) or "false alarm")
            if group["waits_for"]:
                self._part("waits", f"for {', '.join(one['test'] for one in group['waits_for'][:3])}")
            if group["apart_by"] and not group["cause"]:
                self._part("apart by", ", ".join(group["apart_by"][:3]))

    def _is_news(self, group: Mapping[str, Any]) -> bool:
        """Return whether a diagnosis says more than that figures have changed, or that faults come or heal."""
        failed, proven = frozenset(group["failed"]), group["cause"] is not None
        likeliest = (str(proven), *group["causes"][0]["components"])
        healing = not proven and any(key[0] == str(True) and failed < known for key, known in self._causes.items())
        news = not healing and not failed & self._causes.get(likeliest, frozenset())
        if not healing:
            self._causes[likeliest] = failed
        return news

    def _on_symptoms(self, event: dict[str, Any]) -> None:
        mark = f"symptoms {event['state']}"
        by = f"  by {' and '.join(event['cause'])}" if event["cause"] else ""
        faults = "; ".join(self._folded(event["faults"]))
        self._lines.print(f"{self._time(event)}  {mark}  {faults}{by}", mark=mark, colour="bold")

    def _on_stored(self, event: dict[str, Any]) -> None:
        self._lines.print(f"{self._time(event)}  stored  {'; '.join(self._folded(event['faults']))}")

    def _on_ecu_dtc(self, event: dict[str, Any]) -> None:
        mark = f"ECU {event['ecu']}"
        text = f"{event['dtc']} {event['state']}, status 0x{event['status']:02X}"
        self._lines.print(f"{self._time(event)}  {mark}  {text}", mark=mark, colour="bold")

    def _on_security(self, event: dict[str, Any]) -> None:
        mark = f"security {event['kind']}"
        data = "  ".join(f"{name.replace('_', ' ')} {value}" for name, value in event["context"].items())
        text = f"{event['sensor']}, {event['count']} times  {data}".rstrip()
        self._lines.print(f"{self._time(event)}  {mark}  {text}", mark=mark, colour="bold red")

    def _on_clear(self, event: dict[str, Any]) -> None:
        gone = "; ".join(self._folded(event["faults"])) or "no entry was there"
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
        of, what = f"{event['bus']}.{event['message']}", event["what"]
        text = f"{of}: {what} {event['now']:g}, as checked {event['learned']:g}, ever since it came"
        text = f"{of}: it never came" if what == "timeout" else text
        self._lines.print(f"{self._time(event)}  other software  {text}", mark="other software", colour="bold")

    def _on_activity(self, event: dict[str, Any]) -> None:
        mark = f"bus {event['bus']} {event['activity']}"
        self._lines.print(f"{self._time(event)}  {mark}  it was {event['before']}", mark=mark)

    def _on_lossy(self, event: dict[str, Any]) -> None:
        mark = f"bus {event['bus']} loses {'frames' if event['lossy'] else 'no more frames'}"
        text = f"about {number(100 * event['share'], 2)} % did not come: the bus, the host or the recorder loses them"
        self._lines.print(f"{self._time(event)}  {mark}  {text if event['lossy'] else ''}".rstrip(), mark=mark)

    def _on_source(self, event: dict[str, Any]) -> None:
        of = f"{event['bus']}.{event['message']}: source address 0x{event['source']:02X}"
        silent = event["silent_ms"]
        text = f"{of} {f'silent for {silent:.0f} ms' if silent else 'sends it, too'}"
        self._lines.print(f"{self._time(event)}  source  {text}", mark="source", colour="bold" if silent else "")

    def _on_reporter(self, event: dict[str, Any]) -> None:
        mark = f"reporter {event['reporter']} {event['state']}"
        faults = f"; {'; '.join(self._folded(event['faults']))}" if event["faults"] else ""
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
        print_(event["title"], mark=event["title"], colour="bold green" if event["verdict"] == WHOLE else "bold")
        for line in in_lines(event, self._clock, every=self._every):
            print_(f"  {line}", hang=6)
        print_(
            f"{event['frames']} frames, {event['decoded']} decoded, {event['events']} events"
            f" in {event['seconds']:.3f} s ({event['frames_per_s']:,.0f} frames/s)"
        )
        monitors = event["monitors"]
        for name, values in islice(monitors.items(), None if self._every else MOST_MONITORS):
            print_(f"{name}: " + readings(values), hang=2)
        if not self._every and len(monitors) > MOST_MONITORS:
            print_(f"{counted(len(monitors) - MOST_MONITORS, 'more monitor')}")
        odd = {k: v for k, v in event["counters"].items() if v and k not in {"frames", "decoded"}}
        if odd:
            print_("counters: " + readings(odd), hang=2)
        for name, counts in event["buses"].items():
            if counts:
                print_(f"bus {name}: " + readings(counts), hang=2)
        print_("DTCs: " + (self._codes(event["dtcs"]) or "none"), hang=6)

    def _codes(self, dtcs: Sequence[str]) -> str:
        few = self._every or len(dtcs) <= MOST_CODES
        return ", ".join(dtcs) if few else f"{len(dtcs)}, {min(dtcs)} ... {max(dtcs)}"

    def _clock(self, t_ns: int) -> str:
        return f"{(t_ns - self.start_ns) / 1e9:.4f} s"


def readings(values: dict[str, float]) -> str:
    """Return numbers with their names, as words."""
    return "  ".join(f"{name.replace('_', ' ')} {number(value)}" for name, value in values.items())
