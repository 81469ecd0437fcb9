"""The page of a report."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import bokeh
import numpy as np

from gateway import __version__
from gateway.common.jsonlines import line
from gateway.faults.catalogue import FaultDefinition
from gateway.faults.entries import Entry
from gateway.faults.fault_groups import MOST_NAMED
from gateway.faults.remedy import severity_names
from gateway.faults.status import Status
from gateway.faults.summary import UNTESTED, WHOLE, Answer, counted, in_lines
from gateway.runtime.app import Gateway
from gateway_serve.bokeh_files import bokeh_folder
from gateway_serve.report.collect import Collector
from gateway_serve.report.figures import Figure, band, columns_of, documents, fine_columns, load
from gateway_serve.report.timeline import Span, timeline
from gateway_serve.words import number, sentences, unit_of

#: Figures of residuals with a failure, and without one.
MOST_FAILED, MOST_OTHERS = 12, 6
#: Rows of the timeline, findings, and codes without a cause, that are not folded; tests of which all are shown, and of
#: more those that are.
MOST_ROWS, MOST_FINDINGS, MOST_TESTS, MOST_NEAR = 12, 20, 60, 30
STYLE = Path(__file__).parent.parent / "static" / "page.css"
#: Numbers of this machine and this moment, and not of the run.
OF_THE_MOMENT = ("seconds", "frames_per_s")


@dataclass(frozen=True)
class Words:
    """A report's words about its run.

    Attributes:
        title: of the run.
        source: files read or played, and their hash, one line each: name, text.
        config_file: the configuration.
        findings: whether it is as expected, and what; none: nothing was expected.
        truth: injected faults: text and time [ns].
        events: of the JSON contract, after those that the collector has.
    """

    title: str
    source: Sequence[tuple[str, str]]
    config_file: Path
    findings: Sequence[tuple[bool, str]] = ()
    truth: Sequence[tuple[str, int]] = ()
    events: Sequence[Mapping[str, Any]] = ()


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file, or of all files of a folder in the order of their names."""
    made = hashlib.sha256()
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        with file.open("rb") as opened:
            while part := opened.read(1 << 20):
                made.update(part)
    return made.hexdigest()


def write_report(path: Path, gateway: Gateway, found: Collector, told: Words) -> None:
    """Write the report of a run that is over.

    Args:
        path: of the file.
        gateway: that it went through, still open.
        found: collected data.
        told: further words.
    """
    path.write_text(_Page(gateway, found, told).text(), encoding="utf-8")


