"""Redundant pairs and triples on the bus: what is found, what is sent, what is refused."""

import cantools
import numpy as np
import pytest
from amount import SMALL, amount
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from gateway.bus.frames import empty, payload, put
from gateway.engine.build import build_engine
from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED
from gateway.engine.instances import MonitorInstance
from gateway.signals.database import load_database
from gateway_bench.vecu.contract import Run
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import COMPILED, zeros
from gateway_plants.pedal.ecu.ecu import ECU
from gateway_plants.pedal.ecu.params import PedalParams, SensorFault, SensorParams
from gateway_plants.pedal.monitor import PAIR, TRIPLE
from gateway_plants.pedal.monitor.faults import faults
from gateway_plants.pedal.monitor.monitor import AGREED, DEGRADED, INVALID, ONE_CHANNEL, SILENCE, _prepare
from gateway_plants.pedal.monitor.params import PRESETS, Channel, PairParams, TripleParams
from gateway_plants.pedal.monitor.records import Const, State

PEDAL = shipped("dbc/pedal.dbc")
VOTED = cantools.database.load_file(PEDAL)
MESSAGES = {"brake": "PED_Brake", "brake_3": "PED_Brake3", "accelerator": "PED_Accelerator"}
#: Where faults begin and end [s]; shorter where kernels are not compiled.
BEGIN, END, LENGTH = (1.0, 2.0, 3.0) if COMPILED else (0.2, 0.5, 0.75)


def engine_of(preset="brake", send=False, **params):
    database = load_database([PEDAL])
    monitor, model = (TRIPLE, TripleParams) if preset == "brake_3" else (PAIR, PairParams)
    chosen = model(preset=preset, **params)
    emission = database.message(monitor.emits(chosen).message) if send else None
    instance = MonitorInstance("pedal", monitor, chosen, emission=emission)
    return build_engine([(0, database)], [instance], [])


def drive(*faults, preset="brake", seconds=LENGTH, seed=3, stroke="driving", **options):
    print("seed", seed)
    params = PedalParams(message=MESSAGES[preset], stroke=stroke, **options)
    frames, truth = ECU.frames(params, faults, Run(seconds, 0, np.random.default_rng(seed)))
    assert len(truth) == len(faults)
    return frames


class Qualified:
    """What qualified: (time [s], name, failed, evidence)."""

    def __init__(self, engine):
        self.names = [slot.id.removeprefix("pedal.") for slot in engine.faults]
        self.evidence = {slot.id.removeprefix("pedal."): slot.fault.evidence for slot in engine.faults}
        self.events = []

    def __call__(self, events):
        for e in events:
            if e["kind"] in (QUALIFIED_FAILED, QUALIFIED_PASSED):
                name = self.names[e["fault"]]
                values = dict(zip(self.evidence[name], map(float, e["evidence"]), strict=False))
                values |= {"value": float(e["value"]), "threshold": float(e["threshold"])}
                failed = e["kind"] == QUALIFIED_FAILED
                self.events.append((int(e["t_ns"]) / 1e9, name, failed, values))

    def failed(self):
        return [name for _, name, failed, _ in self.events if failed]

    def healed(self, name):
        times = [t for t, n, failed, _ in self.events if n == name and not failed]
        return times[-1] if times else None


def found(frames, preset="brake", **params):
    engine = engine_of(preset, **params)
    seen = Qualified(engine)
    engine.process(frames, seen)
    return seen, engine


def fault(kind, channel=(1,), **options):
    return SensorFault(kind=kind, channel=channel, from_s=BEGIN, to_s=END, **options)


@pytest.mark.costly
@pytest.mark.parametrize("preset", ["brake", "brake_3", "accelerator"])
def test_a_healthy_pedal_has_no_fault(preset):
    seen, engine = found(drive(preset=preset, seconds=amount(20.0, 20.0, 0.5)), preset)
    assert seen.failed() == []
    assert engine.readout()["pedal"]["quality"] == AGREED


