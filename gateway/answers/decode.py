"""Answers into values, by the engine's own decoder: also those longer than a frame, or shorter than their layout."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.answers.model import AnswerLayout, bits_needed
from gateway.answers.pages import PAGE, Page, pages
from gateway.bus.frames import EXTENDED, empty, put
from gateway.signals.database import Database
from gateway.signals.decode import OK
from gateway.signals.payloads import decode_columns
from gateway.signals.tables import DecodePlan, compile_plan


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
    """Decodes the answers of one layout.

    Args:
        layout: of the answers.
    """

    def __init__(self, layout: AnswerLayout) -> None:
        self._limits = layout.limits
        self._pages = [(page, _plan(page)) for page in pages(layout)]
        self.names = tuple(ref.signal for _, plan in self._pages for ref in plan.slot_names)
        needed = {name: bits for page, _ in self._pages for name, bits in _needed(page).items()}
        self._needed = np.asarray([needed[name] for name in self.names], np.int64)

    def decode(self, answers: Sequence[bytes], *, void: bool = False) -> Values:
        """Return the values of answers; of one that is shorter than the layout, those of the signals that fit.

        Args:
            answers: data after service and identifier.
            void: also values that the file calls none (:class:`~gateway.answers.model.Limits`).
        """
        parts = [_columns(page, plan, answers) for page, plan in self._pages]
        values = np.concatenate([part[0] for part in parts]) if parts else np.zeros((0, len(answers)))
        there = np.concatenate([part[1] for part in parts]) if parts else np.zeros(values.shape, np.bool_)
        lengths = 8 * np.asarray([len(answer) for answer in answers], np.int64)
        there = there & (self._needed[:, None] <= lengths[None, :]) & np.isfinite(values)
        if not void:
            for k, name in enumerate(self.names):
                limits = self._limits.get(name)
                if limits is not None and limits.void_low is not None:
                    there[k] &= values[k] > limits.void_low
                if limits is not None and limits.void_high is not None:
                    there[k] &= values[k] < limits.void_high
        return Values(self.names, values, there)


def _plan(page: Page) -> DecodePlan:
    """Return the decode plan of a page, which takes answers of any length."""
    plan = compile_plan([(0, Database([(page.message, Path(page.message.name))]))])
    plan.messages["length"] = 0
    return plan


def _needed(page: Page) -> dict[str, int]:
    """Return how many bits of an answer each signal needs, its multiplexers with it."""
    by_name = {signal.name: signal for signal in page.message.signals}
    needed = {}
    for signal in page.message.signals:
        most, other = bits_needed(signal), signal
        while other.multiplexer_signal is not None:
            other = by_name[other.multiplexer_signal]
            most = max(most, bits_needed(other))
        needed[signal.name] = 8 * page.first + most
    return needed


def _columns(page: Page, plan: DecodePlan, answers: Sequence[bytes]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the values of a page, and whether they are there; shape (signals, answers) each, in the plan's order."""
    frames = empty(len(answers))
    can_id = page.message.frame_id | EXTENDED
    for k, answer in enumerate(answers):
        put(frames, k, 0, can_id, answer[page.first : page.first + PAGE])
    found = decode_columns(frames, plan, 0)
    order = [plan.position(ref.bus, ref.message, ref.signal) for ref in plan.slot_names]
    return found.values[order], found.there[order] & (found.results == OK)[None, :]
