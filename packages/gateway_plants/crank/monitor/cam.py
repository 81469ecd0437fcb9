"""Which of the two crank revolutions of a working cycle it is: edges of a cam sensor.

An edge whose level and crank angle fit one of the cam's edges, and none 360 degrees apart, tells the
half. An edge that fits none, or that contradicts the half counted on since, is a fault of the correlation of
crank and cam.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from gateway.monitors.contract import report
from gateway_fdi.jit import Record, f8, f8s, i4, i8, kernel, means, u1, u1s
from gateway_plants.crank.monitor.faults import CAM_CORRELATION, CAM_SILENT, Reports

#: Edges that a cam can have in a working cycle.
MOST_EDGES = 32
#: Revolutions without an edge after which the cam sensor is silent.
PATIENCE = 4


class Const(Record):
    """Constants."""

    edges: i4 = means("edges of the cam")
    tells: u1 = means("1: edges are told nearer than half a tooth, so that they tell one from the next")
    tolerance: f8 = means("what an edge's angle may be off", "deg")
    tooth_0: f8 = means("crank angle of tooth 0", "deg")
    angles: Annotated[f8s, MOST_EDGES] = means("crank angle of each edge, 0 to 720", "deg")
    levels: Annotated[u1s, MOST_EDGES] = means("level after each edge")


class State(Record):
    """State."""

    half: i4 = means("half of the working cycle, 0 or 1; -1: not known")
    quiet: i4 = means("revolutions since the last edge")
    misfits: i4 = means("edges in a row that did not fit")
    counter: i8 = means("counter of the cam's last frame; -1: none")
    seen: i8 = means("edges that were judged")


def prepare(
    s: State,
    c: Const,
    edges: tuple[tuple[float, int], ...],
    tolerance_deg: float,
    tooth_0_deg: float,
    teeth: int,
) -> None:
    """Fill state and constants.

    Args:
        s: record of State.
        c: record of Const.
        edges: (crank angle 0..720 [deg], level after it) of each edge.
        tolerance_deg: of an edge's angle [deg]; as much as variable valve timing moves it.
        tooth_0_deg: crank angle of tooth 0 [deg].
        teeth: of the crank's wheel.
    """
    c.tells = tells(edges, tolerance_deg, teeth)
    s.half, s.counter = -1, -1
    c.edges, c.tolerance, c.tooth_0 = len(edges), tolerance_deg, tooth_0_deg
    c.angles[: len(edges)] = [angle for angle, _ in edges]
    c.levels[: len(edges)] = [level for _, level in edges]


def tells(edges: tuple[tuple[float, int], ...], tolerance_deg: float, teeth: int) -> bool:
    """Return whether the edges of a cam can tell one tooth of a wheel of equal pitches from the next."""
    return bool(edges) and tolerance_deg < 180.0 / teeth


@kernel
def _off(a: float, b: float, period: float) -> float:
    """Return by how much two angles differ, modulo a period, -period/2..period/2."""
    return float((a - b + period / 2) % period - period / 2)


@kernel
def fits(c: Const, angle: float, level: int) -> bool:
    """Tell whether an edge of the cam is at a crank angle [deg], tooth 0 at zero, in either half of the cycle.

    Args:
        c: record of Const.
        angle: of the edge.
        level: after it.
    """
    for k in range(c.edges):
        if c.levels[k] == level and abs(_off(angle, (c.angles[k] - c.tooth_0) % 720.0, 360.0)) <= c.tolerance:
            return True
    return False


@kernel
def fits_cycle(c: Const, angle: float, level: int, slack: float) -> bool:
    """Return whether an edge of the cam is at an angle of the cycle [deg], tooth 0 at zero.

    Args:
        c: record of Const.
        angle: of the edge, modulo 720.
        level: after it.
        slack: by which it may be farther off than the tolerance [deg].
    """
    for k in range(c.edges):
        if c.levels[k] == level and abs(_off(angle, c.angles[k] - c.tooth_0, 720.0)) <= c.tolerance + slack:
            return True
    return False


@kernel
def edge(s: State, c: Const, angle: float, ahead: int, level: int, slack: float, out: Reports) -> None:
    """Take an edge.

    Args:
        s: record of State.
        c: record of Const.
        angle: crank angle of the edge within its revolution, tooth 0 at zero [deg].
        ahead: revolutions from the present one to that of the edge (-1, 0, 1).
        level: after the edge.
        slack: by which it may be farther off than the tolerance [deg].
        out: record of Out.
    """
    s.quiet = 0
    s.seen += 1
    nearest, found, half = 360.0, 0, -1
    for k in range(c.edges):
        if c.levels[k] != level:
            continue
        # Halves begin at tooth 0, whose angle the cycle is shifted by.
        place = (c.angles[k] - c.tooth_0) % 720.0
        off = _off(angle, place, 360.0)
        nearest = off if abs(off) < abs(nearest) else nearest
        if abs(off) <= c.tolerance + slack:
            found += 1
            # An edge just before tooth 0 may be counted to the revolution behind it.
            turn = int(np.rint((place + off - angle) / 360.0))
            half = turn % 2
    report(out, CAM_SILENT, False, 0.0, PATIENCE)
    if found == 1:
        now = (half - ahead) % 2
        wrong = s.half >= 0 and s.half != now
        _tell(out, wrong, nearest, c.tolerance, angle, level)
        s.misfits = s.misfits + 1 if wrong else 0
        s.half = now
    elif found == 0:
        s.misfits += 1
        _tell(out, True, nearest, c.tolerance, angle, level)


@kernel
def _tell(out: Reports, wrong: bool, off: float, tolerance: float, angle: float, level: int) -> None:
    e = report(out, CAM_CORRELATION, wrong, off, tolerance).cam_correlation
    e.angle, e.off, e.level = angle, off, level


@kernel
def turned(s: State, out: Reports, turns: int) -> None:
    """Count revolutions of the crank."""
    if turns == 0:
        return
    if s.half >= 0:
        s.half = (s.half + turns) % 2
    s.quiet += turns
    if s.quiet >= PATIENCE:
        report(out, CAM_SILENT, True, s.quiet, PATIENCE).cam_silent.revolutions = s.quiet
        s.quiet = 0


@kernel
def forget(s: State) -> None:
    """The crank lost its place: the half is not known any more."""
    s.half = -1
    s.quiet = 0
    s.misfits = 0
