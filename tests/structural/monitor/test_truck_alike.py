"""The truck's T1 to T4 as a structural monitor, beside the monitor that was built by hand, on the same frames."""

import numpy as np
import pytest
import truck_data
from amount import amount

from gateway.bus.frames import empty
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway.signals import frame_encoding as encode
from gateway_bench.vecu.databases import message_of
from gateway_fdi.common.resources import shipped
from gateway_plants.truck.ecu.ecu import DATABASE, MESSAGES
from gateway_plants.truck.monitor.messages import MESSAGES as INPUTS
from gateway_plants.truck.monitor.messages import signal_of
from gateway_plants.truck.monitor.records import R1, R2

BEGIN = 10**9
SECONDS = amount(120, 30, 4)
TESTS = ("T1", "T2", "T3_ICDS", "T4_ICDS")


def frames_of(rows):
    """The frames of samples, four each 10 ms, in the truck's messages."""
    count = len(rows)
    columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    columns |= {"w_e_sens": columns["omega_e_sens"], "w_gb_sens": columns["omega_gb_sens"]}
    columns |= {"SoC_start": np.full(count, 0.5), "FrameCnt": np.arange(count) % 256}
    columns |= {"shift_active": np.zeros(count), "eng_run": np.ones(count)}
    frames = empty(4 * count)
    for place, name in enumerate(MESSAGES):
        message = message_of(DATABASE, name)
        values = {s.name: columns[s.name] for s in message.signals if s.name != "Crc"}
        stamps = BEGIN + np.arange(count) * 10_000_000 + place * 300_000
        frames[place::4] = encode.frames_of(message, values, stamps)
    return frames


def configuration(folder):
    knowns = {
        known: f"{message}.{signal_of(known)}"
        for message, fields in INPUTS.items()
        for known in fields
        if known != "charge"
    }
    signals = ", ".join(f'{known} = "{name}"' for known, name in knowns.items())
    path = folder / "gateway.toml"
    path.write_text(
        f'[clock]\nwatched = false\n[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = ["{shipped("dbc/truck.dbc")}"]\n'
        f'health = {{ watched = false }}\n[memory]\npath = "{folder}/faults.sqlite"\n'
        '[[monitor]]\nname = "by_hand"\ntype = "hybrid_powertrain"\nfollow = false\n'
        f'[[monitor]]\nname = "own"\ntype = "structural"\nmodel = "truck.toml"\nsample = "set"\ntests = {list(TESTS)}\n'
        f"signals = {{ {signals} }}\n"
    )
    return path


@pytest.mark.long
@pytest.mark.costly
def test_residuals_are_those_of_the_monitor_by_hand(tmp_path):
    """T1 and T2; T3 and T4 it steps in windows only.

    Frames are lost, one of a set here and there: both step over the set.
    """
    frames = frames_of(truck_data.drive(SECONDS, 7, noise=0.3, f_R=-0.2, f_pe=-0.01, f_eta=-0.1))
    lost = np.random.default_rng(5).random(len(frames)) < 0.01
    path = configuration(tmp_path)
    gateway = Gateway(load_config(path), None, file=path)
    gateway.start(BEGIN)
    places = [gateway.engine.place_of(name) for name in ("by_hand", "own")]
    by_hand, own = (gateway.engine.state_of(place)[0] for place in places)
    theirs, ours, sets = [], [], []
    for k in np.flatnonzero(~lost):
        gateway.feed(frames[k : k + 1])
        assert int(own.own.samples) == int(by_hand.sets)
        if int(own.own.samples) > len(ours):
            theirs.append([float(by_hand.residual[R1]), float(by_hand.residual[R2])])
            ours.append(own.own.residual[:4].copy())
            sets.append(int(k) // 4)
    gateway.close()
    assert len(ours) < len(frames) // 4 * 0.98
    theirs, ours = np.array(theirs), np.array(ours)
    assert np.abs(ours[:, :2] - theirs).max() < 1e-9
    assert np.abs(theirs).max(0).min() > 0.1
    assert np.diff(sets).max() > 1


@pytest.mark.long
@pytest.mark.costly
def test_t3_and_t4_are_those_by_hand(tmp_path):
    frames = frames_of(truck_data.drive(SECONDS, 7, noise=0.3, f_R=-0.2, f_pe=-0.01, f_eta=-0.1))
    path = configuration(tmp_path)
    gateway = Gateway(load_config(path), None, file=path)
    gateway.start(BEGIN)
    own = gateway.engine.state_of(gateway.engine.place_of("own"))[0]
    ours, samples = [], []
    for k in range(3, len(frames), 4):
        gateway.feed(frames[k - 3 : k + 1])
        ours.append(own.own.residual[:4].copy())
        samples.append({name: float(own.sample[name]) for name in own.sample.dtype.names})
    gateway.close()
    for place, expected in (
        (0, truck_data.t1(samples)),
        (1, truck_data.t2(samples)),
        (2, truck_data.integral(samples, "T3")),
        (3, truck_data.integral(samples, "T4")),
    ):
        assert np.abs(np.array(ours)[:, place] - expected).max() < (3e-4 if place > 1 else 1e-9), TESTS[place]
        assert np.abs(expected).max() > 1e-2
