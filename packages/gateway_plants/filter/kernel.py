"""Step of a filter, and the tests of its innovations.

    x = F x + B u                P = alpha^2 F P F' + Q
    y = z - H x                  S = H P H' + R,  K = P H' S^-1
    x = x + K y                  P = (I - K H) P (I - K H)' + K R K'

as filterpy's ``KalmanFilter.predict`` and ``update`` have it (Joseph's form). Of measurements that are missing the rows
of z, H and R are left out. A filter that is not linear is stepped by Python, and tested here likewise.

While the model holds the innovations are white, and NIS, y' S^-1 y, is chi-square with one degree of freedom for each
measurement (Bar-Shalom, Li, Kirubarajan 2001, section 5.4). Tests:

nis       the sum of a window's NIS, judged once a window; its limit is exact
bias      each innovation in its standard deviations, by the CUSUM on both sides
fading    the fading mean of NIS, from its mean on
mode      the probability of each mode

CUSUM and fading mean begin again after an alarm. A test that has passed says so at the end of a window.
"""

from __future__ import annotations

from math import inf, isfinite, nan, sqrt
from typing import Annotated

from gateway.monitors import contract
from gateway.monitors.contract import Out, report
from gateway_fdi import stopping
from gateway_fdi.jit import Record, call_entry, f8, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import add, copy, dot, minus, plus

#: Room for states, measurements, inputs and modes; longest window.
MOST, WINDOW = 8, 64
#: Values of evidence.
_INNOVATIONS, _STATES = 3, 4


class Const(Record):
    """Constants; matrices as filterpy calls them."""

    call: i8 = means("address of Python's function, 0: the filter is stepped here")
    states: i8 = means("states")
    measured: i8 = means("measurements")
    inputs: i8 = means("inputs")
    f: Annotated[f8s, MOST, MOST] = means("F")
    b: Annotated[f8s, MOST, MOST] = means("B")
    q: Annotated[f8s, MOST, MOST] = means("Q")
    h: Annotated[f8s, MOST, MOST] = means("H")
    r: Annotated[f8s, MOST, MOST] = means("R")
    x: Annotated[f8s, MOST] = means("x at the beginning")
    p: Annotated[f8s, MOST, MOST] = means("P at the beginning")
    alpha: f8 = means("alpha^2, of filterpy's fading memory")
    missing: f8 = means("samples in a row that may be missing")
    settle: i8 = means("samples after a beginning that are not judged")
    nis: i8 = means("fault of the window, -1: no such test; likewise")
    window: i8 = means("its samples")
    limit: Annotated[f8s, MOST * WINDOW + 1] = means("of the sum of NIS, by its degrees of freedom")
    fading: i8 = means("fault of the fading mean")
    fade: stopping.Const = means("fading mean")
    bias: i8 = means("fault of the first innovation")
    cusum: stopping.Const = means("CUSUM of each")
    modes: i8 = means("modes, 0: it has none")
    mode_limit: f8 = means("probability above which one is a fault")


class State(Record):
    """State."""

    x: Annotated[f8s, MOST] = means("x")
    p: Annotated[f8s, MOST, MOST] = means("P")
    z: Annotated[f8s, MOST] = means("measurements, NaN: missing")
    u: Annotated[f8s, MOST] = means("inputs")
    y: Annotated[f8s, MOST] = means("innovations, NaN: of a missing one")
    variance: Annotated[f8s, MOST] = means("variance of each")
    mode: Annotated[f8s, MOST] = means("probability of each mode")
    nis: f8 = means("normalised innovation squared; NaN: nothing was measured")
    seen: i8 = means("measurements in it")
    lost: i8 = means("samples that are lost before this one")
    anew: i8 = means("1: the filter begins with this sample")
    away: i8 = means("samples in a row without any measurement")
    samples: i8 = means("samples since the beginning")
    begun: i8 = means("times that it began again")
    left_out: i8 = means("samples in which a measurement was missing")
    waits: i8 = means("samples before all inputs had come")
    number: i8 = means("of the function that is called")
    total: f8 = means("sum of NIS in this window")
    degrees: i8 = means("its degrees of freedom")
    count: i8 = means("samples of this window")
    fade: stopping.State = means("fading mean")
    rules: Annotated[list[stopping.State], MOST] = means("CUSUM of each innovation")
    at: Annotated[i8s, MOST] = means("scratch: rows that are measured")
    w: Annotated[f8s, MOST, MOST] = means("scratch")
    v: Annotated[f8s, MOST, MOST] = means("scratch")
    factor: Annotated[f8s, MOST, MOST] = means("scratch: Cholesky's factor of S")
    k: Annotated[f8s, MOST, MOST] = means("scratch: K'")
    hp: Annotated[f8s, MOST, MOST] = means("scratch: H P")
    e: Annotated[f8s, MOST] = means("scratch")