#: What a foot does slowly: the readings go from step to step, or rest.
SLOW = (
    ((0.0, 0.1), (5.0, 0.1), (20.0, 0.4)),
    ((0.0, 0.0), (2.0, 0.0), (3.0, 0.02), (4.0, 0.02), (8.0, 0.05), (20.0, 0.06)),
)


@pytest.mark.skipif(SMALL, reason="20 s of samples each 1 ms")
@pytest.mark.parametrize("noise", [0.0, 0.0003, 0.001, 0.004])
@pytest.mark.parametrize("points", [*SLOW, ()])
def test_a_pedal_with_other_noise_than_its_data_sheet_s_is_not_accused(noise, points):
    """Told 2 mV: an ADC that averages has less, and repeats itself at rest and between two steps."""
    rng = np.random.default_rng([int(1e4 * noise), len(points)])
    for _ in range(amount(20, 1)):
        sensors = tuple(
            SensorParams(
                signal=name,
                at_rest=rest,
                at_full=full,
                noise=noise,
                offset=rng.normal(0, 0.004),
                gain=rng.normal(1, 0.002),
            )
            for name, rest, full in (("Ch1", 0.5, 4.5), ("Ch2", 4.5, 0.5))
        )
        stroke = "points" if points else "driving"
        frames = drive(sensor=sensors, stroke=stroke, points=points, seconds=20.0, seed=int(rng.integers(1 << 30)))
        seen, _ = found(frames)
        assert seen.failed() == []


@pytest.mark.costly
@pytest.mark.parametrize("noise", [0.0003, 0.002])
def test_a_frozen_channel_is_found_by_the_movement_of_the_other_whatever_the_noise(noise):
    sensors = (
        SensorParams(signal="Ch1", at_rest=0.5, at_full=4.5, noise=noise),
        SensorParams(signal="Ch2", at_rest=4.5, at_full=0.5, noise=noise, offset=0.003),
    )
    points = ((0.0, 0.2), (BEGIN, 0.2), (BEGIN + 0.2, 0.5), (END + 0.1, 0.6))
    seen, _ = found(drive(fault("stuck"), sensor=sensors, stroke="points", points=points))
    assert seen.failed()[0] == "channel_1_stuck"


@pytest.mark.parametrize(
    ("injected", "name"),
    [
        (fault("short_to_ground"), "channel_1_low"),
        (fault("open", (2,)), "channel_2_low"),
        (fault("short_to_supply", (2,)), "channel_2_high"),
        (fault("stuck"), "channel_1_stuck"),
        (fault("stuck", (2,)), "channel_2_stuck"),
        (fault("offset", size=0.03), "channel_1_implausible"),
        (fault("offset", (2,), size=-0.03), "channel_2_implausible"),
        (fault("impulses", size=0.1), "channel_1_erratic"),
        (fault("garbage", (1, 2)), "correlation"),
    ],
)
@pytest.mark.skipif(not COMPILED, reason="seconds of samples")
def test_each_fault_is_named_with_evidence_and_heals(injected, name):
    seen, _ = found(drive(injected))
    begun = [(t, values) for t, n, failed, values in seen.events if n == name and failed]
    assert len(begun) == 1, seen.events
    assert BEGIN <= begun[0][0] <= BEGIN + 0.3
    assert any(begun[0][1].values()), "evidence"
    assert END < seen.healed(name) <= END + 0.8
    others = set(seen.failed()) - {name}
    # Garbage on both channels may be called erratic and invalid as well; nothing else has a second name.
    assert all(other.endswith(("erratic", "invalid")) for other in others), others
    assert not others or injected.kind == "garbage"


@pytest.mark.skipif(not COMPILED, reason="seconds of samples")
def test_a_channel_that_goes_wrong_once_for_some_samples_is_not_erratic():
    """For 25 samples, too few to isolate it: what counts is how often it begins."""
    seen, _ = found(drive(SensorFault(kind="offset", channel=(1,), from_s=BEGIN, to_s=BEGIN + 0.025, size=0.03)))
    assert seen.failed() == []


