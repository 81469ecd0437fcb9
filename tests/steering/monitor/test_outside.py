"""Steerings of another make (tests/steering/outside): what differs from what is told, and what is at fault."""

import numpy as np
import pytest
from amount import FULL, amount
from steering import bus
from steering.drive import Machine, drive, told

from gateway_bench.wire.replay import config_of, through
from gateway_fdi.errors import GatewayError
from gateway_fdi.jit import COMPILED

pytestmark = [pytest.mark.long, pytest.mark.skipif(not COMPILED, reason="30 s of frames each 1 ms")]

#: Seeds that judge; none below 1000 does.
SEED = 60_000
M = Machine()


def run(seed, machine=M, seconds=30.0, *, of_drive=None, of_bus=None, change=None, **params):
    """Replay a drive; returns what was said."""
    print("seed", seed)
    rng = np.random.default_rng(seed)
    x = drive(machine, seconds, rng, **(of_drive or {}))
    frames = bus.frames(x, machine, **(of_bus or {}))
    return through(config_of(told(M, **(params or {})), bus.DBC), [frames if change is None else change(frames)])


#: Differs from what is told -> machine, options of drive, of the bus, and what may be said of it.
HEALTHY = {
    "as told": (M, {}, {}, ()),
    "resistance +20 %": (M.changed(resistance=0.0576), {}, {}, ()),
    "resistance -20 %": (M.changed(resistance=0.0384), {}, {}, ()),
    "flux -5 %": (M.changed(flux=0.95 * M.flux), {}, {}, ()),
    "inductance +20 %": (M.changed(ld=1.44e-4, lq=1.44e-4), {}, {}, ()),
    "Lq / Ld 1.4": (M.changed(lq=1.68e-4), {}, {}, ()),
    "inertia +20 %": (M.changed(inertia=1.2 * M.inertia), {}, {}, ()),
    "field weakening, -40 A": (M, {"weak": -40.0}, {}, ()),
    "angle 14 bit, quiet": (M.changed(noise=1e-5), {}, {}, ()),
    "angle 12 bit": (M.changed(steps=4096), {}, {}, ()),
    "angle 10 bit": (M.changed(steps=1024), {}, {}, ()),
    "angle 10 bit, quiet": (M.changed(steps=1024, noise=5e-5), {}, {}, ()),
    "angle 9 bit": (M.changed(steps=512), {}, {}, ()),
    "angle 8 bit": (M.changed(steps=256), {}, {}, ()),
    "angle 8 bit, quiet": (M.changed(steps=256, noise=5e-5), {}, {}, ()),
    "wheel delay 0 ms": (M, {}, {"wheel_delay_ms": 0.0}, ()),
    "wheel delay 12 ms": (M, {}, {"wheel_delay_ms": 12.0}, ()),
    "wheel delay 18 ms": (M, {}, {"wheel_delay_ms": 18.0}, ()),
    "bursts of 20 ms": (M, {}, {"burst_ms": 20}, ("pairing",)),
}


@pytest.mark.parametrize("name", HEALTHY if FULL else [*list(HEALTHY)[::4], "angle 8 bit, quiet"])
def test_a_steering_that_is_not_as_told_is_not_accused(name):
    machine, of_drive, of_bus, allowed = HEALTHY[name]
    for k in range(amount(8, 1)):
        said = run(SEED + k, machine, amount(60.0, 20.0), of_drive=of_drive, of_bus=of_bus)
        assert set(said.set) <= set(allowed), (name, k)
        state = said.monitors["m"]
        assert state["pairs"] > 0.99 * amount(60.0, 20.0) * 1000
        assert state["wheel_age_ms"] == pytest.approx(of_bus.get("wheel_delay_ms", 5.0), abs=1.5)


@pytest.mark.parametrize("off", [0.0, 1.5])
def test_a_column_that_twists_is_told_and_accuses_nobody(off):
    """0.3 deg at the largest load, told 0.35: silent; the pinion's fault is found all the same."""
    print("seed", SEED + 500)
    x = drive(M, 24.0, np.random.default_rng(SEED + 500))
    twist = 0.3 * x["true"] / np.abs(x["true"]).max() + off * (np.arange(24_000) >= 16_000)
    frames = bus.frames(x, M, pinion_add=twist)
    if off == 0.0:
        assert through(config_of(told(M), bus.DBC), [frames]).set != []
    said = through(config_of(told(M, compliance=0.35), bus.DBC), [frames])
    assert set(said.set) <= {"angles", "pinion_angle"}
    assert (said.set == []) == (off == 0.0)


def test_a_dead_time_that_is_told_is_no_fault_of_the_voltage():
    real = M.changed(dead=0.2)
    print("seed", SEED + 510)
    x = drive(real, 20.0, np.random.default_rng(SEED + 510))
    step = 1.5 * (np.arange(20_000) >= 12_000)
    for volts, expected in ((0.0, set()), (step, {"voltage"})):
        frames = bus.frames(x, real, voltage=volts)
        said = through(config_of(told(M, dead_volts=0.2), bus.DBC), [frames])
        assert set(said.set) - {"electric"} == expected, said.dtcs


