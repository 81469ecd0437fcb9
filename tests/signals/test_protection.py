"""Checksums, counters and E2E profiles beside programs that nobody here wrote: crccheck, autosar-e2e, opendbc."""

import random

import crccheck.crc
import e2e
import numpy as np
import pytest
from amount import amount, examples
from e2e_frames import CASES, DATABASES, E2E, MODES, drawn, protection_of
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.signals.bits import Field, field_at, mask_of, place
from gateway.signals.protection.checksum import Checksum
from gateway.signals.protection.crc import Crc
from gateway.signals.protection.e2e import E2eCheck
from gateway.signals.protection.judge import FRAME_CONSTANT, FRAME_OK, judge_frame
from gateway.signals.protection.protection import Protection, ProtectionConst, Tables, fill, protect
from gateway.signals.protection.rules import RULES, Frame
from gateway_fdi.errors import InputError


class Checked:
    """A protection as the kernels have it."""

    def __init__(self, protection):
        self.tables = Tables()
        self.rows = np.zeros(1, ProtectionConst.dtype)
        fill(self.rows[0], protection, self.tables)
        self.row = self.rows.view(np.recarray)[0]
        self.arrays = self.tables.array()

    def words(self, data):
        return np.frombuffer(bytes(data).ljust(64, b"\0"), "<u8").copy()

    def protect(self, data, counter):
        words = self.words(data)
        protect(words, len(data), counter, self.row, self.arrays)
        return words.tobytes()[: len(data)]

    def fits(self, data):
        received, computed, verdict = judge_frame(self.words(data), len(data), self.row, self.arrays)
        return verdict == FRAME_OK and received == computed


CRCS = [
    crc for crc in (getattr(crccheck.crc, name) for name in dir(crccheck.crc))
    if isinstance(crc, type) and issubclass(crc, crccheck.crc.CrcBase) and crc._names and 4 <= crc._width <= 64
]  # fmt: skip


@pytest.mark.evidence("AUTOSAR E2E: CRC")
@pytest.mark.parametrize("theirs", CRCS, ids=lambda crc: crc._names[0])
def test_every_crc_of_the_catalogue(theirs):
    ours = Crc(
        theirs._width,
        theirs._poly,
        theirs._initvalue,
        theirs._reflect_input,
        theirs._reflect_output,
        theirs._xor_output,
    )
    rng = random.Random(theirs._width)
    field = field_at(56, theirs._width)
    checked = Checked(Protection(Checksum(ours, last=56), field))
    for length in (1, 8, 56):
        data = rng.randbytes(length)
        made = checked.protect(data + bytes(64 - length), 0) if length == 56 else None
        computed = judge_frame(checked.words(data), length, checked.row, checked.arrays)[1]
        assert int(computed) == theirs.calc(data)
        assert made is None or int.from_bytes(made[56:], "little") == theirs.calc(data)


def test_there_are_many_crcs():
    assert len(CRCS) > 80
    assert {crc._width for crc in CRCS} >= {4, 5, 6, 7, 8, 10, 16, 32, 64}


