"""Values of an expression of other signals: the same texts and the same machine as those of the monitor ``rule``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_checks.rule.machine import Code, Machine, load, run
from gateway_checks.rule.program import Program
from gateway_fdi.jit import kernel


@kernel
def run_each(s: Any, c: Any, times: Any, columns: Any, values: Any) -> None:
    """Run a program at some times.

    Args:
        s: record of Machine.
        c: record of Code.
        times: int64, shape (n,) [ns].
        columns: of the signals, float64, shape (n, signals).
        values: its results, float64, shape (n,); NaN where it has no value yet.
    """
    for k in range(times.shape[0]):
        values[k] = run(s, c, times[k], columns[k], 0.0)


def evaluated(
    program: Program, times: NDArray[np.float64], columns: Sequence[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return what a program makes of its signals.

    Args:
        program: of an expression.
        times: shape (n,) [s].
        columns: of the program's signals, in its order, each of shape (n,).

    Returns:
        shape (n,); NaN where it has no value (a delay that has not passed, a root of a negative number).
    """
    machine, code = (np.zeros(1, record.dtype) for record in (Machine, Code))
    load(machine[0], code[0], program, program.signals)
    values = np.zeros(len(times))
    table = np.ascontiguousarray(np.column_stack(columns)) if columns else np.zeros((len(times), 1))
    stamps = np.rint(times * 1e9).astype(np.int64)
    run_each(machine.view(np.recarray)[0], code.view(np.recarray)[0], stamps, table, values)
    return values
