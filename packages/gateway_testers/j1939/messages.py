"""Diagnostic messages (SAE J1939-73) and identifications (SAE J1939-71), as bytes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from gateway.faults.catalogue import FaultDefinition
from gateway.faults.entries import Entry
from gateway.faults.performance import Ratio
from gateway.faults.usage import Driven
from gateway_testers.j1939.params import FreezeFrameSpn
from gateway_testers.readiness import Readiness

DM1, DM2, DM3, DM5, DM6 = 0xFECA, 0xFECB, 0xFECC, 0xFECE, 0xFECF
DM11, DM12 = 0xFED3, 0xFED4
DM19, DM20, DM21, DM26, DM29 = 0xD300, 0xC200, 0xC100, 0xFDB8, 0x9E00
COMPONENT, SOFTWARE, VIN = 0xFEEB, 0xFEDA, 0xFEEC
DM24, DM25, DM28 = 0xFDB6, 0xFDB7, 0xFD80

#: Lamps, from the lowest bits of the first byte up.
_LAMPS = ("protect", "warning", "stop", "malfunction")
_ON, _NOT_AVAILABLE = 0b01, 0b11
#: Suspect parameter numbers of monitored systems (5.7.20), by readiness group; those without a number are not shown.
SYSTEMS = {
    "catalyst": 3050,
    "misfire": 3052,
    "evaporative_system": 3053,
    "secondary_air": 3054,
    "fuel_system": 3055,
    "oxygen_sensor": 3056,
    "egr": 3058,
    "air_conditioning": 3062,
    "components": 3065,
}
#: The greatest count of two bytes, and the code for one that is not available.
_MOST_2, _NO_2 = 0xFAFF, b"\xff\xff"
#: The greatest occurrence count; 127 says that there is none.
MOST_OCCURRENCES = 126
#: DTCs that one message of 1785 bytes holds.
MOST_DTCS = (1785 - 2) // 4

#: An entry with its definition, of a fault that has SPN and FMI.
Coded = tuple[FaultDefinition, Entry]


def dtc_bytes(spn: int, fmi: int, occurrence: int) -> bytes:
    """Return a DTC: SPN of 19 bits, FMI of 5, conversion method 0, occurrence count of 7 (5.7.1)."""
    return bytes(
        [
            spn & 0xFF,
            spn >> 8 & 0xFF,
            (spn >> 16 & 0x7) << 5 | fmi,
            min(occurrence, MOST_OCCURRENCES),
        ]
    )


def _coded_dtc(coded: Coded) -> bytes:
    definition, entry = coded
    return dtc_bytes(definition.spn or 0, definition.fmi or 0, entry.record.occurrence)


def lamp_bytes(lit: Collection[str], available: Collection[str]) -> bytes:
    """Return the two bytes of lamps: on, off or not available; how they flash is not available."""
    status = 0
    for place, lamp in enumerate(_LAMPS):
        bits = _NOT_AVAILABLE if lamp not in available else _ON if lamp in lit else 0
        status |= bits << 2 * place
    return bytes([status, 0xFF])


def dtc_message(lamps: bytes, dtcs: Sequence[Coded]) -> bytes:
    """Return DM1 and the messages of its shape: lamps, then each DTC; zeros stand for no DTC."""
    codes = b"".join(_coded_dtc(coded) for coded in dtcs[:MOST_DTCS])
    return (lamps + (codes or bytes(4))).ljust(8, b"\xff")


def readiness_message(active: int, previous: int, compliance: int, ready: Readiness) -> bytes:
    """Return DM5: numbers of DTCs, compliance, monitors that there are and that have not completed."""
    continuous, others, incomplete = ready.obd_bytes
    numbers = bytes([min(active, 250), min(previous, 250), compliance, continuous])
    return numbers + others.to_bytes(2, "little") + incomplete.to_bytes(2, "little")


def calibration(check: int, identification: str) -> bytes:
    """Return DM19: verification number, low byte first, and identification of 16 characters."""
    return check.to_bytes(4, "little") + identification.encode().ljust(16, b"\0")


def performance(ignition_cycles: int, conditions: int, ratios: Mapping[str, Ratio]) -> bytes:
    """Return DM20: ignition cycles, general denominator, then number, numerator and denominator of each system."""
    made = _two_bytes(ignition_cycles) + _two_bytes(conditions)
    for group, number in SYSTEMS.items():
        if group in ratios:
            system = (number | 0x1F << 19).to_bytes(3, "little")  # 19 bits; reserved ones are 1
            made += system + b"".join(_two_bytes(count) for count in ratios[group])
    return made.ljust(8, b"\xff")


def _two_bytes(count: float | None) -> bytes:
    return _NO_2 if count is None else min(int(count), _MOST_2).to_bytes(2, "little")


def driven(since: Driven) -> bytes:
    """Return DM21: distance [km] with the MIL on and since the clear, running time [min] likewise."""
    distances = [None if metres is None else metres / 1000 for metres in (since.lit_m, since.cleared_m)]
    times = [None if seconds is None else seconds / 60 for seconds in (since.lit_s, since.cleared_s)]
    return b"".join(_two_bytes(value) for value in (*distances, *times))


def readiness_of_cycle(ready: Readiness) -> bytes:
    """Return DM26: monitors of this cycle that there are, and that have not completed; time and warm-ups unknown."""
    continuous, others, incomplete = ready.obd_bytes
    return b"\xff\xff\xff" + bytes([continuous]) + others.to_bytes(2, "little") + incomplete.to_bytes(2, "little")


def counts(pending: int, all_pending: int, lit: int, previously_lit: int, permanent: int) -> bytes:
    """Return DM29: numbers of DTCs - emission related pending, pending, MIL on, previously MIL on, permanent."""
    numbers = (pending, all_pending, lit, previously_lit, permanent)
    return bytes(min(number, 250) for number in numbers).ljust(8, b"\xff")


def identification(*texts: str) -> bytes:
    """Return texts, each ended by "*"."""
    return b"".join(text.encode() + b"*" for text in texts)


def spn_support(parameters: Iterable[FreezeFrameSpn]) -> bytes:
    """Return DM24: each parameter of the freeze frames, with its length; a bit of 0 says "supported"."""
    made = b""
    for p in parameters:
        flags = 0x1F & ~0x01  # in expanded freeze frames, and nowhere else
        made += bytes([p.spn & 0xFF, p.spn >> 8 & 0xFF, (p.spn >> 16 & 0x7) << 5 | flags, p.length])
    return made or bytes([0, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF])


def freeze_frames(
    frames: Iterable[tuple[Coded, Mapping[str, float | None]]],
    parameters: Sequence[FreezeFrameSpn],
) -> bytes:
    """Return DM25: for each freeze frame its length, the DTC, and the parameters in the order of DM24."""
    made = b""
    for coded, content in frames:
        part = _coded_dtc(coded)
        part += b"".join(p.encode(content.get(p.signal)) for p in parameters)
        if len(made) + 1 + len(part) > 1785:
            break
        made += bytes([len(part)]) + part
    return made or bytes([0, 0, 0, 0, 0, 0xFF, 0xFF, 0xFF])
