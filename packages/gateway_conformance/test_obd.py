"""OBD (SAE J1979, ISO 15031-5, on CAN by ISO 15765-4): maps, formats, and what the modes say of each other."""

from __future__ import annotations

import pytest

from gateway_conformance.target import Target, shown

#: Bytes of PIDs (SAE J1979-DA), of those that most vehicles have.
LENGTHS = {
    0x01: 4, 0x03: 2, 0x04: 1, 0x05: 1, 0x06: 1, 0x07: 1, 0x0B: 1, 0x0C: 2, 0x0D: 1, 0x0E: 1, 0x0F: 1, 0x10: 2, 0x11: 1,
    0x1C: 1, 0x1F: 2, 0x21: 2, 0x2F: 1, 0x30: 1, 0x31: 2, 0x33: 1, 0x41: 4, 0x42: 2, 0x43: 2, 0x45: 1, 0x46: 1, 0x49: 1,
    0x4D: 2, 0x4E: 2, 0x51: 1,
}  # fmt: skip


def _map(target: Target, page: str) -> set[int]:
    """Return the numbers that a mode, or a page of identifiers of OBD on UDS, says it has, by its maps."""
    found: set[int] = set()
    for base in range(0, 0x100, 0x20):
        request = f"{page} {base:02X}"
        asked = bytes.fromhex(request)
        answer = target.positive(request, len(asked) - 1)
        expected = f"{shown(bytes([asked[0] + 0x40]) + asked[1:])} and four bytes"
        target.ask(request).needs(len(answer) == len(asked) + 4, expected)
        bits = int.from_bytes(answer[-4:], "big")
        found |= {base + 32 - k for k in range(32) if bits >> k & 1}
        if not bits & 1:
            break
    return found


@pytest.mark.parametrize("page", ["01", "09", "22 F4", "22 F8"])
def test_maps_say_what_is_answered(target: Target, page: str) -> None:
    """SAE J1979, 6.1, 6.9 (modes 01, 09), ISO 14229-1, C.1 (F4xx, F8xx): what maps name is answered, nothing else."""
    there, head = _map(target, page), bytes.fromhex(page)
    start = bytes([head[0] + 0x40]) + head[1:]
    for number in sorted(there | {*range(1, 0x60)}):
        if number % 0x20 == 0:
            continue
        answer = target.ask(f"{page} {number:02X}", patience_ns=round(1e8) if number not in there else round(1e9))
        if number not in there:
            answer.needs(not answer.came or bool(answer.refusal), "no positive answer: the map does not name it")
            continue
        data = answer.positive(start + bytes([number]))[len(start) + 1 :]
        length = LENGTHS.get(number) if page in ("01", "22 F4") else None
        answer.needs(len(data) == length if length else bool(data), f"{length or 'some'} bytes of data")


def test_several_pids(target: Target) -> None:
    """SAE J1979, 6.1.1: up to six PIDs in one request; each stands before its data."""
    there = [number for number in sorted(_map(target, "01")) if LENGTHS.get(number)][:2]
    if len(there) < 2:
        pytest.skip("fewer than two PIDs of known length")
    answer = target.ask(f"01 {there[0]:02X} {there[1]:02X}")
    data = answer.positive(bytes([0x41, there[0]]))
    second = 2 + LENGTHS[there[0]]
    good = len(data) == second + 1 + LENGTHS[there[1]] and data[second] == there[1]
    answer.needs(good, f"41, {there[0]:02X} and its data, {there[1]:02X} and its data")


def _codes(target: Target, mode: str) -> list[bytes]:
    """Return the DTCs of a mode; expects their number before them, none twice, no empty place."""
    answer = target.positive(mode, 0)
    asked = target.ask(mode)
    found = [answer[k : k + 2] for k in range(2, len(answer), 2)]
    asked.needs(len(answer) == 2 + 2 * answer[1], f"{int(mode, 16) + 0x40:02X}, a number n, and n DTCs of two bytes")
    asked.needs(b"\0\0" not in found and len(set(found)) == len(found), "no DTC twice, and none of zeros")
    return found


@pytest.mark.parametrize("mode", ["03", "07", "0A"])
def test_dtcs(target: Target, mode: str) -> None:
    """SAE J1979, 6.3, 6.7, 6.10: modes 03, 07 and 0A on CAN tell the number of DTCs, and two bytes of each."""
    _codes(target, mode)


def test_the_count_of_dtcs(target: Target) -> None:
    """SAE J1979, 6.1, PID 01: bits 0 to 6 of byte A are the number of DTCs of mode 03."""
    count = len(_codes(target, "03"))
    answer = target.ask("01 01")
    answer.needs((answer.positive(b"\x41\x01")[2] & 0x7F) == count, f"a count of {count}, as mode 03 lists")


def test_dtcs_are_those_of_uds(target: Target) -> None:
    """SAE J1979, 6.3, ISO 14229-1, D.2: a DTC of mode 03 is confirmed by 19 02 08, too, where both are there."""
    codes = _codes(target, "03")
    confirmed = target.positive("19 02 08", 1)
    known = {confirmed[k : k + 2] for k in range(3, len(confirmed), 4)}
    target.ask("19 02 08").needs(
        {*codes} <= known, f"also {', '.join(map(shown, sorted({*codes} - known)))} of mode 03"
    )


