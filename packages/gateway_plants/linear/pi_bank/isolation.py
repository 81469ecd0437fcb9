"""Which actuator, which sensor, how large: decisions on the bank beyond paper 003's products.

A change of the innovations raises an alarm first: the generalised likelihood ratio of the observer in use, over the
window, or the energy of its last sample alone. Then it is searched whether faults of actuators, beginning anywhere in
the window, explain the innovations of each observer:

    of all observers                     actuators: each observer's estimate is corrected for its transient
    only of the one without sensor j     sensor j; from here on that observer alone is believed
    of none, for a while                 more than one sensor, or not the plant that was told: not isolated

A sensor's offset is a step in its own reading; an actuator's fault is the same step where it acts at once (a current, a
rate), and only later what follows from it. So actuators are believed only once a sensor's jump explains clearly less
(:data:`CLEARER`): with all sensors a first one's, beside a sensor that is at fault, or about to be named, a second
one's. If that does not come, two sensors may be at fault, and it is not isolated.

No jump explains an actuator that drifts, is stuck or has lost effect, and by chance one observer is disturbed less than
the others. So a sensor is named only once no course of the actuators explains the samples, and an actuator only where
no course of the others does, and each observer finds its fault (:mod:`free`). What actuators explain and no jump does
is judged meanwhile (``drifting``); what nobody is named for within :data:`LONG` samples is not isolated.

In between nothing is judged: verdicts stand. It is (15) with what actuators explain taken off, so that neither a large
fault of an actuator trips the sensors' flags, nor the settling behind a sensor's fault the actuators'. An actuator is
at fault when the corrected omega lies beyond its threshold and beyond its own uncertainty; while no sensor is, all
observers have to agree, as in (16). A sensor's fault has a level too: y_j - C_j x_j, by the observer that does not take
it; its flag is held until that is gone.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated

import numpy as np

from gateway_fdi.isolation import fault_size
from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import copy
from gateway_fdi.quantiles import chi2_above, normal_above
from gateway_plants.linear.mathematics.plant import LinearPlant
from gateway_plants.linear.pi_bank import bank, glr, start, unstructured_faults
from gateway_plants.linear.pi_bank.bank import BANK, MOST_INPUTS, MOST_OUTPUTS
from gateway_plants.linear.pi_bank.design import Noise, Observer, augmented

#: No sensor.
NONE = -1
#: Samples in a row beyond a threshold, for an actuator's fault.
PERSISTENCE = 3
#: Samples in which a lost command is estimated.
BLIND = 4
#: Samples until what cannot be isolated is called so.
PATIENCE = 25
#: Of an estimate, in its standard deviations: what is surely gone; what surely contradicts.
GONE, AGAINST = 2.0, 2.0
#: Likewise: what each observer has to find of an actuator's fault before it is named.
AFFIRMED = 3.0
#: Samples until what no part is named for is not isolated.
LONG = 100
#: Of a sensor's offset, likewise: below it, it is none.
NOTHING = 3.0
#: Energy that a fault has to take from an observer's innovations, once there is an alarm [standard deviations squared].
WEAK = 6.0
#: Energy by which actuators have to explain more than one sensor more: twice the log of the odds.
CLEARER = 25.0
#: Standard deviation of an actuator's fault beforehand, in thresholds.
PRIOR = 100.0


class Const(Record):
    """Constants."""

    bank: bank.Const = means("the bank")
    jump: glr.Const = means("faults that begin at once")
    free: unstructured_faults.Const = means("actuators that do anything")
    start: start.Const = means("first samples")
    actuator: Annotated[f8s, MOST_INPUTS] = means("thresholds of the actuators' faults, in the command's unit")
    sensor: Annotated[f8s, MOST_OUTPUTS] = means("thresholds of the sensors' faults, in the reading's unit")
    spread: Annotated[f8s, MOST_OUTPUTS] = means("standard deviation of each sensor's offset")
    sure: f8 = means("quantile beyond which an estimate is no noise")
    window_alarm: f8 = means("largest log likelihood ratio of the window, doubled")
    sample_alarm: Annotated[f8s, BANK] = means("largest energy of a sample, by observer")
    hold: i8 = means("samples after which a sensor's fault is gone", "samples")


class State(Record):
    """State."""

    bank: bank.State = means("the bank")
    jump: glr.State = means("faults that begin at once")
    free: unstructured_faults.State = means("actuators that do anything")
    start: start.State = means("first samples")
    started: i8 = means("1: the first samples are over")
    active: i8 = means("the observer in use")
    latched: i8 = means("the sensor at fault; NONE: none")
    suspect: fault_size.State = means("whether its offset is beyond its threshold")
    undecided: i8 = means("samples since an alarm", "samples")
    drifting: i8 = means("1: no jump explains it, but actuators do that do anything")
    unexplained: i8 = means("1: what happened is not isolated")
    tested: i8 = means("1: the last sample was judged")
    actuator: Annotated[i8s, MOST_INPUTS] = means("1: the actuator is at fault")
    count: Annotated[i8s, MOST_INPUTS] = means("samples that the actuator's fault is beyond its threshold", "samples")
    open_question: Annotated[i8s, MOST_INPUTS] = means("samples that it is, and may be another part's", "samples")
    fault: Annotated[f8s, MOST_INPUTS] = means("size of each actuator's fault")
    limit: Annotated[f8s, MOST_INPUTS] = means("what that size is tested against")
    offset: Annotated[f8s, MOST_OUTPUTS] = means("size of each sensor's offset")
    blind: i8 = means("samples until a command that was lost has been estimated", "samples")
    agreed: i8 = means("samples in a row that a healthy plant explains", "samples")
    explains: Annotated[i8s, BANK] = means("1: actuators explain what this observer leaves")


def settled(plant: LinearPlant, observer: Observer) -> float:
    """Return the time in which an observer forgets [s]."""
    poles = np.linalg.eigvals(augmented(plant) - observer.gain.gain @ observer.shown)
    return plant.period / max(1.0 - float(np.abs(poles).max()), 1e-6)


def prepare(
    c: Const,
    s: State,
    plant: LinearPlant,
    noise: Noise,
    observers: tuple[Observer, ...],
    *,
    actuator: np.ndarray,
    sensor: np.ndarray,
    mtfa_s: float,
    start_s: float,
    hold_s: float,
    known: bool = False,
) -> None:
    """Fill records of CONST and STATE.

    Args:
        noise: of it.
        observers: of :func:`gateway_plants.linear.pi_bank.design.design`.
        actuator: thresholds Th_a, shape (m,).
        sensor: thresholds Th_s, shape (p,).
        mtfa_s: mean time between false alarms that is asked for [s].
        start_s: time in which nothing is judged [s].
        hold_s: a sensor's fault is gone when it has been for so long [s].
        known: the plant begins in state 0 without a fault.

    Raises:
        ValueError: the plant is too large.
    """
    n, m, p = plant.states, plant.inputs, plant.outputs
    bank.prepare(c.bank, plant, observers)
    glr.prepare(c.jump, s.jump, plant, observers, PRIOR * actuator)
    unstructured_faults.prepare(c.free, plant, noise, observers, actuator)
    # What y can be says how large states are at most: not known, as far as the sensors tell.
    unknown = np.concatenate([np.full(n, 1e3 * noise.outputs.max()), PRIOR * actuator])
    start.prepare(
        c.start,
        plant,
        noise,
        max(round(start_s / plant.period), 1),
        np.zeros(n + m) if known else unknown,
    )
    c.actuator[:m], c.sensor[:p] = actuator, sensor
    for j in range(p):
        x = observers[j + 1].gain.error[:n, :n]
        c.spread[j] = np.sqrt(plant.c[j] @ x @ plant.c[j] + noise.outputs[j] ** 2)
    # Estimates change as slowly as their observer forgets; innovations are new with every sample.
    c.sure = normal_above(min(settled(plant, observers[0]) / (2 * m * mtfa_s), 0.02))
    c.window_alarm = chi2_above(min(plant.period / mtfa_s, 0.01), m)
    for k in range(p + 1):
        c.sample_alarm[k] = chi2_above(min(plant.period / mtfa_s, 0.01), p if k == 0 else p - 1)
    c.hold = max(round(hold_s / plant.period), 1)
    s.latched = NONE


@kernel
def restart(s: State, c: Const) -> None:
    """Begin anew: nothing is known of the plant's state."""
    start.anew(s.start, c.start)
    glr.forget(s.jump)
    s.started, s.active, s.latched = 0, 0, NONE
    s.undecided = s.drifting = s.unexplained = s.tested = s.agreed = s.blind = 0
    fault_size.begin(s.suspect)
    s.jump.open[:] = 0
    s.bank.z[:, :] = 0.0
    s.actuator[:] = 0
    s.count[:] = 0
    s.open_question[:] = 0


