"""The hybrid truck: follows its cycle with every fault, is the plant of its structural model, and sends what
it says.
"""

import numpy as np
import pytest
from amount import amount, examples
from hypothesis import given, settings
from hypothesis import strategies as st
from protecting import protect

from gateway.bus.frames import payload
from gateway.signals import frame_encoding as encode
from gateway_bench.vecu.contract import Run
from gateway_bench.vecu.databases import message_of
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputErrors
from gateway_fdi.jit import COMPILED
from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.generator.loading import residual_generator
from gateway_plants.truck.ecu.cycles import speeds
from gateway_plants.truck.ecu.drive import drive
from gateway_plants.truck.ecu.ecu import DATABASE, ECU, MESSAGES, frames_of
from gateway_plants.truck.ecu.params import TruckFault, TruckParams

compiled = pytest.mark.skipif(not COMPILED, reason="millions of steps of the plant")
TRUCK = TruckParams(type="truck")
FTP75 = 1874.0
FAULTS = (
    "battery_short",
    "inverter_voltage",
    "machine_efficiency",
    "machine_resistance",
    "machine_voltage_sensor",
)


def test_ftp75_is_the_published_schedule():
    t = np.arange(0.0, 1370.0)
    v = speeds("udds", t)
    assert np.trapezoid(v, t) / 1609.344 == pytest.approx(7.45, abs=0.01)
    assert v.max() == pytest.approx(25.348, abs=1e-3)
    t = np.arange(0.0, FTP75 + 1)
    assert np.trapezoid(speeds("ftp75", t), t) == pytest.approx(17_770, abs=20)
    assert (speeds("ftp75", np.arange(1.0, 500.0) + 1369.0) == speeds("ftp75", np.arange(1.0, 500.0))).all()
    assert speeds("ftp75", np.array([5000.0]))[0] == 0.0


@compiled
@pytest.mark.parametrize("fault", [None, *FAULTS[:: amount(1, 2)]])
def test_it_follows_the_cycle_with_every_fault(fault):
    """Speed within 2.5 m/s, 17.6 km, charge between 0.40 and 0.60."""
    faults = () if fault is None else (TruckFault(kind=fault),)
    driven = drive(TRUCK, faults, FTP75)
    rows = driven.samples
    assert np.abs(rows["v"] - driven.asked).max() <= 2.5
    assert rows["v"].sum() * 0.01 >= 17_600
    assert 0.40 <= rows["soc"].min() <= rows["soc"].max() <= 0.60
    assert 4 < rows["fuel"][-1] < 9
    assert set(np.unique(rows["gear"])) >= {1, 4, 8, 12}
    assert 0.5 < rows["locked"].mean() < 0.8
    assert np.abs(rows["i_em"]).max() < 1200  # peaks at shifts, until the current loop has learned half a voltage


@compiled
def test_the_same_arguments_give_the_same_drive():
    a, b = (drive(TRUCK, (), 60.0).samples for _ in range(2))
    assert (a == b).all()


def windows(rows, least=8.0):
    """Where the clutch has held for long: [first, last) samples."""
    held = (rows["locked"] == 1) & (rows["clutch"] > 0.995)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(int), [0]])))
    return [(a, b) for a, b in edges.reshape(-1, 2) if (b - a) * 0.01 >= least]


def residuals(rows, test, slope=0.0):
    """Largest residual of a generator without noise, over all windows in which the clutch holds."""
    model = load_model(shipped("models/truck.toml"))
    choice = model.residuals[test]
    loaded = residual_generator(model, choice.equations, choice.consistency)
    s, c = (np.zeros(1, d).view(np.recarray) for d in (loaded.state, loaded.const))
    u = np.zeros(len(rows), loaded.inputs).view(np.recarray)
    loaded.prepare(c[0])
    loaded.reset(s[0], c[0])
    columns = {
        "ice_ctrl": "ice", "U_em_ctrl": "volts", "u_c": "clutch", "gear": "gear", "T_b_ctrl": "brake",
        "I_b_sens": "i_b", "U_em_sens": "u_em", "I_em_sens": "i_em", "omega_e_sens": "omega_e",
        "omega_gb_sens": "omega_gb",
    }  # fmt: skip
    for known in loaded.inputs.names:
        u[known] = rows[columns[known]] if known in columns else slope
    s, c = s[0], c[0]
    found = np.full(len(rows), np.nan)
    for first, last in windows(rows):
        loaded.start(s, c, u[first])
        for k in range(first, last):
            found[k] = loaded.step(s, c, u[k], 0.01 if k > first else 0.0)
    found[np.abs(rows["u_em"]) <= 20] = np.nan
    return float(np.abs(found[np.isfinite(found)]).max(initial=0.0))