@pytest.mark.skipif(not COMPILED, reason="seconds of samples")
def test_a_drift_is_seen_in_a_pair_and_named_in_a_triple():
    drifting = SensorFault(kind="drift", channel=(1,), from_s=BEGIN, size=0.05)
    pair, engine = found(drive(drifting))
    assert pair.failed() == ["drift"]
    assert engine.readout()["pedal"]["quality"] == DEGRADED
    triple, engine = found(drive(drifting, preset="brake_3"), "brake_3")
    assert triple.failed()[-1] == "channel_1_drifts"
    assert engine.readout()["pedal"]["isolated"] == 0b001
    assert "channel_1_drifts" not in [f.name for f in PAIR.faults(PairParams())], "nobody could tell"


@pytest.mark.skipif(not COMPILED, reason="seconds of samples")
def test_all_channels_dead_is_invalid_and_heals():
    seen, engine = found(drive(fault("short_to_ground", (1, 2))))
    assert seen.failed() == ["channel_1_low", "channel_2_low", "invalid"]
    assert END < seen.healed("invalid") < END + 0.25
    assert engine.readout()["pedal"]["quality"] == AGREED


@pytest.mark.costly
def test_a_jump_of_all_channels_together():
    """Both sensors of the accelerator rise with the pedal: a jump of their supply is one of both."""
    engine = engine_of("accelerator")
    seen = Qualified(engine)
    channels = PRESETS["accelerator"].channels
    rng = np.random.default_rng(5)

    def row(travel):
        return [c.at_rest + travel * (c.at_full - c.at_rest) + rng.normal(0, 0.002) for c in channels]

    travels = [0.3] * 100 + [0.8] * 10 + [0.3] * 300
    raw(engine, [row(travel) for travel in travels], "PED_Accelerator", seen)
    assert seen.failed() == ["jump"]
    assert seen.events[0][0] == pytest.approx(0.101)
    assert seen.healed("jump")


def test_a_reading_beyond_the_travel():
    engine = engine_of()
    seen = Qualified(engine)
    raw(engine, [(0.5, 4.5)] * 20 + [(0.28, 4.5)] * 50, sink=seen)
    assert seen.failed() == ["channel_1_range"]
    assert seen.events[0][3]["position [%]"] == pytest.approx(-5.5, abs=0.05)


def test_a_drift_is_kept_with_the_limit_that_judged_it():
    """The channels move apart beyond the tolerance of 2 %, and back below it before that is confirmed."""
    engine = engine_of()
    seen = Qualified(engine)
    rng = np.random.default_rng(7)
    apart = np.concatenate([np.zeros(100), np.linspace(0.0, 2.6, 110), np.linspace(2.6, 1.8, 10), np.full(400, 1.8)])
    rows = [(0.5 + 4 * (0.3 + d / 100) + rng.normal(0, 0.0005), 4.5 - 4 * 0.3 + rng.normal(0, 0.0005)) for d in apart]
    raw(engine, rows, sink=seen)
    assert seen.failed() == ["drift"]
    (evidence,) = (values for _, _, failed, values in seen.events if failed)
    assert 2.0 > evidence["value"] > evidence["threshold"], evidence
    (first, *_) = (values for _, name, _, values in seen.events if name == "drift")
    assert first["value"] <= first["threshold"], "of the first pass"
    assert first["threshold"] >= 2.0


