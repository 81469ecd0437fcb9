"""Messages of several frames: whole as cantools decodes them, or not at all, and counted."""

import math
import random

import numpy as np
import pytest
from amount import examples
from hypothesis import given, note, settings
from hypothesis import strategies as st
from long_messages import batch, fast, long_message, signal, transported

from gateway.bus.frames import EXTENDED, WOVEN, empty, put
from gateway.engine.build import build_engine
from gateway.j1939.overheard import CUTS
from gateway.runtime.asking import Asking
from gateway.signals.database import Database
from gateway.signals.payloads import are_last, decode_columns, message_rows
from gateway.signals.reassembly import woven_of
from gateway.signals.tables import SignalRef, compile_plan

#: Parameter group, where it is sent to, longest, of each way that messages come.
BAM, TO_ONE, FAST, FAST_TO_ONE = (0xFEE3, 0xFF, 1785), (0xEF00, 0x21, 1785), (0x1F805, 0xFF, 223), (0x1EF00, 0x21, 223)
WAYS = (BAM, TO_ONE, FAST, FAST_TO_ONE)


def random_message(draw, name, way, length):
    """Return a message whose signals, each in bytes of its own, are spread over all of it."""
    signals, byte = [], draw.choice([0, max(length - 12, 0)])
    while byte < length:
        room = min(draw.randint(1, 9), length - byte)
        bits = draw.choice([each for each in (1, 5, 8, 12, 16, 24, 32, 53, 64) if each <= 8 * room])
        first = 8 * byte + draw.randrange(8 * room - bits + 1)
        big = draw.random() < 0.5
        start = 8 * (first // 8) + 7 - first % 8 if big else first
        scale = draw.choice([1, 0.25, 0.001])
        signals.append(signal(f"S{byte}", start, bits, big=big, signed=draw.random() < 0.5, scale=scale))
        byte += room + draw.choice([0, 0, 3, length // 8])
    return long_message(name, way[0], length, signals)


def sent(way, source, data, number, begin_s):
    pgn, destination, _ = way
    send = transported if pgn < 0x10000 else fast
    more = () if pgn < 0x10000 else (number,)
    return send(pgn, source, destination, data, *more, begin_s=begin_s)


def same(ours, theirs):
    return math.isclose(ours, float(theirs), rel_tol=1e-12, abs_tol=1e-9)


@pytest.mark.evidence("SAE J1939-21: overheard")
@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 2**32))
def test_whole_messages_are_decoded_as_cantools_does(seed):
    """Sources apart, interleaved, batches cut anywhere: tables of a log, and the loop's mailbox."""
    note(f"seed {seed}")
    draw = random.Random(seed)
    messages, said, streams = [], [], []
    for k, way in enumerate(WAYS):
        length = draw.choice([9, 13, 14, 64, 65, 128, draw.randint(9, way[2]), way[2]])
        messages.append(random_message(draw, f"M{k}", way, length))
        for source in draw.sample(range(0xF0), 2):
            for number in range(draw.randint(1, 3)):
                data = draw.randbytes(length)
                begin_s = 1.0 + 20 * number + draw.random() * 0.3
                streams.append(sent(way, source, data, number, begin_s))
                said.append((f"M{k}", source, max(t for t, *_ in streams[-1]), data))
    database = Database([(message, None) for message in messages])
    plan = compile_plan([(3, database)])
    frames = batch(*streams, bus=3)
    cuts = sorted(draw.sample(range(len(frames)), min(3, len(frames))))
    woven = woven_of(plan)
    parts = [woven.hear(part) for part in np.split(frames, cuts)]
    whole = {"long_whole": len(said), "long_parts": len(frames)}
    assert woven.counters() == {**whole, **{f"long_{name}": 0 for name in (*CUTS, "stray")}}
    found = np.concatenate(parts)
    rows = message_rows(found, plan)
    assert (rows >= 0).sum() == (found["can_id"] & WOVEN == WOVEN).sum()
    for message in messages:
        row = plan.message(3, message.name)
        mine = found[rows == row]
        columns, heads = decode_columns(mine, plan, row), mine[are_last(mine)]
        expected = sorted((each for each in said if each[0] == message.name), key=lambda each: (each[2], each[1]))
        order = np.lexsort((heads["can_id"] & 0xFF, np.round(heads["t_ns"] / 1e9, 6)))
        assert [int(can_id & 0xFF) for can_id in heads["can_id"][order]] == [source for _, source, _, _ in expected]
        for k, (*_, data) in zip(order, expected, strict=True):
            theirs = message.decode(data, decode_choices=False)
            for name, value in theirs.items():
                place = plan.position(3, message.name, name)
                assert columns.there[place, k]
                assert same(columns.values[place, k], value), (message.name, name)


def engine_of(*messages):
    database = Database([(message, None) for message in messages])
    wanted = [SignalRef(0, message.name, each.name) for message in messages for each in message.signals]
    return build_engine([(0, database)], [], [], extra=wanted)


@pytest.mark.parametrize("seed", range(3))
def test_the_loop_has_what_the_tables_have(seed):
    draw = random.Random(seed)
    messages = [random_message(draw, f"M{k}", way, draw.choice([20, 64, 65, way[2]])) for k, way in enumerate(WAYS)]
    engine = engine_of(*messages)
    woven = woven_of(engine.plan)
    for number in range(2):
        datas = [draw.randbytes(message.length) for message in messages]
        streams = [
            sent(way, 0x10 + k, data, number, 1.0 + 20 * number)
            for k, (way, data) in enumerate(zip(WAYS, datas, strict=True))
        ]
        frames = woven.hear(batch(*streams))
        for part in np.split(frames, sorted(draw.sample(range(len(frames)), 3))):
            engine.process(part, lambda events: None)
        for message, data in zip(messages, datas, strict=True):
            for name, value in message.decode(data, decode_choices=False).items():
                ours = engine.tables.mailbox[engine.plan.slot(0, message.name, name)]
                assert same(ours, value), (message.name, name)
    counters = engine.counters()
    assert (counters["decoded"], counters["too_short"], counters["late"]) == (8, 0, 0)


def heard(messages, *streams, wait_s=0.0):
    """Return what was put together of streams, (group, bytes), and the counts that are not zero."""
    plan = compile_plan([(0, Database([(message, None) for message in messages]))])
    woven = woven_of(plan)
    frames = batch(*streams)
    if wait_s:
        later = empty(1)
        put(later, 0, int(frames["t_ns"][-1]) + round(wait_s * 1e9), 0x123, b"")
        frames = np.concatenate([frames, later])
    found = woven.hear(frames)
    found = found[found["can_id"] & WOVEN == WOVEN]
    ends = np.flatnonzero(are_last(found)) + 1
    whole = [
        ((int(part["can_id"][-1]) >> 8) & 0x3FFFF, b"".join(bytes(one["data"][: one["length"]]) for one in part))
        for part in np.split(found, ends[:-1])
        if len(part)
    ]
    counts = {name.removeprefix("long_"): count for name, count in woven.counters().items() if count}
    assert counts.pop("whole", 0) == len(whole)
    assert counts.pop("parts") == sum(map(len, streams))
    return whole, counts


DATA = bytes(range(40))
ONE = [signal("S0", 8 * 39, 8)]


def of(way):
    return long_message("M", way[0], 40, ONE)


@pytest.mark.evidence("SAE J1939-21: overheard cuts")
@pytest.mark.parametrize("way", WAYS)
def test_a_packet_that_is_missing_takes_its_message_with_it_and_no_other(way):
    first, second = sent(way, 1, DATA, 0, 1.0), sent(way, 1, DATA[::-1], 1, 30.0)
    places = [k for k, (_, can_id, data) in enumerate(first) if can_id >> 16 & 0xFF not in (0xEC,)]
    beginning = 0 if way[0] > 0xFFFF else None
    for k in places:
        kept = [*first[:k], *first[k + 1 :]]
        whole, counts = heard([of(way)], kept, second)
        assert [data for _, data in whole] == [DATA[::-1]], f"without frame {k}"
        if k == beginning:
            assert counts == {"stray": len(first) - 1}
        else:
            assert counts in ({"lost": 1}, {"late": 1}), f"without frame {k}"


@pytest.mark.parametrize("way", WAYS)
def test_a_packet_that_comes_twice_does_no_harm(way):
    frames = sent(way, 1, DATA, 0, 1.0)
    for k, (_, can_id, _) in enumerate(frames):
        if can_id >> 16 & 0xFF == 0xEC or k == len(frames) - 1:
            continue
        again = [*frames[: k + 1], *frames[k:]]
        assert [data for _, data in heard([of(way)], again)[0]] == [DATA], f"frame {k} twice"


@pytest.mark.evidence("SAE J1939-21: overheard cuts")
@pytest.mark.parametrize("way", WAYS)
def test_a_pause_longer_than_the_timeout_ends_a_message(way):
    frames = sent(way, 1, DATA, 0, 1.0)
    packets = [k for k, (_, can_id, _) in enumerate(frames) if can_id >> 16 & 0xFF != 0xEC]
    at = packets[2]
    for pause_s, whole in ((0.7, True), (0.8, False)):
        before_s = frames[at - 1][0]
        late = [(t_s + (before_s + pause_s - frames[at][0] if k >= at else 0), *rest)
                for k, (t_s, *rest) in enumerate(frames)]  # fmt: skip
        found, counts = heard([of(way)], late)
        assert (len(found), counts) == (int(whole), {} if whole else {"late": 1})
    found, counts = heard([of(way)], frames[:at], wait_s=2.0)
    assert (found, counts) == ([], {"late": 1}), "nothing comes any more"
    assert heard([of(way)], frames[:at])[1] == {}, "it may come yet"


def control(source, destination, *data, pgn=TO_ONE[0]):
    return (7 << 26 | 0xEC00 << 8 | destination << 8 | source, bytes(data) + pgn.to_bytes(3, "little"))


@pytest.mark.evidence("SAE J1939-21: overheard cuts")
@pytest.mark.parametrize("side", ["sender", "receiver"])
def test_a_session_that_a_side_gives_up_is_counted(side):
    frames = sent(TO_ONE, 1, DATA, 0, 1.0)
    at = next(k for k, row in enumerate(frames) if row[1] >> 16 & 0xFF == 0xEB) + 2
    ends = (1, 0x21) if side == "sender" else (0x21, 1)
    given_up = [*frames[:at], (frames[at - 1][0], *control(*ends, 255, 3, 255, 255, 255)), *frames[at:at]]
    assert heard([of(TO_ONE)], given_up, sent(TO_ONE, 1, DATA, 0, 9.0)) == ([(0xEF21, DATA)], {"aborted": 1})


def test_a_receiver_may_ask_again_and_hold():
    """Packets that are sent again take the place of the first ones; a hold lengthens the wait."""
    frames = [row for row in sent(TO_ONE, 1, DATA, 0, 1.0) if row[1] >> 16 & 0xFF == 0xEB]
    packets = [row[1:] for row in frames]
    rows = [control(1, 0x21, 16, 40, 0, 6, 255), control(0x21, 1, 17, 4, 1, 255, 255), *packets[:2], packets[3]]
    rows += [control(0x21, 1, 17, 0, 255, 255, 255)]
    steps = [0.01] * len(rows)
    rows += [control(0x21, 1, 17, 5, 2, 255, 255), *packets[1:], control(0x21, 1, 19, 40, 0, 6, 255)]
    steps += [1.0, *[0.01] * 6]
    t_s, stream = 1.0, []
    for step, row in zip(steps, rows, strict=True):
        t_s += step
        stream.append((t_s, *row))
    assert heard([of(TO_ONE)], stream) == ([(0xEF21, DATA)], {})


def test_a_new_beginning_replaces_what_was_under_way():
    for way in WAYS:
        first = sent(way, 1, DATA, 0, 1.0)
        at = [k for k, row in enumerate(first) if row[1] >> 16 & 0xFF != 0xEC][2]
        begin_s = first[at][0]
        whole, counts = heard([of(way)], first[:at], sent(way, 1, DATA[::-1], 0, begin_s))
        assert ([data for _, data in whole], counts) == ([DATA[::-1]], {"replaced": 1})


def test_what_cannot_be_is_no_message():
    bad = [control(1, 0xFF, 32, 40, 0, 5, 255, pgn=BAM[0]), control(1, 0xFF, 32, 7, 7, 0, 255, pgn=BAM[0])]
    bad += [control(1, 0x21, 32, 40, 0, 6, 255, pgn=BAM[0])]
    assert heard([of(BAM)], [(1.0, *row) for row in bad]) == ([], {"malformed": 3})
    first = fast(FAST[0], 1, 0xFF, DATA, 0)
    short = [first[0], (first[1][0], first[1][1], first[1][2][:5]), *first[2:]]
    assert heard([of(FAST)], short) == ([], {"malformed": 1})
    assert heard([of(FAST)], [(1.0, first[0][1], b"\x00\xff" + bytes(6))]) == ([], {"malformed": 1})


def test_of_groups_that_nobody_wants_nothing_is_counted():
    other = sent((0xFECA, 0xFF, 0), 1, DATA, 0, 1.0)
    assert heard([of(BAM)], other[:3], wait_s=3.0) == ([], {})


def test_short_ones_of_long_groups_are_messages():
    """A group that fits in a frame comes as one; signals that it does not have are not there."""
    for length in (40, 100):
        message = long_message("M", BAM[0], length, [signal("S0", 0, 8), signal("Far", 8 * (length - 1), 8)])
        plan = compile_plan([(0, Database([(message, None)]))])
        frames = empty(1)
        put(frames, 0, 10**9, message.frame_id & ~0xFF | 0x11 | EXTENDED, b"\x2a" * 8)
        found = woven_of(plan).hear(frames)
        row = message_rows(found, plan)
        columns = decode_columns(found[row == 0], plan, 0)
        assert columns.values[plan.position(0, "M", "S0")].tolist() == [42.0]
        assert columns.there[:, 0].tolist() == [name.signal == "S0" for name in plan.slot_names]


def test_a_batch_that_ends_within_a_message_gives_those_before():
    long = long_message("M", BAM[0], 100, [signal("S0", 8 * 99, 8)])
    plan = compile_plan([(0, Database([(long, None)]))])
    found = woven_of(plan).hear(batch(sent(BAM, 1, bytes(99) + b"\7", 0, 1.0), sent(BAM, 1, bytes(100), 0, 30.0)))
    mine = found[message_rows(found, plan) == 0]
    assert len(mine) == 4
    for count, values in ((4, [7.0, 0.0]), (3, [7.0]), (2, [7.0]), (1, [])):
        assert decode_columns(mine[:count], plan, 0).values[0].tolist() == values


def test_a_bus_without_such_messages_has_nothing_that_listens():
    plain = long_message("M", BAM[0], 8, [signal("S0", 0, 8)])
    assert woven_of(compile_plan([(0, Database([(plain, None)]))])) is None


@pytest.mark.parametrize("of_gateway", [False, True])
def test_a_message_that_is_under_way_outlives_a_reload(of_gateway):
    """The bus has another index then; what was counted stays; also in a gateway that asks nobody."""
    database = Database([(of(way), None) for way in (BAM,)])
    old, new = (woven_of(compile_plan([(bus, database)])) for bus in (0, 1))
    if of_gateway:
        old, new = Asking(old), Asking(new)
        Asking().succeed(old, {0: 1})
    frames = batch(sent(BAM, 1, DATA, 0, 1.0)[:3], sent(BAM, 2, DATA, 0, 1.0))
    assert len(old.hear(frames[:6])) == 6
    new.succeed(old, {0: 1})
    frames["bus"] = 1
    found = new.hear(frames[6:])
    assert (found["can_id"] & 0xFF)[found["can_id"] & WOVEN == WOVEN].tolist() == [2]
    assert new.counters()["long_parts"] == len(frames)
