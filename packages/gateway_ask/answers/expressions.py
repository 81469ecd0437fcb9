"""Expressions over bytes of an answer, as numbers in it: ``[B10:B11]/10-40`` is 16 bits, a factor, and an offset.

An expression is a sum over bits of the answer, as long as it only adds, and multiplies by constants. It is a signal if
these bits follow each other, and each counts twice the next one. Python reads the expression: its operators go before
each other as WiCAN's do (C's, but for ``^``, which is refused).
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, NamedTuple

from gateway_ask.answers.model import signal_of

#: A byte, with a sign (S), one bit of it; a range of bytes, the first is the highest.
_BYTE = r"([BS])(\d{1,4})"
_TERM = re.compile(rf"\[{_BYTE}:{_BYTE}\]|{_BYTE}(?::([0-7]))?(?!\d)")
#: Longest expression; greatest shift; bytes of a range, and of one with a sign whose sign counts.
_LONGEST, _SHIFT, _WIDEST, _SIGNED = 200, 64, 8, (1, 2, 4)

_ADDED: dict[type[ast.operator], Callable[[Fraction, Fraction], Fraction]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
}


class Sum(NamedTuple):
    """A sum: a number, and what each bit adds when it is 1; bits count from the highest of the first byte on."""

    number: Fraction
    bits: Mapping[int, Fraction]


#: Byte of an expression -> byte of the answer's data, or the number that always stands there; None: nobody knows.
ByteOf = Callable[[int], "tuple[str, int] | None"]


class NotOne(ValueError):
    """An expression is not one number of the answer; the text says why."""


def signal(name: str, text: str, byte_of: ByteOf, unit: str | None) -> Any:
    """Return the signal that an expression is.

    Args:
        name: of the signal.
        text: the expression.
        byte_of: where its bytes are: ``("data", index)`` or ``("number", value)``.
        unit: of its values.

    Raises:
        NotOne: it is none.
    """
    found = _sum_of(text, byte_of)
    bits = sorted(found.bits, key=lambda bit: (-abs(found.bits[bit]), bit))
    if not bits:
        raise NotOne("it has no byte of the answer")
    weights = [found.bits[bit] for bit in bits]
    scale, count = weights[-1], len(bits)
    signed = count > 1 and weights[0] == -scale * 2 ** (count - 1)
    if weights[int(signed) :] != [scale * 2 ** (count - 1 - k) for k in range(int(signed), count)]:
        raise NotOne("it is not one number of the answer, times a factor")
    little = [8 * (bit // 8) + 7 - bit % 8 for bit in bits]
    big = bits == list(range(bits[0], bits[0] + count))
    if not big and little != list(range(little[0], little[0] - count, -1)):
        raise NotOne("its bits do not follow each other")
    start = 8 * (bits[0] // 8) + 7 - bits[0] % 8 if big else little[-1]
    return signal_of(
        name, start, count, big=big, signed=signed, scale=float(scale), offset=float(found.number), unit=unit
    )


def _sum_of(text: str, byte_of: ByteOf) -> Sum:
    terms: list[Sum] = []

    def named(match: re.Match[str]) -> str:
        terms.append(_term(match, byte_of))
        return f" x{len(terms) - 1} "

    words = _TERM.sub(named, text)
    if len(text) > _LONGEST or re.search(r"[A-Za-wyzV_\[\]]", words):
        raise NotOne("it is no expression over bytes")
    try:
        return _evaluated(ast.parse(words.strip(), mode="eval").body, terms)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise NotOne(str(error) if isinstance(error, NotOne) else "it is no expression over bytes") from error


def _term(match: re.Match[str], byte_of: ByteOf) -> Sum:
    """Return the sum of a byte, a bit, or a range."""
    kind, first, other, last, single, at, bit = match.groups()
    if kind is not None and kind != other:
        raise NotOne(f"{match[0]} has bytes of two kinds")
    signed = (kind or single) == "S"
    low, high = (int(first), int(last)) if kind is not None else (int(at), int(at))
    size = high - low + 1
    if not 1 <= size <= _WIDEST or (signed and size > max(_SIGNED)):
        raise NotOne(f"{match[0]} has {size} bytes")
    number, bits = Fraction(0), dict[int, Fraction]()
    for k in range(size):
        place = byte_of(low + k)
        if place is None:
            raise NotOne(f"byte {low + k} is not of the answer's data")
        weight = 256 ** (size - 1 - k)
        if place[0] == "number":
            number += place[1] * weight
        else:
            bits |= {8 * place[1] + j: Fraction(weight * 2 ** (7 - j)) for j in range(8)}
    if bit is not None:
        shift, only = 7 - int(bit), next(iter(bits), None)
        return Sum(Fraction(int(number) >> int(bit) & 1), {} if only is None else {only + shift: Fraction(1)})
    if signed and size in _SIGNED:
        top = next(iter(bits), None)
        if top is None or number:
            raise NotOne(f"{match[0]} has bytes that are not of the answer's data")
        bits[top] = -bits[top]
    return Sum(number, bits)


def _evaluated(node: ast.expr, terms: list[Sum]) -> Sum:
    """Return the sum that a part of an expression is."""
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return Sum(Fraction(str(node.value)), {})
    if isinstance(node, ast.Name):
        return terms[int(node.id[1:])]
    if not isinstance(node, ast.BinOp):
        raise NotOne("it has an operator that is not known")
    left, right = _evaluated(node.left, terms), _evaluated(node.right, terms)
    kind = type(node.op)
    if kind in _ADDED:
        added = _ADDED[kind]
        every = {**left.bits, **right.bits}
        bits = {bit: added(left.bits.get(bit, Fraction(0)), right.bits.get(bit, Fraction(0))) for bit in every}
        return Sum(added(left.number, right.number), {bit: weight for bit, weight in bits.items() if weight})
    if kind is ast.Mult and not left.bits:
        left, right = right, left
    if right.bits:
        raise NotOne("it multiplies, divides, or masks by bytes")
    return _by_constant(kind, left, right.number)


def _by_constant(kind: type[ast.operator], value: Sum, constant: Fraction) -> Sum:
    if kind is ast.Div and not constant:
        raise NotOne("it divides by 0")
    if kind in (ast.Mult, ast.Div):
        factor = constant if kind is ast.Mult else 1 / constant
        return Sum(value.number * factor, {bit: weight * factor for bit, weight in value.bits.items() if factor})
    if kind not in (ast.LShift, ast.RShift, ast.BitAnd):
        raise NotOne("it has an operator that is not known")
    whole = [value.number, constant, *value.bits.values()]
    if any(each.denominator != 1 for each in whole) or constant < 0:
        raise NotOne("it shifts or masks a fraction")
    if kind is not ast.BitAnd and constant > _SHIFT:
        raise NotOne(f"it shifts by more than {_SHIFT} bits")
    if kind is ast.LShift:
        return _by_constant(ast.Mult, value, Fraction(2 ** int(constant)))
    weights = [int(weight) for weight in value.bits.values()]
    plain = not value.number and all(each > 0 and each & each - 1 == 0 for each in weights)
    if not plain or len(set(weights)) < len(weights):
        raise NotOne("it shifts or masks what is not one number of the answer")
    if kind is ast.BitAnd:
        return Sum(Fraction(0), {bit: weight for bit, weight in value.bits.items() if int(weight) & int(constant)})
    kept = {bit: weight / 2 ** int(constant) for bit, weight in value.bits.items()}
    return Sum(Fraction(0), {bit: weight for bit, weight in kept.items() if weight >= 1})
