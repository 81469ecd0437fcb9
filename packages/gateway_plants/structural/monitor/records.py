"""Records that all monitors made from a model have beside those of their generators.

Those of a model derive from them, with arrays as long as it wants (:func:`lengths`); here they have all the room that
there may be.
"""

from __future__ import annotations

from typing import Annotated

from gateway.monitors.contract import EVIDENCE
from gateway_checks.rule.machine import Code, Machine
from gateway_fdi import cusum
from gateway_fdi.isolation import machine
from gateway_fdi.jit import f8, f8s, i8, i8s, means
from gateway_fdi.masks import words
from gateway_plants.structural.monitor.plan import MOST_FAULTS, MOST_METERS, MOST_TESTS, Plan

#: Known variables of a model, things that can be told of, tests in the evidence of each.
MOST_INPUTS, MOST_TOLD, SHOWN = 128, 2 * MOST_FAULTS + 1, 3
#: What a value of the evidence is: KINDS k + one of the first three, of test or meter k; or one of the others.
RESIDUAL, NORM, SIZE = range(3)
KINDS = 3
NOT_USED, LISTED, RANKED = -1, -2, -3
#: Samples that are searched for a jump; a power of 2.
WINDOW = 32

#: Most of everything, by the names that the records' lengths have; "words" of masks of tests, and of faults.
MOST = {
    "inputs": MOST_INPUTS,
    "tests": MOST_TESTS,
    "faults": MOST_FAULTS,
    "meters": MOST_METERS,
    "generators": MOST_TESTS + MOST_METERS,
    "groups": MOST_TOLD - 1,
    "told": MOST_TOLD,
    "words": words(max(MOST_TESTS, MOST_FAULTS)),
    "known_words": words(MOST_INPUTS),
}


class Const(machine.Const, lengths=MOST):
    """Constants."""

    inputs: i8 = means("known variables")
    wanted: Annotated[i8s, "inputs"] = means("1: the tests need it")
    reads: Annotated[i8s, "tests", "known_words"] = means("inputs that each test needs, a mask")
    counted: i8 = means("1: samples are counted; 0: their times say how many periods lie between them")
    period_ns: i8 = means("period of the samples", "ns")
    missing: i8 = means("samples in a row that may have an input that is no number")
    gap_ns: i8 = means("behind a longer one all begins anew", "ns")
    settle_ns: i8 = means("time behind a start in which nothing is judged", "ns")
    active: Code = means("when the tests are at work, as a program")
    shown: Annotated[i8s, "told", EVIDENCE] = means("what the values of its evidence are")
    jumps: i8 = means("1: the tests look for jumps")
    weighted: Annotated[f8s, WINDOW, 1, 1] = means("of a residual in standard deviations, for a jump of its mean")
    inverse: Annotated[f8s, WINDOW, 1, 1] = means("inverse of the information on a jump")
    cusum: Annotated[list[cusum.Const], "tests"] = means("CUSUM of each test")
    sigma: Annotated[f8s, "tests"] = means("standard deviation of each healthy residual")
    level: Annotated[f8s, "tests"] = means("of the likelihood ratio of a jump, doubled")
    meters: i8 = means("faults whose sizes are measured")
    forgets: Annotated[f8s, "meters"] = means("rate at which its filter forgets; very high: it has none", "rad/s")
    memory_s: f8 = means("over which sizes are averaged", "s")


class State(machine.State, lengths=MOST):
    """State."""

    at_ns: i8 = means("time of the sample", "ns")
    last_ns: i8 = means("last sample", "ns")
    since_ns: i8 = means("when the generators began", "ns")
    running: i8 = means("1: the generators run")
    begun: i8 = means("1: there is a sample")
    samples: i8 = means("samples taken")
    missed: i8 = means("samples that were left out, or did not come")
    gone: Annotated[i8s, "known_words"] = means("inputs of the sample that are no numbers, a mask")
    left_out: i8 = means("of these in a row, for an input that is no number")
    periods: i8 = means("since the last sample that was taken")
    without: i8 = means("tests that give no number, as long as an input is away, or that wait")
    dt: f8 = means("since the sample before", "s")
    active: Machine = means("what that program remembers")
    residual: Annotated[f8s, "tests"] = means("residual of each test")
    anew: Annotated[i8s, "generators"] = means("1: it gave no number, and begins anew")
    from_ns: Annotated[i8s, "tests"] = means("when the test began anew, alone", "ns")
    waits: Annotated[i8s, "tests"] = means("1: what may be off is not known well enough to judge it")
    weighed: i8 = means("number of faults that sign and size show; -1: one, and they are not all")
    likely: Annotated[i8s, "words"] = means("those faults, a mask")
    paired: Annotated[i8s, "words"] = means("faults of pairs that fit better than one fault, a mask")
    sure: Annotated[i8s, "words"] = means("of two faults those that are there in any case, a mask")
    last: Annotated[i8s, "words"] = means("those that were sure last, since faults began beside the tests, a mask")
    before: Annotated[i8s, "words"] = means("those before that, of which something may have been learned, a mask")
    beyond: Annotated[i8s, "words"] = means("tests that have fired for sure since faults run beside them, a mask")
    awaits: i8 = means("1: sign and size will soon say more")
    by_size: i8 = means("1: something may be off, so that tests name no fault against sign and size")
    norm: Annotated[f8s, "tests"] = means("T over J: above 1 a test has fired")
    cusum: Annotated[list[cusum.State], "tests"] = means("CUSUM of each test")
    begun_jump: Annotated[f8s, "tests", WINDOW, 1] = means("sums of each beginning of a jump in the window")
    newest: Annotated[f8s, 1] = means("newest residual")
    ring: i8 = means("place of the newest sample in the window")
    window: i8 = means("samples in the window")
    judged_ns: i8 = means("the sample that was judged last", "ns")
    reported_ns: i8 = means("when tests were reported last", "ns")
    turn: i8 = means("what is reported next, where it is too much for one step")
    measured: Annotated[f8s, "meters"] = means("residual of each meter")
    gain: Annotated[f8s, "meters"] = means("and what a fault of size 1 adds to it")
    measured_then: Annotated[f8s, "meters"] = means("what its filter still has of the residual before a test fired")
    gain_then: Annotated[f8s, "meters"] = means("and of the gain")
    information: Annotated[f8s, "meters"] = means("sum of squared gains, while a test has fired")
    product: Annotated[f8s, "meters"] = means("sum of gains times residuals")
    sizes: Annotated[f8s, "meters"] = means("of each fault that has a meter; 0: nothing has fired")


def lengths(plan: Plan, inputs: int) -> dict[str, int]:
    """Return how long the arrays are that a plan wants, by the names of :data:`MOST`."""
    tests, faults = len(plan.tests), len(plan.faults)
    wanted = {
        "inputs": inputs,
        "tests": tests,
        "faults": faults,
        "meters": len(plan.measured),
        "generators": len(plan.generators),
        "groups": len(plan.diagnoses),
        "told": len(plan.diagnoses) + 1,
        "words": words(max(tests, faults)),
        "known_words": words(inputs),
    }
    return {name: max(1, length) for name, length in wanted.items()}
