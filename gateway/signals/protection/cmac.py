"""AES-128 (FIPS 197) and CMAC (NIST SP 800-38B, RFC 4493), as kernels: SecOC's MAC is computed in the loop.

A call of a library for each frame would leave the loop, and end the pump; here it is a checksum as others are. The
price: the table of a round is looked up by secret bytes, so that a process on the same processor's cache could learn
of the key by timing. Nothing else of a library's care is lost: there is no padding, no nonce, no decryption.

A block is four columns, most significant byte first. One table, T[x] = (2s, s, s, 3s) with s = S[x], makes a round's
substitution and mixing; its bits 8 to 15 are the substitution alone, for the last round.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import kernel

#: Bytes of a key and of a block.
BLOCK = 16
#: Columns of the round keys, then of CMAC's two subkeys: cells of a key's row among the tables.
ROUND_KEYS, K1, K2 = 0, 44, 48
_LOW = 0xFFFFFFFF


@dataclass(frozen=True)
class Mac:
    """A CMAC.

    Attributes:
        key: 16 bytes; it is shown nowhere.
        check: stands for the key where it is told or compared.
    """

    key: bytes = field(repr=False)

    @property
    def check(self) -> str:
        """A digest that tells keys apart."""
        return hashlib.sha256(b"gateway key check" + self.key).hexdigest()[:16]


def _doubled(byte: int) -> int:
    return (byte << 1) ^ (0x11B if byte & 0x80 else 0)


@cache
def rounds_table() -> NDArray[np.uint64]:
    """Return T, shape (256,): the S-box derived as FIPS 197, 5.1.1 has it, and its multiples."""
    power, log = [1], {}
    for k in range(255):  # 3 generates the field's multiplicative group
        log[power[k]] = k
        power.append(power[k] ^ _doubled(power[k]))
    table = np.zeros(256, np.uint64)
    for x in range(256):
        inverse = power[(255 - log[x]) % 255] if x else 0
        s = 0x63
        for turn in range(5):
            s ^= (inverse << turn | inverse >> (8 - turn)) & 0xFF
        twice = _doubled(s)
        table[x] = twice << 24 | s << 16 | s << 8 | (twice ^ s)
    return table


@cache
def key_table(key: bytes) -> NDArray[np.uint64]:
    """Return a key's row of the tables, shape (256,): round keys (FIPS 197, 5.2), CMAC's subkeys (SP 800-38B, 6.1)."""
    table = rounds_table()
    columns = [int.from_bytes(key[k : k + 4], "big") for k in range(0, BLOCK, 4)]
    constant = 1
    while len(columns) < K1:
        last = columns[-1]
        if len(columns) % 4 == 0:
            last = (last << 8 | last >> 24) & _LOW
            last = sum((int(table[last >> at & 0xFF]) >> 8 & 0xFF) << at for at in (24, 16, 8, 0)) ^ constant << 24
            constant = _doubled(constant)
        columns.append(columns[-4] ^ last)
    row = np.zeros(256, np.uint64)
    row[: len(columns)] = columns
    zero = np.uint64(0)
    subkey = sum(int(c) << 96 - 32 * k for k, c in enumerate(encrypted(zero, zero, zero, zero, row, table)))
    for place in (K1, K2):
        subkey = (subkey << 1 & (1 << 128) - 1) ^ (0x87 if subkey >> 127 else 0)
        row[place : place + 4] = [subkey >> at & _LOW for at in (96, 64, 32, 0)]
    return row


@kernel
def mixed(a: Any, b: Any, c: Any, d: Any, table: Any) -> Any:
    """Return a column after a round's substitution, shift of rows and mixing; the bytes are of four columns."""
    byte, low = np.uint64(0xFF), np.uint64(_LOW)
    x = table[a >> np.uint64(24)]
    y = table[(b >> np.uint64(16)) & byte]
    z = table[(c >> np.uint64(8)) & byte]
    w = table[d & byte]
    y = (y >> np.uint64(8)) | (y << np.uint64(24))
    z = (z >> np.uint64(16)) | (z << np.uint64(16))
    w = (w >> np.uint64(24)) | (w << np.uint64(8))
    return (x ^ y ^ z ^ w) & low


