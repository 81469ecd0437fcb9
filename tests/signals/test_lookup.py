"""Identity of frames: exact identifiers, J1939 parameter groups, the hash table."""

import random

import cantools.database.can as can_database
import numpy as np
import pytest

from gateway.bus.frames import EXTENDED, empty, put
from gateway.signals.database import Database, load_database
from gateway.signals.decode import hashed, lookup
from gateway.signals.payloads import among
from gateway.signals.tables import compile_plan
from gateway_fdi.errors import InputError


def message(name, can_id, extended=False, protocol=None, signals=()):
    return can_database.Message(
        frame_id=can_id,
        name=name,
        length=8,
        signals=list(signals),
        is_extended_frame=extended,
        protocol=protocol,
    )


def plan_of(*messages, bus=0, pgn=()):
    database = Database([(m, None) for m in messages])
    return compile_plan([(bus, database)], pgn=pgn)


def name_at(plan, bus, can_id):
    row = lookup(plan.keys, plan.rows, bus, can_id)
    return None if row < 0 else plan.message_names[row][1]


@pytest.mark.evidence("SAE J1939-21: PDU1 PDU2")
def test_pdu2_matches_whatever_the_priority_and_source():
    plan = plan_of(message("EEC1", 0x0CF00400, True, "j1939"))
    for can_id in (0x0CF00400, 0x18F004FE, 0x00F00421):
        assert name_at(plan, 0, can_id | EXTENDED) == "EEC1"
    assert name_at(plan, 0, 0x0CF00500 | EXTENDED) is None
    assert name_at(plan, 0, 0x0DF00400 | EXTENDED) is None, "another data page"
    assert plan.identifiers(0) is None, "no kernel filter can be set by identifier"


@pytest.mark.evidence("SAE J1939-21: PDU1 PDU2")
def test_pdu1_matches_whatever_the_destination():
    plan = plan_of(message("TSC1", 0x0C000003, True, "j1939"))
    for can_id in (0x0C000003, 0x18002711, 0x0000FF00):
        assert name_at(plan, 0, can_id | EXTENDED) == "TSC1"
    assert name_at(plan, 0, 0x0C010003 | EXTENDED) is None


def test_exact_identifiers_win_and_standard_ones_never_match_by_group():
    plan = plan_of(
        message("Group", 0x18FECA00, True, "j1939"),
        message("Mine", 0x18FECA27, True),
        message("Standard", 0x123),
    )
    assert name_at(plan, 0, 0x18FECA27 | EXTENDED) == "Mine"
    assert name_at(plan, 0, 0x18FECA28 | EXTENDED) == "Group"
    assert name_at(plan, 0, 0x123) == "Standard"
    assert name_at(plan, 0, 0x123 | EXTENDED) is None
    assert name_at(plan, 0, 0x18FECA28) is None


def test_a_whole_bus_can_match_by_group():
    one = message("EEC1", 0x0CF00400, True)
    assert name_at(plan_of(one), 0, 0x0CF00421 | EXTENDED) is None
    assert name_at(plan_of(one, pgn=[0]), 0, 0x0CF00421 | EXTENDED) == "EEC1"


@pytest.mark.long
def test_thousands_of_identifiers_and_collisions_on_purpose():
    rng = random.Random(7)
    capacity = 8192
    crowded = [k for k in range(1 << 18) if hashed(np.uint64(k | EXTENDED), capacity - 1) < 3][:60]
    ids = set(crowded) | {rng.randrange(1 << 29) for _ in range(3000)}
    plan = plan_of(*(message(f"m{can_id}", can_id, True) for can_id in ids))
    assert len(plan.keys) == capacity
    for can_id in ids:
        assert name_at(plan, 0, can_id | EXTENDED) == f"m{can_id}"
    for _ in range(5000):
        other = rng.randrange(1 << 29)
        if other not in ids:
            assert name_at(plan, 0, other | EXTENDED) is None


def test_two_messages_of_one_identity_are_refused():
    with pytest.raises(InputError, match="identifier of A: 0x10"):
        database = Database([(message("A", 0x10), None), (message("B", 0x10), None)])
        compile_plan([(0, database)], [], messages=[(0, "A"), (0, "B")])


def test_errors_name_what_is_close(tmp_path):
    path = tmp_path / "x.dbc"
    path.write_text('VERSION ""\nBU_: A\nBO_ 1 Engine: 8 A\n SG_ Speed : 0|8@1+ (1,0) [0|0] "" A\n')
    database = load_database([path])
    with pytest.raises(InputError, match="did you mean Engine"):
        database.message("Engin")
    with pytest.raises(InputError, match="did you mean Speed"):
        database.signal("Engine", "Sped")


def test_a_damaged_database_is_one_clear_error(tmp_path):
    whole = (
        'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 1 Engine: 8 A\n'
        ' SG_ Mode M : 0|4@1+ (1,0) [0|0] "" A\n SG_ Speed m1 : 8|8@1+ (0.5,-1) [0|0] "rpm" A\n'
        'CM_ SG_ 1 Speed "of the crank";\nVAL_ 1 Mode 0 "off" 1 "on" ;\n'
    )
    path = tmp_path / "cut.dbc"
    outcomes = set()
    for cut in range(len(whole) + 1):
        path.write_text(whole[:cut])
        try:
            load_database([path])
        except InputError as error:
            outcomes.add("refused")
            assert str(path) in str(error)
            assert "\n" not in str(error)
        else:
            outcomes.add("loaded")
    assert outcomes == {"refused", "loaded"}
    rng = random.Random(11)
    for _ in range(300):
        noise = bytearray(whole.encode())
        for _ in range(rng.randrange(1, 6)):
            noise[rng.randrange(len(noise))] = rng.randrange(256)
        path.write_bytes(bytes(noise))
        try:
            load_database([path])
        except InputError as error:
            assert str(path) in str(error)


def test_missing_and_foreign_files(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        load_database([tmp_path / "none.dbc"])
    (tmp_path / "x.txt").write_text("")
    with pytest.raises(InputError, match="one of .dbc"):
        load_database([tmp_path / "x.txt"])


def test_frames_of_some_messages_are_found_as_the_lookup_finds_them():
    """Beside the kernel: by identifier, and by PGN whatever priority and addresses are; on their own bus only."""
    ids = {"EEC1": 0x0CF00400, "TSC1": 0x0C000003, "own": 0x18FEF100}
    messages = [message(name, can_id, True, signals=[can_database.Signal("S", 0, 8)]) for name, can_id in ids.items()]
    rng = random.Random(4)
    for pgn in ((), (0,)):
        plan = plan_of(*messages, pgn=pgn)
        frames = empty(400)
        for k in range(len(frames)):
            changed = rng.choice(list(ids.values())) ^ rng.choice([0, 0, 0x21, 0xFF00, 0x04000000, 0x10000])
            put(frames, k, k, changed | rng.choice([EXTENDED, EXTENDED, 0]), bytes(8), bus=rng.choice([0, 0, 1]))
        slots = [plan.slot(0, "EEC1", "S"), plan.slot(0, "TSC1", "S")]
        rows = {plan.message(0, "EEC1"), plan.message(0, "TSC1")}
        wanted = [lookup(plan.keys, plan.rows, int(f["bus"]), int(f["can_id"])) in rows for f in frames]
        assert among(frames, plan, slots).tolist() == wanted
        assert 20 < sum(wanted) < 380
        assert not among(frames, plan, []).any()
