"""Each slip in a monitor is one clear line: it names the monitor, the field and the file; compiled or not."""

from dataclasses import replace
from typing import Annotated

import numpy as np
import pytest
from battery_bus import battery_database, voltages

from gateway.engine.build import build_engine
from gateway.engine.events import QUALIFIED_FAILED
from gateway.engine.instances import MonitorInstance
from gateway.monitors import contract
from gateway.monitors.conformance import accepted
from gateway.monitors.contract import (
    Calibration,
    CusumCalibration,
    Debounce,
    Emission,
    Fault,
    Monitor,
    MonitorParams,
    Readout,
    Signal,
    report,
)
from gateway_fdi.errors import InputError
from gateway_fdi.jit import COMPILED, Record, f8, f8s, i8, kernel, labels, means


class Params(MonitorParams):
    limit: float = 11.0


class State(Record):
    lowest: f8
    cells: Annotated[f8s, 3]


class Const(Record):
    limit: f8
    fault: i8


class Inputs(contract.Inputs):
    volts: f8 = means(unit="V")
    amps: Annotated[f8s, 2]


class Evidence(Record):
    volts: f8 = means(unit="V")


class Outputs(Record):
    twice: f8
    half: f8


@kernel
def step(s, c, u, out):
    s.lowest = min(s.lowest, u.volts)
    report(out, c.fault, u.volts < c.limit, u.volts, c.limit).volts = u.volts
    out.values.twice, out.values.half = 2.0 * u.volts, 0.5 * u.volts
    out.send = 1


@kernel
def misspelt(s, c, u, out):
    s.lowest = min(s.lowets, u.volts)


@kernel
def too_few(s, c, u):
    pass


FAULT = Fault("low", "P0562-16", "too low", labels(Evidence), Debounce(1, 1))
CONNECTED = {
    "volts": Signal("BATT.Volts", unit="V", triggers=True),
    "amps": [Signal("BATT.Amps"), None],
}
GOOD = Monitor(
    type="battery",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    evidence=Evidence,
    outputs=Outputs,
    step=step,
    connect=lambda p: CONNECTED,
    prepare=lambda p, s, c: setattr(c, "limit", p.limit),
    faults=lambda p: (FAULT,),
    emits=lambda p: Emission("SAID", {"twice": "Twice", "half": "Half"}),
    capabilities=(Readout(("lowest",)),),
)


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    return battery_database(tmp_path_factory.mktemp("dbc"))


def run(database, *monitors, volts=(10.0, 12.0, 10.0), **signals):
    """Feed the voltages; returns the engine and the ids of the faults that failed."""
    instances = [MonitorInstance(name, monitor, Params(), signals=signals.get(name, {})) for name, monitor in monitors]
    engine = build_engine([(0, database)], instances, [])
    failed = []

    def sink(events):
        failed.extend(engine.faults[int(e["fault"])].id for e in events if e["kind"] == QUALIFIED_FAILED)

    engine.process(voltages(volts), sink)
    return engine, failed


def test_the_good_one_works_and_what_is_not_connected_is_no_number(database):
    engine, failed = run(database, ("a", GOOD))
    assert set(failed) == {"a.low"}
    assert engine.readout()["a"]["lowest"] == 0.0
    assert np.isnan(engine.tables.pool[-1])
    assert accepted(GOOD, "a:GOOD") is GOOD


def signals(**changed):
    return {"connect": lambda p: {k: v for k, v in {**CONNECTED, **changed}.items() if v != "gone"}}


class Whole(contract.Inputs):
    volts: i8
    amps: Annotated[f8s, 2]


class Nine(Record):
    many: Annotated[f8s, 9]


class Seventeen(Record):
    many: Annotated[f8s, 17]


class Eight(Record):
    many: Annotated[f8s, 8]


class Crooked(Record):
    good: f8
    number: i8


class Deep(contract.Inputs):
    volts: f8
    inner: Crooked


class Within(Record):
    inner: Crooked