def _rows(target: Target, request: str, head: int, size: int) -> list[bytes]:
    """Return the rows of a list of DTCs of the emission system; expects its head and whole rows."""
    answer = target.positive(request, 2)
    target.ask(request).needs((len(answer) - head) % size == 0, f"{head} bytes and rows of {size}")
    return [answer[k : k + size] for k in range(head, len(answer), size)]


def test_dtcs_of_the_emission_system(target: Target) -> None:
    """ISO 14229-1:2020, 0x19 42: severity, DTC, status; each has a bit of the mask, and is in 19 02, too."""
    for mask in (0x04, 0x08, 0xAF):
        request = f"19 42 33 {mask:02X} FF"
        rows, asked = _rows(target, request, 6, 5), target.ask(request)
        asked.needs(all(row[-1] & mask for row in rows), f"only DTCs with a bit of {mask:02X} in the status")
        by_mask = target.ask(f"19 02 {mask:02X}")
        if by_mask.came and by_mask.came[0].startswith(b"\x59\x02"):
            known = {by_mask.came[0][k : k + 4] for k in range(3, len(by_mask.came[0]), 4)}
            asked.needs({row[1:] for row in rows} <= known, "DTCs and status as 19 02 has them")


def test_permanent_dtcs_of_the_emission_system(target: Target) -> None:
    """ISO 14229-1:2020, 0x19 55: DTC and status; the codes of mode 0A where both are there."""
    codes = {row[:2] for row in _rows(target, "19 55 33", 5, 4)}
    classic = target.ask("0A")
    if classic.came and classic.came[0][:1] == b"\x4a":
        said = {classic.came[0][k : k + 2] for k in range(2, len(classic.came[0]), 2)}
        target.ask("19 55 33").needs(codes == said, f"the codes of mode 0A: {', '.join(map(shown, sorted(said)))}")


def test_vin_on_uds(target: Target) -> None:
    """ISO 14229-1, C.1, F802 (infotype 02): 17 characters, the VIN of 22 F190 where both are there."""
    answer = target.positive("22 F8 02", 2)
    asked = target.ask("22 F8 02")
    asked.needs(
        len(answer) == 20 and answer[3:].isascii() and answer[3:].isalnum(), "62 F8 02 and 17 letters and digits"
    )
    other = target.ask("22 F1 90")
    if other.came and other.came[0].startswith(b"\x62\xf1\x90"):
        other.needs(other.came[0][3:] == answer[3:], f"{shown(answer[3:])}, the VIN of 22 F8 02")


def test_freeze_frame(target: Target) -> None:
    """SAE J1979, 6.2, PID 02: the DTC of frame 0; zeros if there is none; one of modes 03 and 07 else."""
    answer = target.positive("02 02 00", 2)
    asked = target.ask("02 02 00")
    asked.needs(len(answer) == 5, "42 02 00 and two bytes")
    there = {*_codes(target, "03"), *_codes(target, "07"), b"\0\0"}
    asked.needs(answer[3:] in there, "a DTC of mode 03 or 07, or zeros")


def test_test_results(target: Target) -> None:
    """SAE J1979, 6.6 (CAN): of each monitor that the map names, records of nine bytes that begin with its number."""
    for number in sorted(_map(target, "06")):
        if number % 0x20 == 0:
            continue
        answer = target.ask(f"06 {number:02X}")
        data = answer.positive(bytes([0x46, number]))[1:]
        good = len(data) % 9 == 0 and all(data[k] == number for k in range(0, len(data), 9))
        answer.needs(good, f"records of nine bytes, each with {number:02X} first")


def test_vin(target: Target) -> None:
    """SAE J1979, 6.9, infotype 02: one item of 17 characters, which is the VIN of 22 F190 where both are there."""
    answer = target.positive("09 02", 1)
    asked = target.ask("09 02")
    asked.needs(len(answer) == 20 and answer[2] == 1, "49 02 01 and 17 characters")
    asked.needs(answer[3:].isascii() and answer[3:].decode("ascii").isalnum(), "letters and digits")
    other = target.ask("22 F1 90")
    if other.came and other.came[0].startswith(b"\x62\xf1\x90"):
        other.needs(other.came[0][3:] == answer[3:], f"{shown(answer[3:])}, the VIN of 09 02")


def test_functional_silence(target: Target) -> None:
    """SAE J1979, 6.1: a PID that is not there is not answered to the functional address; one that is, is."""
    target.needs_functional()
    there = _map(target, "01")
    target.ask("01 00", functional=True).positive(b"\x41\x00")
    absent = next(number for number in range(1, 0x100) if number not in there and number % 0x20)
    answer = target.ask(f"01 {absent:02X}", functional=True, patience_ns=round(5e7) + target.slack_ns)
    answer.needs(not answer.came, "no answer")


@pytest.mark.intervene
def test_clear(target: Target) -> None:
    """SAE J1979, 6.4: mode 04 is answered by 44, or refused with 22."""
    if target.positive("04", 0) != b"\x44":
        target.ask("04").fails("44")
