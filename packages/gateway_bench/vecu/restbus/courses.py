"""How a signal's value goes over time: as the scenario has it, and its values."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.errors import InputError, named

Values = NDArray[np.float64]
Number = Annotated[float, Field(allow_inf_nan=False)]
#: Breakpoints [time s, value].
Points = tuple[tuple[Number, Number], ...]


def rising(name: str, points: Points) -> None:
    """Refuse breakpoints that are none.

    Raises:
        ValueError: there is none, or their times do not rise.
    """
    if not points:
        raise ValueError(f"{name}: at least one breakpoint")
    if any(b[0] <= a[0] for a, b in pairwise(points)):
        raise ValueError(f"{name}: the times of the breakpoints must rise")


class Sine(StrictModel):
    """A sine."""

    mean: Number = 0.0
    amplitude: Number = Field(description="signal's unit")
    period_s: Number = Field(gt=0, description="[s]")
    phase_deg: Number = Field(0.0, description="at time 0 [deg]")


class Ramp(StrictModel):
    """A straight line from one value to another, which then stays, or starts again."""

    start: Number = Field(description="value before and at its beginning")
    end: Number = Field(description="value at its end")
    in_s: Number = Field(gt=0, description="how long it takes [s]")
    at_s: Number = Field(0.0, ge=0, description="when it begins [s]")
    repeat: bool = Field(False, description="start again at each end: a saw")


class Csv(StrictModel):
    """Two columns of a file of comma-separated values with a line of names."""

    file: Path = Field(description="relative to the scenario")
    time: str = Field("time", description="name of the column of times, which rise [s]")
    value: str = Field(description="name of the column of values, signal's unit")
    hold: bool = Field(False, description="a value stays until the next one; else: straight lines in between")
    repeat: bool = Field(False, description="start again at the end; else the last value stays")


class Log(StrictModel):
    """A signal of a recorded log, from its first frame on."""

    file: Path = Field(description="relative to the scenario; any log that gateway replay reads")
    signal: str | None = Field(None, description='"Message.Signal" in the log; default: the signal itself')
    channel: str | None = Field(None, description="interface or channel in the log; default: any")
    from_s: Number = Field(0.0, ge=0, description="where in the log it begins [s]")
    hold: bool = Field(True, description="a value stays until the next frame; else: straight lines in between")
    repeat: bool = Field(False, description="start again at the end; else the last value stays")


class Course(StrictModel):
    """One of the keys but noise, and noise beside it."""

    value: Number | None = Field(None, description="a constant")
    text: str | None = Field(None, description="a constant, by its text in the database")
    points: Points | None = Field(None, description="[[time s, value], ...], straight lines in between")
    steps: Points | None = Field(None, description="[[time s, value], ...], each value until the next one")
    turns: tuple[Number, ...] | None = Field(None, min_length=1, description="values in turn, one a frame")
    ramp: Ramp | None = None
    sine: Sine | None = None
    csv: Csv | None = None
    log: Log | None = None
    expression: str | None = Field(None, min_length=1, description="of other signals: their values without faults")
    noise: Number = Field(0.0, ge=0, description="standard deviation, signal's unit")

    @model_validator(mode="after")
    def _one(self) -> Self:
        given = sorted(name for name in self.model_fields_set - {"noise"} if getattr(self, name) is not None)
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)}: a signal has one course")
        if not given and "noise" not in self.model_fields_set:
            known = ", ".join(name for name in type(self).model_fields if name != "noise")
            raise ValueError(f"a course is one of {known}")
        for name in ("points", "steps"):
            points = getattr(self, name)
            if points is not None:
                rising(name, points)
        return self


#: A number: a constant; a list: points; a text: an expression.
Short = Number | Points | str | Course


def course_of(given: Short) -> Course:
    """Return a course that may be written short."""
    if isinstance(given, Course):
        return given
    if isinstance(given, str):
        return Course(expression=given)
    return Course(points=given) if isinstance(given, tuple) else Course(value=given)


def values_of(course: Course, times: Values) -> Values | None:
    """Return a course's values at some times [s], without noise; None: it has no course of its own, only noise.

    Raises:
        InputError: a CSV file that cannot be read.
    """
    n = len(times)
    if course.value is not None:
        return np.full(n, course.value)
    if course.points is not None:
        points = np.asarray(course.points)
        return np.asarray(np.interp(times, points[:, 0], points[:, 1]), np.float64)
    if course.steps is not None:
        return _held(np.asarray(course.steps), times)
    if course.turns is not None:
        return np.resize(np.asarray(course.turns, np.float64), n)
    if course.ramp is not None:
        ramp = course.ramp
        share = np.maximum((times - ramp.at_s) / ramp.in_s, 0.0)
        share = share % 1.0 if ramp.repeat else np.minimum(share, 1.0)
        return np.asarray(ramp.start + share * (ramp.end - ramp.start), np.float64)
    if course.sine is not None:
        sine = course.sine
        angle = 2.0 * np.pi * times / sine.period_s + np.radians(sine.phase_deg)
        return np.asarray(sine.mean + sine.amplitude * np.sin(angle), np.float64)
    if course.csv is not None:
        return _of_csv(course.csv, times)
    return None


def _held(points: Values, times: Values) -> Values:
    """Return values that stay until the next one; before the first one it is the first one."""
    place = np.searchsorted(points[:, 0], times, side="right") - 1
    return np.asarray(points[np.maximum(place, 0), 1], np.float64)


def _of_csv(course: Csv, times: Values) -> Values:
    return resampled(read_csv(course), times, hold=course.hold, repeat=course.repeat)


def resampled(points: Values, times: Values, *, hold: bool, repeat: bool) -> Values:
    """Return values at other times.

    Args:
        points: time [s], value, shape (n, 2), n > 0; times rise.
        times: at which the values are asked for [s].
        hold: a value stays until the next one; else: straight lines in between.
        repeat: start again at the end; else the last value stays.
    """
    if repeat and len(points) > 1:
        first, last = points[0, 0], points[-1, 0]
        times = first + (times - first) % (last - first)
    if hold:
        return _held(points, times)
    return np.asarray(np.interp(times, points[:, 0], points[:, 1]), np.float64)


def read_csv(course: Csv) -> Values:
    """Read times and values of a CSV file, shape (rows, 2).

    Raises:
        InputError: no such file or column, no numbers, times that do not rise; names the line.
    """
    file = course.file
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.reader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(getattr(error, "strerror", None) or str(error), key="csv.file", value=str(file)) from error
    header = [name.strip() for name in rows[0]] if rows else []
    places = []
    for key, name in (("time", course.time), ("value", course.value)):
        if name not in header:
            raise InputError(named(f"no such column in {file}; it has", name, header), key=f"csv.{key}", value=name)
        places.append(header.index(name))
    points = [_numbers(row, places, file, line) for line, row in enumerate(rows[1:], 2) if row]
    if not points:
        raise InputError("the file has no rows", file=file)
    for line, (before, after) in enumerate(pairwise(points), 3):
        if after[0] <= before[0]:
            raise InputError("the times must rise", file=file, line=line, value=after[0])
    return np.asarray(points, np.float64)


def _numbers(row: Sequence[str], places: Sequence[int], file: Path, line: int) -> tuple[float, ...]:
    try:
        found = tuple(float(row[place]) for place in places)
    except (ValueError, IndexError) as error:
        raise InputError("two numbers are wanted in this row", file=file, line=line, value=",".join(row)) from error
    if not np.isfinite(found).all():
        raise InputError("two numbers are wanted in this row", file=file, line=line, value=",".join(row))
    return found
