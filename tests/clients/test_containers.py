"""Containers of AUTOSAR: their PDUs are messages, as cantools unpacks them."""

import random

import cantools
import numpy as np
import pytest
from arxml import HEAD, package, reference, tag

from gateway.bus.frames import FD, FD_LENGTHS, WOVEN, empty, put
from gateway.engine.build import build_engine
from gateway.signals.database import Database, load_database
from gateway.signals.payloads import decode_columns, message_rows
from gateway.signals.reassembly import woven_of
from gateway.signals.tables import SignalRef, compile_plan

#: Number in the header, name, length, bits of its signals.
PDUS = ((0x0A0B0C, "Doors", 3, (12, 9)), (0x11, "Seat", 1, (7,)), (0x101, "Wheels", 24, (16, 16, 33, 64)))
BOX = 0x321


def arxml(kind, order):
    """Return a file of one container, whose frame has an identifier that a PDU's number could be, too."""
    pdus, signals, triggerings = [], [], []
    for number, name, length, bits in PDUS:
        at, mapped = 0, []
        for k, each in enumerate(bits):
            signals.append(tag("I_SIGNAL", tag("SHORT_NAME", f"{name}{k}"), tag("LENGTH", each)))
            place = tag("PACKING_BYTE_ORDER", "MOST-SIGNIFICANT-BYTE-LAST") + tag("START_POSITION", at)
            of = reference("I_SIGNAL", f"/Signal/{name}{k}")
            mapped.append(tag("I_SIGNAL_TO_I_PDU_MAPPING", tag("SHORT_NAME", f"m{k}"), of, place))
            at += each
        own = tag("CONTAINED_I_PDU_PROPS", tag(f"HEADER_ID_{kind}_HEADER", number))
        mappings = tag("I_SIGNAL_TO_PDU_MAPPINGS", *mapped)
        pdus.append(tag("I_SIGNAL_I_PDU", tag("SHORT_NAME", name), tag("LENGTH", length), own, mappings))
        of = reference("I_SIGNAL_I_PDU", f"/Pdu/{name}", "I_PDU")
        triggerings.append(tag("PDU_TRIGGERING", tag("SHORT_NAME", f"t{name}"), of))
    refs = [reference("PDU_TRIGGERING", f"/Trigger/t{name}", "CONTAINED_PDU_TRIGGERING") for _, name, *_ in PDUS]
    inside = tag("CONTAINED_PDU_TRIGGERING_REFS", *refs), tag("HEADER_TYPE", f"{kind}-HEADER")
    pdus.append(tag("CONTAINER_I_PDU", tag("SHORT_NAME", "BoxPdu"), tag("LENGTH", 64), *inside))
    mapping = tag("PDU_TO_FRAME_MAPPING", tag("SHORT_NAME", "m"), reference("CONTAINER_I_PDU", "/Pdu/BoxPdu", "PDU"))
    mappings = tag("PDU_TO_FRAME_MAPPINGS", mapping)
    frame = tag("CAN_FRAME", tag("SHORT_NAME", "Box"), tag("FRAME_LENGTH", 64), mappings)
    sent = (reference("CAN_FRAME", "/Frame/Box", "FRAME"), tag("CAN_ADDRESSING_MODE", "STANDARD"))
    triggering = tag("CAN_FRAME_TRIGGERING", tag("SHORT_NAME", "t"), *sent, tag("IDENTIFIER", BOX))
    channel = tag("CAN_PHYSICAL_CHANNEL", tag("SHORT_NAME", "c"), tag("FRAME_TRIGGERINGS", triggering))
    variant = tag("CAN_CLUSTER_CONDITIONAL", tag("PHYSICAL_CHANNELS", channel))
    said = "MOST-SIGNIFICANT-BYTE-FIRST" if order == "big" else "MOST-SIGNIFICANT-BYTE-LAST"
    packages = (
        package("Cluster", tag("CAN_CLUSTER", tag("SHORT_NAME", "Bus"), tag("CAN_CLUSTER_VARIANTS", variant))),
        package("Frame", frame), package("Pdu", *pdus), package("Signal", *signals), package("Trigger", *triggerings),
        package("Sys", tag("SYSTEM", tag("SHORT_NAME", "s"), tag("CONTAINER_I_PDU_HEADER_BYTE_ORDER", said))),
    )  # fmt: skip
    return HEAD + tag("AR_PACKAGES", *packages) + "</AUTOSAR>\n"


def loaded(tmp_path, kind="SHORT", order="big"):
    (tmp_path / "box.arxml").write_text(arxml(kind, order))
    return load_database([tmp_path / "box.arxml"])


def packed(parts, kind, order):
    """Return a container: number and payload of each PDU, padded."""
    number, length = (3, 1) if kind == "SHORT" else (4, 4)
    data = b"".join(at.to_bytes(number, order) + len(each).to_bytes(length, order) + each for at, each in parts)
    return data.ljust(next(each for each in FD_LENGTHS if each >= len(data)), b"\0")


