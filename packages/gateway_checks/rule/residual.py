"""The signed residual of a relation, and how it depends on errors of its signals: derivatives of its program.

``left == right`` has the residual left - right, ``abs(e) < limit`` has e: of other relations it is known only whether
they hold. Derivatives are carried along with the values (forward differentiation). Functions that a small error does
not represent (``max``, ``floor``, ``rate``, ...) have no derivative: NaN. A low-pass and a delay pass on an error that
stays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from gateway.monitors.contract import EVIDENCE, Blame, Gain, LastResult, Reading
from gateway_checks.rule import program as p
from gateway_checks.rule.machine import one_of, two_of
from gateway_checks.rule.params import PartParams
from gateway_checks.rule.program import Program
from gateway_fdi.diagnosis.system import Floats

#: Standard deviations of a residual without a fault that a tolerance has room for; and more, by a factor up to this,
#: where it was off by less lately: its root of the mean square, times LATELY, for movements may be of another kind now.
SPREADS, SHARPER, LATELY = 3.0, 10.0, 3.0
#: Results behind which that is known.
KNOWN = 100
#: By what share gains are wrong: of a relation that is linear; of others, by which they change with the error.
LINEAR, BENT = 0.05, 0.3
#: How likely a relation fails if a signal of it is wrong, against its own validity: a third of the errors is beyond its
#: tolerance; of a signal that only says how far others may be apart nearly none.
SEES, BESIDE = 1.0 / 3.0, 1e-4


class _Value(NamedTuple):
    """A value with its derivatives by the signals; ``bent``: they depend on the signals."""

    value: float
    slope: Floats
    bent: bool = False


def residual_of(part: PartParams) -> Callable[[LastResult], Reading | None] | None:
    """Return what reads the residual of a relation; None: it has none."""
    program = part.holds
    if len(part.signals) > EVIDENCE or not program.ops:
        return None
    if _compares(program) != [len(program.ops) - 1]:
        return None  # several comparisons, or something made of one
    last = program.ops[-1][0]
    equal, remembers = last == p.EQUAL, any(op in (p.LOWPASS, p.DELAY) for op, _ in program.ops)

    def read(result: LastResult) -> Reading | None:
        values = [result.evidence[part.signals.index(name)] for name in program.signals]
        left, right, inner = _run(program, values)
        off = _two(p.SUBTRACT, left, right) if equal else inner
        if off is None or not result.limit > 0.0:
            return None
        # A relation with memory has its own value, and the sign of the terms without memory, if they are as far off.
        if remembers and abs(abs(off.value) - result.value) > result.limit:
            return None
        signed = math.copysign(result.value, off.value)
        return _reading(part, signed, result.limit, _noise(result), off)

    if not equal and (last not in (p.LESS, p.AT_MOST) or not any(op == p.ABS for op, _ in program.ops)):
        return None
    return read


def _noise(result: LastResult) -> float:
    """Return the standard deviation of a residual: of what it was off lately while the relation held."""
    most = result.limit / SPREADS
    if result.state["held"] < KNOWN:
        return most
    return min(max(LATELY * math.sqrt(result.state["square"]), most / SHARPER), most)


def blames(part: PartParams) -> dict[str, list[Blame]]:
    """Return whom a relation blames: all of its signals, and itself; less what only says how far others may be apart.

    Of ``abs(e) < limit`` and of the condition ``when`` a signal has to be wrong in one direction, and by much. A
    message that freezes is seen by a relation to another message only: its own signals go on to fit each other.
    """
    limits = part.holds.ops[-1][0] in (p.LESS, p.AT_MOST)
    own = _compared(part.holds) if limits else set(part.holds.signals)
    signals = [Blame(name, share=SEES if name in own else BESIDE) for name in part.signals]
    apart = len({name.rpartition(".")[0] for name in own}) > 1
    frozen = [Blame(name, "frozen", SEES) for name in part.signals if name in own and apart]
    return {part.rule.name: [*signals, *frozen, Blame(part.rule.name, "model")]}


def _compared(program: Program) -> set[str]:
    """Return the signals inside ``abs`` on the left of a program's one comparison; all, where there is none."""
    if _compares(program) != [len(program.ops) - 1]:
        return set(program.signals)
    inner = _run(program, [1.0 + 0.1 * k for k in range(len(program.signals))])[2]
    if inner is None:
        return set(program.signals)
    return {name for name, slope in zip(program.signals, inner.slope.tolist(), strict=True) if slope != 0.0}


