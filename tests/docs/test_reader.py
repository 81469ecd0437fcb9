"""What people read: each text of the shipped catalogues of faults, of evidence, and of events, held against a list."""

import re
from itertools import chain
from pathlib import Path

import pytest

from gateway.cli.events import EventPrinter
from gateway.config.load import load_config
from gateway.faults.summary import in_lines, summary_of
from gateway.monitors.evidence import as_bits, as_digits, in_words
from gateway.runtime.assemble import prepare
from gateway_serve.words import sentences

ROOT = Path(__file__).parents[2]
#: One of each plant, with as many kinds of tests as there are.
NAMES = ("clocks", "obd_port", "signals", "crank_cam", "linear_belt", "pedal_three", "steering", "motor", "truck")
CONFIGS = [ROOT / "gateway.toml", *(p for p in sorted(ROOT.glob("packages/**/configs/*.toml")) if p.stem in NAMES)]

#: Names of code, symbols of papers, places of a format: of none of these a reader knows what it is.
CODES = re.compile(r"\b\w+_\w+\b|\bT over J\b|\bJ\b|\bnu\b|\bNone\b|\bNaN\b|%[sd]|\{\w*\}|two digits|\bis \d+ *[,)]")
#: Names that users write and see as they are: keys of the configuration in backticks, commands and kernel settings in
#: brackets, and names of the databases.
GIVEN = re.compile(r"`[^`]*`|\([^)]*\)|\[\[[^]]*\]\]|\b[A-Z]\w*\.\w+\b|net\.core\.\w+|\bCAN_[HL]\b|\bA_0105\b")
NO = r"(?:no|not|none|nothing|nobody|never|neither|without|cannot)"
TWICE_NO = re.compile(rf"\b{NO}\b[^.,;:()]*\b{NO}\b")
#: Numbers that have no unit: counts, places, states, ratios.
PLAIN = re.compile(
    r"\b(?:count|step|steps|last|received|computed|constant|frames|lost|errors?|classes|location|revolutions|edges?|teeth"
    r"|tooth|pulses?|turns?|index|level|place|right one|share|neighbours|largest possible|least that is new|freshness"
    r"|value|before|restarts|exceptions|wall|rows|changes|off|started|judged|messages|squared|innovations?|fault|observer"
    r"|reading(?: \d)?|amplitude|balance|symptom|ratio|largest|counter|start|waiting"
    r"|asks for|parity|alone|residual\b.*)"
)


@pytest.fixture(scope="module")
def catalogue():
    """All faults of the shipped configurations, with what programs know of the signals."""
    found = {}
    for path in CONFIGS:
        config = load_config(path)
        for definition in prepare(config, path).catalogue:
            found.setdefault((definition.description, definition.evidence, definition.tested), definition)
    assert len(found) > 100
    return list(found.values())


def unreadable(text):
    """Return what of a text a reader does not understand."""
    left = GIVEN.sub("", text)
    return [*CODES.findall(left), *(["double negation"] if TWICE_NO.search(left) else [])]


def test_the_list_finds_what_it_is_there_for():
    for text in (
        "tests that have fired (e1 1, e1_2 2)", "T over J of e5", "two digits each", "not_tested 3",
        "there is no fault that is not known",
    ):  # fmt: skip
        assert unreadable(text) or CODES.search(text), text
    assert not unreadable("check the sender (gateway doctor); its wires to this bus")


@pytest.mark.long
def test_each_fault_is_described_in_words(catalogue):
    wrong = {}
    for definition in catalogue:
        if definition.description.startswith("does not hold: "):
            continue  # the author's own formula
        for text in (definition.description, definition.remedy):
            if found := unreadable(text):
                wrong[text] = found
    assert wrong == {}


@pytest.mark.long
def test_each_value_of_the_evidence_has_a_name_and_a_unit(catalogue):
    wrong = {}
    for name in {n for d in catalogue for n in (*d.evidence, d.tested) if n}:
        label, text = in_words(name, 3.0, "3")
        if found := unreadable(label):
            wrong[name] = found
        elif text == "3" and not PLAIN.search(label):
            wrong[name] = "no unit"
    assert wrong == {}