@kernel
def _adopt(s: State, o: bank.Const, active: int, y: f8s) -> None:
    """Let all observers adopt the state of one, and forget the window."""
    glr.merge(s.jump, o, active, s.bank.z)
    for k in range(o.p + 1):
        s.jump.open[k] = 0
        copy(s.bank.z[k], s.bank.z[active], o.n + o.m)
        bank.innovate(s.bank, o, k, y)
    glr.forget(s.jump)


@kernel
def _open_faults(s: State, c: Const, y: f8s, actuators: bool) -> None:
    """Open the faults that explain the window: of all observers, or of the active one."""
    o = c.bank
    for k in range(o.p + 1):
        if not actuators and k != s.active:
            continue
        # The best of many beginnings takes some energy of mere noise, too.
        if s.jump.gained[k] > WEAK:
            glr.merge(s.jump, o, k, s.bank.z)
            bank.innovate(s.bank, o, k, y)
            glr.begin(s.jump, c.jump, o, k)
    s.undecided = 0
    glr.forget(s.jump)


@kernel
def _latch_sensor(s: State, c: Const, y: f8s, who: int) -> None:
    """Believe the observer ``who`` alone: the sensor that it does not take is at fault."""
    s.latched, s.active = who - 1, who
    fault_size.begin(s.suspect)
    _open_faults(s, c, y, False)
    unstructured_faults.begin(
        s.free, c.bank, s.bank.z[who], s.actuator
    )  # what has been told so far has had the sensor's fault in it


