"""Decoding equals cantools on random databases and payloads."""

import math

import cantools.database.can as can_database
import numpy as np
from amount import examples
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion
from cantools.database.errors import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.bus.frames import EXTENDED, empty, put
from gateway.signals.database import Database
from gateway.signals.decode import OK, TOO_SHORT, UNKNOWN_MUX, commit, decode, lookup
from gateway.signals.tables import SignalRef, compile_plan

scales = st.one_of(
    st.just((1, 0)),
    st.tuples(st.integers(-9, 9).filter(bool), st.integers(-500, 500)),
    st.tuples(st.sampled_from([0.1, 0.5, 0.03125, 1e-3, -2.5]), st.sampled_from([0, -40.0, 0.1])),
)


def place(draw, free, length, order):
    """Return the start bit of a signal in a free run of bits, None if there is none."""
    size = len(free)
    starts = [k for k in range(size - length + 1) if all(free[k : k + length])]
    if not starts:
        return None
    first = draw(st.sampled_from(starts))
    for k in range(first, first + length):
        free[k] = False
    return first


@st.composite
def messages(draw):
    size = draw(st.sampled_from([1, 2, 3, 5, 7, 8, 8, 8, 12, 24, 64]))
    order = draw(st.sampled_from(["little_endian", "big_endian"]))
    made = []

    def add(name, free, parent=None, ids=None, multiplexer=False):
        is_float = not multiplexer and draw(st.integers(0, 5)) == 0
        length = draw(st.sampled_from([16, 32, 64]) if is_float else st.integers(1, 4 if multiplexer else 64))
        first = place(draw, free, length, order)
        if first is None:
            return None
        # Runs are counted from the payload's first bit: most significant first for big endian.
        start = first if order == "little_endian" else 8 * (first // 8) + 7 - first % 8
        scale, offset = (1, 0) if multiplexer else draw(scales)
        signal = Signal(
            name,
            start,
            length,
            byte_order=order,
            is_signed=not multiplexer and not is_float and draw(st.booleans()),
            conversion=BaseConversion.factory(scale=scale, offset=offset, is_float=is_float),
            is_multiplexer=multiplexer,
            multiplexer_signal=parent,
            multiplexer_ids=ids,
        )
        made.append(signal)
        return signal

    free = [True] * (8 * size)
    for k in range(draw(st.integers(0, 4))):
        add(f"plain{k}", free)
    if draw(st.booleans()):
        outer = add("outer", free, multiplexer=True)
        if outer is not None:
            # Branches share no value, so that their signals may lie in the same place.
            numbers = draw(st.permutations(range(2**outer.length)))
            for branch in range(draw(st.integers(1, min(3, len(numbers))))):
                ids = sorted(numbers[branch::3][: draw(st.integers(1, 3))])
                inside = list(free)
                inner = None
                if draw(st.booleans()):
                    inner = add(f"inner{branch}", inside, "outer", ids, multiplexer=True)
                if inner is not None:
                    number = draw(st.integers(0, 2**inner.length - 1))
                    add(f"deep{branch}", inside, inner.name, [number])
                add(f"branch{branch}", inside, "outer", ids)
    # A multiplexer nobody depends on is a plain signal to cantools.
    parents = {signal.multiplexer_signal for signal in made}
    made = [s for s in made if not s.is_multiplexer or s.name in parents]
    names = {s.name for s in made}
    made = [s for s in made if s.multiplexer_signal is None or s.multiplexer_signal in names]
    extended = draw(st.booleans())
    return can_database.Message(
        frame_id=draw(st.integers(0, 2**29 - 1 if extended else 2**11 - 1)),
        name="M",
        length=size,
        signals=made,
        is_extended_frame=extended,
        strict=False,
    )


def same(ours, theirs):
    theirs = float(theirs)
    if math.isnan(theirs):
        return math.isnan(ours)
    if ours == theirs:
        return True
    # Above 2^53 cantools computes in whole numbers and we in doubles.
    return abs(theirs) > 2**53 and math.isclose(ours, theirs, rel_tol=4e-16)


@settings(max_examples=examples(400), deadline=None)
@given(messages(), st.data())
def test_decoding_equals_cantools(message, data):
    plan = compile_plan([(3, Database([(message, None)]))])
    length = data.draw(st.sampled_from([message.length] * 3 + [64, max(message.length - 1, 0)]), label="length")
    body = data.draw(st.binary(min_size=length, max_size=length), label="payload")
    frames = empty(2)
    can_id = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    put(frames, 1, 0, can_id, body, bus=3)
    assert lookup(plan.keys, plan.rows, 3, can_id) == 0
    assert lookup(plan.keys, plan.rows, 2, can_id) == -1
    assert lookup(plan.keys, plan.rows, 3, can_id ^ EXTENDED) == -1
    values = np.zeros(plan.max_signals + 1)
    present = np.zeros(plan.max_signals + 1, np.uint8)
    words = frames["data"].view("<u8")[1]
    status = decode(words, length, 0, plan.messages, plan.signals, plan.mux_ids, values, present)
    try:
        expected = message.decode(body, decode_choices=False)
    except DecodeError:
        assert status == (TOO_SHORT if length < message.length else UNKNOWN_MUX)
        return
    assert status == OK
    mailbox = np.full(plan.n_slots + 1, np.nan)
    commit(0, plan.messages, plan.signals, values, present, mailbox)
    there = {
        name: mailbox[plan.slot(3, "M", name)]
        for name in (s.name for s in message.signals)
        if present[plan.position(3, "M", name)]
    }
    assert set(there) == set(expected)
    assert all(same(there[name], expected[name]) for name in expected), (there, expected)


@settings(max_examples=examples(100), deadline=None)
@given(messages(), st.data())
def test_what_is_wanted_does_not_change_what_is_decoded(message, data):
    """Strictness about multiplexers must not depend on the signals that somebody asked for."""
    database = Database([(message, None)])
    names = [signal.name for signal in message.signals]
    chosen = data.draw(st.sets(st.sampled_from(names)) if names else st.just(set()))
    whole = compile_plan([(0, database)])
    part = compile_plan([(0, database)], {SignalRef(0, "M", n) for n in chosen}, messages=[(0, "M")])
    body = data.draw(st.binary(min_size=message.length, max_size=message.length))
    frames = empty(1)
    put(frames, 0, 0, message.frame_id, body)
    found = []
    for plan in (whole, part):
        values = np.zeros(plan.max_signals + 1)
        present = np.zeros(plan.max_signals + 1, np.uint8)
        mailbox = np.full(plan.n_slots + 1, np.nan)
        status = decode(
            frames["data"].view("<u8")[0],
            len(body),
            0,
            plan.messages,
            plan.signals,
            plan.mux_ids,
            values,
            present,
        )
        if status == OK:
            commit(0, plan.messages, plan.signals, values, present, mailbox)
        found.append((status, {n: mailbox[plan.slot(0, "M", n)] for n in chosen}))
    assert found[0][0] == found[1][0]
    for name in chosen:
        np.testing.assert_equal(found[0][1][name], found[1][1][name])