def test_numbers_that_stand_for_names_are_read_as_names():
    fired = as_bits("tests that have fired", ["e1", "e2", "e5"])
    assert in_words(fired, 5.0, "5") == ("tests that have fired", "e1, e5")
    ranked = as_digits("faults, likeliest first", ["winding", "bearing", *map(str, range(9)), "sensor"], 2)
    assert in_words(ranked, 1201.0, "1201") == ("faults, likeliest first", "sensor, winding")
    assert in_words(as_digits("faults", (), 3), 12.0, "12") == ("faults", "number 12")
    assert in_words(fired, 0.0, "0")[1] == "none"
    assert in_words("silent [ms]", 110.0, "110") == ("silent", "110 ms")
    words = sentences(
        {"status": 0x2F, "occurrence": 1, "cause": None, "hold": "", "tested": "silent [ms]", "severity": "none",
         "evidence": {"value": 110.0, "threshold": 100.0, "silent [ms]": 110.0, fired: 3.0}, "remedy": "look"}
    )  # fmt: skip
    assert words[1:] == [
        "Silent: 110 ms, limit 100 ms (1.1 times the limit).", "Measured with it: tests that have fired: e1, e2.",
        "What to do: look.",
    ]  # fmt: skip


#: An event of each kind that is printed, as it may come.
EVENTS = (
    {"event": "monitor_off", "monitor": "crank", "type": "crank", "file": "m.py", "reason": "its step failed"},
    {"event": "short_frames", "bus": "can0", "message": "Speed", "length": 4, "database": 8, "signals": ["V"]},
    {"event": "other_software", "bus": "can0", "message": "Speed", "what": "length", "now": 4.0, "learned": 8.0},
    {"event": "activity", "bus": "can0", "activity": "asleep", "before": "running"},
    {"event": "lossy", "bus": "can0", "lossy": True, "share": 0.04},
    {"event": "security", "kind": "door", "sensor": "DoIP", "count": 2, "context": {"first_payload": "0d"}},
    {"event": "reporter", "reporter": "battery", "state": "lost", "reason": "it ended", "faults": ["battery.hot"]},
    {"event": "clock", "step_s": 2.0},
    {"event": "symptoms", "state": "held", "cause": ["bus can0"], "faults": [f"can0.M{k}.timeout" for k in range(9)]},
    {"event": "clear", "faults": []},
    {"event": "intervention", "action": "clear", "protocol": "uds", "bus": "", "address": 1, "outcome": "done"},
    {"event": "bus", "bus": "can0", "state": "failing", "driver_errors": 3, "overflow": 0, "reason": "", "uri": ""},
    {"event": "diagnosis", "groups": [
        {"cause": None, "failed": ["a.b"], "causes": [{"components": ["bus can0"], "probability": 0.9}],
         "waits_for": [{"test": "a.c"}], "apart_by": ["a.d"]}
    ]},
)  # fmt: skip


def test_each_event_is_told_in_words(capsys):
    summary = summary_of((), tests=3, not_judged=["a message of theirs never came"]).as_dict()
    counters = {"frames": 3, "decoded": 2, "symptoms_held": 2, "memory_write_failures": 1}
    monitors = {"signals": {"steps": 3, "not_tested": 1}}
    last = {"event": "summary", "frames": 3, "decoded": 2, "events": 1, "seconds": 1.0, "frames_per_s": 3.0,
            "counters": counters, "monitors": monitors, "buses": {"can0": {"stuff_errors": 1}}, "dtcs": []}  # fmt: skip
    printer = EventPrinter(as_json=False)
    wrong = {}
    for event in chain(EVENTS, [last | summary]):
        printer({"t_ns": 10**9, **event})
        told = capsys.readouterr().out
        assert told, event
        if found := unreadable(told):
            wrong[told] = found
    assert wrong == {}
    assert [*in_lines(summary, str)] == ["not judged: 1 of 3 tests, a message of theirs never came"]
