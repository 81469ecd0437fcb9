"""From parameters to a monitor: the model is read, its tests found or chosen, and their kernel made."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gateway.monitors.contract import (
    Behind,
    Blames,
    Connection,
    CusumCalibration,
    Family,
    Fault,
    Monitor,
    Notes,
    Parts,
    Quantities,
    Quantity,
    Readout,
    Sampled,
    Signal,
    Warnings,
)
from gateway_checks.rule.machine import load
from gateway_checks.rule.program import Program
from gateway_checks.rule.text import compile_text, is_relation
from gateway_fdi.common.resources import find
from gateway_fdi.cusum import MARGIN, NEVER
from gateway_fdi.errors import Gathered, InputError, under
from gateway_fdi.masks import pack
from gateway_fdi.structure.file import load_own_model
from gateway_fdi.structure.generator.records import FEED, FEED_SLOPE, fill
from gateway_fdi.structure.generator.sources import load_source
from gateway_fdi.structure.model import Model, with_sizes
from gateway_fdi.structure.model import Quantity as Known
from gateway_fdi.structure.units import differ
from gateway_plants.structural.monitor import (
    decision,
    fault_likelihood,
    filters,
    identity,
    modes,
    observer,
    parameter_tracking,
    plan_cache,
    records,
    source,
    summary,
    uncertain,
)
from gateway_plants.structural.monitor.faults import behind, blames, false_alarms, faults_of, levels, names_of, shown
from gateway_plants.structural.monitor.params import Params, PartParams
from gateway_plants.structural.monitor.plan import Plan, Test

TYPE, API = "structural", 2
#: Rate at which what has no filter forgets [rad/s].
AT_ONCE = 1e30


class _Made:
    """A monitor of one model with one choice of tests.

    Args:
        plan: its tests.
        slow: what may be off.
    """

    def __init__(self, model: Model, plan: Plan, slow: tuple[uncertain.Slow, ...]) -> None:
        self.model, self.plan, self.slow = model, plan, slow
        if len(model.knowns) > records.MOST_INPUTS:
            text = f"{len(model.knowns)} known variables: a monitor has room for {records.MOST_INPUTS}"
            raise InputError(text, key="model", value=model.name)
        for test in plan.generators:
            load_source(test.name, test.source)
        for _, test in source.faulty(plan):
            load_source(f"{test.name} with faults", test.faulty)
        self._module = load_source(model.name, source.module_of(plan, model.knowns, slow))

    @cached_property
    def monitor(self) -> Monitor[Params]:
        """Return the monitor."""
        module, plan = self._module, self.plan
        names = tuple(test.name for test in plan.tests)
        count = len(names)
        return Monitor(
            type=TYPE,
            api=API,
            params=Params,
            state=module.State,
            const=module.Const,
            inputs=module.Inputs,
            step=module.step,
            connect=self._connect,  # type: ignore[arg-type] # of its parts
            prepare=self._prepare,  # type: ignore[arg-type]
            faults=self._faults,  # type: ignore[arg-type]
            capabilities=(
                Behind(lambda _: behind(self.model, plan), lambda _, s: levels(plan, s), false_alarms(plan)),
                Blames(lambda _: blames(self.model, plan)),
                CusumCalibration(
                    quantities=(*((name, name) for name in names), *((name, "") for name in self._limits)),
                    floors=dict.fromkeys(self._limits, MARGIN * math.sqrt(2.0 * fault_likelihood.SPEAKS)),
                    sums=self._sums,
                    peaks=self._peaks,
                    digests=self._digests,
                ),
                Quantities(
                    lambda _: tuple(self._quantities()),
                    lambda s: np.stack([s["own"]["residual"][:count], s["own"]["norm"][:count]], 1).ravel(),
                ),
                Notes(lambda p: summary.notes(self.model, plan, p)),
                Parts(self._parts),
                Readout((*source.sizes_of(plan), *(one.field for one in self.slow), *source.COUNTS)),
                Sampled(lambda p: p.sampling),
                Warnings(lambda p: summary.warnings(self.model, plan, p)),
            ),
        )

    def _digests(self, p: Any) -> dict[str, str]:
        return {test.name: identity.digest(self.model, test, p) for test in self.plan.tests}

    @property
    def _limits(self) -> tuple[str, ...]:
        """Names of the limits of what sign and size say, where something may be off."""
        faults = (*self.plan.faults, "none") if self.slow and source.faulty(self.plan) else ()
        return tuple(f"likelihood_{fault}" for fault in faults)

    def _sums(self, s: Any) -> dict[str, Any]:
        own, none = s["own"]["cusum"][: len(self.plan.tests)], np.zeros(len(self._limits))
        return {key: np.append(own[key], none) for key in ("samples", "total", "squares")}

    def _peaks(self, s: Any) -> Any:
        own = s["own"]["cusum"]["peak"][: len(self.plan.tests)]
        return np.append(own, np.sqrt(s["fit"]["peak"])) if self._limits else own

    def _quantities(self) -> Iterator[Quantity]:
        for test in self.plan.tests:
            yield Quantity(f"residual of {test.name}", test.unit)
            yield Quantity(f"T over J of {test.name}", limit=1.0)

    # How it is connected ----------------------------------------------------------------------------------------------

    def _parts(
        self, p: Any, find: Callable[[str], Any], give: Callable[[Iterable[str]], Mapping[str, str]]
    ) -> dict[str, PartParams]:
        assert isinstance(p, Params)
        needed = self._needed(p)
        names, wrong = names_of(self.plan), Gathered()
        connected = []
        for z in self.model.knowns:
            with wrong:
                connected += [z] if self._found(z, find, needed=z in needed) else []
        for name in p.codes:
            with wrong:
                uncertain.check_name(name, names, "faults and groups", f"codes.{name}")
        wrong.check()
        own = {f"{self.model.name}.{name}": name for name in names if name not in p.codes}
        given = {own[name]: code for name, code in give(own).items()}
        return {"": PartParams(**p.model_dump(exclude_unset=True), connected=tuple(connected), given=p.codes | given)}

    def _needed(self, p: Params) -> set[str]:
        program = _condition(self.model, p)
        return {*self.plan.knowns, *(() if program is None else program.signals)}

    def _found(self, known: str, find: Callable[[str], Any], *, needed: bool) -> bool:
        """Tell whether a known variable has a signal, of its unit if both have one.

        Raises:
            InputError: it has none and is needed, or that of another unit.
        """
        try:
            signal = find(known)
        except InputError as error:
            if not needed:
                return False
            text = f'the tests need this known variable of the model: signals = {{ {known} = "Message.Signal" }}'
            raise InputError(f"{text}; {error.message}", key=f"signals.{known}") from error
        wanted, told = self.model.quantities.get(known, Known()).unit, str(signal.unit or "")
        if differ(wanted, told):
            text = f'{signal.name} is in "{told}", {known} of the model in "{wanted}"'
            raise InputError(text, key=f"signals.{known}", value=told)
        return True

    def _connect(self, p: PartParams) -> dict[str, Connection]:
        needed = self._needed(p)
        return {
            "value": [
                Signal(z, triggers=z in needed, optional=True, may_be_nan=True) if z in p.connected else None
                for z in self.model.knowns
            ]
        }

    # Its records ------------------------------------------------------------------------------------------------------

    def _prepare(self, p: PartParams, s: Any, c: Any) -> None:
        needed, plan, own = self._needed(p), self.plan, c.own
        own.inputs = len(self.model.knowns)
        own.wanted[: own.inputs] = [z in needed for z in self.model.knowns]
        own.counted, own.missing = p.sample != "set" or bool(p.counters), p.missing
        own.period_ns = p.period_ns
        place_of = {z: k for k, z in enumerate(self.model.knowns)}
        own.reads[: len(plan.tests)] = pack([[place_of[z] for z in test.knowns] for test in plan.tests], len(place_of))
        own.gap_ns = round((p.missing + 1.5) * p.period_ns)
        own.settle_ns, confirm_ns = round(p.settle_s * 1e9), round(p.confirm_s * 1e9)
        program = _condition(self.model, p)
        if program is not None:
            load(s.own.active, own.active, program, self.model.knowns)
        decision.prepare_table(s.own, own, plan, confirm_ns)
        self._fill_shown(own)
        own.jumps = p.decision == "jump"
        decision.prepare_window(own)
        for k, test in enumerate(plan.tests):
            decision.prepare(own, k, p.nu.get(test.name, math.inf), p.thresholds.get(test.name, math.inf), p.limit)
        own.meters, own.forgets[:] = len(plan.measured), AT_ONCE
        place = {k: j for j, k in enumerate(plan.measured.values())}
        for k, (test, field) in enumerate(zip(plan.generators, source.fields_of(plan), strict=True)):
            fitted = filters.bandwidths(test, p) if k < own.tests else filters.of_meter(p)
            if k in place and test.filtered:
                own.forgets[place[k]] = fitted.filter
            fill(
                getattr(c, field),
                self.model,
                values=p.parameters,
                start=dict.fromkeys(test.guessed, 0.0) | p.start,
                filter_bandwidth=fitted.filter,
                derivative_bandwidth=fitted.derivative,
            )
            if test.observed:
                self._fill_observer(test, p, getattr(c, field))
        own.memory_s = max(p.confirm_s, records.WINDOW * p.period_ms / 1e3)
        if self.slow:
            self._fill_slow(p, s, c)
        if source.faulty(plan):
            self._fill_weighed(p, s, c)

    def _fill_observer(self, test: Test, p: PartParams, c: Any) -> None:
        """Fill the gains of a test whose states are corrected.

        Raises:
            InputError: at these parameters no gain helps.
        """
        found = observer.observer_of(self.model, test, p)
        if found is None:
            text = f"test {test.name} diverges at these parameters, and no correction of its states helps"
            raise InputError(text, key="parameters", value=test.name)
        for name, gain, slope in zip(found.states, found.gain, found.slope, strict=True):
            c[f"{FEED}{name}"], c[f"{FEED_SLOPE}{name}"] = gain, slope

    def _fill_slow(self, p: PartParams, s: Any, c: Any) -> None:
        """Fill what follows all that may be off, and the models that it moves."""
        parameter_tracking.prepare(s.follow, c.follow, [one.bound for one in self.slow], p.drift_s)
        if source.is_late(self.slow):
            c.late.per_ms = 1.0 / p.period_ms
            c.late.back = math.ceil(max(one.bound for one in self.slow if one.kind == "lag") / p.period_ms)
        for k, (test, field) in enumerate(zip(self.plan.generators, source.fields_of(self.plan), strict=True)):
            models = [s[f"model_{k}"]]
            if k < len(self.plan.tests):
                fitted = filters.bandwidths(test, p)
                apart_s = max(p.confirm_s, 1.0 / fitted.filter if test.filtered else 0.0)
                found = modes.modes(self.model, test, p)
                turn = 0.0 if found is None else float(abs(found.every.imag).max()) * p.period_ms / 1e3
                parameter_tracking.prepare_test(c.follow, k, p.nu.get(test.name, math.inf), apart_s, turn)
                near = uncertain.neighbours(self.slow, test)
                models += [s[f"near_{k}"][i] for i in range(len(near))]
                if near:
                    c[f"acts_{k}"], s.own.waits[k] = near, 1
            for model in models:
                for name in model.dtype.names or ():
                    model[name] = getattr(c, field)[name]

    def _fill_weighed(self, p: PartParams, s: Any, c: Any) -> None:
        """Fill what weighs faults, and the constants of those that run beside the tests."""
        fault_likelihood.prepare(c.fit, self.plan, len(self.slow), p.period_ms / 1e3, p.confirm_s)
        c.fit.limit[:] = fault_likelihood.SPEAKS
        limits = [p.thresholds.get(name, 0.0) for name in self._limits]
        c.fit.limit[: len(limits)] = np.maximum(0.5 * np.square(limits), fault_likelihood.SPEAKS)
        c.fit.opened = min(limits, default=0.0) >= NEVER
        gains = [(f, k) for f, tests in enumerate(fault_likelihood.moved(self.plan)) for k in tests]
        for k, test in source.faulty(self.plan):
            c[f"column_{k}"] = [gains.index((self.plan.faults.index(fault), k)) for fault in test.faults]
            fitted = filters.bandwidths(test, p)
            for one in s[f"faulty_{k}"]:
                fill(
                    one,
                    with_sizes(self.model),
                    values=p.parameters,
                    start=dict.fromkeys(test.guessed, 0.0) | p.start,
                    filter_bandwidth=fitted.filter,
                    derivative_bandwidth=fitted.derivative,
                )
            apart_s = max(p.confirm_s, 1.0 / fitted.filter if test.filtered else 0.0)
            sigma, c.fit.share[k] = p.nu.get(test.name, math.inf) / decision.NU_OF_NOISE, p.period_ms / 1e3 / apart_s
            if not math.isfinite(sigma) or sigma <= 0.0:
                c.fit.share[k] = 0.0
            c.fit.weight[k] = c.fit.share[k] / sigma**2

    def _fill_shown(self, own: Any) -> None:
        own.shown[:] = records.NOT_USED
        for k, one in enumerate(shown(self.plan)):
            cells = [records.KINDS * test + kind for test in one.tests for kind in (records.RESIDUAL, records.NORM)]
            cells += [records.KINDS * meter + records.SIZE for meter in one.meters]
            cells += [records.LISTED, records.RANKED]
            own.shown[k, : len(cells)] = cells

    def _faults(self, p: PartParams) -> tuple[Fault, ...]:
        return faults_of(self.model, self.plan, p.given)


def _measured(model: Model) -> dict[str, str]:
    """Return unknowns that a sensor's equation gives as they are: unknown -> known variable."""
    found: dict[str, str] = {}
    for equation in model.equations:
        if equation.relation is None or len(equation.variables) != 1 or len(equation.knowns) != 1:
            continue
        x, z = equation.variables[0], equation.knowns[0]
        sides = (equation.relation.left.text, equation.relation.right.text)
        if z in sides and sides[1 - sides.index(z)] in (x, *(f"{x} + {f}" for f in equation.faults)):
            found.setdefault(x, z)
    return found


