"""Answers into values, as the engine has them: through the bus of the answers, and its decoder."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import joined
from gateway.signals.payloads import decode_columns, message_rows
from gateway.signals.tables import compile_plan
from gateway_ask.answers.answer_frames import framed
from gateway_ask.answers.model import AnswerLayout, Limits
from gateway_ask.answers.pages import BYTES, answer_bus


class Values(NamedTuple):
    """Signals of answers to one request.

    Attributes:
        names: of the signals.
        values: physical values, shape (signals, answers); any number where there is none.
        there: whether an answer has them, shape (signals, answers).
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    there: NDArray[np.bool_]


class AnswerDecoder:
    """Decodes the answers of one layout."""

    def __init__(self, layout: AnswerLayout) -> None:
        key = (layout.service, layout.identifier)
        bus = answer_bus([("", {key: layout})])
        self._pages = bus.pages[0][key]
        self._plan = compile_plan([(0, bus.database)])
        self._limits = layout.limits
        # By page: places of its signals among those of the plan's message.
        self._places: dict[int, list[tuple[str, int]]] = {}
        for ref in self._plan.slot_names:
            if not ref.signal.startswith(BYTES):
                place = ref.signal, self._plan.position(*ref)
                self._places.setdefault(self._plan.message(ref.bus, ref.message), []).append(place)
        self.names = tuple(name for row in sorted(self._places) for name, _ in self._places[row])

    def decode(self, answers: Sequence[bytes], *, void: bool = False) -> Values:
        """Return the values of answers; of one that is shorter than the layout, those of the signals that fit.

        Args:
            answers: data after service and identifier.
            void: also values that the file calls none (:class:`~gateway_ask.answers.model.Limits`).
        """
        values = np.zeros((len(self.names), len(answers)))
        there = np.zeros(values.shape, np.bool_)
        # The stamp of a page is the number of its answer.
        frames = joined([framed(answer, self._pages, k, 0) for k, answer in enumerate(answers)])
        rows, at = message_rows(frames, self._plan), 0
        for row, places in sorted(self._places.items()):
            mine = frames[rows == row]
            found, these = decode_columns(mine, self._plan, row), slice(at, at + len(places))
            order = [place for _, place in places]
            values[these, mine["t_ns"]] = found.values[order]
            there[these, mine["t_ns"]] = found.there[order]
            at += len(places)
        there &= np.isfinite(values)
        if not void:
            for k, name in enumerate(self.names):
                there[k] &= ~_void(values[k], self._limits.get(name, Limits()))
        return Values(self.names, values, there)


def _void(values: NDArray[np.float64], limits: Limits) -> NDArray[np.bool_]:
    """Return which values are none, shape (answers,)."""
    low = -np.inf if limits.void_low is None else limits.void_low
    high = np.inf if limits.void_high is None else limits.void_high
    return (values <= low) | (values >= high)