TESTS = ("T1", "T2", "T3_ICDS", "T4_ICDS", "T3_MCDS", "T4_MCDS")
#: What no noise leaves of the residuals: Euler's steps of 10 ms beside the plant's of 1 ms, a SoC that drifts.
HEALTHY = {
    "T1": 1e-9,
    "T2": 2.0,
    "T3_ICDS": 0.05,
    "T4_ICDS": 0.1,
    "T3_MCDS": 0.004,
    "T4_MCDS": 0.008,
}


@pytest.mark.long
@compiled
def test_without_a_fault_its_residuals_are_small():
    """The plant is the structural model: no term is missing, and no sign is wrong."""
    rows = drive(TRUCK, (), 400.0).samples
    assert len(windows(rows)) >= 3
    for test in TESTS:
        assert residuals(rows, test) < HEALTHY[test], test


@pytest.mark.long
@compiled
@pytest.mark.parametrize("fault", FAULTS[:: amount(1, 2)])
def test_a_fault_excites_the_residuals_of_its_signature(fault):
    """Fault signature matrix of the structural analysis, by the plant: all of those, and no others."""
    model = load_model(shipped("models/truck.toml"))
    names = dict(zip(FAULTS, ("f_b_sc", "f_pe", "f_em_eta", "f_em_R", "f_em_U_sens"), strict=True))
    rows = drive(TRUCK, (TruckFault(kind=fault),), 400.0).samples
    for test in TESTS:
        equations = model.residuals[test].equations
        sensitive = any(names[fault] in e.faults for e in model.equations if e.name in equations)
        found = residuals(rows, test)
        assert (found > 3 * HEALTHY[test]) is sensitive, (test, found)


@compiled
def test_faults_begin_and_end():
    fault = TruckFault(kind="machine_voltage_sensor", from_s=5.0, to_s=7.0, size=30.0)
    with_it, without = drive(TRUCK, (fault,), 10.0).samples, drive(TRUCK, (), 10.0).samples
    off = with_it["u_em"] - without["u_em"]
    assert (off[:500] == 0).all()
    assert (off[500:700] == 30).all()
    assert (off[700:] == 0).all()


@compiled
@pytest.mark.parametrize(
    ("change", "quantity", "sign"),
    [
        ({"mass": 1.5}, "fuel", 1),
        ({"wind": 8.0}, "fuel", 1),
        ({"slope": 0.01}, "fuel", 1),
        ({"drag": 0.5}, "fuel", -1),
        ({"engine": 0.9}, "fuel", 1),
        ({"brake": 1.5}, "brake", -1),
    ],
)
def test_disturbances_act(change, quantity, sign):
    nominal = drive(TRUCK, (), 300.0).samples
    other = drive(TRUCK.model_copy(update=change), (), 300.0).samples
    total = [
        rows["fuel"][-1] if quantity == "fuel" else rows["brake"][rows["v"] > 1].sum() for rows in (nominal, other)
    ]
    assert sign * (total[1] - total[0]) > 0.02 * total[0]


def test_frames_carry_the_drive():
    """Decoded with cantools: each signal within half a step, counters and CRCs as protect makes them."""
    seconds = amount(20.0, 20.0, 0.5)
    params = TRUCK.model_copy(update={"start_s": 40.0, "noise_factor": 0.0})
    driven = drive(params, (), seconds)
    frames = frames_of(params, driven, bus=3, rng=np.random.default_rng(1))
    count = round(seconds * 100)
    assert len(frames) == 4 * count
    assert (np.diff(frames["t_ns"]) > 0).all()
    assert set(frames["bus"]) == {3}
    columns = {
        "I_b_sens": "i_b", "U_em_sens": "u_em", "I_em_sens": "i_em", "w_e_sens": "omega_e", "w_gb_sens": "omega_gb",
        "U_em_ctrl": "volts", "ice_ctrl": "ice", "u_c": "clutch", "gear": "gear", "T_b_ctrl": "brake",
    }  # fmt: skip
    for place, name in enumerate(MESSAGES):
        message = message_of(DATABASE, name)
        for k in range(0, count, 37):
            frame = frames[4 * k + place]
            assert frame["can_id"] == message.frame_id
            data = bytes(frame["data"][:8])
            values = message.decode(data)
            assert values["FrameCnt"] == k % 256
            assert data == protect(message, {n: v for n, v in values.items() if n != "Crc"})
            for signal in message.signals:
                if signal.name in columns:
                    wanted = float(driven.samples[columns[signal.name]][k])
                    assert abs(values[signal.name] - wanted) <= 0.5 * signal.scale + 1e-9, signal.name


