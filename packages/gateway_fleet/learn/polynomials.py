"""Polynomials over GF(2): the one that a CRC divides by, found from what frames differ in.

A CRC is affine: crc(a) + crc(b) is the CRC of a + b from zero, with any start value, final exclusive or, and constant
bytes beside the payload; + is exclusive or. So (a + b) x^w + crc(a) + crc(b) is a multiple of the polynomial, for each
pair of frames, and it is the greatest common divisor of a few of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

#: A CRC has a greatest common divisor of its degree after this number of pairs, or none.
MOST_PAIRS = 64

_REVERSED = np.array([int(f"{byte:08b}"[::-1], 2) for byte in range(256)], np.uint8)


def divided(one: int, other: int) -> int:
    """Return the remainder of ``one`` by ``other``, which is not 0; bit k is the coefficient of x^k."""
    degree = other.bit_length()
    while one.bit_length() >= degree:
        one ^= other << (one.bit_length() - degree)
    return one


def greatest_common_divisor(values: Iterable[int], degree: int = 1) -> int:
    """Return the greatest common divisor of polynomials, 0 if all are 0.

    Args:
        values: polynomials.
        degree: that it must have; below it what comes out is of no use, and not completed.
    """
    found = 0
    for value in values:
        other = value
        while other:
            found, other = other, divided(found, other)
        if 0 < found.bit_length() <= degree:
            break
    return found


def polynomial_of(
    covered: NDArray[np.uint8], checksums: Sequence[int], width: int, *, refin: bool, refout: bool
) -> int | None:
    """Return the polynomial of a CRC without its highest term, None if there is none.

    Args:
        covered: the bytes that go in, shape (frames, bytes), in their order; of frames that have the same constants.
        checksums: of the frames.
        width: of the CRC [bit].
        refin: bytes go in with their least significant bit first.
        refout: the result's bits are reversed.
    """
    turned = _REVERSED[covered] if refin else covered
    values = [int.from_bytes(row.tobytes(), "big") for row in turned]
    sums = [int(f"{each:0{width}b}"[::-1], 2) if refout else each for each in checksums]
    multiples = []
    for value, checksum in zip(values[1:], sums[1:], strict=True):
        multiple = (value ^ values[0]) << width ^ checksum ^ sums[0]
        if multiple:
            multiples.append(multiple)
        if len(multiples) == MOST_PAIRS:
            break
    found = greatest_common_divisor(multiples, width)
    if found.bit_length() != width + 1 or not found & 1:
        return None
    return found ^ (1 << width)


def solved(images: Sequence[int], wanted: int) -> int | None:
    """Return which images sum up to a value: bit k is set where ``images[k]`` takes part; None: no sum does.

    Of several solutions it is the one without the images that the earlier ones can replace.
    """
    basis: dict[int, tuple[int, int]] = {}  # highest bit -> (value, which images make it)
    for k, image in enumerate(images):
        value, chosen = _reduced(image, 1 << k, basis)
        if value:
            basis[value.bit_length()] = (value, chosen)
    rest, chosen = _reduced(wanted, 0, basis)
    return None if rest else chosen


def _reduced(value: int, chosen: int, basis: dict[int, tuple[int, int]]) -> tuple[int, int]:
    while value and value.bit_length() in basis:
        other, made = basis[value.bit_length()]
        value, chosen = value ^ other, chosen ^ made
    return value, chosen