class Inputs(contract.SampledInputs):
    """Inputs of a step."""

    z: Annotated[f8s, MOST] = means("measurements")
    u: Annotated[f8s, MOST] = means("inputs of the plant")


class Evidence(Record):
    """Values that are kept with a result."""

    nis: f8 = means("NIS")
    innovation: Annotated[f8s, _INNOVATIONS] = means("of the first measurements")
    state: Annotated[f8s, _STATES] = means("the first states")


@kernel
def begin(s: State, c: Const) -> None:
    """Begin again; all that was counted stays."""
    copy(s.x, c.x, c.states)
    for i in range(c.states):
        copy(s.p[i], c.p[i], c.states)
    s.samples, s.total, s.degrees, s.count = 0, 0.0, 0, 0
    s.fade.up = c.measured
    for j in range(c.measured):
        stopping.reset(s.rules[j])


@kernel
def predict(s: State, c: Const) -> None:
    """Step x and P to the next sample, with s.u."""
    n = c.states
    for i in range(n):
        value = dot(c.b[i], s.u, c.inputs)
        for j in range(n):
            s.w[j, i] = 0.0
        for k in range(n):
            f = c.f[i, k]
            if f != 0.0:  # most of them are in most filters
                value += f * s.x[k]
                for j in range(n):
                    s.w[j, i] += f * s.p[k, j]
        s.e[i] = value
    copy(s.x, s.e, n)
    for i in range(n):
        copy(s.p[i], c.q[i], i + 1)
        for k in range(n):
            f = c.alpha * c.f[i, k]
            if f != 0.0:
                add(s.p[i], f, s.w[k], i + 1)
        for j in range(i):
            s.p[j, i] = s.p[i, j]


@kernel
def _factor(s: State, m: int) -> None:
    """Make s.factor Cholesky's factor of what its lower half holds, with one over its diagonal."""
    for a in range(m):
        for b in range(a + 1):
            value = minus(s.factor[a, b], s.factor[a], s.factor[b], b)
            if a > b:
                s.factor[a, b] = value * s.factor[b, b]
            elif value > 0.0:
                s.factor[a, a] = 1.0 / sqrt(value)
            else:
                raise ValueError("S = H P H' + R is singular: the filter has diverged, or R is too small")


@kernel
def _project(s: State, c: Const, m: int) -> None:
    """Make s.hp, s.variance, and s.factor the lower half of S, of the rows s.at."""
    n = c.states
    for a in range(m):
        row = s.at[a]
        s.hp[a, :] = 0.0
        for j in range(n):
            h = c.h[row, j]
            if h != 0.0:
                add(s.hp[a], h, s.p[j], n)
        for b in range(a + 1):
            s.factor[a, b] = plus(c.r[row, s.at[b]], c.h[row], s.hp[b], n)
        s.variance[row] = s.factor[a, a]


@kernel
def _gain(s: State, n: int, m: int) -> None:
    """Make s.k, which is K', of s.hp and s.factor."""
    for a in range(m):
        copy(s.k[a], s.hp[a], n)
        for b in range(a):
            add(s.k[a], -s.factor[a, b], s.k[b], n)
        inverse = s.factor[a, a]
        for i in range(n):
            s.k[a, i] *= inverse
    for d in range(m):
        a = m - 1 - d
        for b in range(a + 1, m):
            add(s.k[a], -s.factor[b, a], s.k[b], n)
        inverse = s.factor[a, a]
        for i in range(n):
            s.k[a, i] *= inverse


@kernel
def update(s: State, c: Const) -> None:
    """Correct x and P by the measurements s.z that are there."""
    n, m = c.states, 0
    s.nis = nan
    for j in range(c.measured):
        s.y[j] = nan
        if isfinite(s.z[j]):
            s.y[j] = minus(s.z[j], c.h[j], s.x, n)
            s.at[m] = j
            m += 1
    s.seen = m
    if m == 0:
        return
    _project(s, c, m)
    _factor(s, m)
    _gain(s, n, m)
    s.nis = 0.0
    for a in range(m):
        y = s.y[s.at[a]]
        add(s.x, y, s.k[a], n)
        s.e[a] = minus(y, s.factor[a], s.e, a) * s.factor[a, a]
        s.nis += s.e[a] * s.e[a]
    for i in range(n):
        copy(s.w[i], s.p[i], n)
        for a in range(m):
            add(s.w[i], -s.k[a, i], s.hp[a], n)
    _joseph(s, c, m)


