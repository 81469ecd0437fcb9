"""Records of the decision between hypotheses: constants, state, what is done."""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.isolation import fault_size
from gateway_fdi.jit import Record, f8, f8s, i8, i8s, means
from gateway_plants.linear.mathematics.plant import MOST_INPUTS, MOST_OUTPUTS
from gateway_plants.linear.model_set import filters
from gateway_plants.linear.model_set.filters import MOST_SLOW
from gateway_plants.linear.model_set.matrices import MOST_HYPOTHESES

#: What is done: a fault is isolated; the plant's errors are learned from healthy samples; the healthy hypothesis is
#: compared with what comes, and somebody else judges.
ISOLATING, LEARNING, WATCHING = range(3)
#: No part; the plant as a whole, that varies.
NONE, PLANT = -1, -2
#: Actuators, then sensors.
PARTS = MOST_INPUTS + MOST_OUTPUTS


class Const(Record):
    """Constants."""

    filters: filters.Const = means("filters of the plant under each hypothesis")
    level: f8 = means("evidence beyond which something is wrong")
    least: i8 = means("samples in which a part has to be ahead", "samples")
    fits: Annotated[f8s, MOST_OUTPUTS + 1] = means("largest mean e^T V^-1 e of a right hypothesis of so many sensors")
    bounds: f8 = means("bound of what is slow, squared")
    told: f8 = means("bound of what is slow, squared, behind what was not isolated")
    actuator: Annotated[f8s, MOST_INPUTS] = means("size of an actuator's fault that counts, in the command's unit")
    sensor: Annotated[f8s, MOST_OUTPUTS] = means("size of a sensor's fault that counts, in the reading's unit")
    task: i8 = means("ISOLATING, LEARNING or WATCHING")
    doubt: f8 = means("normalised innovation squared of a sample that is not learned from while watching")
    found: i8 = means("samples of the start after which x is known", "samples")
    start: i8 = means("samples in which nothing is judged", "samples")
    hold: i8 = means("samples after which a fault is gone", "samples")
    patience: i8 = means("samples in which a fault has to be isolated", "samples")


class State(Record):
    """State."""

    filters: filters.State = means("filters of the plant under each hypothesis")
    done: i8 = means("samples of the start", "samples")
    named: Annotated[i8s, PARTS] = means("1: the part is named")
    unsure: Annotated[i8s, PARTS] = means("1: it is followed, as a sensor's fault was named that it may hide beside")
    parts: i8 = means("parts that are named")
    moving: i8 = means("samples in which a fault that is followed is taken to move")
    evidence: Annotated[f8s, MOST_HYPOTHESES] = means("g_h of each hypothesis")
    misfits: Annotated[f8s, MOST_HYPOTHESES] = means("normalised innovation squared of each hypothesis, averaged")
    waited: Annotated[i8s, MOST_HYPOTHESES] = means("samples since the jump of each hypothesis", "samples")
    jumps: Annotated[i8s, MOST_HYPOTHESES] = means("jumps of each hypothesis, lately")
    undecided: i8 = means("samples since an alarm", "samples")
    ahead: i8 = means("samples of these in which first was named", "samples")
    first: i8 = means("part that was named last; NONE: none")
    suspects: Annotated[list[fault_size.State], PARTS] = means("whether the size of each named fault counts")
    unexplained: i8 = means("1: what came is not isolated")
    jolted: i8 = means("1: since the alarm VARYING has once not explained what came: it was no gradual change")
    agreed: i8 = means("samples since unexplained that a healthy plant explains, within what was told", "samples")
    astray: i8 = means("samples since unexplained that it explains, beyond what was told", "samples")
    tested: i8 = means("1: the last sample was judged")
    magnitude: Annotated[f8s, PARTS] = means("size of each named fault")
    fit: f8 = means("sum of normalised innovations squared of the healthy hypothesis while it alone runs")
    fitted: i8 = means("samples in that sum", "samples")
    forgiven: i8 = means("alarms that nothing came of")
    calm: i8 = means("samples without an alarm since slow states were kept", "samples")
    keeps: i8 = means("times that slow states were kept")
    kept: Annotated[f8s, 2, MOST_SLOW] = means("slow states of two calm times, the older at ``keeps % 2``")
    kept_cov: Annotated[f8s, 2, MOST_SLOW, MOST_SLOW] = means("their covariance")
