"""The trigger wheel in a log: the intervals of tooth frames (dbc/crank/crank.dbc), and the wheel that they show."""

from __future__ import annotations

from functools import cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gateway_plants.crank.tooth_codec import OVERFLOW_CODE, PADDING_CODE, period_us
from gateway_plants.crank.wheel_report import Watch, told

#: Messages that carry intervals: intervals of a frame, and the signals that are needed.
CLASSIC, FD = "CTW_PT4", "CTW_FD27"
_INTERVALS = {CLASSIC: 4, FD: 27}
_OTHERS = {CLASSIC: ("FrameCnt",), FD: ("PulseCnt", "NValid", "Shift")}
#: A place where pulses are not known, and an interval that is none [us].
_BREAK, _NONE = 0.0, np.nan


@cache
def _periods() -> NDArray[np.float64]:
    """Return the interval of each 12-bit code [us], shape (4096,)."""
    plain = cast(Any, period_us).py_func  # a kernel of one code is not worth a call, 4096 times
    periods = np.array([float(plain(code)) for code in range(4096)])
    periods[PADDING_CODE], periods[OVERFLOW_CODE] = _NONE, _BREAK
    return periods


class Teeth:
    """The intervals of one message of tooth frames.

    Args:
        message: its name, ``CTW_PT4`` or ``CTW_FD27``.
        signals: of the message, in the order of the columns.
    """

    topic = "wheels"

    def __init__(self, message: str, signals: list[str]) -> None:
        self._message = message
        self._pulses = [signals.index(f"Pt{k}") for k in range(_INTERVALS[message])]
        self._others = [signals.index(name) for name in _OTHERS[message]]
        self._watch = Watch()
        self._next = -1

    @classmethod
    def of(cls, message: str, signals: list[str]) -> Teeth | None:
        """Return one for a message, if that carries intervals."""
        if message not in _INTERVALS:
            return None
        wanted = {f"Pt{k}" for k in range(_INTERVALS[message])} | set(_OTHERS[message])
        return cls(message, signals) if wanted <= set(signals) else None

    def begin(self) -> None:
        """Begin another log."""
        self._next = -1

    def add(self, values: NDArray[np.float64]) -> None:
        """Take frames.

        Args:
            values: of its signals, shape (frames, signals); NaN in frames that cannot be decoded.
        """
        values = values[~np.isnan(values[:, self._others]).any(axis=1)]
        if not len(values):
            return
        pulses, others = values[:, self._pulses], values[:, self._others].T.astype(np.int64)
        if self._message == CLASSIC:
            intervals = _periods()[np.nan_to_num(pulses).astype(np.int64) & 0xFFF]
            first, following, modulus = others[0], others[0] + 1, 256
        else:
            valid = np.arange(pulses.shape[1])[None, :] < others[1][:, None]
            intervals = np.where(valid, pulses * (1 << np.clip(others[2], 0, 7))[:, None], _NONE)
            first, following, modulus = others[0], others[0] + others[1], 65536
        expected = np.concatenate([[self._next], following[:-1] % modulus])
        self._next = int(following[-1] % modulus)
        breaks = np.where(first == expected, _NONE, _BREAK)
        train = np.concatenate([breaks[:, None], intervals], axis=1).ravel()
        self._watch.add(train[~np.isnan(train)])

    def told(self) -> str:
        """Return the wheel that it saw, for people."""
        return f"wheel seen: {told(self._watch.result)}"
