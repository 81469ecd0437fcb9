"""The protection of one message: checksum, alive counter, header; checked and made by the same kernels."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Key
from pydantic import model_validator

from gateway.signals.bits import Field, mask_of, placed, read_bits, write_bits
from gateway.signals.protection.checksum import Checksum, ChecksumConst, checksum_of, fill_checksum
from gateway.signals.protection.cmac import key_table, mac_of, rounds_table
from gateway.signals.protection.crc import KNOWN, table_of
from gateway.signals.protection.freshness import FreshConst, Freshness, count_of, fill_freshness, made_value
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.jit import Record, i4, i4s, i8, kernel, means, u1, u8s

#: Constants that a header has, at most.
MOST_CONSTANTS = 2


@dataclass(frozen=True)
class Counter:
    """An alive counter.

    Attributes:
        field: where it lies, a record of :class:`gateway.signals.bits.Field`.
        modulus: how many values it has.
        first: the lowest of them.
        max_step: largest step that is not a failure.
    """

    field: Any
    modulus: int
    first: int = 0
    max_step: int = 1


class WindowParams(StrictModel):
    """AUTOSAR's E2E state machine (PRS_E2EProtocol, 6.14): a frame is used while enough of the last ones are right.

    Size, min_ok and max_error are one number, or three: while starting, while valid, while invalid.
    """

    size: tuple[int, int, int] = Key(description="frames that are looked back at, 1 to 64")
    min_ok: tuple[int, int, int] = Key(description="right ones that it takes")
    max_error: tuple[int, int, int] = Key(description="wrong ones that it bears")
    cycle_ms: float | None = Key(
        None,
        gt=0,
        le=3.6e6,
        description="the receiver's cycle [ms]: each that passes without a frame counts as neither right nor wrong; "
        "default: timeout_ms of the check; without both only frames count",
    )

    @model_validator(mode="before")
    @classmethod
    def _threefold(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        three = ("size", "min_ok", "max_error")
        return {k: [value] * 3 if k in three and isinstance(value, int) else value for k, value in data.items()}

    @model_validator(mode="after")
    def _possible(self) -> Self:
        for size, ok, error in zip(self.size, self.min_ok, self.max_error, strict=True):
            if not 1 <= size <= 64:
                raise ValueError("size: 1 to 64 frames")
            if not 0 <= ok <= size or not 0 <= error <= size:
                raise ValueError("min_ok and max_error: 0 to size")
        # PRS_E2EProtocol: else the frame that makes it valid makes it invalid again.
        if self.min_ok[1] > min(self.min_ok) or self.max_error[1] < max(self.max_error):
            raise ValueError("while valid it takes no more right ones, and bears no fewer wrong ones, than else")
        return self


@dataclass(frozen=True)
class Protection:
    """How a message is protected.

    Attributes:
        checksum: to compute; None: none.
        field: where it lies, a record of :class:`gateway.signals.bits.Field`.
        counter: None: there is none.
        constants: fields of a header with the value that they always have, and their names for people.
        strict: a frame out of sequence is not used (E2E), else it is used and reported.
        window: state machine over the frames; None: each frame is judged alone.
        name: of the rule, for people.
        freshness: of SecOC, whose checksum is a MAC; None: it is none.
    """

    checksum: Checksum | None = None
    field: Any = None
    counter: Counter | None = None
    constants: Sequence[tuple[Any, int, str]] = ()
    strict: bool = False
    window: WindowParams | None = None
    name: str = ""
    freshness: Freshness | None = None


def digest(asked: Protection, can_id: int) -> int:
    """Return a number of 63 bits that stands for what the checksum of a message must be; 0: it has none.

    A header's constants belong to it, and where the counter lies, if it chooses a data id. How far the counter may
    step does not, nor what else is asked of the message.
    """
    if asked.checksum is None:
        return 0
    counter = asked.counter.field.item() if asked.counter is not None and asked.checksum.by_counter else None
    constants = [(field.item(), value) for field, value, _ in asked.constants]
    rule = repr((can_id, asked.checksum, asked.field.item(), constants, counter))
    if asked.checksum.mac is not None:
        rule += asked.checksum.mac.check + repr(asked.freshness)
    return int.from_bytes(hashlib.sha256(rule.encode()).digest()[:8], "little") >> 1 or 1


class ProtectionConst(Record):
    """The protection of a message as the kernels want it."""

    counter: Field = means("where the alive counter lies")
    has_counter: u1 = means("1: there is an alive counter")
    strict: u1 = means("1: a frame out of sequence is not used (E2E)")
    windowed: u1 = means("1: a frame is used by E2E's state machine")
    constants: u1 = means("how many constants the header has")
    modulus: i8 = means("values that the counter has")
    first: i8 = means("first value of the counter")
    max_step: i4 = means("largest step of the counter that is not a failure")
    has_checksum: u1 = means("1: there is a checksum")
    secured: u1 = means("1: the checksum is a MAC (SecOC)")
    field: Field = means("of the checksum")
    checksum: ChecksumConst = means("how it is computed")
    window: Annotated[i4s, 3] = means("frames looked back at: starting, valid, invalid")
    min_ok: Annotated[i4s, 3] = means("right frames of these that are enough")
    max_error: Annotated[i4s, 3] = means("wrong frames of these that are too many")
    constant: Annotated[u8s, 8] = means("bits of the header that are always the same")
    is_constant: Annotated[u8s, 8] = means("which these are")
    header: Annotated[list[Field], MOST_CONSTANTS] = means("the same, one by one")
    expected: Annotated[u8s, MOST_CONSTANTS] = means("values of these")
    owned: Annotated[u8s, 8] = means("all bits that the protection makes")
    fresh: FreshConst = means("freshness value of SecOC")


class Tables:
    """The tables that are in use: of the CRCs, of MACs' keys, and of AES's rounds."""

    def __init__(self) -> None:
        self._places: dict[tuple[int, int, bool] | bytes, int] = {}

    def place(self, asked: Checksum) -> int:
        """Return the place of a CRC's or a MAC's table, making room for it; of others 0."""
        if asked.mac is not None:
            return self._places.setdefault(asked.mac.key, len(self._places))
        crc = asked.crc
        return 0 if crc is None else self._places.setdefault((crc.width, crc.poly, crc.refin), len(self._places))

    def box(self, asked: Checksum) -> int:
        """Return the place of the table of AES's rounds, making room for it where a checksum is a MAC."""
        return 0 if asked.mac is None else self._places.setdefault(b"", len(self._places))

    def array(self) -> NDArray[np.uint64]:
        """Return all of them, shape (tables, 8, 256)."""
        known = KNOWN["crc8_sae_j1850"]
        keys = list(self._places) or [(known.width, known.poly, known.refin)]
        return np.stack([_table(key) for key in keys])


