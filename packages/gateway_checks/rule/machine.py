"""The stack machine that evaluates rules: compiled once for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, cos, exp, floor, isnan, log, nan, sin, sqrt, tan
from typing import Annotated, Any

import numpy as np

from gateway_checks.rule.program import (
    ABS,
    ADD,
    AND,
    AT_LEAST,
    AT_MOST,
    COS,
    DELAY,
    DIVIDE,
    EQUAL,
    EXP,
    LESS,
    LOG,
    LOWPASS,
    MAX,
    MIN,
    MODULO,
    MORE,
    MOST_DELAYED,
    MOST_MEMORIES,
    MOST_NUMBERS,
    MOST_OPS,
    MOST_STACK,
    MULTIPLY,
    NEGATE,
    NOT,
    NUMBER,
    OR,
    RATE,
    SIGN,
    SIGNAL,
    SIN,
    SQRT,
    SUBTRACT,
    TAN,
    UNEQUAL,
    Program,
)
from gateway_fdi.jit import Record, f8, f8s, i4s, i8, i8s, kernel, means


class Code(Record):
    """A program."""

    length: i8 = means("its operations")
    op: Annotated[i4s, MOST_OPS] = means("operations")
    argument: Annotated[i4s, MOST_OPS] = means("their arguments: a number's, an input's or a memory's place")
    number: Annotated[f8s, MOST_NUMBERS] = means("numbers of the program")
    seconds: Annotated[f8s, MOST_MEMORIES] = means("of each memory: delay or time constant", "s")


class Memory(Record):
    """Memories of rate, delay and lowpass."""

    samples: i8 = means("values so far")
    value: f8 = means("last value")
    result: f8 = means("what is made of them")
    since_ns: i8 = means(unit="ns")
    apart_ns: i8 = means("between the last two changes", "ns")
    at: i8 = means("place of the newest delayed sample")
    times: Annotated[i8s, MOST_DELAYED] = means(unit="ns")
    values: Annotated[f8s, MOST_DELAYED] = means("delayed values")


class Machine(Record):
    """Stack, memories, and the two sides of the last comparison."""

    stack: Annotated[f8s, MOST_STACK] = means("the stack")
    memory: Annotated[list[Memory], MOST_MEMORIES] = means("memories")
    left: f8 = means("left side of the last comparison")
    right: f8 = means("right side of the last comparison")
    unknown: i8 = means("1: something compared has no value yet")


@kernel
def rate(m: Memory, t_ns: int, x: float) -> float:
    """Return the change per second: of the last change, 0 when it stays away for twice as long as the one before.

    Signals are held between their frames, so that a rule steps more often than a signal comes.
    """
    if m.samples == 0:
        m.samples, m.value, m.result, m.since_ns = 1, x, nan, t_ns
    elif x != m.value and t_ns > m.since_ns:
        m.apart_ns = t_ns - m.since_ns
        m.result = (x - m.value) / (m.apart_ns * 1e-9)
        m.samples, m.value, m.since_ns = 2, x, t_ns
    elif (m.samples == 2 and t_ns - m.since_ns > 2 * m.apart_ns) or (
        m.samples == 1 and t_ns - m.since_ns > 1_000_000_000
    ):
        m.result = 0.0
    return m.result


@kernel
def lowpass(m: Memory, t_ns: int, x: float, seconds: float) -> float:
    """Return a first-order low-pass of the held value."""
    if m.samples == 0 or isnan(m.result):
        m.samples, m.result = 1, x
    else:
        m.result += (1.0 - exp(-(t_ns - m.since_ns) * 1e-9 / seconds)) * (m.value - m.result)
    m.value, m.since_ns = x, t_ns
    return m.result


@kernel
def delayed(m: Memory, t_ns: int, x: float, seconds: float) -> float:
    """Return what a value was some time ago, to a hundredth of it; NaN until that is known."""
    if m.samples == 0 or t_ns - m.times[m.at] >= seconds * 1e7:
        m.at = (m.at + 1) % MOST_DELAYED
        m.times[m.at], m.values[m.at] = t_ns, x
        m.samples = min(m.samples + 1, MOST_DELAYED)
    wanted = t_ns - np.int64(seconds * 1e9)
    for k in range(m.samples):
        place = (m.at - k) % MOST_DELAYED
        if m.times[place] <= wanted:
            return float(m.values[place])
    return nan


@kernel
def one_of(op: int, x: float) -> float:
    """Return a function of one value; NaN outside of where it is defined."""
    if op == NEGATE:
        return -x
    if op == ABS:
        return abs(x)
    if op == NOT:
        return 1.0 if x == 0.0 else 0.0
    if op == SQRT:
        return sqrt(x) if x >= 0.0 else nan
    if op == LOG:
        return log(x) if x > 0.0 else nan
    if op == EXP:
        return exp(min(x, 700.0))
    if op == SIN:
        return sin(x)
    if op == COS:
        return cos(x)
    if op == TAN:
        return tan(x)
    if op == SIGN:
        return 1.0 if x > 0.0 else -1.0 if x < 0.0 else 0.0
    return float(floor(x)) if abs(x) < 9e15 else x


@kernel
def two_of(op: int, x: float, y: float) -> float:
    """Return a function of two values; NaN outside of where it is defined."""
    if op == ADD:
        return x + y
    if op == SUBTRACT:
        return x - y
    if op == MULTIPLY:
        return x * y
    if op == DIVIDE:
        return x / y if y != 0.0 else nan
    if op == MODULO:
        return x - y * floor(x / y) if y != 0.0 and abs(x / y) < 9e15 else nan
    if op == MIN:
        return nan if isnan(x) or isnan(y) else min(x, y)
    if op == MAX:
        return nan if isnan(x) or isnan(y) else max(x, y)
    if op == AND:
        return 1.0 if x != 0.0 and y != 0.0 else 0.0
    if op == OR:
        return 1.0 if x != 0.0 or y != 0.0 else 0.0
    return power(x, y)


@kernel
def power(x: float, y: float) -> float:
    """Return x to the y; NaN where it has no real value."""
    if x == 0.0:
        return nan if y < 0.0 else 1.0 if y == 0.0 else 0.0
    size = y * log(abs(x))
    if size > 700.0 or (x < 0.0 and y != floor(y)):
        return nan
    return exp(size) if x > 0.0 or ceil(y / 2.0) == y / 2.0 else -exp(size)


@kernel
def compare(s: Machine, op: int, x: float, y: float, tolerance: float) -> float:
    """Return 1 if a comparison holds, within the tolerance; remembers both sides.

    That is the left side, and its limit by the right side; of an equality the distance, and the tolerance: the ratio
    says how near to its limit it is.
    """
    s.left, s.right = x, y
    if isnan(x) or isnan(y):
        s.unknown = 1
        return 0.0
    holds = False
    if op == LESS:
        s.right = y + tolerance
        holds = x < s.right
    elif op == AT_MOST:
        s.right = y + tolerance
        holds = x <= s.right
    elif op == MORE:
        s.right = y - tolerance
        holds = x > s.right
    elif op == AT_LEAST:
        s.right = y - tolerance
        holds = x >= s.right
    else:
        s.left, s.right = abs(x - y), tolerance
        holds = s.left <= tolerance if op == EQUAL else s.left > tolerance
    return 1.0 if holds else 0.0


@kernel
def run(s: Machine, c: Code, t_ns: int, values: Any, tolerance: float) -> float:
    """Run a program; returns what it leaves, and ``unknown`` 1 where that means nothing yet.

    Args:
        s: the machine.
        c: the program.
        t_ns: time of the step.
        values: of the signals, float64.
        tolerance: of its comparisons.
    """
    s.unknown = 0
    top = -1
    for k in range(c.length):
        op, at = c.op[k], c.argument[k]
        if op == NUMBER:
            top += 1
            s.stack[top] = c.number[at]
        elif op == SIGNAL:
            top += 1
            s.stack[top] = values[at]
        elif op == RATE:
            s.stack[top] = rate(s.memory[at], t_ns, s.stack[top])
        elif op == DELAY:
            s.stack[top] = delayed(s.memory[at], t_ns, s.stack[top], c.seconds[at])
        elif op == LOWPASS:
            s.stack[top] = lowpass(s.memory[at], t_ns, s.stack[top], c.seconds[at])
        elif op >= SQRT or op in (NEGATE, NOT, ABS):
            s.stack[top] = one_of(op, s.stack[top])
        elif LESS <= op <= UNEQUAL:
            top -= 1
            s.stack[top] = compare(s, op, s.stack[top], s.stack[top + 1], tolerance)
        else:
            top -= 1
            s.stack[top] = two_of(op, s.stack[top], s.stack[top + 1])
    return float(s.stack[0])


def load(s: Any, c: Any, program: Program, signals: Sequence[str]) -> None:
    """Make a machine ready to run a program.

    Args:
        s: record of :class:`Machine`.
        c: record of :class:`Code`.
        program: that it is to run.
        signals: names of the values that it will be given, in their order.
    """
    c["length"] = len(program.ops)
    for k, (op, argument) in enumerate(program.ops):
        c["op"][k] = op
        c["argument"][k] = signals.index(program.signals[argument]) if op == SIGNAL else argument
    c["number"][: len(program.numbers)] = program.numbers
    c["seconds"][: len(program.times_s)] = program.times_s
    s["memory"]["result"] = np.nan