@pytest.mark.costly
def test_the_voted_frame_leaves_in_the_batch_of_its_input():
    frames = drive(fault("short_to_ground", (2,)))
    engine = engine_of(send=True)
    state = engine._states[0][0]
    message = VOTED.get_message_by_name("GW_BrakePedal")
    qualities = set()
    for k, frame in enumerate(frames):
        sent = engine.process(frame.reshape(1), lambda events: None)
        assert len(sent) == 1
        assert sent[0]["t_ns"] == frame["t_ns"]
        assert sent[0]["can_id"] == message.frame_id
        values = message.decode(payload(sent[0]), decode_choices=False)
        assert values["FrameCnt"] == k % 16
        assert values["Position"] == pytest.approx(float(state["value"]), abs=0.0051)
        assert values["Quality"] == state["quality"]
        assert values["Used"] == state["used"]
        qualities.add(int(values["Quality"]))
    assert {AGREED, ONE_CHANNEL} <= qualities


def test_both_pedals_have_their_own_message_and_dtcs():
    for preset, name, dtc in (
        ("brake", "GW_BrakePedal", "P057A-2A"),
        ("accelerator", "GW_AcceleratorPedal", "P2120-2A"),
    ):
        params = PairParams(preset=preset)
        assert PAIR.emits(params).message == name
        assert {f.name: f.dtc for f in PAIR.faults(params)}["channel_1_stuck"] == dtc
    for monitor, params in ((PAIR, PairParams()), (TRIPLE, TripleParams())):
        codes = [fault.dtc for fault in monitor.faults(params)]
        assert len(set(codes)) == len(codes), "each fault its own"


@pytest.mark.costly
@pytest.mark.parametrize("voter", ["tracking", "average", "median"])
def test_every_voter_can_be_chosen(voter):
    frames = drive(stroke="exponential", at_s=(0.05,))
    engine = engine_of(voter=voter)
    state = engine._states[0][0]
    seen, off = Qualified(engine), []
    for frame in frames:
        engine.process(frame.reshape(1), seen)
        off.append(abs(float(state["value"]) - float(state["tracking"]["value"])))
    assert seen.failed() == []
    assert max(off[20:]) < 1.0
    assert (max(off) == 0) == (voter == "tracking")


@pytest.mark.costly
def test_the_value_is_invalid_when_samples_stay_away():
    frames = drive(seconds=0.3)
    engine = engine_of(send=True)
    engine.process(frames, lambda events: None)
    last = int(frames["t_ns"][-1])
    assert len(engine.advance(last + (SILENCE - 1) * 1_000_000, lambda events: None)) == 0
    sent = engine.advance(last + 3_600_000_000_000, lambda events: None)
    assert len(sent) == 1, "once"
    assert sent[0]["t_ns"] == last + SILENCE * 1_000_000
    message = VOTED.get_message_by_name("GW_BrakePedal")
    assert message.decode(payload(sent[0]), decode_choices=False)["Quality"] == INVALID
    later = frames.copy()
    later["t_ns"] += last + 3_600_000_000_000
    engine.process(later, lambda events: None)
    assert engine.readout()["pedal"]["quality"] == AGREED


@pytest.mark.costly
def test_frames_lost_on_the_bus_are_no_fault():
    frames = drive(seconds=amount(10.0, 10.0, 0.5))
    kept = np.random.default_rng(2).random(len(frames)) > 0.1
    seen, _ = found(frames[kept])
    assert seen.failed() == []


@pytest.mark.long
@settings(max_examples=amount(25, 15, 2))
@given(st.integers(0, 2**16), st.lists(st.integers(1, 700), min_size=1, max_size=8))
def test_live_is_replay(seed, cuts):
    """Any cutting into batches gives the same events and the same frames."""
    frames = drive(fault("stuck"), fault("impulses", (2,)), seed=seed)

    def outcome(batches):
        engine = engine_of(send=True)
        seen = []
        sent = [engine.process(batch, lambda events: seen.append(events.copy())) for batch in batches]
        return np.concatenate(seen).tobytes(), np.concatenate(sent).tobytes()

    places = np.cumsum(cuts) % len(frames)
    assert outcome(np.split(frames, np.sort(places))) == outcome([frames])


