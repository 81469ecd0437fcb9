"""A program of the stack machine, and the words that texts have for its operations."""

from __future__ import annotations

from dataclasses import dataclass, field

#: Room of one rule: operations, numbers, signals, functions with a memory, samples that a delay remembers.
MOST_OPS, MOST_NUMBERS, MOST_SIGNALS, MOST_MEMORIES, MOST_DELAYED = 96, 32, 16, 6, 128
MOST_STACK = 16

(
    NUMBER, SIGNAL, ADD, SUBTRACT, MULTIPLY, DIVIDE, POWER, MODULO, NEGATE,
    LESS, AT_MOST, MORE, AT_LEAST, EQUAL, UNEQUAL, AND, OR, NOT,
    ABS, MIN, MAX, SQRT, SIN, COS, TAN, EXP, LOG, SIGN, FLOOR, RATE, DELAY, LOWPASS,
) = range(32)  # fmt: skip

#: Function -> operation, its arguments.
FUNCTIONS = {
    "abs": (ABS, 1), "min": (MIN, 2), "max": (MAX, 2), "sqrt": (SQRT, 1),
    "sin": (SIN, 1), "cos": (COS, 1), "tan": (TAN, 1), "exp": (EXP, 1), "log": (LOG, 1),
    "sign": (SIGN, 1), "floor": (FLOOR, 1), "rate": (RATE, 1), "delay": (DELAY, 2), "lowpass": (LOWPASS, 2),
}  # fmt: skip


@dataclass
class Program:
    """The program that a text becomes.

    Attributes:
        ops: operation and its argument (place of a number, a signal or a memory), in postfix order.
        numbers: literals.
        signals: names, as the text has them.
        times_s: of each function with a memory: delay or time constant [s].
        depth: of the stack.
    """

    ops: list[tuple[int, int]] = field(default_factory=list)
    numbers: list[float] = field(default_factory=list)
    signals: list[str] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    depth: int = 0
