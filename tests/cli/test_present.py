"""What people see of events."""

import random
from typing import get_args

import pytest

from gateway.cli.dtc_words import against, few, state_in_words
from gateway.cli.events import EventPrinter
from gateway.cli.lines import number, wrapped
from gateway.faults.catalogue import FaultDefinition
from gateway.faults.dtc import Dtc
from gateway_bench.vecu.contract import Truth
from gateway_bench.vecu.message_faults import KINDS, MessageFault
from gateway_bench.vecu.registry import VIRTUAL_ECUS
from gateway_bench.vecu.scenario import WireFault, load_scenario
from gateway_bench.vecu.words import WORDS, injected
from gateway_fdi.common.resources import shipped


def test_the_seconds_that_people_see_go_on_where_the_clock_was_set(capsys):
    printer = EventPrinter(as_json=False, start_ns=10 * 10**9)
    bus = {"event": "bus", "bus": "b", "uri": "test:b", "state": "open", "reason": ""}
    printer({**bus, "t_ns": 11 * 10**9})
    printer({"event": "clock", "t_ns": (12 - 3600) * 10**9, "step_s": -3600.0})
    printer({**bus, "t_ns": (13 - 3600) * 10**9})
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[0] for line in lines] == ["1.0000", "2.0000", "3.0000"]
    assert lines[1][2:] == ["clock", "set", "by", "-3600.000000", "s"]


@pytest.mark.parametrize(
    ("faults", "text"),
    [(["a.length", "b[0]"], "a.length, b[0]"), ([], "no entry was there")],
)
def test_a_clear_names_the_entries_that_went(capsys, faults, text):
    EventPrinter(as_json=False)({"event": "clear", "t_ns": 2 * 10**9, "faults": faults})
    assert capsys.readouterr().out.split(maxsplit=2)[2].strip() == f"cleared: {text}"


def dtc(status, fault="crank.missed_pulse", **evidence):
    return {
        "event": "dtc", "t_ns": 10**9, "fault": fault, "dtc": "P0336-39", "status": status, "fdc": 127, "occurrence": 1,
        "stored": True, "evidence": {"value": 0.9919, "threshold": 0.5, **evidence},
    }  # fmt: skip


def definition(fault):
    return FaultDefinition(
        fault, Dtc.parse("P0336-39"), "pulses missed", remedy="check the sensor", tested="away from its place [pitch]"
    )


def test_a_dtc_is_explained_once_and_its_evidence_is_whole(capsys):
    printer = EventPrinter(as_json=False)
    printer.definition = definition
    evidence = {f"residual {k} [pitch]": 0.0123456 * k for k in range(1, 9)}
    printer(dtc(0x2F, **evidence))
    printer(dtc(0x2E))
    printer(dtc(0x2F, **evidence))
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= 80
    assert said.count("meaning   pulses missed") == said.count("to do     check the sensor") == 1
    assert said.count("evidence  away from its place: 0.9919, limit 0.5 [pitch]") == 2
    assert all(said.count(f"{name} {value:.6g}") == 2 for name, value in evidence.items())
    assert said.count("status    0x2F  fdc +127  occurrence 1") == 2


def test_the_same_advice_is_given_once(capsys):
    printer = EventPrinter(as_json=False)
    printer.definition = definition
    printer(dtc(0x2F))
    printer({**dtc(0x2F, fault="crank.added_pulse"), "dtc": "P0336-3A", "t_ns": 5 * 10**9})
    assert "to do     as for P0336-39" in capsys.readouterr().out