def _table(key: tuple[int, int, bool] | bytes) -> NDArray[np.uint64]:
    if isinstance(key, tuple):
        return table_of(*key)
    table = np.zeros((8, 256), np.uint64)  # a CRC's has as many rows
    table[0] = key_table(key) if key else rounds_table()
    return table


def fill(row: Any, asked: Protection, tables: Tables) -> None:
    """Fill a record of :class:`ProtectionConst`, zeroed before."""
    if asked.checksum is not None:
        row["has_checksum"] = 1
        row["field"] = asked.field
        made = asked.checksum
        fill_checksum(row["checksum"], made, asked.field, tables.place(made), tables.box(made))
        row["secured"] = made.mac is not None
    if asked.freshness is not None:
        fill_freshness(row["fresh"], asked.freshness)
    if asked.counter is not None:
        counter = asked.counter
        row["has_counter"] = 1
        row["counter"] = counter.field
        row["modulus"], row["first"], row["max_step"] = counter.modulus, counter.first, counter.max_step
    row["strict"] = asked.strict
    if asked.window is not None:
        row["windowed"] = 1
        row["window"], row["min_ok"], row["max_error"] = asked.window.size, asked.window.min_ok, asked.window.max_error
    bits = mask = 0
    for k, (field, value, _) in enumerate(asked.constants):
        row["header"][k], row["expected"][k] = field, value
        bits |= placed(field, value)
        mask |= mask_of(field)
    row["constants"] = len(asked.constants)
    if mask:
        row["constant"] = np.frombuffer(bits.to_bytes(64, "little"), "<u8")
        row["is_constant"] = np.frombuffer(mask.to_bytes(64, "little"), "<u8")
    mask |= 0 if asked.checksum is None else mask_of(asked.field)
    mask |= 0 if asked.counter is None else mask_of(asked.counter.field)
    mask |= 0 if asked.freshness is None or asked.freshness.field is None else mask_of(asked.freshness.field)
    row["owned"] = np.frombuffer(mask.to_bytes(64, "little"), "<u8")


