"""Checksums that carmakers put into their frames, as community databases (opendbc) know them.

A rule is what opendbc 0.3.1 computes (MIT licence; the constants of single messages below are facts it lists); each is
said here in the terms of :class:`gateway.signals.protection.checksum.Checksum`. The tests compare every one with
opendbc's packer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

from gateway.common.plugins import Registry
from gateway.signals.protection.checksum import Checksum
from gateway.signals.protection.crc import KNOWN, Crc
from gateway.signals.protection.volkswagen import MLB_STARTS, MQB_DATA_IDS
from gateway_fdi.errors import InputError


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


def _honda(f: Frame) -> Checksum:
    plus = 8 - f.nibbles_of_id + (3 if f.extended else 0)
    return Checksum(nibbles=True, negative=True, plus=plus)


def _toyota(f: Frame) -> Checksum:
    return Checksum(plus=f.bytes_of_id, plus_length=True)


def _subaru(f: Frame) -> Checksum:
    return Checksum(first=1, plus=f.bytes_of_id)


def _tesla(f: Frame) -> Checksum:
    return Checksum(plus=(f.can_id & 0xFF) + (f.can_id >> 8 & 0xFF))


def _psa(f: Frame) -> Checksum:
    start = {0x452: 0x4, 0x38D: 0x7, 0x42D: 0xC}.get(f.can_id, 0xB)
    return Checksum(nibbles=True, negative=True, plus=start)


def _giorgio(f: Frame) -> Checksum:
    xorout = {0xDE: 0x10, 0x106: 0xF6, 0x122: 0xF1}.get(f.can_id, 0x0A)
    return Checksum(Crc(8, 0x1D, 0, xorout=xorout))


def _hyundai_fd(f: Frame) -> Checksum:
    xorout = {8: 0x5F29, 16: 0x041D, 24: 0x819D, 32: 0x9F5B}.get(f.length, 0)
    return Checksum(Crc(16, 0x1021, 0, xorout=xorout), after=(f.can_id & 0xFF, f.can_id >> 8 & 0xFF))


def _volkswagen_mqb(f: Frame) -> Checksum:
    return Checksum(KNOWN["crc8_autosar"], by_counter=tuple(MQB_DATA_IDS.get(f.can_id, b"")))


def _volkswagen_mlb(f: Frame) -> Checksum:
    start = MLB_STARTS.get(f.can_id)
    return _volkswagen_mqb(f) if start is None else Checksum(xor=True, plus=start)


def _of(checksum: Checksum) -> Callable[[Frame], Checksum]:
    return lambda _frame: checksum


_J1850 = KNOWN["crc8_sae_j1850"]

#: Returns the checksum of a message.
Rule = Callable[[Frame], Checksum]

#: Name in a configuration -> the checksum of a message.
RULES: dict[str, Rule] = {
    "body": _of(Checksum(Crc(8, 0xD5, 0xFF), backwards=True)),
    "chrysler": _of(Checksum(_J1850)),
    "fca_giorgio": _giorgio,
    "honda": _honda,
    "hyundai_6b": _of(Checksum(last=6)),
    "hyundai_7b": _of(Checksum()),
    "hyundai_canfd": _hyundai_fd,
    "hyundai_crc8": _of(Checksum(Crc(8, 0x1D, 0x22, xorout=0xDF))),
    "nissan": _of(Checksum(_J1850)),
    "psa": _psa,
    "subaru": _subaru,
    "subaru_preglobal": _of(Checksum()),
    "tesla": _tesla,
    "toyota": _toyota,
    "volkswagen_mlb": _volkswagen_mlb,
    "volkswagen_mqb": _volkswagen_mqb,
    "volkswagen_pq": _of(Checksum(xor=True)),
}


def _accepted(found: object, name: str) -> Rule:
    if not callable(found):
        raise InputError(f"no function, but {type(found).__name__}", value=name)
    return cast("Rule", found)


#: Rules of other packages, by name.
OTHERS: Registry[Rule] = Registry("gateway.protections", _accepted)


def rule_of(name: str) -> Rule | None:
    """Return a rule, ours before those of other packages; None: there is none of this name.

    Raises:
        InputError: another package's cannot be imported, or is no function.
    """
    return RULES.get(name) or OTHERS.get(name)
