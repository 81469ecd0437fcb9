"""The values of all signals of a rest bus, at any time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gateway.signals.database import Database
from gateway_bench.vecu.restbus.courses import Course, Short, course_of, resampled, values_of
from gateway_bench.vecu.restbus.expression import evaluated
from gateway_bench.vecu.restbus.recording import points_of
from gateway_checks.rule.program import Program
from gateway_checks.rule.text import compile_text
from gateway_fdi.common.tomlfile import key_path
from gateway_fdi.errors import InputError, named, under

if TYPE_CHECKING:
    from cantools.database.can.signal import Signal

Values = NDArray[np.float64]


def start_value(signal: Signal) -> float:
    """Return a signal's start value in its database, or what its range has nearest to 0."""
    if signal.raw_initial is not None:
        return float(signal.raw_initial * signal.scale + signal.offset)
    low = -np.inf if signal.minimum is None else float(signal.minimum)
    high = np.inf if signal.maximum is None else float(signal.maximum)
    return float(min(max(0.0, low), high)) if low <= high else 0.0


class Courses:
    """Courses of signals, and values by the database for those that have none.

    Args:
        given: "Message.Signal" -> course.
        database: of the bus.
        sent: names of the messages that are sent.

    Raises:
        InputError: a signal that is not there or not sent, an expression that is none.
    """

    def __init__(self, given: Mapping[str, Short], database: Database, sent: Mapping[str, object]) -> None:
        self._database = database
        self._courses: dict[str, Course] = {}
        self._programs: dict[str, Program] = {}
        for name, short in given.items():
            key = key_path(("signals", name))
            with under(key, name, whole=False):
                signal = self.signal(name)
                message = name.rpartition(".")[0]
                if message not in sent:
                    raise InputError(named("this message is not sent; sent are", message, sent), value=message)
                course = self._courses[name] = self._numbered(course_of(short), signal)
                if course.log is not None and course.log.signal is not None:
                    self.signal(course.log.signal)
                if course.expression is not None:
                    self._programs[name] = compile_text(course.expression, self._unit)
        for name in self._programs:
            self._without_circle(name, ())

    def signal(self, name: str) -> Signal:
        """Return the signal that "Message.Signal" names.

        Raises:
            InputError: there is none; names close ones.
        """
        message, _, own = name.rpartition(".")
        if not message:
            raise InputError('a signal is named "Message.Signal"', value=name)
        return self._database.signal(message, own)

    def _unit(self, name: str) -> str | None:
        return str(self.signal(name).unit or "") or None

    def _numbered(self, course: Course, signal: Signal) -> Course:
        if course.text is None:
            return course
        choices = dict(signal.choices or {})
        texts = {str(text): float(value * signal.scale + signal.offset) for value, text in choices.items()}
        if course.text not in texts:
            raise InputError(named("its texts are", course.text, texts), key="text", value=course.text)
        return course.model_copy(update={"text": None, "value": texts[course.text]})

    def _without_circle(self, name: str, on_the_way: tuple[str, ...]) -> None:
        if name in on_the_way:
            circle = " -> ".join((*on_the_way[on_the_way.index(name) :], name))
            raise InputError(f"expressions in a circle: {circle}", key=key_path(("signals", name)), value=name)
        program = self._programs.get(name)
        for other in program.signals if program is not None else ():
            self._without_circle(other, (*on_the_way, name))

    def given(self, name: str) -> bool:
        """Whether a signal has a course."""
        return name in self._courses

    def noise(self, name: str) -> float:
        """Return the standard deviation of a signal's noise."""
        return self._courses[name].noise if name in self._courses else 0.0

    def at(self, name: str, times: Values) -> Values:
        """Return a signal's values at some times [s], without noise and faults.

        Raises:
            InputError: a file that cannot be read.
        """
        course, signal = self._courses.get(name), self.signal(name)
        start = start_value(signal)
        if name in self._programs:
            program = self._programs[name]
            values = evaluated(program, times, [self.at(other, times) for other in program.signals])
            return np.where(np.isnan(values), start, values)
        with under(key_path(("signals", name))):
            found = None if course is None else self._found(name, course, times)
        return np.full(len(times), start) if found is None else found

    def _found(self, name: str, course: Course, times: Values) -> Values | None:
        if course.log is None:
            return values_of(course, times)
        log = course.log
        return resampled(points_of(log, name, self._database), times, hold=log.hold, repeat=log.repeat)
