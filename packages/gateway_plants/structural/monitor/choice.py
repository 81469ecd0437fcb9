"""Which residual generators run: those that the configuration names, or the fewest that tell as much as all.

`auto`, and `pairs` for two faults at once, first ask whether tests of the causality that is preferred tell as much as
all that can be computed. If so, they are the fewest of them, else the fewest of all, the preferred ones where there is
a choice. That a generator can be computed the structure says; that algebra finds its code, only algebra does: a set
without is left out, and the choice made again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.common.extras import need
from gateway_fdi.common import progress
from gateway_fdi.errors import InputError, nearest, under
from gateway_fdi.masks import Sets
from gateway_fdi.structure.analysis import Analysis, analyse
from gateway_fdi.structure.generator.code import correctable, write
from gateway_fdi.structure.generator.conditioning import begins, forgets, gains_at_rest, noise_gains
from gateway_fdi.structure.generator.initial import find_initial
from gateway_fdi.structure.generator.realisation import Realisation, realise
from gateway_fdi.structure.generator.solver import NotSolvableError
from gateway_fdi.structure.isolability import isolability_of_model
from gateway_fdi.structure.model import Model, Quantity, ResidualChoice, state_of, with_sizes
from gateway_fdi.structure.selection import fewest_tests, requirements
from gateway_fdi.structure.sensors import place_sensors
from gateway_fdi.structure.sequence import shown
from gateway_plants.structural.monitor import filters, modes, observer
from gateway_plants.structural.monitor.params import Params
from gateway_plants.structural.monitor.plan import MOST_FAULTS, MOST_TESTS, Noise, Plan, Test

#: Places for sensors that a refusal names.
MOST_HINTS = 4
#: Sets up to which each is written, and its noise compared, where noise is told.
MOST_COMPARED = 200

#: What a class of causality costs against one equation, by what is preferred. (20) is a derivative in the consistency
#: relation; a derivative elsewhere is a low-pass's slope, and the last resort.
#: Up to CHEAP it is as preferred.
_COST = {"integral": {"S": 0, "SI": 1, "SD": 50, "SDI": 51}, "mixed": {"S": 0, "SD": 1, "SDI": 2, "SI": 50}}
_CHEAP = 2


def choose(model: Model, p: Params) -> Plan:
    """Return the tests of a monitor, with their code.

    Raises:
        InputError: a test that is not there or cannot be computed; a fault that no test sees; too many of them.
    """
    need("structure", "monitors made from a structural model", key="type")
    progress.say(f"{model.name}: tests are chosen and their code is written; the next start finds it")
    chosen = tuple(_auto(model, p) if isinstance(p.tests, str) else _named(model, p))
    if not chosen:
        raise InputError(
            "no equation of the model can be checked: it has no redundancy that can be computed", key="model"
        )
    for what, count, most in (("tests", len(chosen), MOST_TESTS), ("faults", len(model.faults), MOST_FAULTS)):
        if count > most:
            raise InputError(f"{count} {what}: a monitor has room for {most}", key="tests")
    seen = {fault for test in chosen for fault in test.faults}
    blind = [fault for fault in model.faults if fault not in seen and fault not in p.unseen]
    if blind:
        raise _refused(model, blind)
    faults = tuple(fault for fault in model.faults if fault in seen)
    meters = tuple(_meters(model, p, chosen, faults)) if p.sizes else ()
    return Plan(chosen, faults, tuple(_told(model, chosen, seen)), meters)


def _meters(model: Model, p: Params, tests: Sequence[Test], faults: Sequence[str]) -> Iterator[Test]:
    """Yield generators for the sizes of faults that no test measures: they check the equation that the fault is in.

    Its set is that of a test that sees the fault: what else is in it computes the equation's other variables.
    """
    measured = {test.measures for test in tests if not test.differentiated}
    for fault in faults:
        where = [e.name for e in model.equations if fault in e.faults]
        if fault in measured or len(where) != 1:
            continue
        found = []
        for test in sorted((t for t in tests if fault in t.faults), key=lambda t: len(t.equations)):
            try:
                one = _test(model, p, "", ResidualChoice(frozenset(test.equations), where[0]))
            except (NotSolvableError, ValueError):
                continue
            if one.measures == fault and not one.drifting:
                found.append(one)
                if not (one.guessed or one.differentiated):
                    break
        if found:
            best = min(found, key=lambda one: (bool(one.differentiated), bool(one.guessed)))
            yield replace(best, name=f"size of {fault}")


def _named(model: Model, p: Params) -> Iterator[Test]:
    """Yield the tests that the configuration names."""
    analysis: Analysis | None = None
    for k, name in enumerate(p.tests):
        key = f"tests[{k}]"
        if name in p.tests[:k]:
            raise InputError("this test is there twice", key=key, value=name)
        choice = model.residuals.get(name)
        if choice is None and ":" not in name:
            known = ", ".join(model.residuals) or "none"
            text = f'the residuals of the model are {known}; or "SET:EQUATION"{nearest(name, model.residuals)}'
            raise InputError(text, key=key, value=name)
        if choice is None:
            analysis = analysis or analyse(model)
            with under(key, name):
                choice = analysis.choice(name)
        try:
            yield _test(model, p, name.replace(":", "_"), choice)
        except (NotSolvableError, ValueError) as error:
            raise InputError(str(error), key=key, value=name) from error


@dataclass(frozen=True)
class _Set:
    """A set of equations with the consistency relations to check it by, best first, and what the best costs."""

    row: NDArray[np.bool_]
    ways: tuple[str, ...]
    cost: float
    preferred: bool


def _sets(analysis: Analysis, p: Params) -> list[_Set]:
    """Return the sets of which a residual generator may be computed."""
    candidates, cost = analysis.candidates, _COST[p.causality]
    usable = candidates.chosen("SDI", "realizable")
    unique = candidates.chosen("SDI", "unique")

    def order(k: int) -> tuple[bool, bool, int, int]:
        """Several solutions last; a derivative within the sequence behind one in the consistency relation."""
        within = bool(candidates.derivative_in_sequence[k])
        return not unique[k], within, cost[candidates.causality(k)], int(candidates.equation[k])

    found = []
    for number, row in enumerate(analysis.msos):
        mine = sorted((int(k) for k in np.flatnonzero((candidates.mso == number) & usable)), key=order)
        if mine:
            names = tuple(analysis.structure.equations[candidates.equation[k]] for k in mine)
            several, within, dear, _ = order(mine[0])
            price = float(row.sum()) + 200 * several + 100 * within + dear
            found.append(_Set(row, names, price, preferred=not several and not within and dear <= _CHEAP))
    return found


def _auto(model: Model, p: Params) -> Iterator[Test]:
    """Yield the fewest tests that detect and tell apart as much as all that can be computed."""
    analysis = analyse(model)
    if analysis.left_out:
        progress.say(f"{model.name}: {analysis.left_out}")
    sets, together = _sets(analysis, p), 2 if p.tests == "pairs" else 1
    made: dict[bytes, Test] = {}
    while sets:
        quality = _quality(model, p, sets, made)
        chosen = _fewest(model, sets, quality, large=bool(analysis.left_out), together=together)
        new = [s for s in chosen if s.row.tobytes() not in made]
        lost = [s for s in chosen if not _made(model, p, s, made)]
        if not lost and not new:
            yield from _with_names(model, [made[s.row.tobytes()] for s in chosen])
            return
        gone = {s.row.tobytes() for s in lost}
        sets = [s for s in sets if s.row.tobytes() not in gone]


def _quality(model: Model, p: Params, sets: Sequence[_Set], made: Mapping[bytes, Test]) -> NDArray[np.float64]:
    """Return how well each set sees each fault, shape (sets, faults): of size 1 at rest, over the residual's noise.

    It is infinite of a set that is not known yet; and of what lasts, where no noise is told or the sets are many. Where
    pairs are to be told apart each set that does so is as good: which sees them better depends on both.
    """
    found = np.full((len(sets), len(model.faults)), np.inf)
    if p.tests == "pairs":
        return found
    for k, test in enumerate(made.get(s.row.tobytes()) for s in sets):
        if test is None:
            continue
        noise = filters.noises(test, p)[0] if len(sets) <= MOST_COMPARED else 0.0
        for fault, gain in zip(test.faults, test.at_rest, strict=True):
            found[k, model.faults.index(fault)] = gain / noise if noise > 0.0 else np.inf if gain > 0.0 else 0.0
    return found


def _fewest(
    model: Model, sets: Sequence[_Set], quality: NDArray[np.float64], *, large: bool, together: int
) -> list[_Set]:
    """Return the fewest sets; of a large model, whose sets differ tenfold in size, none that is needlessly large."""
    rows = np.array([s.row for s in sets])
    incidence = np.array([[f in e.faults for f in model.faults] for e in model.equations], np.int64)
    signature: Sets = (rows.astype(np.int64) @ incidence.reshape(len(model.equations), -1)) > 0
    preferred = np.array([s.preferred for s in sets])
    wanted = requirements(signature, together=together)
    if preferred.any() and (not len(wanted) or wanted[:, preferred].any(1).all()):
        places = np.flatnonzero(preferred)
    else:
        places = np.arange(len(sets))
    cost = np.array([sets[int(k)].cost for k in places])
    sizes = rows.sum(1)[places] if large else None
    found = fewest_tests(signature[places], cost, sizes, quality[places], together=together)
    return [sets[int(places[int(k)])] for k in found]


def _made(model: Model, p: Params, found: _Set, made: dict[bytes, Test]) -> bool:
    """Write the code of a set's best way that has one, one that does not drift if there is; returns whether it has."""
    key = found.row.tobytes()
    equations = frozenset(e.name for e, there in zip(model.equations, found.row, strict=True) if there)
    for consistency in found.ways:
        if key in made and not made[key].drifting:
            break
        try:
            test = _test(model, p, "", ResidualChoice(equations, consistency))
        except (NotSolvableError, ValueError):
            continue
        if key not in made or not test.drifting:
            made[key] = test
    return key in made