class _Page:
    def __init__(self, gateway: Gateway, found: Collector, told: Words) -> None:
        self._gateway, self._found, self._told = gateway, found, told
        self._figures: list[Figure] = []
        self._entries = sorted(gateway.memory.entries(), key=lambda entry: (entry.record.first_ns or 0, str(entry.dtc)))
        self._summary = gateway.found()
        kinds = [kind for answer in self._summary.answers for kind in answer.symptoms]
        #: Faults that show what another one shows, which stands for them.
        self._alike = {fault for kind in kinds if len(kind.faults) > MOST_NAMED for fault in kind.faults[1:]}
        self._events = [_lasting(event) for event in (*found.events, *told.events)]

    def text(self) -> str:
        parts = [
            self._verdict(), self._timeline(), self._codes(), self._residuals(), self._tests(), self._buses(),
            self._settings(),
        ]  # fmt: skip
        document, places = documents(self._figures)
        script = (bokeh_folder() / "bokeh.min.js").read_text(encoding="utf-8").replace("</script", "<\\/script")
        policy = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"
        title = escape(f"{self._told.title} - gateway")
        return "\n".join(
            [
                '<!doctype html>\n<html lang="en" data-theme="light">\n<head>\n<meta charset="utf-8">',
                f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
                '<meta name="viewport" content="width=device-width, initial-scale=1">',
                f"<title>{title}</title>\n<style>{STYLE.read_text(encoding='utf-8')}</style>\n</head>\n<body>",
                f'<header class="top"><div class="brand"><h1>{escape(self._told.title)}</h1></div></header>\n<main>',
                *parts,
                "</main>",
                f'<script type="application/json" id="events">{_json(self._events)}</script>',
                f'<script type="application/json" id="figures">{document}</script>',
                f'<script type="application/json" id="places">{places}</script>',
                f"<script>{script}</script>",
                "<script>const of = (id) => JSON.parse(document.getElementById(id).textContent);"
                'Bokeh.set_log_level("warn");'
                'Bokeh.embed.embed_items({report: of("figures")}, of("places"));</script>',
                "</body>\n</html>\n",
            ]
        )

    def _seconds(self, t_ns: int | None) -> float:
        return 0.0 if t_ns is None else round((t_ns - self._found.first_ns) / 1e9, 6)

    def _figure(self, model: Any, text: str) -> str:
        place = f"figure-{len(self._figures)}"
        self._figures.append(Figure(place, model, text))
        figure = f'<div id="{place}" class="figure" role="img" aria-label="{escape(text)}"></div>'
        return f'<p class="called" aria-hidden="true">{escape(text)}</p>{figure}'

    def _verdict(self) -> str:
        findings, found = self._told.findings, self._summary
        good = all(good for good, _ in findings) if findings else found.verdict in (WHOLE, UNTESTED)
        text = ("As expected" if good else "Not as expected") if findings else found.title
        said = {True: "" if good else "as expected: ", False: "NOT as expected: "}
        lines = [said[ok] + what for ok, what in findings]
        if len(lines) > MOST_FINDINGS:
            lines[MOST_FINDINGS:] = [f"{len(lines) - MOST_FINDINGS} more, in the events of this file"]
        lines += in_lines(found.as_dict(), lambda t_ns: f"{self._seconds(t_ns):.3f} s")
        facts = [
            *self._told.source,
            ("length", f"{self._seconds(self._found.last_ns):.3f} s"),
            ("frames", str(self._gateway.engine.counters()["frames"])),
        ]
        items = "".join(
            f"<li{' class=indented' if line[0] == ' ' else ''}>{escape(line.strip())}</li>" for line in lines
        )
        kind = "good" if good else "bad"
        head = f'<section class="verdict {kind}"><p>{escape(text)}</p><ul class="plain">{items}</ul></section>'
        return head + _card("Run", _facts(facts))

    def _timeline(self) -> str:
        since: dict[str, float] = {}
        spans: list[Span] = []
        end = self._seconds(self._found.last_ns)
        for event in self._found.events:
            if event["event"] != "dtc":
                continue
            name = f"{event['dtc']} {event['fault']}"
            failed = bool(event["status"] & Status.TEST_FAILED)
            if failed:
                since.setdefault(name, self._seconds(event["t_ns"]))
            elif name in since:
                spans.append(Span(name, since.pop(name), self._seconds(event["t_ns"])))
        spans += [Span(name, begun, end) for name, begun in since.items()]
        spans.sort(key=lambda span: span.begin)
        names = sorted(dict.fromkeys(span.row for span in spans), key=lambda row: row.partition(" ")[2] in self._alike)
        few = {name for name in names[:MOST_ROWS] if name.partition(" ")[2] not in self._alike}
        more = [span for span in spans if span.row not in few]
        spans = [span for span in spans if span.row in few]
        spans += [Span(f"injected: {text}", self._seconds(t_ns)) for text, t_ns in self._told.truth]
        folded = _details(f"{len(names) - len(few)} more", timeline(more, end)) if more else ""
        return _card("Timeline", timeline(spans, end) + folded if spans else '<p class="none">Nothing failed.</p>')

    def _codes(self) -> str:
        if not self._entries:
            return _card("Trouble codes", '<p class="none">No trouble codes.</p>')
        return _card("Causes and trouble codes", "".join(map(self._case, self._summary.answers)))

    def _case(self, answer: Answer) -> str:
        """Return a case: its cause, the entry that stands for it, and the others folded below."""
        case = answer.case
        entries = {entry.fault: entry for entry in self._entries}
        codes = [self._code(entries[shown["fault"]], shown) for shown in case.entries]
        if len(codes) <= (1 if case.proven else MOST_ROWS):
            body = "".join(codes)
        else:
            kinds = [each.text for each in answer.symptoms if len(each.faults) > MOST_NAMED]
            what = f"{len(codes) - 1} more{' that it explains' if case.proven else ''}"
            short = [
                f"{entry['dtc']} {entry['fault']}: {entry['occurrence']} times,"
                f" first {self._seconds(entry['first_ns']):.4f} s, last {self._seconds(entry['last_ns']):.4f} s"
                for entry in case.entries[MOST_ROWS:]
            ]
            rest = "".join(codes[1:MOST_ROWS]) + f'<pre class="mono">{escape(chr(10).join(short))}</pre>' * bool(short)
            body = codes[0] + _details("; ".join([what, *kinds]), rest)
        head = f'<h3 class="cause">{escape(case.text)}</h3>' if case.text else ""
        return f'<section class="case{" proven" if case.proven else ""}">{head}{body}</section>'

    def _code(self, entry: Entry, shown: Mapping[str, Any]) -> str:
        definition, kept = self._gateway.memory.definition(entry.fault), entry.record
        severity, _ = severity_names(definition.severity)
        words = sentences({**shown, "remedy": definition.remedy, "severity": severity, "tested": definition.tested})
        bits = ", ".join((bit.name or "").replace("_", " ").lower() for bit in Status(entry.status)) or "none"
        parts = [
            f'<article class="dtc" data-dtc="{entry.dtc}"><div class="more"><h3>{entry.dtc} {escape(entry.fault)}</h3>',
            f'<p class="muted">{escape(definition.description)}</p>',
            f"<p>status 0x{int(entry.status):02X}: {escape(bits)}; occurrence {kept.occurrence};"
            f" first {self._seconds(kept.first_ns):.4f} s, last {self._seconds(kept.last_ns):.4f} s</p>",
            "<ul>" + "".join(f"<li>{escape(text)}</li>" for text in words) + "</ul>",
        ]
        if kept.inputs:
            parts.append(_values("Inputs of its monitor then", kept.inputs))
        parts += [
            _values(f"Freeze frame {frame.number}, {self._seconds(frame.t_ns):.4f} s", frame.content)
            for frame in entry.freeze_frames
        ]
        return "".join(parts) + "</div></article>"

    def _residuals(self) -> str:
        found, index = self._found, {d.id: k for k, d in enumerate(self._gateway.catalogue)}
        failed: dict[str, list[float]] = {}
        for window in found.windows:
            failed.setdefault(window.fault, []).append(self._seconds(window.t_ns))
        parts = []
        shown: list[str] = []
        for window in found.windows:
            columns = fine_columns(window.columns, found.first_ns)
            definition = self._gateway.catalogue[index[window.fault]]
            if columns and window.fault not in self._alike and len(shown) < MOST_FAILED:
                at = self._seconds(window.t_ns)
                title = f"{window.fault} around its failure at {at:.3f} s"
                parts.append(self._figure(band(columns, unit_of(definition.tested), marks=[at]), title))
                shown.append(window.fault)
        total = found.total
        order = sorted(index, key=lambda name: (name not in failed, -float(total[index[name]]["ratio"]), index[name]))
        others = 0
        for name in order:
            columns = columns_of(found, index[name])
            is_well = name not in failed and not total[index[name]]["failed"]
            others += is_well
            near = float(total[index[name]]["ratio"])
            if columns and (name in shown or (is_well and others <= MOST_OTHERS and near > 0)):
                title = f"{name} over the whole run, at most {number(near)} times the limit"
                unit = unit_of(self._gateway.catalogue[index[name]].tested)
                parts.append(self._figure(band(columns, unit, marks=failed.get(name, ())), title))
        left = sum(row["failed"] > 0 for row in total) - len(set(shown))
        if left > 0:
            parts.append(f'<p class="muted">{counted(left, "more test")} failed; their figures are in the table</p>')
        return _card("Residuals against their limits", "".join(parts) or '<p class="none">No test has run.</p>')

    def _tests(self) -> str:
        """Return the tests, of many those that failed or came nearest; the others are folded."""
        found = sorted(
            zip(self._gateway.catalogue, self._found.total, strict=True),
            key=lambda each: (each[0].id in self._alike, -int(each[1]["failed"]), -float(each[1]["ratio"])),
        )
        few = found if len(found) <= MOST_TESTS else found[:MOST_NEAR]
        # One text: the table of many thousands would be slow.
        more = "\n".join(
            f"{definition.id}, {definition.dtc}: {row['count']} results, {row['failed']} failed"
            + (
                f", {number(row['low'])} to {number(row['high'])}, {number(row['ratio'])} times the limit"
                * bool(row["numbers"])
            )
            for definition, row in found[len(few) :]
        )
        more = f'<pre class="mono">{escape(more)}</pre>' if more else ""
        folded = _details(f"{len(found) - len(few)} more, further from a fault", more) if more else ""
        return _card("Tests", self._table_of(few) + folded)

    def _table_of(self, found: Sequence[tuple[FaultDefinition, Any]]) -> str:
        rows = []
        for definition, row in found:
            count = int(row["count"])
            unit = unit_of(definition.tested)
            name = f"{escape(definition.id)}{f' [{escape(unit)}]' if unit else ''}"
            cells = [f"<th scope=row>{name}</th>", f"<td>{definition.dtc}</td>", _number(count)]
            cells.append(_number(int(row["failed"]) if count else 0))
            known = count > 0 and row["numbers"] > 0
            cells += [
                _number(float(row[name])) if known else '<td class="number"></td>' for name in ("low", "high", "ratio")
            ]
            rows.append(cells)
        return _table(("Test", "DTC", "Results", "Failed", "Least", "Greatest", "Times the limit"), rows)

    def _buses(self) -> str:
        found = self._found
        parts = []
        for k, bus in enumerate(self._gateway.config.bus):
            frames = int(sum(load_[k][2] for load_ in found.loads.values()))
            errors = {name: n for name, n in self._gateway.engine.error_counters(k).items() if n}
            parts.append(f"<p>{escape(bus.name)}: {frames} frames; errors: {escape(str(errors or 'none'))}</p>")
            if frames:
                model, unit = load(found, k, (bus.bitrate, bus.data_bitrate))
                parts.append(self._figure(model, f"load of {bus.name}: {unit}"))
        return _card("Buses", "".join(parts))

    def _settings(self) -> str:
        text = self._told.config_file.read_text(encoding="utf-8")
        facts = [
            ("configuration", f"{self._told.config_file.name}, SHA-256 {file_hash(self._told.config_file)}"),
            ("gateway", __version__),
            ("Python, NumPy, bokeh", f"{platform.python_version()}, {np.__version__}, {bokeh.__version__}"),
        ]
        if self._found.left_out:
            facts.append(("events left out of this file", str(self._found.left_out)))
        return _card(
            "Configuration and versions",
            f"{_facts(facts)}<details><summary>{escape(self._told.config_file.name)}</summary>"
            f'<pre class="mono">{escape(text)}</pre></details>',
        )


