"""What protects a message, found in its frames: profiles with random ids, carmakers' rules, any CRC; not in noise."""

import random
from pathlib import Path

import numpy as np
import pytest
from amount import amount
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from e2e_frames import CASES, DATABASES, E2E, drawn

from gateway.signals.bits import field_of
from gateway.signals.database import load_database
from gateway.signals.protection.checksum import Checksum
from gateway.signals.protection.crc import Crc
from gateway.signals.protection.protection import Counter, Protection, ProtectionConst, Tables, fill, protect_all
from gateway_fleet.learn.claims import called_checksum, proven
from gateway_fleet.learn.counters import of_raw
from gateway_fleet.learn.polynomials import divided, polynomial_of
from gateway_fleet.learn.protection_check import Payloads, judged
from gateway_fleet.learn.protections import protection_found

NOWHERE = Path("made_up.dbc")


def payloads(frames):
    data = np.zeros((len(frames), 64), np.uint8)
    for row, frame in zip(data, frames, strict=True):
        row[: len(frame)] = np.frombuffer(bytes(frame), np.uint8)
    return Payloads(data.view("<u8").reshape(len(frames), 8), np.array([len(f) for f in frames], np.int64))


def message_of(length, *signals):
    named = {signal.start // 8 for signal in signals}
    rest = [Signal(f"Byte{k}", 8 * k, 8) for k in range(length) if k not in named]
    return Message(0x123, "M", length, [*signals, *rest], strict=False)


@pytest.mark.parametrize(("profile", "mode"), CASES)
def test_e2e_profiles_with_random_ids_are_recovered(profile, mode):
    """Frames of another program: what was found accepts all later ones, and says the id where frames show it.

    One in 256 ids of profiles with 8 bits is what a carmaker's rule computes: then it may have that name.
    """
    tried, otherwise = 0, 0
    for seed in range(amount(100, 5)):
        check, length, protect_frame = drawn(profile, mode, seed)
        if length == E2E[profile][1]:
            continue  # a header alone: sixteen different frames prove no list of sixteen ids
        tried += 1
        rng = random.Random(seed)
        data, frames = bytearray(rng.randbytes(length)), []
        for _ in range(400):
            for k in {*range(check.offset), *range(check.offset + E2E[profile][1], length)}:
                if rng.random() < 0.3:
                    data[k] = rng.getrandbits(8)
            protect_frame(data)
            frames.append(bytes(data))
        found = protection_found(message_of(length), NOWHERE, [payloads(frames[:300])])
        assert found.claim is not None, f"seed {seed}"
        later = payloads(frames[300:])
        assert judged(later, found.claim.protection).good.all(), f"seed {seed}"
        wrong = Payloads(later.words ^ np.uint64(1 << 8 * (check.offset % 8)), later.lengths)
        assert check.offset >= 8 or not judged(wrong, found.claim.protection).good.any(), f"seed {seed}"
        if "e2e" not in found.claim.keys:
            assert profile in ("P01", "P11"), f"seed {seed}: {found.claim.keys}"
            otherwise += 1
            continue
        keys = found.claim.keys["e2e"]
        if profile in ("P04", "P05", "P06", "P07") or mode == "alternating":
            assert keys["data_id"] == check.data_id, f"seed {seed}"
        elif profile == "P02":
            assert keys["data_ids"] == list(check.data_ids), f"seed {seed}"
        else:
            assert "one of 256" in found.claim.note, f"seed {seed}: 8 bits cannot tell 16"
    assert tried >= 3
    assert otherwise <= 1 + tried // 20


@pytest.mark.parametrize("rule", DATABASES)
def test_rules_of_carmakers_are_recovered(rule, tmp_path):
    """Frames of opendbc's packer, without the name of the file that would say the carmaker."""
    name = DATABASES[rule]
    packer, rng = pytest.importorskip("opendbc.can.packer").CANPacker(name), random.Random(rule)
    file = tmp_path / "car.dbc"
    tried = 0
    for message in pytest.importorskip("opendbc.can.dbc").DBC(name).msgs.values():
        field = next((s for s in message.sigs.values() if s.calc_checksum is not None), None)
        if field is None or message.size > 64 or tried == amount(40, 6):
            continue
        others = [s for s in message.sigs.values() if s is not field and "COUNTER" not in s.name.upper()]
        if sum(s.size for s in others) < 16:
            continue  # too few different frames to prove anything
        tried += 1
        mine = next((s for s in message.sigs.values() if "COUNTER" in s.name.upper()), None)
        frames = []
        for sent in range(1200):
            values = {s.name: rng.getrandbits(s.size) * s.factor + s.offset for s in others}
            values |= {} if mine is None else {mine.name: sent % (1 << mine.size)}
            frames.append(packer.make_can_msg(message.name, 0, values)[1])
        signals = [
            Signal(s.name, s.start_bit, s.size,
                   byte_order="little_endian" if s.is_little_endian else "big_endian")
            for s in message.sigs.values() if s is field or s is mine
        ]  # fmt: skip
        described = Message(
            message.address,
            message.name,
            message.size,
            signals,
            is_extended_frame=message.address > 0x7FF,
            strict=False,
        )
        found = protection_found(described, file, [payloads(frames[:900])])
        assert found.claim is not None, message.name
        assert judged(payloads(frames[900:]), found.claim.protection).good.all(), message.name
        assert found.claim.matched == found.claim.frames, message.name
        if mine is not None and mine.size > 1 and "e2e" not in found.claim.keys:
            assert found.counter is not None, message.name
            assert found.counter.signal == mine.name
    assert tried >= 1


def crc_frames(rng, crc, length, listed):
    """Return a message with a CRC in its first bytes and a counter, and 700 frames of it."""
    size = -(-crc.width // 8)
    field, counter = Signal("Check", 0, crc.width), Signal("Alive", 8 * size, 4)
    message = message_of(length, field, counter)
    asked = Protection(
        Checksum(crc, by_counter=listed),
        field_of(field),
        Counter(field_of(counter), 15 if listed else 16),
    )
    data = np.zeros((700, 64), np.uint8)
    row = bytearray(rng.randbytes(length))
    for k in range(700):
        for at in range(size, length):
            if rng.random() < 0.4:
                row[at] = rng.getrandbits(8)
        data[k, :length] = np.frombuffer(bytes(row), np.uint8)
    made = payloads([bytes(each[:length]) for each in data])
    tables, rows = Tables(), np.zeros(1, ProtectionConst.dtype)
    fill(rows[0], asked, tables)
    protect_all(made.words, made.lengths, rows.view(np.recarray)[0], tables.array(), 0)
    return message, made


@pytest.mark.parametrize("width", [8, 16, 24, 32])
def test_crcs_of_any_polynomial_are_recovered(width):
    """Polynomial, reflection, and what is constant, or a byte by the counter, from frames alone."""
    for seed in range(amount(60, 6)):
        rng = random.Random(f"{width} {seed}")
        both = rng.random() < 0.5
        crc = Crc(width, rng.getrandbits(width) | 1, rng.getrandbits(width), both, both, rng.getrandbits(width))
        listed = tuple(rng.randbytes(16)) if rng.random() < 0.5 else ()
        message, made = crc_frames(rng, crc, rng.choice([8, 12, 20]), listed)
        found = protection_found(message, NOWHERE, [made[:500]])
        assert found.counter is not None, f"seed {seed}"
        assert found.counter.modulus == (15 if listed else 16), f"seed {seed}"
        assert found.claim is not None, f"seed {seed}"
        assert judged(made[500:], found.claim.protection).good.all(), f"seed {seed}"


@pytest.mark.long
def test_nothing_is_claimed_for_random_bytes():
    """Messages that look protected (a field called CHECKSUM, a counter) and whose bytes are chance."""
    count = amount(1000, 30)
    for seed in range(count):
        rng = random.Random(seed)
        length = rng.choice([4, 8, 8, 8, 16, 64])
        data, frames, often = bytearray(rng.randbytes(length)), [], rng.random()
        for sent in range(600):
            for k in range(length):
                if rng.random() < often:
                    data[k] = rng.getrandbits(8)
            data[0] = rng.getrandbits(8)
            data[1] = (data[1] & 0xF0) | (sent & 15)
            frames.append(bytes(data))
        message = message_of(length, Signal("CHECKSUM", 0, 8), Signal("COUNTER", 8, 4))
        found = protection_found(message, NOWHERE, [payloads(frames)])
        assert found.claim is None, f"seed {seed}: {found.claim}"
        assert found.nearly is None, f"seed {seed}: {found.nearly}"
        assert found.counter is not None, f"seed {seed}"
        assert found.counter.signal == "COUNTER", f"seed {seed}"
        assert found.unexplained == ("CHECKSUM",), f"seed {seed}"


def test_frames_that_do_not_change_prove_nothing():
    """Constant frames fit many rules: none is claimed."""
    message = message_of(8, Signal("CHECKSUM", 0, 8), Signal("COUNTER", 8, 4))
    found = protection_found(message, NOWHERE, [payloads([bytes(8)] * 500)])
    assert found.claim is None
    assert found.counter is None


def test_a_claim_needs_more_evidence_than_was_free_to_be_chosen():
    """Twenty values of a field called CHECKSUM say 160 bits: 130 of them may have been chosen, not one more."""
    message = message_of(4, Signal("CHECKSUM", 24, 8))
    frames = payloads([bytes([k, 7, 9, (k + 16 + 4 + 0x24) & 0xFF]) for k in range(20)])
    keys = {"checksum": {"rule": "toyota", "signal": "CHECKSUM"}}
    assert proven(message, keys, frames, free_bits=130).matched == 20
    assert proven(message, keys, frames, free_bits=131) is None
    assert proven(message, keys, frames[:4]).matched == 4
    assert proven(message, keys, frames[:3]) is None, "24 bits: chance is one in 17 million"


def test_a_field_not_called_so_is_judged_by_the_orders_of_its_values():
    """Chance deals 40 different values out rightly in one of 40! orders; 12! orders are fewer than 10^9."""
    message = message_of(4, Signal("Moment", 24, 8))
    each = [(k % 7, 7 * (k // 7), 49 * (k * k % 4)) for k in range(40)]
    frames = [bytes([a, b, c, (a + b + c + 28) & 0xFF]) for a, b, c in each]
    keys = {"checksum": {"rule": "sum", "signal": "Moment", "plus": 28}}
    assert proven(message, keys, payloads(frames)).matched == 40
    assert proven(message, keys, payloads(frames[:12])) is None


def test_a_field_not_called_so_covers_all_that_changes():
    """A sum of two bytes beside a third that goes its own way may be two signals: a checksum sees the third."""
    message = message_of(4, Signal("Moment", 24, 8))
    keys = {"checksum": {"rule": "sum", "signal": "Moment", "plus": 28, "over": [0, 2]}}
    for free, found in ((0, 40), (1, None)):
        each = [(k % 7, 7 * (k // 7), free * k * k & 0xFF) for k in range(40)]
        frames = [bytes([a, b, c, (a + b + 28) & 0xFF]) for a, b, c in each]
        claim = proven(message, keys, payloads(frames))
        assert (claim and claim.matched) == found


def test_one_payload_that_is_repeated_hides_no_wrong_ones():
    """Ten of fifty distinct payloads are wrong: a thousand repetitions of a right one do not make the rule right."""
    message = message_of(2, Signal("CHECKSUM", 8, 8))
    keys = {"checksum": {"rule": "sum", "signal": "CHECKSUM", "plus": 3}}
    frames = [bytes([k, k + 3 + (k % 5 == 4)]) for k in range(50)] + [bytes([0, 3])] * 2000
    assert proven(message, keys, payloads(frames)) is None
    assert proven(message, keys, payloads([bytes([k, k + 3]) for k in range(50)] + [bytes([0, 3])] * 2000)) is not None


@pytest.mark.parametrize("seed", range(12))
def test_a_torque_that_another_byte_repeats_is_no_checksum(seed):
    """An engine at idle: its speed changes in each frame, its torque hardly, and another byte is that torque less 1."""
    rng = np.random.default_rng(seed)
    torque = 16 + (rng.random(400) < 0.4).astype(int)
    more = rng.random(400) < 0.02 * (seed % 2)
    rpm = 3200 + rng.integers(0, 200, 400)
    frames = [bytes([0, 3, n & 0xFF, n >> 8, m, 0, int(x), m + 15]) for n, m, x in zip(rpm, torque, more, strict=True)]
    message = message_of(8, Signal("Moment", 32, 8))
    for over in ({}, {"over": [5, 8]}, {"over": [7, 8]}):
        keys = {"checksum": {"rule": "sum", "signal": "Moment", "plus": 241, **over}}
        assert proven(message, keys, payloads(frames)) is None, over
    assert protection_found(message, NOWHERE, [payloads(frames)]).claim is None, f"seed {seed}"


def test_a_sum_of_a_byte_in_a_field_of_two_is_not_claimed_as_one_of_two():
    """The sum never carried in the learning drive: a sum of 16 bits with a constant fits, and is wrong later."""
    rng = np.random.default_rng(6)
    rows = rng.integers(30, 60, (400, 2)).tolist()
    message = message_of(4, Signal("Pedal", 16, 16))
    found = protection_found(message, NOWHERE, [payloads([bytes([a, b, a + b + 100, 0]) for a, b in rows])])
    assert found.claim is None
    summed = [bytes([a, b, c, *(a + b + c + 65000 & 0xFFFF).to_bytes(2, "little")]) for a, b, c in
              rng.integers(0, 256, (400, 3)).tolist()]  # fmt: skip
    wide = protection_found(message_of(5, Signal("Pedal", 24, 16)), NOWHERE, [payloads(summed)])
    assert wide.claim.keys["checksum"]["plus"] == 65000, "each bit of it changes"


@pytest.mark.parametrize(
    ("name", "called"),
    [
        ("CheckSum_TCS1", True),
        ("CF_Ems_ChecksumEMS9", True),
        ("crc_0x1ed", True),
        ("MSG_CRC8", True),
        ("SCRCtrl", False),
    ],
)
def test_a_checksum_may_be_called_after_its_message(name, called):
    assert called_checksum(name) == called


def test_a_copy_of_one_byte_is_no_checksum():
    """A sum over two bytes, one of which rests in all frames but three: what the other says, it says alone."""
    rng = np.random.default_rng(5)
    first = rng.integers(0, 200, 500)
    rare = np.isin(np.arange(500), (100, 200, 300)).astype(int)
    frames = payloads([bytes([a, b, a + b]) for a, b in zip(first.tolist(), rare.tolist(), strict=True)])
    keys = {"checksum": {"rule": "sum", "signal": "Copy"}}
    message = message_of(3, Signal("Copy", 16, 8))
    assert proven(message, keys, frames) is None
    both = payloads([bytes([a, b, a + b]) for a, b in rng.integers(0, 120, (500, 2)).tolist()])
    assert proven(message, keys, both).matched == 500


def test_of_two_sums_that_fit_the_one_without_a_constant_is_taken():
    """A steering angle about zero: its high nibbles rest, so that a sum of the low ones and a constant fits as well."""
    rng = np.random.default_rng(6)

    def frame(angle, count):
        head = bytes([angle & 0xFF, angle >> 8, 0, 7, count])
        check = 0
        for byte in head:
            check ^= byte & 0xF ^ byte >> 4
        return bytes([*head[:4], count | check << 4])

    message = message_of(5, Signal("Angle", 0, 16), Signal("CheckSum", 36, 4))
    rest = [frame(0xFF48 + int(a), k % 16) for k, a in enumerate(rng.integers(0, 6, 120))]
    found = protection_found(message, NOWHERE, [payloads(rest)]).claim
    assert dict(found.keys["checksum"]) == {"rule": "xor", "signal": "CheckSum", "of": "nibbles"}
    moves = [frame(int(a), k % 16) for k, a in enumerate(rng.integers(0, 0xFFFF, 500))]
    assert judged(payloads(moves), found.protection).good.all()


def test_a_message_with_few_payloads_has_the_rule_that_its_name_says(tmp_path):
    """Eight payloads in all: that the field is called a checksum, and the file Toyota's, is known before."""
    file = tmp_path / "toyota_x.dbc"
    file.write_text('VERSION ""\nBS_:\nBU_: A\nBO_ 291 M: 8 A\n SG_ CHECKSUM : 63|8@0+ (1,0) [0|255] "" A\n')
    message = load_database([file]).message("M")
    made = [bytes([k % 8, 0, 0, 0, 0, 0, 0, (k % 8 + 8 + 0x01 + 0x23) & 0xFF]) for k in range(300)]
    found = protection_found(message, file, [payloads(made)])
    assert found.claim.keys["checksum"]["rule"] == "toyota"
    assert found.claim.matched == 8


def test_what_a_database_says_is_believed_only_with_proof(tmp_path):
    """opendbc's names say Toyota; frames that are none are not called so."""
    file = tmp_path / "toyota_x.dbc"
    file.write_text('VERSION ""\nBS_:\nBU_: A\nBO_ 291 M: 8 A\n SG_ CHECKSUM : 63|8@0+ (1,0) [0|255] "" A\n')
    message = load_database([file]).message("M")
    rng = random.Random(1)
    frames = [rng.randbytes(8) for _ in range(400)]
    assert protection_found(message, file, [payloads(frames)]).claim is None
    right = [bytes([*f[:7], (sum(f[:7]) + 8 + 0x01 + 0x23) & 0xFF]) for f in frames]
    found = protection_found(message, file, [payloads(right)])
    assert found.claim.keys["checksum"]["rule"] == "toyota"


@pytest.mark.parametrize("seed", range(amount(40, 8)))
def test_counters_whose_frames_get_lost_are_found_and_fields_by_chance_are_not(seed):
    """Four per cent of the frames are lost; beside the counter a sum of it, a wander and a state."""
    rng = np.random.default_rng(seed)
    modulus = int(rng.choice([4, 15, 16, 256]))
    count = np.arange(4000) % modulus
    wander = np.cumsum(rng.integers(-1, 2, 4000)) & 0xFF
    state = np.cumsum(rng.random(4000) < 0.01) % 4
    kept = rng.random(4000) >= 0.04
    between = np.diff(np.flatnonzero(kept)) + rng.uniform(-0.2, 0.2, int(kept.sum()) - 1)
    follows = np.ones(int(kept.sum()) - 1, np.bool_)
    bits = {4: 2, 15: 4, 16: 4, 256: 8}[modulus]
    found = of_raw("X", count[kept], follows, bits, between, 4)
    assert found is not None, f"seed {seed}: {modulus}"
    assert (found.first, found.modulus) == (0, modulus), f"seed {seed}"
    assert found.lost == pytest.approx(0.04 * found.steps, rel=0.4), f"seed {seed}"
    for other in (wander, state, rng.integers(0, 16, 4000)):
        assert of_raw("X", other[kept], follows, 8, between, 4) is None, f"seed {seed}"
    assert of_raw("X", count[:6], follows[:5], bits, None) is None, "six frames are chance"


def test_the_sum_of_a_counter_and_constants_is_no_counter():
    """Its values go up with the counter's: the field that is called a checksum is none."""
    frames = [bytes([7, k % 16, 0, (7 + k % 16 + 90) & 0xFF]) for k in range(400)]
    message = message_of(4, Signal("M_X", 8, 4), Signal("M_Checksum", 24, 8))
    found = protection_found(message, NOWHERE, [payloads(frames)])
    assert found.counter.signal == "M_X"
    only = message_of(4, Signal("M_Checksum", 24, 8))
    lone = protection_found(only, NOWHERE, [payloads([f[:1] + bytes([3]) + f[2:] for f in frames])])
    assert lone.counter is None or lone.counter.signal != "M_Checksum"


@pytest.mark.parametrize(("divisor", "found"), [(0x107, 0x07), (0x106, None), (0x87, None)])
def test_a_polynomial_has_its_highest_and_its_lowest_term(divisor, found):
    """CRCs divide by polynomials with both: what has the degree of another width, or no 1, is none."""
    rows = np.random.default_rng(4).integers(0, 256, (20, 3), np.uint8)
    sums = [divided(int.from_bytes(row.tobytes(), "big") << 8, divisor) for row in rows]
    assert polynomial_of(rows, sums, 8, refin=False, refout=False) == found


def test_each_byte_of_a_frame_that_no_signal_describes_may_be_the_checksum():
    rng = random.Random(6)
    frames = [rng.randbytes(7) for _ in range(700)]
    described = Message(0x123, "M", 8, [], strict=False)
    found = protection_found(described, NOWHERE, [payloads([bytes([sum(f) & 0xFF]) + f for f in frames])])
    assert found.claim is not None
    assert found.claim.keys["checksum"]["signal"] == "byte 0"


def exclusive_or(counts, rest):
    """Return frames of six bytes, the first the exclusive or of the others, the second counts; ``rest``: the others."""
    made = [bytes([c << 4, *other]) for c, other in zip(counts, rest, strict=True)]
    return payloads([bytes([int(np.bitwise_xor.reduce(list(one))), *one]) for one in made])


def test_a_rule_is_claimed_only_where_its_rivals_are_excluded():
    """An idling car: only the counter moves, and a sum is an exclusive or. Braking tells them apart."""
    message = Message(0x284, "Brake", 6, [Signal("CHECKSUM", 0, 8), Signal("COUNTER", 12, 4)], strict=False)
    count, rng = np.arange(400) % 16, np.random.default_rng(1)
    braking = exclusive_or(count, rng.integers(0, 256, (400, 4)))
    found = protection_found(message, NOWHERE, [exclusive_or(count, np.zeros((400, 4), int))])
    names = {claim.maker for kind in found.rules for claim in kind}
    assert {"volkswagen_pq", "hyundai_6b"} < names
    assert found.among(set()).claim is None
    assert found.among({"toyota"}).claim is None
    assert found.among({"volkswagen_pq", "hyundai_6b"}).claim is None, "both makers' messages are beside it"
    beside = found.among({"volkswagen_pq"})
    assert judged(braking, beside.claim.protection).good.all()
    assert beside.among(set()) is beside, "decided"
    whole = protection_found(message, NOWHERE, [braking])
    assert [kind[0].maker for kind in whole.rules] == ["volkswagen_pq"]
    assert whole.among(set()).claim is whole.claim


def test_a_sum_with_a_constant_is_claimed_where_bytes_moved_as_a_whole():
    """A steering wheel in the middle: the low half of a byte and a counter say nothing of how bytes go in."""
    message = Message(0x85, "M", 6, [Signal("Wheel", 7, 16, "big_endian"), Signal("Cs", 24, 8)], strict=False)

    def frames(wheel):
        made = ([0x7D, w & 0xFF, w >> 8, 0, (k & 15) << 4, 0xFF] for k, w in enumerate(wheel))
        return payloads([bytes([*f[:3], (130 - sum(f[:3]) - (f[4] >> 4)) & 0xFF, *f[4:]]) for f in made])

    assert protection_found(message, NOWHERE, [frames(3 + np.arange(2000) // 40 % 5)]).claim is None
    summed = [bytes([*f[:3], (130 - sum(f[:3]) - sum(f[4:])) & 0xFF, *f[4:]]) for f in
              np.random.default_rng(2).integers(0, 256, (600, 6)).tolist()]  # fmt: skip
    assert protection_found(message, NOWHERE, [payloads(summed)]).claim.keys["checksum"]["plus"] == 130