def _with_names(model: Model, tests: Sequence[Test]) -> Iterator[Test]:
    """Give tests the names that the model has for them, else that of the equation that is checked."""
    own = {(r.equations, r.consistency): name for name, r in model.residuals.items()}
    taken: set[str] = set()
    for test in tests:
        name = stem = own.get((frozenset(test.equations), test.consistency), test.consistency)
        number = 2
        while name in taken:
            name, number = f"{stem}_{number}", number + 1
        taken.add(name)
        yield replace(test, name=name)


def _test(model: Model, p: Params, name: str, choice: ResidualChoice) -> Test:
    """Return a test with its code.

    Raises:
        NotSolvableError: algebra does not find it.
        ValueError: its set does not determine its unknowns.
    """
    differentiate = False
    try:
        realised = realise(model, choice.equations, choice.consistency, start=p.start)
    except NotSolvableError:
        differentiate = True
        realised = realise(model, choice.equations, choice.consistency, differentiate=True, start=p.start)
    guessed: tuple[str, ...] = ()
    every = realised.initialised
    for guessed in dict.fromkeys([(), *((x,) for x in every), every]):  # begin at 0, and have the time to settle
        if guessed:
            start = dict.fromkeys(guessed, 0.0) | p.start
            realised = realise(model, choice.equations, choice.consistency, differentiate=differentiate, start=start)
        if guessed == every or _begins(realised):
            break
    test = _written(model, p, name, realised, guessed, observed=False)
    own = p.model_copy(update={"parameters": {}})  # so that the plan does not hang on the values of a configuration
    if correctable(realised) and observer.wanted(modes.modes(model, test, own)):
        corrected = _written(model, p, name, realised, guessed, observed=True)
        if observer.observer_of(model, corrected, own) is not None:
            return corrected
    return test


