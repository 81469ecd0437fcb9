"""The answer first: verdict, causes with their symptoms by ECU, and what was not judged. Every door leads with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from gateway.faults.fault_groups import MOST_NAMED, Case, briefly_named, cases_of
from gateway.faults.status import Status

#: Verdicts: faults are there now; only stored ones are; none, and all that ran has passed; nothing was tested.
FAULTS, STORED, WHOLE, UNTESTED = "faults", "stored", "no faults", "nothing tested"
#: Why a test was not judged, where no more is known.
NO_RESULT = "without a result in this operation cycle"
#: Causes, and kinds of symptoms of each, that lines for people have; the rest is counted.
MOST_CASES, MOST_KINDS = 8, 4


class Symptoms(NamedTuple):
    """Entries that show the same: of one ECU, one kind, one meaning.

    Attributes:
        of: whose they are, for people: an ECU, else a bus, else a monitor.
        what: what they are of: messages, signals or tests.
        description: what all of them show; "": of a fault that no gateway knows any more.
        faults, dtcs: of the entries, in their order.
    """

    of: str
    what: str
    description: str
    faults: tuple[str, ...]
    dtcs: tuple[str, ...]

    @property
    def text(self) -> str:
        """Words for people, in one line."""
        shown = f": {self.description}" if self.description else ""
        if len(self.faults) == 1:
            return f"{self.dtcs[0]} {self.faults[0]}{shown}"
        return f"{counted(len(self.faults), self.what)} of {self.of}{shown} ({_codes(self.dtcs)})"

    def as_dict(self) -> dict[str, Any]:
        """Return it in the form of the JSON contract."""
        return {**self._asdict(), "text": self.text, "count": len(self.faults)}


class Answer(NamedTuple):
    """A case in short form.

    Attributes:
        case: cause and entries.
        since_ns: when the first of the entries that fail now failed last; of none, when the first entry did.
        symptoms: all entries, by what they show.
    """

    case: Case
    since_ns: int
    symptoms: Sequence[Symptoms]

    @property
    def text(self) -> str:
        """The cause for people, in one line; where none is known, the first kind of symptoms."""
        case = self.case
        if not case.probability:
            return self.symptoms[0].text
        return case.text if not case.proven else f"cause: {case.text}"

    def as_dict(self) -> dict[str, Any]:
        """Return it in the form of the JSON contract."""
        kinds = [each.as_dict() for each in self.symptoms]
        return {**self.case.as_dict(), "line": self.text, "since_ns": self.since_ns, "symptoms": kinds}


class Summary(NamedTuple):
    """Faults of a gateway, or of its memory.

    Attributes:
        verdict: of :data:`FAULTS`, :data:`STORED`, :data:`WHOLE`, :data:`UNTESTED`.
        answers: causes and what nothing explains, the most important first.
        failing: entries that fail now.
        stored: all other entries.
        tests: how many there are; 0: not known.
        not_judged: why -> how many tests have no result in this operation cycle.
    """

    verdict: str
    answers: Sequence[Answer]
    failing: int
    stored: int
    tests: int
    not_judged: Mapping[str, int]

    @property
    def title(self) -> str:
        """The verdict for people: the cause where it is one, else what was counted."""
        if self.verdict in (WHOLE, UNTESTED):
            return self.verdict.capitalize()
        told = [each.case for each in self.answers if each.case.failing or self.verdict == STORED]
        proven = [case for case in told if case.proven]
        others = sum(len(case.entries) for case in told if not case.proven)
        if len(proven) == 1 and not others:
            return f"Cause{'' if self.failing else ' of stored faults'}: {briefly_named(proven[0].components)}"
        parts = [counted(n, what) for n, what in ((len(proven), "cause"), (others, "fault")) if n]
        return f"{' and '.join(parts)}{'' if self.failing else ', none of them now'}"

    def as_dict(self) -> dict[str, Any]:
        """Return it in the form of the JSON contract."""
        return {
            "verdict": self.verdict,
            "title": self.title,
            "failing": self.failing,
            "stored": self.stored,
            "tests": self.tests,
            "not_judged": dict(self.not_judged),
            "causes": [answer.as_dict() for answer in self.answers],
        }


def summary_of(
    entries: Sequence[Mapping[str, Any]],
    *,
    ecus: Mapping[str, str] | None = None,
    tests: int = 0,
    not_judged: Iterable[str] = (),
) -> Summary:
    """Return the summary of entries.

    Args:
        entries: in the form of the JSON contract (:func:`gateway.faults.service.as_dict`), with a description if known.
        ecus: ECU that sends the message of a test, by the fault's id without its last part.
        tests: how many tests there are; 0: not known.
        not_judged: why, for each test without a result in this operation cycle.
    """
    cases: list[Case] = []
    alone: list[Case] = []
    for case in cases_of(entries):
        (cases if case.probability else alone).append(case)
    for now in (True, False):  # what nothing explains is told by what it shows
        mine = [entry for case in alone if bool(case.failing) == now for entry in case.entries]
        for kind in folded(mine, ecus):
            named_here = set(kind.faults)
            group = [entry for entry in mine if entry["fault"] in named_here]
            cases.append(Case((), 0.0, False, (), len(group) * now, group))
    cases.sort(key=lambda case: (not case.failing, not case.proven))
    answers = [Answer(case, _since(case), folded(case.entries, ecus)) for case in cases]
    failing = sum(answer.case.failing for answer in answers)
    why = dict(Counter(not_judged).most_common())
    untested = tests > 0 and sum(why.values()) >= tests
    verdict = FAULTS if failing else STORED if entries else UNTESTED if untested else WHOLE
    return Summary(verdict, answers, failing, len(entries) - failing, tests, why)


def in_lines(found: Mapping[str, Any], clock: Callable[[int], str], *, every: bool = False) -> Iterator[str]:
    """Yield a summary for people, below its title; a line that belongs to the one before is indented.

    Args:
        found: as :meth:`Summary.as_dict` has it.
        clock: makes text of a time [ns].
        every: all of it, not the first.
    """
    causes = found["causes"]
    shown = causes if every else causes[:MOST_CASES]
    for cause in shown:
        yield f"{cause['line']}, {'since' if cause['failing'] else 'stored, from'} {clock(cause['since_ns'])}"
        kinds = cause["symptoms"][0 if cause["probability"] else 1 :]
        for kind in kinds if every else kinds[:MOST_KINDS]:
            yield f"  {kind['text']}"
        if not every and (more := sum(kind["count"] for kind in kinds[MOST_KINDS:])):
            yield f"  {counted(more, 'more fault')}"
    if len(causes) > len(shown):
        rest = causes[len(shown) :]
        yield f"and {counted(len(rest), 'more cause')}, of {counted(sum(len(one['faults']) for one in rest), 'fault')}"
    for why, count in found["not_judged"].items():
        yield f"not judged: {count} of {counted(found['tests'], 'test')}, {why}"


def folded(entries: Sequence[Mapping[str, Any]], ecus: Mapping[str, str] | None = None) -> list[Symptoms]:
    """Return entries by what they show, in the order of the first of each; arguments as of :func:`summary_of`."""
    found: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for entry in entries:
        what = _what(entry["fault"], entry["dtc"])
        text = str(entry.get("description") or "")
        # A rule's text is its own: that it does not hold is what they have in common.
        text = text.partition(": ")[0] if what == "test" else text
        found.setdefault((_owner(entry, ecus or {}), what, text), []).append(entry)
    return [
        Symptoms(
            of, what, (group[0].get("description") or "") if len(group) == 1 else text,
            tuple(entry["fault"] for entry in group), tuple(entry["dtc"] for entry in group),
        )
        for (of, what, text), group in found.items()
    ]  # fmt: skip


def counted(count: int, what: str) -> str:
    """Return a number of things for people: ``"1 cause"``, ``"2 causes"``."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def _codes(dtcs: Sequence[str]) -> str:
    return ", ".join(dtcs) if len(dtcs) <= MOST_NAMED else f"{min(dtcs)} ... {max(dtcs)}"


def _what(fault: str, dtc: str) -> str:
    """Return what a fault is of: checks are ``bus.message.kind``, tests of signals ``monitor.message.signal.kind``."""
    parts = fault.count(".")
    return "message" if parts == 2 and dtc.startswith("U") else "signal" if parts == 3 else "test"


def _owner(entry: Mapping[str, Any], ecus: Mapping[str, str]) -> str:
    """Return whose an entry is, for people.

    Only a message or its sender explains a check of that message: an entry that a dead ECU explains is of that ECU.
    """
    first, _, rest = entry["fault"].partition(".")
    ecu = ecus.get(entry["fault"].rpartition(".")[0], "")
    cause = (entry.get("cause") or {}).get("components", ())
    if not ecu and rest.count(".") == 1 and len(cause) == 1 and cause[0].startswith(f"ecu {first}."):
        ecu = cause[0].rpartition(".")[2]
    if ecu:
        return f"ECU {ecu}"
    return f"bus {first}" if rest.count(".") == 1 and entry["dtc"].startswith("U") else first


def _since(case: Case) -> int:
    failing = [entry for entry in case.entries if entry["status"] & Status.TEST_FAILED] or case.entries
    return min(entry["last_ns"] or entry["first_ns"] or 0 for entry in failing)
