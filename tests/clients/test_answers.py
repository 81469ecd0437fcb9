"""Answers as messages: pages, short and long answers, several identifiers; can-isotp and cantools are the oracles."""

import cantools
import isotp
import numpy as np
import pytest
from amount import amount
from asking_rig import DBC

from gateway.signals.tables import compile_plan
from gateway_ask.answers.answer_frames import FrameEncoder, records
from gateway_ask.answers.layout import j1979, read_layouts
from gateway_ask.answers.model import AnswerLayout, message_of
from gateway_ask.answers.pages import MOST, SLOTS, STRIDE, answer_bus
from gateway_ask.clients.passive_reassembly import N_CR_NS, Reassembler
from gateway_fdi.errors import InputError

SEED = 7


def frames_of(message, *, mode=isotp.AddressingMode.Normal_11bits, fd=False):
    """Return the frames of a message as can-isotp sends them."""
    sent, flow = (
        [],
        [isotp.CanMessage(arbitration_id=0x7E0, data=b"\xf1\x30\x00\x00" if "Ext" in mode.name else b"\x30\x00\x00")],
    )
    more = {"target_address": 0xF1, "source_address": 0xF1} if "Ext" in mode.name else {}
    layer = isotp.TransportLayerLogic(
        lambda _: flow.pop() if flow and sent else None,
        lambda m: sent.append(bytes(m.data)),
        isotp.Address(mode, txid=0x7E8, rxid=0x7E0, **more),
        params={"tx_padding": 0xCC, "can_fd": fd, "tx_data_length": 64 if fd else 8},
    )
    layer.send(message)
    for _ in range(1000):
        layer.process()
        if not layer.transmitting():
            return sent
    raise AssertionError("can-isotp did not end")


@pytest.mark.evidence("ISO 15765-2: heard")
@pytest.mark.parametrize("mode", ["Normal_11bits", "Extended_11bits"])
@pytest.mark.parametrize("fd", [False, True])
def test_messages_of_can_isotp_are_put_together(mode, fd):
    print("seed", SEED)
    rng, mode = np.random.default_rng(SEED), isotp.AddressingMode[mode]
    heard = Reassembler(0xF1 if "Ext" in mode.name else None)
    for length in [*range(1, 70), *rng.integers(70, 4095, amount(200, 10))]:
        message = rng.bytes(int(length))
        found = [heard.take(data, 0) for data in frames_of(message, mode=mode, fd=fd)]
        assert [one for one in found if one is not None] == [message]
        assert not heard.receiving
    assert heard.errors == 0


@pytest.mark.evidence("ISO 15765-2: heard")
def test_messages_that_are_cut_are_counted_and_left_out():
    first, *rest = frames_of(bytes(range(40)))
    heard = Reassembler()
    heard.take(first, 0)
    assert heard.take(rest[1], 0) is None  # one is missing
    assert (heard.errors, heard.receiving) == (1, False)
    heard.take(first, 0)
    heard.take(rest[0], N_CR_NS + 1)  # too late
    assert (heard.errors, heard.receiving) == (2, False)
    heard.take(first, 0)
    assert heard.take(b"\x02\x7e\x00", 1) == b"\x7e\x00"  # another message
    assert heard.errors == 3
    assert Reassembler(most=20).take(first, 0) is None
    other = Reassembler(0x12)
    assert (other.take(b"\xf1\x02\x7e\x00", 0), other.errors) == (None, 0)  # to another tester