def _lasting(event: Mapping[str, Any]) -> dict[str, Any]:
    """Return an event without what another run of the same would say otherwise."""
    made = {name: value for name, value in event.items() if name not in OF_THE_MOMENT}
    if made["event"] == "log":
        made["file"] = Path(made["file"]).name
    return made


def _json(value: Any) -> str:
    return line(value).replace("<", "\\u003c")


def _card(title: str, body: str) -> str:
    return f'<section class="card"><h2>{escape(title)}</h2>{body}</section>'


def _details(summary: str, body: str) -> str:
    return f"<details><summary>{escape(summary)}</summary>{body}</details>"


def _number(value: float | None) -> str:
    return f'<td class="number">{number(value)}</td>'


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], kind: str = "") -> str:
    numbers = [k for k, cell in enumerate(rows[0] if rows else ()) if cell.startswith('<td class="number"')]
    kinds = [' class="number"' if k in numbers else "" for k in range(len(head))]
    titles = "".join(f'<th scope="col"{kind}>{escape(text)}</th>' for text, kind in zip(head, kinds, strict=True))
    body = "".join(f"<tr>{''.join(cells)}</tr>" for cells in rows)
    top = f"<thead><tr>{titles}</tr></thead>" if head else ""
    table = f'<table class="{kind}">{top}<tbody>{body}</tbody></table>'
    return f'<div class="wide" tabindex="0" role="group" aria-label="table">{table}</div>' if head else table


def _facts(facts: Sequence[tuple[str, str]]) -> str:
    rows = [[f"<th scope=row>{escape(name)}</th>", f"<td>{escape(text)}</td>"] for name, text in facts]
    return _table((), rows, "pairs")


def _values(title: str, values: Mapping[str, float | None]) -> str:
    if not values:
        return f'<p class="muted">{escape(title)}: no signals are configured for it</p>'
    rows = [[f"<th scope=row>{escape(name)}</th>", _number(value)] for name, value in values.items()]
    return f'<p class="muted">{escape(title)}</p>{_table((), rows)}'
