"""A budget for a step of algebra: without one, some expressions keep it busy for hours.

It counts calls, not seconds: a model that is solved on one machine is solved on each.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any, TypeVar

import sympy

from gateway_fdi.structure.generator.symbols import Algebra

Found = TypeVar("Found")

#: Calls of functions that a step may take, some seconds. The four tanks with sizes of faults take two thirds of them,
#: of a car of ten equations the largest that ends takes a third.
CALLS = 3_000_000


class _Spent(BaseException):
    """The budget is spent; no ``except Exception`` within the algebra takes it for its own."""


class TooLongError(Exception):
    """A step of algebra takes more than its budget."""


def bounded(work: Callable[[], Found]) -> Found:
    """Return what a step of algebra finds.

    Raises:
        TooLongError: it takes more than :data:`CALLS`.
    """
    left = CALLS

    def count(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise _Spent

    before = sys.gettrace()
    sys.settrace(count)
    try:
        return work()
    except _Spent:
        raise TooLongError from None
    finally:
        sys.settrace(before)


def cancelled(expression: Algebra) -> Algebra:
    """Return an expression without the common factors of its fractions; as it is, where these are not found in time."""
    try:
        return bounded(lambda: sympy.cancel(expression))
    except TooLongError:
        return expression
