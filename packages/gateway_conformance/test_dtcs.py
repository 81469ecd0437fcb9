"""0x19 ReadDTCInformation (ISO 14229-1:2020, 12.3): each report for itself, and all of them against each other."""

from __future__ import annotations

import pytest

from gateway_conformance.target import Target, shown

#: A DTC that no server has: P0000-00 stands for none; record numbers, and how many DTCs are looked at in each case.
NO_DTC, ALL, MOST = "00 00 01", "FF", 8
MASKS = ("FF", "01", "04", "08", "20", "2F", "50", "80")

#: DTC -> status.
Listed = dict[bytes, int]


def _read(target: Target, request: str) -> bytes:
    return target.positive(request, 1)


def _entries(target: Target, request: str, answer: bytes, size: int = 4, at: int = 3) -> list[bytes]:
    """Return the records of a list; expects whole ones, and no DTC twice."""
    asked = target.ask(request)
    asked.needs(len(answer) >= at and (len(answer) - at) % size == 0, f"{at} bytes and records of {size} bytes")
    found = [answer[k : k + size] for k in range(at, len(answer), size)]
    dtcs = [one[-4:-1] for one in found]
    asked.needs(len(set(dtcs)) == len(dtcs), "no DTC twice")
    return found


def _list(target: Target, request: str, at: int = 3, size: int = 4) -> Listed:
    """Return a list of DTCs with their status."""
    return {one[-4:-1]: one[-1] for one in _entries(target, request, _read(target, request), size, at)}


def _supported(target: Target) -> Listed:
    """Return all DTCs, by 0A or else by 02 FF."""
    answer = target.ask("19 0A")
    return _list(target, "19 02 FF" if answer.refusal else "19 0A")


def _with_data(target: Target, report: str) -> list[bytes]:
    """Return DTCs that are worth asking for records of."""
    listed = _list(target, "19 02 FF")
    ranked = sorted(listed, key=lambda dtc: -(listed[dtc] & 0x0D))[:MOST]
    if not ranked:
        pytest.skip(f"there are no DTCs to ask 19 {report} for")
    return ranked


@pytest.mark.parametrize("mask", MASKS)
def test_counts_equal_lists(target: Target, mask: str) -> None:
    """ISO 14229-1, 12.3: 01 tells mask, format identifier and count; 02 lists as many, same mask."""
    count = _read(target, f"19 01 {mask}")
    target.ask(f"19 01 {mask}").needs(len(count) == 6 and count[3] <= 4, "59 01, mask, format 00 to 04, two bytes")
    listed = target.ask(f"19 02 {mask}")
    answer = _read(target, f"19 02 {mask}")
    number = int.from_bytes(count[4:], "big")
    listed.needs(len(answer) == 3 + 4 * number, f"{number} DTCs, as 19 01 {mask} counts")
    listed.needs(answer[2] == count[2], f"the status availability mask {count[2]:02X} of 19 01")


@pytest.mark.parametrize("mask", MASKS)
def test_lists_keep_their_masks(target: Target, mask: str) -> None:
    """ISO 14229-1, 12.3: 02 lists the DTCs whose status has a bit of the mask, all of them and no others."""
    everything, found = _list(target, "19 02 FF"), _list(target, f"19 02 {mask}")
    right = {dtc for dtc, status in everything.items() if status & int(mask, 16)}
    words = f"the {len(right)} DTCs of 19 02 FF whose status has a bit of {mask}"
    target.ask(f"19 02 {mask}").needs(found.keys() == right, words)


def test_status_availability(target: Target) -> None:
    """ISO 14229-1, 12.3, D.2: no status has a bit that is not available; every report tells the same mask."""
    mask = _read(target, "19 02 FF")[2]
    for request in ("19 02 FF", "19 0A", "19 0B", "19 0C", "19 0D", "19 0E", "19 15"):
        answer = target.ask(request)
        if answer.refusal:
            continue
        data = answer.positive(bytes.fromhex(request)[:2].replace(b"\x19", b"\x59", 1))
        answer.needs(data[2] == mask, f"the status availability mask {mask:02X}, as 19 02 FF tells")
        answer.needs(not any(status & ~mask for status in data[6::4]), f"no status bit outside of the mask {mask:02X}")