@settings(max_examples=examples(60), deadline=None)
@given(st.data())
def test_packed_frames_are_those_of_cantools(data):
    name = data.draw(st.sampled_from(MESSAGES))
    message = message_of(DATABASE, name)
    rows = [
        {
            s.name: data.draw(st.floats(s.minimum, s.maximum)) if s.length > 1 else data.draw(st.integers(0, 1))
            for s in message.signals
            if s.name != "Crc"
        }
        for _ in range(3)
    ]
    for row in rows:  # as numbers that the signals can carry, so that rounding of halves does not matter
        for s in message.signals:
            if s.name in row:
                row[s.name] = round(row[s.name] / s.scale) * s.scale
    packed = encode.frames_of(message, {n: [row[n] for row in rows] for n in rows[0]}, np.arange(len(rows)))
    assert [payload(frame) for frame in packed] == [protect(message, row) for row in rows]


def test_what_a_signal_cannot_carry_is_clipped():
    message = message_of(DATABASE, "HEV_CTRL_VEH")
    clipped = encode.frames_of(message, {"T_b_ctrl": [1e9], "alpha": [-9.0], "FrameCnt": [1]}, np.zeros(1))
    assert message.decode(payload(clipped[0]))["T_b_ctrl"] == 65535
    assert message.decode(payload(clipped[0]))["alpha"] == pytest.approx(-0.32768)


def test_noise_is_that_of_the_sensors():
    params = TRUCK.model_copy(update={"start_s": 0.0})
    seconds = amount(15.0, 15.0, 2.0)
    frames, truth = ECU.frames(
        params, (TruckFault(kind="battery_short", from_s=1.0),), Run(seconds, 0, np.random.default_rng(5))
    )
    assert [t.kind for t in truth] == ["battery_short"]
    message = message_of(DATABASE, "HEV_SENS_MECH")
    mine = frames[frames["can_id"] == message.frame_id]
    values = [message.decode(bytes(f["data"][:8])) for f in mine]
    still = np.array([v["w_gb_sens"] for v in values])  # the truck stands
    assert still.std() == pytest.approx(0.2, rel=0.25)
    engine = np.array([v["w_e_sens"] for v in values])
    assert engine.std() == pytest.approx(0.5, rel=0.25)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"kind": "battery_short", "size": -1.0}, "more than -1"),
        ({"kind": "battery_short", "from_s": 3.0, "to_s": 3.0}, "to_s must lie after from_s"),
        ({"kind": "battery_empty"}, "kind"),
    ],
)
def test_bad_faults_are_refused(fault, said):
    with pytest.raises(ValueError, match=said):
        TruckFault.model_validate(fault)


def test_it_is_an_ecu_of_a_scenario(tmp_path):
    """Frames of its own bus in a player, faults by their kinds; another ECU's faults are refused."""
    text = """
name = "truck"
duration_s = {seconds}
[[ecu]]
type = "truck"
start_s = 20.0
[[fault]]
ecu = "truck"
kind = "{kind}"
from_s = 0.1
"""
    path = tmp_path / "truck.toml"
    path.write_text(text.format(seconds=amount(3.0, 3.0, 0.5), kind="machine_voltage_sensor"))
    player = Player(load_scenario(path), {"powertrain": 2})
    assert set(player.frames["can_id"]) == {0x100, 0x101, 0x110, 0x111}
    assert set(player.frames["bus"]) == {2}
    assert [t.kind for t in player.truth] == ["machine_voltage_sensor"]
    path.write_text(text.format(seconds=1.0, kind="actuator_offset"))
    with pytest.raises(InputErrors, match="of type truck: it has no actuator_offset"):
        load_scenario(path)
