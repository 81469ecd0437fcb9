"""Decoding equals cantools on random databases and payloads."""

import math

import numpy as np
import pytest
from amount import examples
from cantools.database.can import Message, Signal
from cantools.database.errors import DecodeError
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracle import said, unclear, value
from random_messages import messages, odd_messages

from gateway.bus.frames import EXTENDED, FD, empty, put
from gateway.signals.database import Database
from gateway.signals.decode import OK, TOO_SHORT, UNKNOWN_MUX, commit, decode, decode_whole, lookup
from gateway.signals.payloads import decode_columns
from gateway.signals.tables import SignalRef, compile_plan


def assert_whole(plan, words, mailbox):
    """Assert that the short way of a whole message gives the same mailbox."""
    if plan.messages[0]["whole"]:
        short = np.full(plan.n_slots + 1, np.nan)
        decode_whole(words, plan.messages[0], plan.signals, short)
        np.testing.assert_equal(short, mailbox)


def same(ours, theirs):
    theirs = float(theirs)
    if math.isnan(theirs):
        return math.isnan(ours)
    if ours == theirs:
        return True
    # Above 2^53 cantools computes in whole numbers and we in doubles.
    return abs(theirs) > 2**53 and math.isclose(ours, theirs, rel_tol=4e-16)


@pytest.mark.evidence("Live is replay: decode")
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
    short = length < message.length
    try:
        expected = message.decode(body, decode_choices=False, allow_truncated=True)
        assert status == (TOO_SHORT if short else OK)
    except DecodeError:  # the multiplexer selects nothing: what else there is it does not say
        expected = {name: values[-1] for name, values in said(message, body).items()}
        assert status == (TOO_SHORT if short else UNKNOWN_MUX)
    mailbox = np.full(plan.n_slots + 1, np.nan)
    commit(0, plan.messages, plan.signals, values, present, mailbox)
    if not short:
        assert_whole(plan, words, mailbox)
    there = {
        name: mailbox[plan.slot(3, "M", name)]
        for name in (s.name for s in message.signals)
        if present[plan.position(3, "M", name)]
    }
    assert set(there) == set(expected)
    assert all(same(there[name], expected[name]) for name in expected), (there, expected)


@settings(max_examples=examples(400), deadline=None)
@given(odd_messages(), st.data())
def test_each_signal_is_there_by_itself(message, data):
    """Frames of any length; signals of one name, beyond the end, of scaled multiplexers: the rest is decoded."""
    database = Database([(message, None)])
    plan = compile_plan([(0, database)])
    body = data.draw(st.binary(min_size=0, max_size=message.length + 4), label="payload")
    frames = empty(1)
    put(frames, 0, 0, message.frame_id, body, flags=FD)
    found = decode_columns(frames, plan, 0)
    expected = said(message, body)
    assume(not unclear(message, body))
    there = {name: found.values[plan.position(0, "M", name), 0] for name in database.signals("M")
             if found.there[plan.position(0, "M", name), 0]}  # fmt: skip
    assert set(there) == set(expected)
    for name, number in there.items():
        assert any(same(number, one) for one in expected[name]), (name, number, expected[name])


def test_a_multiplexer_beyond_the_end_selects_nothing():
    """Two multiplexers of one name: what they select is there by the one that the frame has."""
    head = [Signal("a", 0, 1, "little_endian", is_multiplexer=True), Signal("a", 8, 1, is_multiplexer=True)]
    chosen = [Signal(f"s{k}", 1, 3, "little_endian", multiplexer_ids=[k], multiplexer_signal="a") for k in (0, 1)]
    message = Message(0x123, "M", 1, [*head, *chosen], strict=False)
    database = Database([(message, None)])
    plan = compile_plan([(0, database)])
    for byte in (2, 3):
        frames = empty(1)
        put(frames, 0, 0, message.frame_id, bytes([byte]), flags=FD)
        found = decode_columns(frames, plan, 0)
        there = {name for name in database.signals("M") if found.there[plan.position(0, "M", name), 0]}
        assert there == set(said(message, bytes([byte]))) == {"a", f"s{byte % 2}"}


@settings(max_examples=examples(100), deadline=None)
@given(odd_messages(), st.data())
def test_exact_names_stand_for_one_signal(message, data):
    database = Database([(message, None)])
    exact = database.message("M").signals
    assert len({signal.name for signal in exact}) == len(message.signals)
    joined = {one.name for each in database.joined("M").values() for one in each}
    wanted = {SignalRef(0, "M", name) for name in joined}
    plan = compile_plan([(0, database)], wanted, messages=[(0, "M")])
    body = data.draw(st.binary(min_size=message.length, max_size=message.length), label="payload")
    assume(not unclear(message, body))
    frames = empty(1)
    put(frames, 0, 0, message.frame_id, body, flags=FD)
    found = decode_columns(frames, plan, 0)
    for signal, own in zip(message.signals, exact, strict=True):
        if own.name in joined and found.there[plan.position(0, "M", own.name), 0]:
            assert same(found.values[plan.position(0, "M", own.name), 0], value(signal, body))
            assert signal.name in said(message, body)


@settings(max_examples=examples(100), deadline=None)
@given(messages(), st.data())
def test_what_is_wanted_does_not_change_what_is_decoded(message, data):
    """Strictness about multiplexers must not depend on the signals that somebody asked for."""
    database = Database([(message, None)])
    names = [signal.name for signal in message.signals]
    alone = not any(signal.is_float or signal.is_multiplexer or signal.multiplexer_ids for signal in message.signals)
    chosen = data.draw(st.sets(st.sampled_from(names)) if names else st.just(set()))
    whole = compile_plan([(0, database)])
    part = compile_plan([(0, database)], {SignalRef(0, "M", n) for n in chosen}, messages=[(0, "M")])
    body = data.draw(st.binary(min_size=message.length, max_size=message.length))
    frames = empty(1)
    put(frames, 0, 0, message.frame_id, body)
    assert bool(whole.messages[0]["whole"]) == alone
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
        commit(0, plan.messages, plan.signals, values, present, mailbox)
        if status == OK:
            assert_whole(plan, frames["data"].view("<u8")[0], mailbox)
        found.append((status, {n: mailbox[plan.slot(0, "M", n)] for n in chosen}))
    assert found[0][0] == found[1][0]
    for name in chosen:
        np.testing.assert_equal(found[0][1][name], found[1][1][name])