def _written(
    model: Model, p: Params, name: str, realised: Realisation, guessed: tuple[str, ...], *, observed: bool
) -> Test:
    """Return a test with its code."""
    code = write(name or realised.consistency, realised, sized=p.sizes, observed=observed)
    faulty = _faulty(model, realised, bool(realised.differentiated), dict.fromkeys(guessed, 0.0) | p.start, observed)
    gains = gains_at_rest(realised)
    return Test(
        name=name,
        equations=realised.equations,
        consistency=realised.consistency,
        causality=_causality(realised),
        faults=tuple(gains),
        sequence=shown(model, realised.steps),
        knowns=code.knowns,
        rates=code.rates,
        unit=_unit(model, realised),
        guessed=guessed,
        drifting=() if observed else _drifting(model, realised),
        differentiated=realised.differentiated,
        filtered=bool(realised.transformed),
        noise=tuple(Noise(*one) for one in noise_gains(realised)),
        at_rest=tuple(gains.values()),
        measures=code.fault,
        source=code.source,
        observed=observed,
        faulty=faulty,
    )


def _faulty(
    model: Model, realised: Realisation, differentiate: bool, start: Mapping[str, float], observed: bool
) -> str:
    """Return the code of a test with the sizes of faults in its constants; empty: algebra does not find it."""
    try:
        found = realise(
            with_sizes(model),
            frozenset(realised.equations),
            realised.consistency,
            differentiate=differentiate,
            start=start,
        )
        return write(f"{realised.consistency} with faults", found, observed=observed).source
    except (NotSolvableError, ValueError):
        return ""