def ramp(n, begin, slope):
    return np.maximum(np.arange(n) - begin * 1000, 0) * 1e-3 * slope


def test_the_angle_sensors_faults_are_named_for_every_delay():
    """From 12 s on, in motion or at rest, with the steering wheel's angle 12 ms old."""
    n = 20_000
    step = (np.arange(n) >= 12_000).astype(float)
    noise = np.random.default_rng(3).normal(0, 0.03, n) * step
    for name, options in {
        "motor_angle_offset": {"add": 0.2 * step},
        "motor_angle_noise": {"add": noise},
    }.items():
        for k in range(amount(10, 1)):
            said = run(SEED + 100 + k, M, 20.0, of_drive=options, of_bus={"wheel_delay_ms": 12.0})
            assert said.set[0] == name, (k, said.dtcs)
            assert 12.0 <= said.at(name) < 13.0
            assert not set(said.set) & {"wheel_angle", "pinion_angle", "current", "voltage"}


def test_a_stuck_sensor_is_found_when_the_motor_turns():
    for k in range(amount(10, 2)):
        said = run(SEED + 200 + k, M.changed(steps=1024), 25.0, of_drive={"held": 12.0})
        assert "motor_angle_stuck" in said.set
        assert not set(said.set) & {"wheel_angle", "pinion_angle"}


@pytest.mark.parametrize("delay", [5.0, 12.0])
def test_the_other_angles_are_named_whatever_the_delay(delay):
    n = 30_000
    step = (np.arange(n) >= 15_000).astype(float)
    for part in ("wheel", "pinion"):
        for k in range(amount(10, 1)):
            said = run(SEED + 300 + k, M, 30.0, of_bus={"wheel_delay_ms": delay, f"{part}_add": 1.5 * step})
            assert f"{part}_angle" in said.set or said.set == ["angles"], said.dtcs
            other = {"wheel": "pinion", "pinion": "wheel"}[part]
            assert f"{other}_angle" not in said.set
            assert min(t for t, _, _ in said.dtcs) >= 15.0


def test_messages_of_other_names_by_configuration(tmp_path):
    """An own database: other names of messages and signals, the same units; another unit is refused by its key."""
    text = bus.DBC.read_text()
    names = {"AFS_MotCur": "EPS_Phase", "I_U": "PhaseU", "SAS_Angle": "LWI_01", "Delta_S_dot": "LWI_Rate"}
    for old, new in names.items():
        text = text.replace(f" {old} ", f" {new} ").replace(f" {old}:", f" {new}:")
    own = tmp_path / "own.dbc"
    own.write_text(text)
    x = drive(M, 12.0, np.random.default_rng(SEED + 400), add=0.2 * (np.arange(12_000) >= 8000))
    frames = bus.frames(x, M)
    signals = {
        f"{message}.{name}": f"{names.get(message, message)}.{names.get(name, name)}"
        for message, all_names in {
            "AFS_MotCur": ("I_U", "I_V", "Theta_park", "MC_cur", "Valid_cur"),
            "SAS_Angle": ("Delta_S", "Delta_S_dot", "MC_sas", "Valid_sas"),
        }.items()
        for name in all_names
    }
    said = through(config_of(told(M, signals=signals), own), [frames])
    assert said.set[0] == "motor_angle_offset"
    own.write_text(text.replace('(1,0) [-2048|2047] "deg/s"', '(1,0) [-2048|2047] "rad/s"'))
    with pytest.raises(GatewayError, match=r'rad/s.* in the database, the plant wants "deg/s"') as error:
        through(config_of(told(M, signals=signals), own), [frames])
    assert "SAS_Angle.Delta_S_dot" in str(error.value)


def test_a_machine_of_gym_electric_motor():
    """Its solver, its inverter: silent when healthy; a current and the pinion are found, and nothing else named."""
    from steering import gem

    x = gem.drive()
    n = len(x["sensor"])
    step = (np.arange(n) >= 2000).astype(float)

    def said(x, **of_bus):
        config = config_of(told(gem.GEM, resistance_error=0.1), bus.DBC)
        return through(config, [bus.frames(x, gem.GEM, **of_bus)])

    assert np.abs(x["omega"]).max() > 40.0, "it turns"
    assert said(x).set == []
    current = said(x | {"i_u": x["i_u"] + 15.0 * step}).set
    print(current)
    assert set(current) & {"current", "electric"}
    pinion = said(x, pinion_add=1.5 * step, wheel_delay_ms=9.0).set
    print(pinion)
    assert set(pinion) & {"pinion_angle", "angles"}
    assert not {"wheel_angle", "current", "voltage"} & set(pinion)