def batch(*datas):
    frames = empty(len(datas))
    for k, data in enumerate(datas):
        put(frames, k, 10**9 * (k + 1), BOX, data, bus=2, flags=FD)
    return frames


def chosen(draw, kind):
    """Return PDUs of a container, in any order; those of long headers have less room."""
    parts = [(number, draw.randbytes(length)) for number, _, length, _ in PDUS]
    some = draw.sample(parts, draw.randint(0, 3 if kind == "SHORT" else 2))
    return [*some, *draw.choices(parts[:2], k=draw.randint(0, 2))]


@pytest.mark.parametrize(("kind", "order"), [(k, o) for k in ("SHORT", "LONG") for o in ("big", "little")])
def test_pdus_are_decoded_as_cantools_does(kind, order, tmp_path):
    database = loaded(tmp_path, kind, order)
    draw = random.Random(f"{kind} {order}")
    said = [chosen(draw, kind) for _ in range(60)]
    frames = batch(*(packed(parts, kind, order) for parts in said))
    plan = compile_plan([(2, database)])
    woven = woven_of(plan)
    found = woven.hear(frames)
    assert woven.counters() == {"contained_whole": sum(map(len, said)), "contained_unknown": 0, "contained_cut": 0}
    rows = message_rows(found, plan)
    assert (rows >= 0).all()
    for number, name, *_ in PDUS:
        row, message = plan.message(2, name), database.message(name)
        expected = [(k, data) for k, parts in enumerate(said) for at, data in parts if at == number]
        mine = found[rows == row]
        assert mine["t_ns"].tolist() == [10**9 * (k + 1) for k, _ in expected]
        columns = decode_columns(mine, plan, row)
        for k, (_, data) in enumerate(expected):
            for signal, value in message.decode(data, decode_choices=False).items():
                assert columns.values[plan.position(2, name, signal), k] == float(value)
    if kind == "SHORT":
        theirs = cantools.database.load_string((tmp_path / "box.arxml").read_text(), "arxml").get_message_by_name("Box")
        for parts, frame in zip(said, frames, strict=True):
            made = theirs.encode([(each, data) for each, data in parts])
            assert made == bytes(frame["data"][: len(made)])
            if order == "big":  # cantools reads all numbers so
                unpacked = theirs.decode_container(made, decode_choices=False)
                assert [one.name for one, _ in unpacked] == [theirs.get_contained_message_by_header_id(at).name
                                                              for at, _ in parts]  # fmt: skip


def test_what_a_database_does_not_know_and_what_is_cut_is_counted(tmp_path):
    plan = compile_plan([(2, loaded(tmp_path))])
    doors, seat = (0x0A0B0C, b"abc"), (0x11, b"z")
    woven = woven_of(plan)
    good = packed([doors, (0x77, b"other"), seat], "SHORT", "big")
    cut = packed([seat, doors], "SHORT", "big")[:10]
    found = woven.hear(batch(good, cut, packed([seat], "SHORT", "big") + b"\0\0\0\1"))
    names = [plan.message_names[row][1] for row in message_rows(found, plan)]
    assert names == ["Box", "Doors", "Seat", "Box", "Seat", "Box", "Seat"]
    assert woven.counters() == {"contained_whole": 4, "contained_unknown": 1, "contained_cut": 1}
    assert woven.notes() == ["4 PDUs of containers, 1 unknown; 1 containers cut off"]


def test_a_pdu_s_number_is_no_identifier(tmp_path):
    plan = compile_plan([(2, loaded(tmp_path))])
    frames = batch(bytes(8), bytes(8))
    frames["can_id"] = [0x11, 0x101]
    assert message_rows(frames, plan).tolist() == [-1, -1]
    assert plan.identifiers(2) == [BOX]
    assert not woven_of(compile_plan([(2, Database([]))]))
    only = compile_plan([(2, loaded(tmp_path))], [], messages=[(2, "Box")])
    assert woven_of(only) is None, "nobody wants a PDU"


def test_the_loop_takes_them_and_a_pdu_s_own_checks(tmp_path):
    database = loaded(tmp_path)
    wanted = [SignalRef(2, name, each.name) for _, name, *_ in PDUS for each in database.message(name).signals]
    engine = build_engine([(2, database)], [], [], extra=wanted)
    draw = random.Random(5)
    parts = [(number, draw.randbytes(length)) for number, _, length, _ in PDUS]
    frames = woven_of(engine.plan).hear(batch(packed(parts, "SHORT", "big")))
    assert (frames["can_id"] & WOVEN == WOVEN).sum() == len(PDUS)
    for part in np.split(frames, [1, 2]):
        engine.process(part, lambda events: None)
    for (_, name, *_), (_, data) in zip(PDUS, parts, strict=True):
        for signal, value in database.message(name).decode(data, decode_choices=False).items():
            assert engine.tables.mailbox[engine.plan.slot(2, name, signal)] == float(value)
    assert engine.counters()["decoded"] == len(PDUS)