def _begins(realised: Realisation) -> bool:
    """Tell whether (24) says where the states begin that nothing else says it of."""
    try:
        return begins(realised, find_initial(realised))
    except NotSolvableError:
        return False


def _causality(realised: Realisation) -> str:
    derives = bool(realised.transformed or realised.differentiated)
    return "S" + "D" * derives + "I" * bool(realised.integrated)


def _drifting(model: Model, realised: Realisation) -> tuple[str, ...]:
    """Return the integrated states of which some combination never forgets.

    Those whose start the model gives are integrals on purpose (a charge, a mass).
    """
    states = tuple(x for x in realised.integrated if model.quantities.get(x, Quantity()).value is None)
    return () if forgets(realised, states) else states


def _unit(model: Model, realised: Realisation) -> str:
    """Return the unit of a residual: of the side of its equation that is a name alone."""
    relation = model.by_name[realised.consistency].relation
    if relation is None or realised.transformed:
        return ""
    for side in (relation.left, relation.right):
        quantity = model.quantities.get(side.text)
        if quantity is not None and quantity.unit not in ("", "1"):
            return quantity.unit
    return ""


def _refused(model: Model, blind: Sequence[str]) -> InputError:
    """Return the error of faults that no test sees, with the sensors that would help."""
    idle = [fault for fault in blind if not any(fault in e.faults for e in model.equations)]
    if idle:
        return InputError(f"fault {', '.join(idle)} of the model stands in no equation", key="model")
    what = f"no test sees {', '.join(blind)}"
    could = isolability_of_model(model).detectable
    if all(could[model.faults.index(fault)] for fault in blind):
        hint = (
            "the model could: look at gateway structure, which sets see it, and declare what their equations solve for"
        )
    else:
        places = [one for one in place_sensors(_only(model, blind), isolate=False) if one]
        named = " or ".join(" and ".join(one) for one in places[:MOST_HINTS])
        some = ",".join(dict.fromkeys(name for one in places[:MOST_HINTS] for name in one))
        hint = (
            f"a sensor of {named} would help (gateway structure {model.name}.toml --sensors {some})"
            if places
            else "no sensor would help"
        )
    return InputError(f'{what}: {hint}; or say unseen = ["{blind[0]}"{", ..." * (len(blind) > 1)}]', key="model")


def _only(model: Model, faults: Sequence[str]) -> Model:
    """Return the model with some of its faults alone."""
    equations = tuple(replace(e, faults=tuple(f for f in e.faults if f in faults)) for e in model.equations)
    return replace(model, equations=equations, faults=tuple(faults), residuals={})


def _told(model: Model, tests: Sequence[Test], seen: set[str]) -> Iterator[str]:
    """Yield what people should know of the tests."""
    for test in tests:
        if test.guessed:
            names = " and ".join(test.guessed)
            yield f"{test.name}: no equation says where {names} should start: at 0, and settle_s to settle, or give it"
        if test.drifting:
            names = " and ".join(test.drifting)
            yield f"{test.name} integrates {names} and does not forget all of it: what a sensor is off by adds up"
        if test.differentiated:
            names = ", ".join(test.differentiated)
            yield f"{test.name}: the slope of a low-pass (derivative_bandwidth) stands for the derivative of {names}"
    blind = [fault for fault in model.faults if fault not in seen]
    if blind:
        yield f"no test sees {', '.join(blind)}"
    yield from _idle(model)


def _idle(model: Model) -> Iterator[str]:
    """Yield what stands in no equation of the model: a slip, most likely."""
    relations = [e.relation for e in model.equations if e.relation is not None]
    used = {name for r in relations for side in (r.left, r.right) for name in side.names}
    used |= {state_of(name) for name in used if name.startswith("der(")}
    used |= {name for e in model.equations for name in (*e.variables, *e.knowns, e.differential)}
    for kind, names in (("unknown", model.unknowns), ("known", model.knowns), ("parameter", model.parameters)):
        idle = [name for name in names if name not in used]
        if idle:
            yield f"{kind} {', '.join(idle)} of the model stands in no equation"