def test_no_bit_no_dtc(target: Target) -> None:
    """ISO 14229-1, 12.3: a mask of no bit, or of bits that are not available, matches nothing."""
    available = _read(target, "19 02 FF")[2]
    for mask in {0, ~available & 0xFF}:
        answer = target.ask(f"19 02 {mask:02X}")
        answer.needs(len(answer.positive(b"\x59\x02")) == 3, "no DTC")


def test_supported(target: Target) -> None:
    """ISO 14229-1, 12.3: 0A lists all that there are, each once; those of 02 FF are among them."""
    supported, listed = _list(target, "19 0A"), _list(target, "19 02 FF")
    missing = [shown(dtc) for dtc in listed.keys() - supported.keys()]
    target.ask("19 0A").needs(not missing, f"also {', '.join(missing)}, which 19 02 FF lists")


@pytest.mark.parametrize("report", ["0B", "0C", "0D", "0E"])
def test_first_and_most_recent(target: Target, report: str) -> None:
    """ISO 14229-1, 12.3: 0B to 0E tell one DTC or none, one that is supported."""
    found = _list(target, f"19 {report}")
    good = len(found) <= 1 and found.keys() <= _supported(target).keys()
    target.ask(f"19 {report}").needs(good, "one supported DTC, or none")


def test_permanent(target: Target) -> None:
    """ISO 14229-1, 12.3: 15 is a list as 02 is; its DTCs are supported."""
    found = _list(target, "19 15")
    target.ask("19 15").needs(found.keys() <= _supported(target).keys(), "supported DTCs only")


def _records(target: Target, report: str, dtc: bytes, numbers: list[int] | None = None) -> list[int]:
    """Expect that all records of a DTC are its records one after the other; returns their numbers."""
    code = shown(dtc)
    request = f"19 {report} {code} {ALL}"
    whole = _read(target, request)
    asked = target.ask(request)
    asked.needs(whole[2:5] == dtc and len(whole) >= 6, f"59 {report} {code} and its status")
    found, at = [], 6
    while at < len(whole):
        number = whole[at]
        found.append(number)
        one = target.ask(f"19 {report} {code} {number:02X}")
        part = one.positive(whole[:1] + whole[1:5])[6:]
        one.needs(bool(part) and part[0] == number, f"record {number:02X}, which {ALL} tells")
        at += len(part)
        asked.needs(at <= len(whole), f"record {number:02X} as long as by its number: {len(part)} bytes")
    asked.needs(len(set(found)) == len(found), "no record twice")
    if numbers is not None:
        asked.needs(sorted(found) == sorted(numbers), f"the records {numbers}, as 19 03 tells")
    return found


def test_snapshots(target: Target) -> None:
    """ISO 14229-1, 12.3: 03 names DTC and record; 04 has exactly these records, each by its number, too."""
    answer = _read(target, "19 03")
    found = [bytes(one) for one in (answer[k : k + 4] for k in range(2, len(answer), 4))]
    asked = target.ask("19 03")
    asked.needs((len(answer) - 2) % 4 == 0, "records of a DTC and a number")
    asked.needs({one[:3] for one in found} <= _supported(target).keys(), "supported DTCs only")
    asked.needs(len(set(found)) == len(found), "no record twice")
    for dtc in sorted({one[:3] for one in found})[:MOST]:
        _records(target, "04", dtc, [one[3] for one in found if one[:3] == dtc])


@pytest.mark.parametrize("report", ["04", "06"])
def test_records(target: Target, report: str) -> None:
    """ISO 14229-1, 12.3: record FF of a DTC is all its records; each is there by its number, too."""
    for dtc in _with_data(target, report):
        _records(target, report, dtc)


@pytest.mark.parametrize("report", ["04", "06", "09"])
def test_an_unknown_dtc(target: Target, report: str) -> None:
    """ISO 14229-1, 12.3: reports of one DTC refuse a DTC that there is not with 31."""
    record = "" if report == "09" else ALL
    answer = target.ask(f"19 {report} {NO_DTC} {record}")
    if answer.refusal in (0x11, 0x12, 0x7E, 0x7F):
        pytest.skip(f"19 {report} is not supported")
    answer.refused(0x31)