@kernel
def _only_undisturbed(s: State, c: Const) -> int:
    """Return the only observer whose innovations no fault of actuators is needed for, 0: none or several."""
    found = 0
    for k in range(1, c.bank.p + 1):
        if s.explains[k] == 1 and s.jump.gained[k] < c.window_alarm:
            found = k if found == 0 else -1
    return max(found, 0)


@kernel
def _search_explanations(s: State, c: Const) -> tuple[int, int]:
    """Search for faults of actuators that explain the innovations, for each observer that is in use.

    Returns:
        how many observers without a sensor have such an explanation, and the last of these.
    """
    observers_explaining, last = 0, 0
    for k in range(c.bank.p + 1):
        s.explains[k] = 0
        if s.latched == NONE or k == s.active:
            s.explains[k] = 1 if glr.search(s.jump, c.jump, c.bank, k) else 0
        if k > 0 and s.explains[k] == 1:
            observers_explaining += 1
            last = k
    return observers_explaining, last


@kernel
def _sensor_would_do(s: State, c: Const, k: int) -> bool:
    """Tell whether a jump of a sensor would explain nearly as well what observer k needs a fault of actuators for."""
    gained = s.jump.gained[k]
    return bool(gained > c.window_alarm and glr.other_sensor(s.jump, c.jump, c.bank, k) > gained - CLEARER)


@kernel
def _isolate(s: State, c: Const, y: f8s) -> None:
    """Decide between actuators and a sensor if the explanations allow it."""
    s.undecided += 1
    s.drifting = 0
    observers_explaining, last = _search_explanations(s, c)
    if s.latched != NONE:
        if observers_explaining == 1 and not _sensor_would_do(s, c, s.active):
            _open_faults(s, c, y, False)
        elif s.undecided > PATIENCE:
            s.unexplained = 1
    elif s.explains[0] == 1 and observers_explaining == c.bank.p and s.undecided >= 2 and not _sensor_would_do(s, c, 0):
        _open_faults(s, c, y, True)
    elif not unstructured_faults.refuted(s.free, c.free, 0, 0):
        s.drifting = 1 if s.undecided > PATIENCE else 0
    elif s.explains[0] == 0 and observers_explaining == 1 and not _sensor_would_do(s, c, last):
        _latch_sensor(s, c, y, last)
    elif s.undecided > PATIENCE:
        alone = _only_undisturbed(s, c)
        if s.explains[0] == 1:  # small, and whoever does not agree is not sure of it
            _open_faults(s, c, y, True)
        elif alone > 0:
            _latch_sensor(s, c, y, alone)
        else:
            s.unexplained = 1


@kernel
def _contradicted(s: State, c: Const, i: int) -> bool:
    """Tell whether any observer contradicts that actuator i is at fault."""
    o = c.bank
    way = 1.0 if s.fault[i] > 0.0 else -1.0
    for k in range(1, o.p + 1):
        own = way * glr.corrected(s.jump, o, k, s.bank.z, o.n + i)
        if own + AGAINST * s.jump.sigma[k, i] < c.actuator[i] or own < AFFIRMED * s.jump.sigma[k, i]:
            return True
    return False