def compiled(asked: Protection) -> tuple[Any, NDArray[np.uint64]]:
    """Return a protection as the kernels want it: its record, and its tables."""
    tables, rows = Tables(), np.zeros(1, ProtectionConst.dtype)
    fill(rows[0], asked, tables)
    return rows.view(np.recarray)[0], tables.array()


@kernel
def counter_of(words: Any, p: Any) -> int:
    """Return a payload's alive counter, 0 where it has none."""
    if p.has_counter == 0:
        return 0
    return int(np.int64(read_bits(words, p.counter)))


@kernel
def same_constants(words: Any, p: Any) -> bool:
    """Return whether the header's constants are what they should be."""
    for k in range(8):
        if (words[k] ^ p.constant[k]) & p.is_constant[k] != np.uint64(0):
            return False
    return True


@kernel
def protect(words: Any, length: int, counter: int, p: Any, tables: Any) -> None:
    """Put counter, constants and checksum into a payload, over any bits.

    Args:
        words: payload, 8 little-endian uint64, zero beyond its length.
        length: payload length [byte].
        counter: how many frames were sent before; of it the counter is made.
        p: record of :class:`ProtectionConst`.
        tables: of the CRCs, uint64, shape (tables, 8, 256).
    """
    for k in range(8):
        words[k] = (words[k] & ~p.owned[k]) | p.constant[k]
    if p.secured == 1:
        fresh = made_value(p.fresh, counter)
        if p.fresh.truncated > 0:
            write_bits(words, p.fresh.field, fresh)
        write_bits(words, p.field, mac_of(words, fresh, p.checksum, tables))
        return
    value = np.int64(0)
    if p.has_counter == 1:
        value = p.first + counter % p.modulus
        write_bits(words, p.counter, np.uint64(value))
    if p.has_checksum == 1:
        write_bits(words, p.field, checksum_of(words, length, int(value), p.checksum, tables))


@kernel
def protect_all(words: Any, lengths: Any, p: Any, tables: Any, sent: int) -> None:
    """Protect frames of one message that are sent one after the other, the first after ``sent`` others.

    Of ``words`` and ``lengths``, int64 [byte], each row is a frame's; else as :func:`protect`.
    """
    for k in range(words.shape[0]):
        protect(words[k], lengths[k], sent + k, p, tables)


@kernel
def sent_before(words: Any, p: Any, least: int) -> int:
    """Return how many frames a payload says that its sender had sent before.

    Args:
        words: payload, shape (8,).
        p: record of :class:`ProtectionConst`.
        least: of SecOC, what it was at the frame before; else it is modulo the counter's range.
    """
    if p.secured == 1:
        return count_of(words, p.fresh, least)
    return counter_of(words, p) - int(p.first)


@kernel
def protect_again(words: Any, lengths: Any, where: Any, p: Any, tables: Any, least: int) -> int:
    """Protect frames of one message that were changed, each with the counter that it has.

    Arguments as of :func:`protect_all`; ``where``, uint8, is 0 for a frame that stays as it is. ``least`` is that of
    :func:`sent_before`, of the frame before these; returned is that of the last one.
    """
    for k in range(words.shape[0]):
        if where[k] != 0 or p.secured == 1:
            least = sent_before(words[k], p, least)
        if where[k] != 0:
            protect(words[k], lengths[k], least, p, tables)
    return least