@kernel
def substituted(a: Any, b: Any, c: Any, d: Any, table: Any) -> Any:
    """Return a column after the last round's substitution and shift of rows."""
    byte, eight = np.uint64(0xFF), np.uint64(8)
    x = (table[a >> np.uint64(24)] >> eight) & byte
    y = (table[(b >> np.uint64(16)) & byte] >> eight) & byte
    z = (table[(c >> eight) & byte] >> eight) & byte
    w = (table[d & byte] >> eight) & byte
    return (x << np.uint64(24)) | (y << np.uint64(16)) | (z << eight) | w


@kernel(inlined=False)
def encrypted(a: Any, b: Any, c: Any, d: Any, key: Any, table: Any) -> Any:
    """Return a block's four columns, uint64, after AES-128; of :func:`key_table` and :func:`rounds_table`."""
    a ^= key[0]
    b ^= key[1]
    c ^= key[2]
    d ^= key[3]
    for k in range(4, 40, 4):
        w = mixed(a, b, c, d, table) ^ key[k]
        x = mixed(b, c, d, a, table) ^ key[k + 1]
        y = mixed(c, d, a, b, table) ^ key[k + 2]
        z = mixed(d, a, b, c, table) ^ key[k + 3]
        a, b, c, d = w, x, y, z
    w = substituted(a, b, c, d, table) ^ key[40]
    x = substituted(b, c, d, a, table) ^ key[41]
    y = substituted(c, d, a, b, table) ^ key[42]
    z = substituted(d, a, b, c, table) ^ key[43]
    return w, x, y, z


@kernel
def authenticated_byte(words: Any, value: Any, p: Any, payload: int, k: int) -> Any:
    """Return byte ``k`` of what a MAC is computed over, uint64: data id, payload, freshness, then CMAC's padding."""
    byte = np.uint64(0xFF)
    if k < p.before:
        return (p.before_bytes >> np.uint64(8 * k)) & byte
    k -= p.before
    if k < payload:
        k += p.first
        return (words[k >> 3] >> np.uint64(8 * (k & 7))) & byte
    k -= payload
    fresh = (p.fresh + 7) >> 3
    if k < fresh:  # to the left, zero bits after it
        return ((value << np.uint64(64 - p.fresh)) >> np.uint64(56 - 8 * k)) & byte
    return np.uint64(0x80 if k == fresh else 0)


@kernel(inlined=False)
def mac_of(words: Any, value: Any, p: Any, tables: Any) -> Any:
    """Return the truncated MAC of a payload, uint64.

    Args:
        words: payload, 8 little-endian uint64.
        value: its whole freshness value, uint64.
        p: record of :class:`gateway.signals.protection.checksum.ChecksumConst`.
        tables: uint64, shape (tables, 8, 256).
    """
    key, table = tables[p.table, 0], tables[p.box, 0]
    payload = int(p.last - p.first)
    size = int(p.before) + payload + ((int(p.fresh) + 7) >> 3)
    blocks = max((size + 15) >> 4, 1)
    a = b = c = d = np.uint64(0)
    eight = np.uint64(8)
    for block in range(blocks):
        w = x = y = z = np.uint64(0)
        for k in range(16 * block, 16 * block + 4):
            w = (w << eight) | authenticated_byte(words, value, p, payload, k)
            x = (x << eight) | authenticated_byte(words, value, p, payload, k + 4)
            y = (y << eight) | authenticated_byte(words, value, p, payload, k + 8)
            z = (z << eight) | authenticated_byte(words, value, p, payload, k + 12)
        if block == blocks - 1:
            subkey = K1 if size == 16 * blocks else K2
            w ^= key[subkey]
            x ^= key[subkey + 1]
            y ^= key[subkey + 2]
            z ^= key[subkey + 3]
        a, b, c, d = encrypted(a ^ w, b ^ x, c ^ y, d ^ z, key, table)
    return ((a << np.uint64(32)) | b) >> np.uint64(64 - p.width)