@kernel
def _joseph(s: State, c: Const, m: int) -> None:
    """P = (I - K H) P (I - K H)' + K R K', as P = W + (K R - W H') K' with W = P - K H P."""
    n = c.states
    for a in range(m):
        row = s.at[a]
        s.v[a, :] = 0.0
        for b in range(m):
            r = c.r[row, s.at[b]]
            if r != 0.0:
                add(s.v[a], r, s.k[b], n)
        for j in range(n):
            h = c.h[row, j]
            if h != 0.0:
                for i in range(n):
                    s.v[a, i] -= h * s.w[i, j]
    for i in range(n):
        for j in range(i + 1):
            total = s.w[i, j]
            for a in range(m):
                total += s.v[a, i] * s.k[a, j]
            s.p[i, j] = s.p[j, i] = total


@kernel
def _show(s: State, e: Evidence) -> None:
    e.nis = s.nis
    copy(e.innovation, s.y, _INNOVATIONS)
    copy(e.state, s.x, _STATES)


@kernel
def judge(s: State, c: Const, out: Out[Evidence, Record]) -> None:
    """Test what a sample left; a test that has passed says so once a window."""
    for k in range(1, c.modes):
        _show(s, report(out, k - 1, s.mode[k] > c.mode_limit, s.mode[k], c.mode_limit))
    s.count += 1
    ended = s.count >= c.window
    if c.bias >= 0:
        for j in range(c.measured):
            if isfinite(s.y[j]):
                alarm = stopping.update(s.rules[j], c.cusum, s.y[j] / sqrt(s.variance[j]))
                if alarm or ended:
                    _show(s, report(out, c.bias + j, alarm, s.rules[j].level, c.cusum.threshold))
                if alarm:
                    stopping.reset(s.rules[j])
    if c.fading >= 0:
        # What is missing counts as its mean: no more false alarms than without it.
        alarm = stopping.update(s.fade, c.fade, s.nis + c.measured - s.seen)
        if alarm or ended:
            _show(s, report(out, c.fading, alarm, s.fade.level, c.fade.threshold))
        if alarm:
            s.fade.up = c.measured
    s.total, s.degrees = s.total + s.nis, s.degrees + s.seen
    if ended:
        if c.nis >= 0:
            limit = c.limit[s.degrees]
            _show(s, report(out, c.nis, s.total > limit, s.total, limit))
        s.total, s.degrees, s.count = 0.0, 0, 0


@kernel
def _taken(s: State, c: Const, u: Inputs) -> bool:
    """Take a sample into the state; tells whether all inputs have come so far."""
    s.lost = 0
    if isfinite(u.gap) and u.gap - 1.0 <= c.missing:
        s.lost = int(max(u.gap - 1.0, 0.0))
    elif s.samples > 0:
        s.anew = 1
        s.begun += 1
    for j in range(c.inputs):
        if isfinite(u.u[j]):
            s.u[j] = u.u[j]
        elif not isfinite(s.u[j]):
            s.waits += 1
            return False
    there = 0
    for j in range(c.measured):
        s.z[j] = u.z[j] if isfinite(u.z[j]) else nan
        if isfinite(u.z[j]):
            there += 1
    if there < c.measured:
        s.left_out += 1
    if there > 0 and s.away > c.missing:
        s.anew = 1
        s.begun += 1
    s.away = 0 if there > 0 else s.away + 1
    return True


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Record]) -> None:
    """Take one sample."""
    if not _taken(s, c, u):
        return
    if s.anew == 1:
        begin(s, c)
        s.lost = 0
    if c.call != 0:
        if call_entry(c.call, s.number, 0, 0, 0) != 0:
            raise ValueError("its step failed")
    else:
        for _ in range(s.lost + 1):
            predict(s, c)
        update(s, c)
    s.anew = 0
    s.samples += 1
    if not (s.seen == 0 or s.nis < inf):
        s.anew = 1  # beyond all numbers: what follows would be none
        s.begun += 1
        return
    if s.samples > c.settle and s.seen > 0:
        judge(s, c, out)