def raw(engine, rows, message="PED_Brake", sink=lambda events: None):
    """Feed readings [V] of one sample a millisecond."""
    frames = empty(len(rows))
    for k, row in enumerate(rows):
        values = {f"Ch{i + 1}": v for i, v in enumerate(row)}
        data = VOTED.get_message_by_name(message).encode({"Crc": 0, "FrameCnt": k % 16, **values})
        put(frames, k, k * 1_000_000, VOTED.get_message_by_name(message).frame_id, data)
    return engine.process(frames, sink)


def test_readings_become_per_cent_of_the_travel_by_each_channels_slope():
    engine = engine_of()
    raw(engine, [(2.5, 2.5)] * 5)
    assert engine.readout()["pedal"]["value"] == pytest.approx(50, abs=0.05)
    engine = engine_of()
    raw(engine, [(1.5, 3.5)] * 5)
    assert engine.readout()["pedal"]["value"] == pytest.approx(25, abs=0.05)
    engine = engine_of("accelerator")
    raw(engine, [(0.75 + 0.31, 0.375 + 0.155)] * 5, "PED_Accelerator")
    assert engine.readout()["pedal"]["value"] == pytest.approx(10, abs=0.1)


OWN = {"at_rest": 0.5, "at_full": 4.5, "low": 0.25, "high": 4.75, "noise": 0.002, "counter": "FrameCnt"}
#: One channel in each of two messages.
APART = [{**OWN, "signal": "PED_Brake.Ch1"}, {**OWN, "signal": "PED_Brake3.Ch1"}]


def two_messages(travel, first=(0, 10**9), second=(0, 10**9), seed=9):
    """Frames of both messages, each millisecond, while each is there (samples from, to)."""
    rng = np.random.default_rng(seed)
    frames = empty(2 * len(travel))
    n = 0
    for k, x in enumerate(travel):
        for name, there, late in (("PED_Brake", first, 0), ("PED_Brake3", second, 300_000)):
            if there[0] <= k < there[1]:
                values = {"Ch1": 0.5 + 4.0 * x + rng.normal(0, 0.002), "Ch2": 1.0, "Ch3": 1.0}
                message = VOTED.get_message_by_name(name)
                own = {s.name: values[s.name] for s in message.signals if s.name in values}
                data = message.encode({"Crc": 0, "FrameCnt": k % 16, **own})
                put(frames, n, k * 1_000_000 + late, message.frame_id, data)
                n += 1
    return frames[:n]


def moves(n):
    """A pedal that never rests."""
    return 0.5 - 0.3 * np.cos(2 * np.pi * 1.3 * np.arange(n) * 1e-3)


def test_channels_may_come_in_different_messages():
    """A sample is there when each has come once more."""
    engine = engine_of(channel=APART)
    seen = Qualified(engine)
    travel = moves(300)
    engine.process(two_messages(travel), seen)
    state = engine.readout()["pedal"]
    assert state["samples"] == 300
    assert state["quality"] == AGREED
    assert state["value"] == pytest.approx(100 * travel[-1], abs=0.3)
    assert seen.failed() == []


@pytest.mark.skipif(not COMPILED, reason="thousands of samples")
@pytest.mark.parametrize("gone", [1, 2])
def test_a_channel_whose_message_stops_is_missing_and_the_other_goes_on(gone):
    """No stuck channel before that, nobody else is accused, and the value is that of the live one."""
    engine = engine_of(channel=APART)
    seen = Qualified(engine)
    travel = moves(4000)
    there = {1: "first", 2: "second"}[gone]
    engine.process(two_messages(travel, **{there: (0, 2000)}), seen)
    assert seen.failed() == [f"channel_{gone}_missing"]
    assert seen.events[-1][0] == pytest.approx(2.1, abs=0.01)
    state = engine.readout()["pedal"]
    assert state["quality"] == ONE_CHANNEL
    assert state["value"] == pytest.approx(100 * travel[-1], abs=0.3)