BAD = Signal("BATT.Amps")
WRONG = {
    "another version": ({"api": 1}, "api = 1: written for version 1"),
    "params": ({"params": dict}, "params: a class that derives from MonitorParams"),
    "state": ({"state": State.dtype}, "state: a class that derives from Record"),
    "inputs": ({"inputs": State}, "inputs: a class that derives from Inputs"),
    "evidence that is no record": ({"evidence": f8}, "evidence: a class that derives from Record"),
    "an input that is no float": ({"inputs": Whole}, "inputs.volts: a field here is float64"),
    "an output that is no float": ({"outputs": Crooked}, "outputs.number: a field here is float64"),
    "a record in an input": ({"inputs": Deep}, "inputs.inner: a field here is float64"),
    "a record in evidence": (
        {"evidence": Within},
        "evidence.inner.number: a field here is float64",
    ),
    "nine of evidence": ({"evidence": Nine}, "evidence: 9 numbers; there is room for 8"),
    "seventeen outputs": ({"outputs": Seventeen}, "outputs: 17 numbers; there is room for 16"),
    "a kernel of three": ({"step": too_few}, "step takes (s, c, u, out)"),
    "a readout that is not there": (
        {"capabilities": (Readout(("lowets",)),)},
        "no field 'lowets'; did you mean lowest?",
    ),
    "a readout twice": ({"capabilities": (Readout(("lowest", "lowest")),)}, "shown twice"),
    "a readout of an array": (
        {"capabilities": (Readout(("cells",)),)},
        "'cells' is not one number",
    ),
    "two readouts": ({"capabilities": (Readout(()), Readout(()))}, "Readout is there 2 times"),
    "two calibrations": (
        {
            "capabilities": (
                Calibration((), lambda s: (), lambda p: ()),
                CusumCalibration((), {}, lambda s: (), lambda s: ()),
            )
        },
        "one kind of calibration",
    ),
    "no such input": (
        signals(vlots=BAD),
        "connect = 'vlots': there is no such input; did you mean volts",
    ),
    "an input too few": (signals(volts="gone"), "connect.volts: this input is not connected; None"),
    "no input at all": ({"connect": lambda p: {}}, "connect.volts: this input is not connected"),
    "a signal too many": (
        signals(amps=[BAD, BAD, BAD]),
        "connect.amps: 3 signals for an array of 2",
    ),
    "one signal for an array": (
        signals(amps=BAD),
        "connect.amps: an array of 2: one signal for each",
    ),
    "an array for one": (signals(volts=[BAD]), "connect.volts: one signal, not 1"),
    "a text": (signals(volts="BATT.Volts"), "connect.volts = 'BATT.Volts': a Signal("),
    "a text in an array": (
        signals(amps=["BATT.Amps", None]),
        "connect.amps = 'BATT.Amps': a Signal(",
    ),
    "nothing triggers": (signals(volts=Signal("BATT.Volts")), "connect: no signal triggers"),
    "a name twice": (
        {"faults": lambda p: (FAULT, FAULT)},
        "faults[1].name = 'low': this name is taken",
    ),
    "names without values": (
        {"faults": lambda p: (replace(FAULT, evidence=("a", "b")),)},
        "faults[0].evidence = 'low': 2 names of evidence; a result has room for 1",
    ),
    **{
        f"a debounce without {text}": (
            {"faults": lambda p, changed=changed: (replace(FAULT, debounce=Debounce(**changed)),)},
            f"faults[0].debounce = 'low': {text}",
        )
        for text, changed in {
            "failed_after = 0: at least 1": {"failed_after": 0},
            "passed_after = 0: at least 1": {"passed_after": 0},
            "failed_step = 0: at least 1": {"failed_step": 0},
            "passed_step = -1: at least 1": {"passed_step": -1},
            "a debounce by time needs both": {"failed_ms": 10.0},
            "failed_ms = nan: 0 to 3.6e+06 ms": {"failed_ms": float("nan"), "passed_ms": 1.0},
        }.items()
    },
    "emits without outputs": ({"outputs": None}, "emits: outputs and emits go together"),
    "outputs without emits": ({"emits": None}, "emits: outputs and emits go together"),
    "an output without a signal": (
        {"emits": lambda p: Emission("SAID", {"twice": "Twice"})},
        "emits = 'twice': signals for each output, in their order: twice, half",
    ),
    "a signal too many for an output": (
        {"emits": lambda p: Emission("SAID", {"twice": ("Twice", "Half"), "half": "Half"})},
        "emits.twice: 2 signals for 1 numbers",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_each_slip_is_one_line_with_monitor_field_and_file(database, case):
    changed, told = WRONG[case]
    with pytest.raises(InputError) as refused:
        run(database, ("a", accepted(replace(GOOD, **changed), "a:GOOD")))
    text = str(refused.value)
    assert told in text
    assert "\n" not in text
    assert text.startswith(f'{__file__}: monitor type "battery"')


def test_what_there_is_just_room_for_is_accepted():
    assert accepted(replace(GOOD, evidence=Eight), "a:GOOD").evidence is Eight


@pytest.mark.parametrize("name", ["volts", "amps"])
def test_an_input_may_be_connected_to_nothing(database, name):
    only = {**CONNECTED, name: None} | ({"amps": [CONNECTED["volts"]] * 2} if name == "volts" else {})
    engine, failed = run(database, ("a", replace(GOOD, connect=lambda p: only)))
    assert failed == ([] if name == "volts" else ["a.low"])
    assert np.isnan(engine.tables.pool[2:]).sum() == (1 if name == "volts" else 2)


def test_a_monitor_may_send_nothing(database):
    @kernel
    def silent(s, c, u, out):
        report(out, 0, u.volts < c.limit, u.volts, c.limit).volts = u.volts

    _, failed = run(database, ("a", replace(GOOD, step=silent, emits=None, outputs=None)))
    assert set(failed) == {"a.low"}


def test_what_is_no_monitor_is_refused():
    with pytest.raises(InputError, match=r"'pkg:NAME': this is no Monitor, but dict"):
        accepted({}, "pkg:NAME")


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (signals(volts=Signal("BATT.Vlots", triggers=True)), "did you mean Volts"),
        (signals(volts=Signal("BAT.Volts", triggers=True)), "did you mean BATT"),
        (signals(volts=Signal("BATT.Volts", unit="mV", triggers=True)), 'its unit is "V" in the database'),
        (signals(volts=Signal("Volts", triggers=True)), 'a signal is named "Message.Signal"'),
        ({"triggers": lambda p: ("BAT",)}, "did you mean BATT"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_database_is_told_by_the_monitor_s_name(database, changed, told):
    with pytest.raises(InputError, match='monitor "a"') as refused:
        run(database, ("a", replace(GOOD, **changed)))
    assert told in str(refused.value)


def test_a_signal_that_the_monitor_does_not_have_cannot_be_put_elsewhere(database):
    with pytest.raises(
        InputError,
        match=r'monitor "a".signals = .BATT.Vlots.: the monitor has no such signal; did you mean',
    ):
        run(database, ("a", GOOD), a={"BATT.Vlots": "OTHER.Volts"})
    _, failed = run(database, ("a", GOOD), a={"BATT.Volts": "OTHER.Volts"})
    assert failed == [], "BATT steps nobody now"


@pytest.mark.skipif(not COMPILED, reason="in plain Python its first step fails: tests/engine/test_fence.py")
def test_a_misspelt_field_of_a_record_is_one_error_that_names_it(database):
    with pytest.raises(Exception, match="lowets") as refused:
        run(database, ("a", replace(GOOD, step=misspelt)))
    assert "misspelt" in str(refused.value)


@pytest.mark.parametrize("number", [1, 2, -1, 2**31 - 1])
def test_a_number_beyond_its_faults_is_counted_and_nobody_else_s_fault(database, number):
    wrong = replace(GOOD, prepare=lambda p, s, c: (setattr(c, "limit", 11.0), setattr(c, "fault", number)))
    engine, failed = run(database, ("a", wrong), ("z", GOOD))
    assert set(failed) == {"z.low"}
    assert engine.counters()["results_unknown"] == 3


def test_evidence_is_that_of_the_step_not_of_the_one_before(database):
    @kernel
    def forgets(s, c, u, out):
        e = report(out, 0, u.volts < c.limit, u.volts, c.limit)
        if s.lowest == 0.0:
            e.volts = u.volts
        s.lowest = 1.0

    engine, _ = run(database, ("a", replace(GOOD, step=forgets)), volts=(10.0,))
    assert engine.tables.out[0]["results"][0]["evidence"][0] == 10.0
    engine.process(voltages([10.0], 4_000_000), lambda _: None)
    assert engine.tables.out[0]["results"][0]["evidence"].tolist() == [0.0] * 8


def test_more_results_than_there_is_room_for_are_counted(database):
    @kernel
    def talks(s, c, u, out):
        for _ in range(200):
            report(out, 0, False, u.volts, c.limit).volts = 1.0

    engine, _ = run(database, ("a", replace(GOOD, step=talks)), volts=(12.0,))
    assert engine.counters()["results_lost"] == 200 - contract.MAX_RESULTS
