"""Checksums that carmakers put into their frames, as community databases (opendbc) know them.

A rule is what opendbc 0.3.1 computes (MIT licence; the constants of single messages below are facts it lists); each is
said here in the terms of :class:`gateway.signals.protection.checksum.Checksum`. The tests compare every one with
opendbc's packer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.common.plugins import Registry, accept_callable
from gateway.signals.protection.checksum import Checksum
from gateway.signals.protection.crc import KNOWN, Crc
from gateway.signals.protection.volkswagen import MLB_STARTS, MQB_DATA_IDS


@dataclass(frozen=True)
class Frame:
    """A message as a rule needs it: identifier, whether it has 29 bits, length [byte]."""

    can_id: int
    extended: bool
    length: int

    @property
    def bytes_of_id(self) -> int:
        """Sum of its identifier's bytes."""
        return sum(self.can_id.to_bytes(4, "big"))

    @property
    def nibbles_of_id(self) -> int:
        """Sum of its identifier's half bytes."""
        return sum(byte // 16 + byte % 16 for byte in self.can_id.to_bytes(4, "big"))


def _volkswagen_mqb(f: Frame) -> Checksum:
    return Checksum(KNOWN["crc8_autosar"], by_counter=tuple(MQB_DATA_IDS.get(f.can_id, b"")))


def _volkswagen_mlb(f: Frame) -> Checksum:
    start = MLB_STARTS.get(f.can_id)
    return _volkswagen_mqb(f) if start is None else Checksum(xor=True, plus=start)


_J1850 = KNOWN["crc8_sae_j1850"]
#: By identifier, else the last one: first value of PSA's sum; last step of the Giorgio platform's CRC.
_PSA, _GIORGIO = ({0x452: 0x4, 0x38D: 0x7, 0x42D: 0xC}, 0xB), ({0xDE: 0x10, 0x106: 0xF6, 0x122: 0xF1}, 0x0A)
#: By length: last step of Hyundai's CRC on CAN FD.
_HYUNDAI_FD = {8: 0x5F29, 16: 0x041D, 24: 0x819D, 32: 0x9F5B}

#: Returns the checksum of a message.
Rule = Callable[[Frame], Checksum]

#: Name in a configuration -> the checksum of a message.
RULES: dict[str, Rule] = {
    "body": lambda _: Checksum(Crc(8, 0xD5, 0xFF), backwards=True),
    "chrysler": lambda _: Checksum(_J1850),
    "fca_giorgio": lambda f: Checksum(Crc(8, 0x1D, 0, xorout=_GIORGIO[0].get(f.can_id, _GIORGIO[1]))),
    "honda": lambda f: Checksum(nibbles=True, negative=True, plus=8 - f.nibbles_of_id + 3 * f.extended),
    "hyundai_6b": lambda _: Checksum(last=6),
    "hyundai_7b": lambda _: Checksum(),
    "hyundai_canfd": lambda f: Checksum(
        Crc(16, 0x1021, 0, xorout=_HYUNDAI_FD.get(f.length, 0)), after=(f.can_id & 0xFF, f.can_id >> 8 & 0xFF)
    ),
    "hyundai_crc8": lambda _: Checksum(Crc(8, 0x1D, 0x22, xorout=0xDF)),
    "nissan": lambda _: Checksum(_J1850),
    "psa": lambda f: Checksum(nibbles=True, negative=True, plus=_PSA[0].get(f.can_id, _PSA[1])),
    "subaru": lambda f: Checksum(first=1, plus=f.bytes_of_id),
    "subaru_preglobal": lambda _: Checksum(),
    "tesla": lambda f: Checksum(plus=(f.can_id & 0xFF) + (f.can_id >> 8 & 0xFF)),
    "toyota": lambda f: Checksum(plus=f.bytes_of_id, plus_length=True),
    "volkswagen_mlb": _volkswagen_mlb,
    "volkswagen_mqb": _volkswagen_mqb,
    "volkswagen_pq": lambda _: Checksum(xor=True),
}


#: Rules of other packages, by name.
OTHERS: Registry[Rule] = Registry("gateway.protections", accept_callable)


def rule_of(name: str) -> Rule | None:
    """Return a rule, ours before those of other packages; None: there is none of this name.

    Raises:
        InputError: another package's cannot be imported, or is no function.
    """
    return RULES.get(name) or OTHERS.get(name)