@kernel
def _asked_for(s: State, c: Const, i: int) -> bool:
    """Tell whether nothing but actuator i can be at fault: no sensor, no course of the other actuators."""
    if s.latched == NONE and (_contradicted(s, c, i) or unstructured_faults.refuted(s.free, c.free, 0, 0)):
        return False
    way = 1.0 if s.fault[i] > 0.0 else -1.0
    return unstructured_faults.asked_for(s.free, c.free, c.bank, s.active, i, way, c.actuator[i], c.sure)


@kernel
def _set_flags(s: State, c: Const, y: f8s) -> None:
    """Set the flags of the actuators, and end that of a sensor whose fault is gone."""
    o, k = c.bank, s.active
    for i in range(o.m):
        value = glr.corrected(s.jump, o, k, s.bank.z, o.n + i)
        std = s.jump.sigma[k, i]
        limit = max(c.actuator[i], c.sure * std)
        s.fault[i], s.limit[i] = value, limit
        beyond = abs(value) >= limit
        sure = beyond and _asked_for(s, c, i)
        s.count[i] = s.count[i] + 1 if sure else 0
        s.open_question[i] = s.open_question[i] + 1 if beyond and not sure and s.actuator[i] == 0 else 0
        quiet = s.jump.open[k] == 0 and abs(value) < 0.5 * limit
        if s.count[i] >= PERSISTENCE:
            s.actuator[i] = 1
        elif quiet or abs(value) + GONE * std < c.actuator[i]:
            s.actuator[i] = 0
    for i in range(o.m):
        if s.open_question[i] > LONG:
            s.unexplained = 1
    s.offset[:] = 0.0
    if s.latched == NONE:
        return
    j = s.latched
    expected = 0.0
    for i in range(o.n):
        expected += o.c[j, i] * glr.corrected(s.jump, o, k, s.bank.z, i)
    s.offset[j] = y[j] - expected
    gone = abs(s.offset[j]) < max(0.5 * c.sensor[j], NOTHING * c.spread[j])
    # What no jump explains, an actuator that drifts, leaves one observer alone with an explanation too; its sensor is
    # right: then the suspect is doubted.
    if fault_size.follow(s.suspect, abs(s.offset[j]) >= c.sensor[j], gone, PATIENCE, c.hold) != fault_size.STANDS:
        _adopt(s, o, k, y)
        s.latched, s.active = NONE, 0
        unstructured_faults.begin(s.free, c.bank, s.bank.z[0], s.actuator)
        fault_size.begin(s.suspect)


@kernel
def _agree(s: State, c: Const, starts: bool) -> bool:
    """Tell whether all observers find the same faults of the actuators, as far as they know them.

    Args:
        starts: the start is just over: what it has found it knows less well than observers do in the long run.
    """
    o = c.bank
    for k in range(1, o.p + 1):
        for i in range(o.m):
            apart = abs(s.bank.z[k, o.n + i] - s.bank.z[0, o.n + i])
            variance = c.jump.variance[k, i] + c.jump.variance[0, i]
            if starts:
                variance = max(variance, s.start.p[k, o.n + i, o.n + i] + s.start.p[0, o.n + i, o.n + i])
            if apart > c.actuator[i] + 4.0 * sqrt(variance):
                return False
    return True


@kernel
def _recover(s: State, c: Const, y: f8s, u: f8s) -> None:
    """Go on with a bank that contradicts itself, until it has agreed for long enough that all is well.

    All may come to agree on a fault of an actuator: two speeds of one shaft that are off alike are what its motor's
    voltage would do, but for how it began, and that was not the actuator. So this is no agreement.
    """
    o = c.bank
    bank.step(s.bank, o, y, u)
    well = _agree(s, c, False)
    for i in range(o.m):
        if abs(s.bank.z[0, o.n + i]) >= c.actuator[i]:
            well = False
    s.agreed = s.agreed + 1 if well else 0
    if s.agreed >= c.hold:
        restart(s, c)