def _condition(model: Model, p: Params) -> Program | None:
    """Return the program of `active`, None without one; an unknown in it is its sensor's value.

    Raises:
        InputError: it is no condition, or names what is neither known nor measured.
    """
    if p.active is None:
        return None
    measured = _measured(model)
    names = (*model.knowns, *measured)

    def unit_of(name: str) -> str | None:
        return model.quantities.get(name, Known()).unit or None

    with under("active", p.active):
        program = compile_text(p.active, unit_of, named=names)
        if not is_relation(p.active):
            raise InputError("this says nothing that is true or false: compare it with something", value=p.active)
    program.signals[:] = [measured.get(name, name) for name in program.signals]
    return program


#: What the names of a parameter of the monitor are.
_NAMED = {"parameters": "parameters", "start": "states", "unseen": "faults", "noise": "known variables"}
#: Monitors by the names of their plans, and what may be off: the same one for the same model.
_MONITORS: dict[tuple[str, tuple[uncertain.Slow, ...]], _Made] = {}


def made(p: Params, folder: Path) -> Monitor[Params]:
    """Return the monitor that has these parameters."""
    if p.between == "interpolated" and p.sample != "clock":
        text = 'its values are of one time already: sample = "clock", or between = "held"'
        raise InputError(text, key="between", value=p.between)
    if bool(p.counters) != (p.sample == "counter") and p.sample != "set":
        text = 'counters = ["Message.Signal", ..] and sample = "counter" (or "set") go together'
        raise InputError(text, key="counters", value=p.sample)
    if p.max_age_ms is not None and p.sample == "counter":
        raise InputError("what has the same counter is of one time, whatever its age", key="max_age_ms")
    if p.between == "interpolated" and p.max_age_ms is not None and p.max_age_ms > p.most_between_ms:
        text = f"with period_ms = {p.period_ms:g} at most {p.most_between_ms:g} can be interpolated over"
        raise InputError(text, key="max_age_ms", value=f"{p.max_age_ms:g}")
    path = find(p.model, folder, "models", ".toml", beside="the configuration", key="model")
    model = load_own_model(path, key="model")
    asked = {
        "name": model.name, "tests": p.tests, "causality": p.causality, "unseen": sorted(p.unseen),
        "start": sorted(p.start.items()), "sizes": p.sizes, "noise": sorted(p.noise.items()),
    }  # fmt: skip
    key = plan_cache.key_of(path.read_bytes(), asked)
    wrong = Gathered()
    slow: tuple[uncertain.Slow, ...] = ()
    with wrong:
        _condition(model, p)
    with wrong:
        slow = uncertain.slow_of(model, p)
    for field, names, known in (
        ("parameters", p.parameters, model.parameters),
        ("start", p.start, model.states),
        ("unseen", p.unseen, model.faults),
        ("noise", p.noise, model.knowns),
    ):
        for name in names:
            with wrong:
                uncertain.check_name(name, known, _NAMED[field], field if field == "unseen" else f"{field}.{name}")
    wrong.check()
    if (key, slow) not in _MONITORS:
        plan = plan_cache.read(key)
        if plan is None:
            from gateway_plants.structural.monitor.choice import choose  # noqa: PLC0415 - algebra is slow to load

            plan = choose(model, p)
            plan_cache.write(key, plan)
        _MONITORS[key, slow] = _Made(model, plan, slow)
    made_of = _MONITORS[key, slow]
    monitor = made_of.monitor
    with wrong:
        _check_tests(monitor, p)
    with wrong:
        modes.refuse_diverging(model, made_of.plan, p)
    wrong.check()
    return monitor


def _check_tests(monitor: Monitor[Params], p: Params) -> None:
    """Raise InputError or InputErrors if there is no such test, or another one of its name than nu was found for."""
    calibration = monitor.capability(CusumCalibration)
    assert calibration is not None
    assert calibration.digests is not None
    tests = [name for name, _ in calibration.quantities]
    more = "; the model, or which tests are chosen, has changed since: gateway calibrate --write" if p.digests else ""
    wrong = Gathered()
    for key, names in (("digests", p.digests), ("nu", p.nu), ("thresholds", p.thresholds)):
        for name in names:
            with wrong:
                uncertain.check_name(name, tests, "tests", f"{key}.{name}", more)
    now = calibration.digests(p)
    for name, digest in p.digests.items():
        if name in now and digest != now[name] and (name in p.nu or name in p.thresholds):
            text = (
                f"nu and thresholds are of another test of this name, this one is {now[name]}: its equations,"
                " causality, filter, decision or what is uncertain have changed since; gateway calibrate --write finds"
                " new ones"
            )
            with wrong:
                raise InputError(text, key=f"digests.{name}", value=digest)
    wrong.check()


FAMILY = Family(type=TYPE, api=API, params=Params, made=made)