def layout(rng, identifier):
    """Return a layout of signals at random places, which may overlap."""
    length, signals = int(rng.integers(1, 300)), []
    for k in range(int(rng.integers(1, 12))):
        bits, big = int(rng.integers(1, 65)), bool(rng.integers(2))
        bits = min(bits, 8 * length)
        place = int(rng.integers(0, 8 * length - bits + 1))
        start = 8 * (place // 8) + 7 - place % 8 if big else place
        made = cantools.database.can.signal.Signal(
            f"S{k}", start, bits, "big_endian" if big else "little_endian", bool(rng.integers(2))
        )
        signals.append(made)
    return AnswerLayout(0x22, identifier, message_of(0x22, identifier, signals))


def test_pages_decode_as_cantools_decodes_the_whole():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    for case in range(amount(400, 40, 10)):
        own = layout(rng, case)
        bus = answer_bus([("ecu", {(0x22, case): own})])
        assert not bus.left_out
        plan = compile_plan([(3, bus.database)])
        whole = rng.bytes(own.message.length)
        for data in (whole, whole + b"\xff\xff", whole[: int(rng.integers(1, len(whole) + 1))]):
            weaver = FrameEncoder(bus.pages[0], bus.lengths[0], 3)
            frames = weaver.frames(b"\x62" + case.to_bytes(2, "big") + data, 5)
            found = {}
            for _, columns in decoded(plan, frames):
                found |= columns
            fits = [s for s in own.message.signals if end_of(s) <= len(data)]
            alone = {s.name: message_of(0x22, case, [s]) for s in fits}  # cantools decodes no signals that overlap
            wanted = {name: m.decode(data[: m.length], decode_choices=False)[name] for name, m in alone.items()}
            assert {name: float(value) for name, value in wanted.items()} == found


def end_of(signal):
    start = signal.start
    if signal.byte_order == "big_endian":
        start = 8 * (start // 8) + 7 - start % 8
    return (start + signal.length + 7) // 8


def decoded(plan, frames):
    """Yield what the engine's kernels decode of each frame: signals that are there, but for the multiplexer."""
    from gateway.signals.decode import decode, lookup

    for frame in frames:
        row = lookup(plan.keys, plan.rows, int(frame["bus"]), int(frame["can_id"]))
        assert row >= 0
        values, present = np.zeros(plan.max_signals), np.zeros(plan.max_signals, np.uint8)
        words = np.ascontiguousarray(frame["data"]).view(np.uint64)
        if decode(words, int(frame["length"]), row, plan.messages, plan.signals, plan.mux_ids, values, present) != 0:
            continue
        names = [ref.signal for ref in plan.slot_names if plan.message(ref.bus, ref.message) == row]
        bus, message = plan.message_names[row]
        yield (
            row,
            {
                name: values[plan.position(bus, message, name)]
                for name in names
                if present[plan.position(bus, message, name)] and not name.startswith("AnswerBytes")
            },
        )


def test_several_identifiers_in_one_answer_are_told_apart_by_their_lengths():
    lengths = {(0x22, 0x0101): 2, (0x22, 0x0202): 1, (0x01, 0x0C): 2, (0x01, 0x0D): 1}
    cases = {
        "620101AABB0202CC": [((0x22, 0x0101), "AABB"), ((0x22, 0x0202), "CC")],
        "620101AABB0202": [((0x22, 0x0101), "AABB0202")],  # a longer answer
        "620101AA": [((0x22, 0x0101), "AA")],
        "62030300": [((0x22, 0x0303), "00")],
        "410C1AF80D55": [((0x01, 0x0C), "1AF8"), ((0x01, 0x0D), "55")],
        "410D55": [((0x01, 0x0D), "55")],
        "6201": [],
    }
    for answer, wanted in cases.items():
        assert [(key, data.hex().upper()) for key, data in records(bytes.fromhex(answer), lengths)] == wanted


def test_ecus_with_the_same_layouts_have_messages_of_their_own(tmp_path):
    (tmp_path / "a.dbc").write_text(DBC)
    layouts = {(one.service, one.identifier): one for one in read_layouts(tmp_path / "a.dbc")}
    bus = answer_bus([("front", layouts), ("rear", layouts)])
    assert sorted(message.name for message in bus.database) == sorted(
        f"{ecu}_{name}" for ecu in ("front", "rear") for name in ("Cells", "Cells_2", "Cells_3", "Speed")
    )
    ids = [page.can_id for own in bus.pages for pages in own.values() for page in pages]
    assert len(set(ids)) == len(ids) == 8
    with pytest.raises(InputError, match="more than"):
        answer_bus([(f"e{k}", layouts) for k in range(SLOTS)])


def test_a_signal_far_behind_its_multiplexer_is_left_out_and_told():
    made = cantools.database.can.signal.Signal
    signals = [
        made("Kind", 0, 8, is_multiplexer=True),
        made("Near", 8, 8, multiplexer_ids=[1], multiplexer_signal="Kind"),
        made("Far", 8 * (STRIDE + MOST), 8, multiplexer_ids=[1], multiplexer_signal="Kind"),
    ]
    bus = answer_bus([("ecu", {(0x22, 1): AnswerLayout(0x22, 1, message_of(0x22, 1, signals))})])
    assert [text.split(":")[1].split(".")[1] for text in bus.left_out] == ["Far"]
    plan = compile_plan([(0, bus.database)])
    for data, wanted in (("0107", {"Kind": 1.0, "Near": 7.0}), ("01", {})):
        frames = FrameEncoder(bus.pages[0], bus.lengths[0], 0).frames(bytes.fromhex("620001" + data), 0)
        assert [found for _, found in decoded(plan, frames)] == ([wanted] if wanted else [])


def test_the_standards_pids_have_pages_too():
    layouts = {(one.service, one.identifier): one for one in j1979()}
    bus = answer_bus([("engine", layouts)])
    plan = compile_plan([(0, bus.database)])
    frames = FrameEncoder(bus.pages[0], bus.lengths[0], 0).frames(bytes.fromhex("410C1AF8"), 0)
    assert [found for _, found in decoded(plan, frames)] == [{"RPM": 1726.0}]