@kernel
def unknown_command(s: State, c: Const) -> None:
    """Say that the command of the sample before is not known: behind :func:`step` or :func:`missing`.

    What it was instead has moved the state by Gamma times what nobody knows: it is estimated like a fault that lasted
    for one sample, from the next innovations, and nothing is judged till then. Of several lost in a row, none of which
    shows yet, it is taken that they were the same.
    """
    o = c.bank
    if s.started == 0:
        start.unknown_command(s.start, c.start, o)
        return
    if s.unexplained == 1:
        return
    for k in range(o.p + 1):
        glr.pulse(s.jump, c.jump, o, k, s.bank.z, s.blind == BLIND)
    glr.forget(s.jump)
    s.undecided, s.drifting, s.blind, s.tested = 0, 0, BLIND, 0


@kernel
def _estimate_command(s: State, c: Const, y: f8s, u: f8s) -> None:
    """Take a sample to estimate what a command was that nobody knows."""
    o = c.bank
    s.blind -= 1
    unstructured_faults.step(s.free, c.free, o, s.active, y, u)
    for k in range(o.p + 1):
        if s.latched == NONE or k == s.active:
            bank.innovate(s.bank, o, k, y)
            glr.learn(s.jump, c.jump, o, k, s.bank.e)
            bank.advance(s.bank, o, k, u)
            glr.onwards(s.jump, o, k, s.bank.z)
            if s.blind == 0:
                glr.merge(s.jump, o, k, s.bank.z)


@kernel
def _watch(s: State, c: Const, y: f8s) -> None:
    """Take the innovations of a sample; isolates what has changed."""
    o, x = c.bank, s.jump
    x.at = (x.at + 1) % glr.WINDOW
    x.kept = min(x.kept + 1, glr.WINDOW)
    for k in range(o.p + 1):
        if s.latched == NONE or k == s.active:
            bank.innovate(s.bank, o, k, y)
            glr.keep(x, o, k, s.bank.e)
    alarm = glr.likelihood_ratio(x, c.jump, o, s.active) > c.window_alarm
    alarm = glr.energy(x, c.jump, o, s.active, x.at) > c.sample_alarm[s.active] or alarm
    if s.drifting == 1 and not alarm:
        s.drifting = s.undecided = 0
    if s.undecided > 0 or alarm:
        _isolate(s, c, y)
    if s.drifting == 1 and s.undecided > LONG:
        named = 0
        for i in range(o.m):
            named += s.actuator[i]
        if named == 0:
            s.unexplained = 1


@kernel
def step(s: State, c: Const, y: f8s, u: f8s) -> None:
    """Take one sample of outputs ``y`` with the commands ``u`` that are held from it on; sets flags and sizes."""
    o = c.bank
    s.tested = 0
    if s.started == 0:
        if start.step(s.start, c.start, o, s.bank.z, y, u):
            s.started = 1
            unstructured_faults.begin(s.free, c.bank, s.bank.z[0], s.actuator)
            s.unexplained = 0 if _agree(s, c, True) else 1
        return
    if s.unexplained == 1:
        _recover(s, c, y, u)
        return
    if s.blind > 0:
        _estimate_command(s, c, y, u)
        return
    unstructured_faults.step(s.free, c.free, o, s.active, y, u)
    x = s.jump
    _watch(s, c, y)
    if s.unexplained == 1:
        x.open[:] = 0
        s.latched, s.active, s.undecided, s.drifting, s.agreed = NONE, 0, 0, 0, 0
    for k in range(o.p + 1):
        if s.latched == NONE or k == s.active:
            glr.learn(x, c.jump, o, k, s.bank.e)
    if (s.undecided == 0 or s.drifting == 1) and s.unexplained == 0:
        s.tested = 1
        _set_flags(s, c, y)
    for k in range(o.p + 1):
        if s.latched == NONE or k == s.active:
            bank.advance(s.bank, o, k, u)
            glr.onwards(x, o, k, s.bank.z)


@kernel
def missing(s: State, c: Const, u: f8s) -> None:
    """Step over a sample that did not come."""
    o = c.bank
    s.tested = 0
    if s.started == 0:
        start.missing(s.start, c.start, o, s.bank.z, u)
        return
    for k in range(o.p + 1):
        # What a lost command was is still to be estimated: it goes on, nothing has told of it.
        if s.blind > 0:
            glr.coast(s.jump, o, k)
        else:
            glr.merge(s.jump, o, k, s.bank.z)
        bank.missing(s.bank, o, k, u)
    unstructured_faults.missing(s.free, c.free, o, s.active, u)
    glr.forget(s.jump)
    s.undecided = s.drifting = 0