@pytest.mark.evidence("AUTOSAR E2E: E2E profiles")
@pytest.mark.parametrize(("profile", "mode"), CASES)
def test_e2e_frames_of_another_program_are_accepted_and_any_flip_is_not(profile, mode):
    for seed in range(amount(20)):
        check, length, theirs = drawn(profile, mode, seed)
        checked = Checked(protection_of(check, length))
        rng = random.Random(seed)
        data = bytearray(rng.randbytes(length))
        for sent in range(20):
            for k in range(check.offset + E2E[profile][1], length):
                data[k] = rng.getrandbits(8)
            theirs(data)
            assert checked.fits(data), f"seed {seed}, frame {sent}"
        counters = mask_of(protection_of(check, length).counter.field)
        for bit in range(8 * length):
            flipped = bytearray(data)
            flipped[bit // 8] ^= 1 << bit % 8
            # Alternating ids tell counters apart by their parity only; all other bits are covered.
            assert not checked.fits(flipped) or counters >> bit & 1, f"seed {seed}, bit {bit}"


@pytest.mark.parametrize(("profile", "mode"), CASES)
def test_e2e_frames_of_ours_are_theirs(profile, mode):
    for seed in range(amount(20)):
        ours, length, _ = drawn(profile, mode, seed)
        checked = Checked(protection_of(ours, length))
        check = getattr(getattr(e2e, profile.lower()), f"e2e_{profile.lower()}_check")
        options = {} if profile == "P02" else {"offset": ours.offset}
        if profile in ("P01", "P11"):
            options["data_id_mode"] = getattr(getattr(e2e, profile.lower()), f"E2E_{profile}_DATAID_{MODES[mode]}")
        for sent in range(40):
            data = bytearray(checked.protect(random.Random(sent).randbytes(length), sent))
            known = bytes(ours.data_ids) if profile == "P02" else ours.data_id
            assert check(data, known, **options), f"seed {seed}, frame {sent}"
            assert checked.fits(data)


@pytest.mark.parametrize("rule", DATABASES)
def test_frames_of_opendbc_s_packer_are_accepted_and_any_flip_is_not(rule):
    name = DATABASES[rule]
    packer, rng, tried = pytest.importorskip("opendbc.can.packer").CANPacker(name), random.Random(rule), 0
    for message in pytest.importorskip("opendbc.can.dbc").DBC(name).msgs.values():
        field = next((s for s in message.sigs.values() if s.calc_checksum is not None), None)
        if field is None or message.size > 64:
            continue
        tried += 1
        row = np.zeros(1, Field.dtype)[0]
        place(row, field.start_bit, field.size, big=not field.is_little_endian)
        frame = Frame(message.address, message.address > 0x7FF, message.size)
        checked = Checked(Protection(RULES[rule](frame), row))
        for _ in range(amount(4)):
            values = {
                s.name: rng.getrandbits(s.size) * s.factor + s.offset for s in message.sigs.values() if s is not field
            }
            _, data, _ = packer.make_can_msg(message.name, 0, values)
            assert checked.fits(data), f"{message.name} {data.hex()}"
            covered = 0
            for bit in range(8 * len(data)):
                flipped = bytearray(data)
                flipped[bit // 8] ^= 1 << bit % 8
                covered += not checked.fits(flipped)
            assert covered >= 8 * len(data) - 16, f"{message.name}: what a rule leaves out is a byte or two"
    assert tried >= 2


@given(st.integers(0, 511), st.integers(1, 64), st.booleans(), st.randoms())
@settings(max_examples=examples(100), deadline=None)
def test_fields_are_written_as_they_are_read(start, length, big, rng):
    row = np.zeros(1, Field.dtype)[0]
    first = 8 * (start // 8) + 7 - start % 8 if big else start
    if first + length > 512:
        return
    place(row, start, length, big=big)
    checked = Checked(Protection(Checksum(plus=12345), row))
    data = rng.randbytes(64)
    made = checked.protect(data, 0)
    assert checked.fits(made)
    own = mask_of(row)
    assert own.bit_count() == length
    difference = int.from_bytes(made, "little") ^ int.from_bytes(data, "little")
    assert difference & ~own == 0


def test_the_header_s_constants_are_checked():
    checked = Checked(protection_of(E2eCheck(profile="P04", data_id=0x12345678), 16))
    other = Checked(protection_of(E2eCheck(profile="P04", data_id=0x12345679), 16))
    data = other.protect(bytes(16), 3)
    judged = judge_frame(checked.words(data), 16, checked.row, checked.arrays)
    assert judged == (0x12345679, 0x12345678, FRAME_CONSTANT + 1), "the second of them: the data id"


@pytest.mark.parametrize(
    ("profile", "keys", "key"),
    [
        ("P04", {}, "offset"),
        ("P01", {"data_id": 1 << 16}, "data_id"),
        ("P11", {"data_id_mode": "low"}, "data_id_mode"),
        ("P02", {"data_id": 3}, "data_ids"),
        ("P01", {"data_ids": (1,) * 16}, "data_ids"),
        ("P02", {"data_ids": (1,) * 16, "offset": 1}, "offset"),
    ],
)
def test_what_a_profile_does_not_have_is_refused(profile, keys, key):
    with pytest.raises(InputError) as told:
        protection_of(E2eCheck(profile=profile, **keys), 8)
    assert told.value.key == key


@pytest.mark.evidence("AUTOSAR E2E: E2E profile 22")
def test_profile_22_by_the_vectors_of_its_specification():
    """PRS_E2EProtocol (AUTOSAR FO), examples of profile 22: ids 1 to 16, counter 1, all other bytes zero."""
    ids = tuple(range(1, 17))
    short = Checked(protection_of(E2eCheck(profile="P22", data_ids=ids), 8))
    assert short.protect(bytes(8), 1) == bytes.fromhex("1B01000000000000")
    offset = Checked(protection_of(E2eCheck(profile="P22", data_ids=ids, offset=8), 16))
    assert offset.protect(bytes(16), 1) == bytes(8) + bytes.fromhex("1401000000000000")
    rng = random.Random(22)
    for counter in range(16):
        data = bytearray(short.protect(rng.randbytes(8), counter))
        assert e2e.p02.e2e_p02_check(bytes(data), bytes(ids)), "without an offset it is profile 2"