@pytest.mark.parametrize(
    ("report", "rest"),
    [("01", ""), ("02", ""), ("03", "00"), ("04", "01 02 03"), ("05", ""), ("06", "01 02"), ("07", "FF"),
     ("08", "FF FF FF"), ("09", "01"), ("0A", "FF"), ("0B", "00"), ("0D", "00"), ("14", "00"), ("15", "00"),
     ("42", "33"), ("55", "")],
)  # fmt: skip
def test_wrong_lengths(target: Target, report: str, rest: str) -> None:
    """ISO 14229-1, 12.3: each report has its length; others are refused with 13."""
    answer = target.ask(f"19 {report} {rest}")
    if answer.refusal in (0x11, 0x12, 0x7E, 0x7F):
        pytest.skip(f"19 {report} is not supported")
    answer.refused(0x13)


def test_stored_data(target: Target) -> None:
    """ISO 14229-1, 12.3: 05 repeats the record's number; with a record: DTC, status and at least one identifier."""
    answer = _read(target, "19 05 01")
    good = answer[2:3] == b"\x01" and (len(answer) == 3 or (len(answer) > 8 and answer[7] > 0))
    target.ask("19 05 01").needs(good, "59 05 01, and DTC, status, number of identifiers and data if there is a record")


def test_fault_detection_counters(target: Target) -> None:
    """ISO 14229-1, 12.3: 14 lists DTCs on their way to failed: counters from 01 to 7E, of supported DTCs."""
    answer = _read(target, "19 14")
    found = _entries(target, "19 14", answer, 4, 2)
    good = all(1 <= one[3] <= 0x7E and one[:3] in _supported(target) for one in found)
    target.ask("19 14").needs(good, "counters from 01 to 7E of supported DTCs")


def test_severities(target: Target) -> None:
    """ISO 14229-1, 12.3: 07 counts what 08 lists; 09 tells of each what 08 does."""
    answer = _read(target, "19 08 E0 FF")
    found = _entries(target, "19 08 E0 FF", answer, 6)
    count = _read(target, "19 07 E0 FF")
    words = f"59 07, mask, format, and {len(found)}, as 19 08 lists"
    target.ask("19 07 E0 FF").needs(len(count) == 6 and int.from_bytes(count[4:], "big") == len(found), words)
    target.ask("19 08 E0 FF").needs(all(one[0] & 0xE0 for one in found), "severities with a bit of the mask E0")
    for one in found[:MOST]:
        request = f"19 09 {shown(one[2:5])}"
        target.ask(request).needs(_read(target, request)[3:8] == one[:5], f"{shown(one[:5])}, as 19 08 lists")


def test_wwh_obd(target: Target) -> None:
    """ISO 14229-1, 12.3, ISO 27145-3: 42 tells group, masks, format 02 or 04, then severity, DTC and status."""
    answer = _read(target, "19 42 33 FF FF")
    asked = target.ask("19 42 33 FF FF")
    asked.needs(len(answer) >= 6 and answer[2] == 0x33 and answer[5] in (2, 4), "59 42 33, two masks, format 02 or 04")
    found = _list(target, "19 42 33 FF FF", 6, 5)
    asked.needs(found.keys() <= _supported(target).keys(), "supported DTCs only")
    target.ask("19 42 00 FF FF").refused(0x31)


def test_wwh_obd_permanent(target: Target) -> None:
    """ISO 14229-1, 12.3: 55 tells group, mask, format 02 or 04, then DTC and status."""
    answer = _read(target, "19 55 33")
    good = len(answer) >= 5 and answer[2] == 0x33 and answer[4] in (2, 4)
    target.ask("19 55 33").needs(good, "59 55 33, mask, format 02 or 04")
    _list(target, "19 55 33", 5)


def test_suppressed(target: Target) -> None:
    """ISO 14229-1, 8.2.2: bit 7 of the report suppresses its answer."""
    _read(target, "19 02 FF")
    target.silent("19 82 FF")
