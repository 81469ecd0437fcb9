"""The answer first: verdict, causes, symptoms by ECU; at any size in a few lines, and nothing is lost in JSON."""

import networks

from gateway.bus.frames import empty, put
from gateway.cli.events import EventPrinter
from gateway.faults.summary import FAULTS, STORED, UNTESTED, WHOLE, in_lines, summary_of
from gateway.runtime.app import Gateway

ECUS, MESSAGES = ("Brakes", "Engine", "Gears", "Doors"), 100
NETWORK = {"can0": {ecu: [(0x100 + 100 * n + k, 100) for k in range(MESSAGES)] for n, ecu in enumerate(ECUS)}}


def entry(name, dtc="U0100-87", *, failing=True, components=(), role="symptom", last_ns=10**9, text="message missing"):
    cause = {
        "role": role, "components": list(components), "probability": 0.99, "lead": name, "t_ns": last_ns,
        "ranked": [{"components": list(components), "probability": 0.99}],
    }  # fmt: skip
    return {
        "dtc": dtc, "fault": name, "status": 0x2F if failing else 0x2E, "first_ns": last_ns, "last_ns": last_ns,
        "description": text, "cause": cause if components else None,
    }  # fmt: skip


def missing(count, ecu="Brakes", **more):
    return [entry(f"can0.{ecu}{k}.timeout", f"U{0x100 + k:04X}-87", **more) for k in range(count)]


def lines(found, **more):
    return list(in_lines(found.as_dict(), lambda t_ns: f"{t_ns / 1e9:g} s", **more))


def test_two_thousand_symptoms_of_one_cause_are_two_lines_and_all_of_them_are_in_json():
    found = summary_of(missing(2000, components=["ecu can0.Brakes"]), tests=4000, not_judged=["it is off"] * 7)
    assert (found.verdict, found.title, found.failing) == (FAULTS, "Cause: ecu can0.Brakes", 2000)
    assert lines(found) == [
        "cause: ecu can0.Brakes (99 %), since 1 s",
        "  2000 messages of ECU Brakes: message missing (U0100-87 ... U08CF-87)",
        "not judged: 7 of 4000 tests, it is off",
    ]
    (cause,) = found.as_dict()["causes"]
    assert (cause["since_ns"], len(cause["faults"]), len(cause["symptoms"][0]["dtcs"])) == (10**9, 2000, 2000)


def test_what_nothing_explains_is_told_by_ecu_and_kind():
    ecus = {f"can0.Brakes{k}": "Brakes" for k in range(97)}
    other = entry("crank.missed_pulse", "P0336-39", text="pulses missed", last_ns=2 * 10**9)
    found = summary_of([*missing(97), other], ecus=ecus)
    assert found.title == "98 faults"
    assert lines(found) == [
        "P0336-39 crank.missed_pulse: pulses missed, since 2 s",
        "97 messages of ECU Brakes: message missing (U0100-87 ... U0160-87), since 1 s",
    ]


def test_what_has_healed_keeps_its_cause():
    found = summary_of(missing(4, failing=False, components=["bus can0"]))
    assert (found.verdict, found.title) == (STORED, "Cause of stored faults: bus can0")
    assert lines(found)[0] == "cause: bus can0 (99 %), stored, from 1 s"


def test_causes_by_the_dozen_are_counted():
    entries = [entry(f"m.f{k}", f"P{k:04d}-00", components=[f"part {k}"], text=f"text {k}") for k in range(20)]
    found = summary_of(entries)
    assert found.title == "20 causes"
    assert lines(found)[-1] == "and 12 more causes, of 12 faults"
    assert len(lines(found, every=True)) == 40
    many = summary_of([entry("m.f", components=[f"part {k}" for k in range(9)])])
    assert many.title == "Cause: part 0, part 1, part 2 and 6 more"


def test_nothing_is_a_verdict_too():
    assert summary_of((), tests=2).verdict == WHOLE
    assert summary_of((), tests=2, not_judged=["never came"] * 2).verdict == UNTESTED


def test_a_dead_ecu_of_a_hundred_messages_is_told_in_less_than_forty_lines(tmp_path, capsys):
    gateway = Gateway(networks.config_of(tmp_path, NETWORK, timeout=5))
    printer, every = EventPrinter(as_json=False), EventPrinter(as_json=False, every=True)
    told = {}
    for each in (printer, every):
        each.definition, each.ecus = gateway.catalogue.get, gateway.senders

    def hear(event):
        for each in (printer, every):
            each(event)
            told[each] = told.get(each, "") + capsys.readouterr().out

    gateway.listen(hear)
    gateway.start(0)
    for turn in range(40):
        alive = [i for ecu, of in NETWORK["can0"].items() for i, _ in of if turn < 20 or ecu != "Brakes"]
        frames = empty(len(alive))
        for k, can_id in enumerate(alive):
            put(frames, k, turn * 10**8 + round(k * 10**8 / len(alive)), can_id, bytes(8))
        gateway.feed(frames)
    gateway.advance(4 * 10**9)
    hear(gateway.summary(1.0))
    gateway.close()
    short = told[printer].splitlines()
    assert len(short) < 40
    at = short.index("Cause: ecu can0.Brakes")
    assert short[at + 1].startswith("  cause: ecu can0.Brakes (")
    assert short[at + 2].startswith("    100 messages of ECU Brakes: message missing for longer than its timeout")
    assert any("not judged: " in line and line.endswith("too little came for a result") for line in short)
    assert len(told[every].splitlines()) > 400, "each by itself, where that is asked for"