def test_wrapping_breaks_groups_before_words_and_loses_nothing():
    assert wrapped("12345678  ab cd  ef", 12, 2) == "12345678\n  ab cd  ef"
    assert wrapped("at most 16.5 s or 3 [rad/s]", 12, 0) == "at most\n16.5 s or\n3 [rad/s]", (
        "a unit stays with its number"
    )
    assert wrapped("one\n\ttwo", 80) == "one\n\ttwo"
    assert wrapped("see " + "x" * 100, 80, 4) == "see\n    " + "x" * 100, "a path is not cut"
    seed = random.randrange(10**6)
    print(f"seed {seed}")
    draw = random.Random(seed)
    for _ in range(300):
        words = ["w" * draw.randint(1, 20) for _ in range(draw.randint(1, 30))]
        text = words[0] + "".join(" " * draw.randint(1, 3) + word for word in words[1:])
        made = wrapped(text, 40, 6)
        assert made.split() == words
        assert max(map(len, made.splitlines())) <= 40
        assert all(line.startswith(" " * 6) for line in made.splitlines()[1:])


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "-"), (0.0, "0"), (-0.0, "0"), (1504.13, "1504"), (0.00015572, "0.000156"), (11598.0, "11598"),
     (float("inf"), "inf"), (float("nan"), "nan"), (1e20, "1e+20")],
)  # fmt: skip
def test_numbers_are_short_and_whole_ones_whole(value, text):
    assert number(value, 3) == text


def test_evidence_in_short_form():
    evidence = {"value": 5.0, "threshold": 4.75, "size": 5.0} | {f"x{k} [rpm]": 1000.0 for k in range(9)}
    assert against(evidence, "size [V]") == "size: 5, limit 4.75 [V]"
    assert against({}, "") == "value: -, limit -"
    short = few(evidence, "size", 40)
    assert short.startswith("size: 5, limit 4.75  x0 [rpm] 1000")
    assert short.endswith("...")
    assert wrapped(short, 40, 0).count("\n") == 1
    assert state_in_words(0x2F) == "failed now, confirmed"
    assert state_in_words(0xA4) == "not failed now, pending, warning lamp on"


def kinds():
    yield from KINDS
    yield from get_args(WireFault.model_fields["kind"].annotation)
    for ecu in VIRTUAL_ECUS.values():
        if ecu.fault is not None:
            yield from get_args(ecu.fault.model_fields["kind"].annotation)


def test_every_kind_of_fault_has_words():
    assert len(set(kinds())) > 50
    for kind in kinds():
        assert any(kind == end or kind.endswith(f"_{end}") for end in WORDS), kind


@pytest.mark.parametrize(
    ("scenario", "fact", "text"),
    [
        ("crank_missed_tooth", Truth(4_013_000_000, "missed_pulses", 1, 20), "sensor misses pulses, 1 at tooth 20"),
        ("pedal_faults", Truth(3_000_000_000, "short_to_ground", 9), "channel 1: short circuit to ground, until 4.5 s"),
        ("pedal_faults", Truth(30_000_000_000, "garbage", 9), "channels 1, 2: readings are random, until 30.08 s"),
        ("linear_belt_faults", Truth(17_000_000_000, "output_offset", 9),
         "output 2: is off by a constant, size 10, until 20 s"),
        ("linear_belt_faults", Truth(32_000_000_000, "output_offset", 9),
         "output 3: is off by a constant, size 1, until 35 s"),
        ("steering_parts", Truth(6_500_000_000, "current_offset", 9),
         "current: is off by a constant, size 8, until 7 s"),
        ("steering_parts", Truth(11_000_000_000, "late_voltage", 9), "voltage frames come late"),
        ("crank_wire_lost", Truth(3_000_000_000, "lost", 9), "0x700: frames are lost, probability 0.5, until 5 s"),
        ("crank_healthy", Truth(1, "of_a_stranger", 9), "of a stranger"),
    ],
)  # fmt: skip
def test_an_injected_fault_in_words(scenario, fact, text):
    assert injected(fact, load_scenario(shipped(f"scenarios/{scenario}.toml"))) == text


def test_what_a_fault_s_own_keys_say_is_told_with_their_units():
    healthy = load_scenario(shipped("scenarios/crank_healthy.toml"))
    late = WireFault(kind="late", message="0x700", from_s=1, delay_ms=40, probability=0.5)
    told = injected(Truth(1_000_000_000, "late", 3), healthy.model_copy(update={"wire": (late,)}))
    assert told == "0x700: frames come late, probability 0.5, delay 40 ms"
    fault = {"kind": "noise", "ecu": "engine", "signal": "A.X", "size": 2, "when": "A.Y > 1"}
    noisy = healthy.model_copy(update={"fault": (MessageFault(**fault),)})
    assert injected(Truth(5, "noise", 3), noisy) == "A.X: is noisy, size 2, while A.Y > 1"