@pytest.mark.skipif(not COMPILED, reason="thousands of samples")
def test_a_channel_that_comes_back_is_trusted_again():
    engine = engine_of(channel=APART)
    seen = Qualified(engine)
    frames = two_messages(moves(4000))
    k = np.arange(len(frames)) // 2
    away = (frames["can_id"] == frames["can_id"][0]) & (k > 1000) & (k < 2000)
    engine.process(frames[~away], seen)
    assert seen.failed() == ["channel_1_missing"]
    assert 2.1 < seen.healed("channel_1_missing") < 2.4
    assert engine.readout()["pedal"]["quality"] == AGREED


@pytest.mark.skipif(not COMPILED, reason="thousands of samples")
@pytest.mark.parametrize("gone", [1, 2])
def test_what_one_channel_alone_shows_is_told(gone):
    """It jumps by 20 % of the travel in a millisecond, as no foot does; it breaks to ground."""
    travel = moves(4000)
    there = {1: "first", 2: "second"}[gone]
    for change, name in ((0.2, "jump"), (-2.0, f"channel_{3 - gone}_low")):
        engine = engine_of(channel=APART)
        seen = Qualified(engine)
        wrong = travel.copy()
        wrong[3000:] = np.maximum(wrong[3000:] + change, -0.12)
        engine.process(two_messages(wrong, **{there: (0, 2000)}), seen)
        assert seen.failed()[:2] == [f"channel_{gone}_missing", name]
        assert next(t for t, n, failed, _ in seen.events if failed and n == name) == pytest.approx(3.01, abs=0.015)
        assert not any(n.startswith(f"channel_{gone}") for n in seen.failed()[1:])


@pytest.mark.skipif(not COMPILED, reason="thousands of samples")
def test_frames_lost_of_two_messages_are_no_fault():
    engine = engine_of(channel=APART)
    seen = Qualified(engine)
    frames = two_messages(moves(6000))
    engine.process(frames[np.random.default_rng(3).random(len(frames)) > 0.05], seen)
    assert seen.failed() == []
    assert engine.readout()["pedal"]["quality"] == AGREED


def test_a_database_without_a_counter_is_no_error():
    """The counter is a spare input: the time stamps number the samples then."""
    frames = two_messages(moves(50), second=(0, 0))
    database = load_database([PEDAL])
    instance = MonitorInstance(
        "pedal", PAIR, PairParams(channel=({"counter": "Alive"}, {"counter": "Alive"})), signals={}
    )
    engine = build_engine([(0, database)], [instance], [])
    engine.process(frames, lambda events: None)
    assert engine.readout()["pedal"]["samples"] == 50


ROW = {"signal": "M.S", "at_rest": 0.5, "at_full": 4.5, "low": 0.2, "high": 4.8}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"at_full": 0.5}, "no slope"),
        ({"low": 0.6}, "low must lie below"),
        ({"high": 4.4}, "high must lie above"),
        ({"signal": "Ch1"}, "signal"),
        ({"noise": -1}, "noise"),
        ({"gain": 2}, "gain"),
    ],
)
def test_a_wrong_channel_is_refused(changes, text):
    with pytest.raises(ValidationError, match=text):
        Channel(**{**ROW, **changes})


def test_the_number_of_channels_has_to_fit():
    with pytest.raises(ValidationError, match="2 channels, here are 3"):
        PairParams(channel=(ROW,) * 3)
    with pytest.raises(ValidationError, match="3 channels, here are 2"):
        TripleParams(channel=(ROW,) * 2)


@pytest.mark.parametrize("preset", ["brake", "accelerator"])
def test_a_common_supply_is_reported_as_the_fault_of_its_name(preset):
    chosen = PairParams(preset=preset, ratiometric=True)
    s, c = zeros(1, State)[0], zeros(1, Const)[0]
    _prepare(chosen, s, c)
    assert chosen.tells_supply == (preset == "brake")
    assert (faults(chosen)[c.last_fault].name == "supply") == chosen.tells_supply