def _compares(program: Program) -> list[int]:
    return [k for k, (op, _) in enumerate(program.ops) if p.LESS <= op <= p.UNEQUAL]


def _reading(part: PartParams, residual: float, limit: float, noise: float, off: _Value) -> Reading | None:
    named = zip(part.holds.signals, off.slope.tolist(), strict=True)
    gains = tuple(Gain(name, gain) for name, gain in named if math.isfinite(gain) and gain != 0.0)
    if not gains or not math.isfinite(residual):
        return None
    return Reading(residual, noise, gains, BENT if off.bent else LINEAR, abs(residual) / limit)


def _run(program: Program, values: Sequence[float]) -> tuple[_Value, _Value, _Value | None]:
    """Return both sides of a program's one comparison, and the argument of ``abs`` where that is its left side."""
    count = len(values)
    stack: list[_Value] = []
    inner: dict[int, _Value] = {}  # place in the stack -> argument of abs that stands there
    for op, at in program.ops[:-1]:
        if op == p.NUMBER:
            stack.append(_Value(program.numbers[at], np.zeros(count)))
        elif op == p.SIGNAL:
            stack.append(_Value(values[at], np.eye(count)[at]))
        elif op in (p.LOWPASS, p.DELAY):
            continue
        elif op in _ONE:
            x = stack.pop()
            stack.append(_one(op, x))
            if op == p.ABS:
                inner[len(stack) - 1] = x
                continue
        else:
            y, x = stack.pop(), stack.pop()
            stack.append(_two(op, x, y))
        inner.pop(len(stack) - 1, None)
    left, right = stack
    return left, right, inner.get(0)


_ONE = (p.NEGATE, p.NOT, p.ABS, p.SQRT, p.SIN, p.COS, p.TAN, p.EXP, p.LOG, p.SIGN, p.FLOOR, p.RATE)


def _unknown(slope: Floats) -> Floats:
    """Return slopes of which only is known where they are 0."""
    return np.where(slope == 0.0, 0.0, np.nan)


def _one(op: int, x: _Value) -> _Value:
    if op == p.NEGATE:
        return _Value(-x.value, -x.slope, x.bent)
    value = math.nan if op == p.RATE else float(one_of(op, x.value))
    slopes: dict[int, Callable[[float], float]] = {
        p.SQRT: lambda v: 0.5 / math.sqrt(v) if v > 0.0 else math.nan,
        p.SIN: math.cos, p.COS: lambda v: -math.sin(v), p.TAN: lambda v: 1.0 + math.tan(v) ** 2,
        p.EXP: lambda v: math.exp(min(v, 700.0)), p.LOG: lambda v: 1.0 / v if v > 0.0 else math.nan,
    }  # fmt: skip
    if op not in slopes or not math.isfinite(x.value):
        return _Value(value, _unknown(x.slope), True)
    return _Value(value, np.where(x.slope == 0.0, 0.0, slopes[op](x.value) * x.slope), True)


def _two(op: int, x: _Value, y: _Value) -> _Value:
    value, bent = float(two_of(op, x.value, y.value)), x.bent or y.bent
    if op == p.ADD:
        return _Value(value, x.slope + y.slope, bent)
    if op == p.SUBTRACT:
        return _Value(value, x.slope - y.slope, bent)
    both = bool(x.slope.any() and y.slope.any())
    if op == p.MULTIPLY:
        return _Value(value, x.slope * y.value + x.value * y.slope, bent or both)
    if op == p.DIVIDE and y.value != 0.0:
        return _Value(value, (x.slope - value * y.slope) / y.value, bent or bool(y.slope.any()))
    if op == p.POWER and not y.slope.any() and x.value > 0.0:
        return _Value(value, y.value * x.value ** (y.value - 1.0) * x.slope, True)
    return _Value(value, _unknown(x.slope) + _unknown(y.slope), True)
