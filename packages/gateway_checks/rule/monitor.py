"""Relations between signals: each is a fault of its own, tested when one of its signals comes.

Signals are held between their frames. A relation is not tested while one of its signals never came or is overdue, while
its condition does not hold, or while something in it has no value yet (a delay that has not passed, a root of a
negative number).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from math import nan
from typing import Annotated, Any

from gateway.monitors.contract import (
    EVIDENCE,
    Blames,
    Connection,
    Debounce,
    Fault,
    LastResult,
    Monitor,
    Out,
    Parts,
    Reading,
    Residuals,
    Signal,
    report,
)
from gateway.monitors.contract import Inputs as Event
from gateway_checks.rule.machine import Code, Machine, load, run
from gateway_checks.rule.params import Params, PartParams, Rule
from gateway_checks.rule.program import MOST_SIGNALS, Program
from gateway_checks.rule.residual import blames, residual_of
from gateway_checks.rule.text import compile_text, is_relation
from gateway_fdi.errors import Gathered, InputError, under
from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means

#: Results over which is averaged what a relation is off while it holds.
LATELY = 1000


class Inputs(Event):
    """The signals of a relation."""

    value: Annotated[f8s, MOST_SIGNALS] = means("value of each signal")


class Const(Record):
    """A relation, and when it is tested."""

    holds: Code = means("the relation")
    when: Code = means("when it is tested")
    tolerance: f8 = means("by which it may be broken")
    signals: i8 = means("how many it has")


class State(Record):
    """Memory of both."""

    holds: Machine = means("machine of the relation")
    when: Machine = means("machine of when it is tested")
    square: f8 = means("mean square of what the relation was off lately while it held")
    held: i8 = means("results in that mean")
    told: i8 = means("1: the last sample was tested")


class Evidence(Record):
    """The signals' values."""

    value: Annotated[f8s, EVIDENCE] = means("value")


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Any]) -> None:
    """Test the relation."""
    result = run(s.holds, c.holds, u.t_ns, u.value, c.tolerance)  # also while it is not tested: it remembers
    shut = s.holds.unknown == 1
    if c.when.length > 0:
        condition = run(s.when, c.when, u.t_ns, u.value, 0.0)
        shut = shut or s.when.unknown == 1 or condition == 0.0
    if shut:
        if s.told == 1:  # else the time of its last result would go on
            report(out, 0, False, nan, nan)
        s.told = 0
        return
    s.told = 1
    if result == 1.0:
        s.held = min(s.held + 1, LATELY)
        s.square += (s.holds.left**2 - s.square) / s.held
    evidence = report(out, 0, result == 0.0, s.holds.left, s.holds.right)
    for k in range(min(c.signals, EVIDENCE)):
        evidence.value[k] = u.value[k]


def _connect(p: PartParams) -> dict[str, Connection]:
    own: list[Signal | None] = [Signal(name, triggers=True) for name in p.signals]
    return {"value": [*own, *[None] * (MOST_SIGNALS - len(own))]}


def _prepare(p: PartParams, s: Any, c: Any) -> None:
    holds, when = p.holds, p.when
    load(s["holds"], c["holds"], holds, p.signals)
    if when is not None:
        load(s["when"], c["when"], when, p.signals)
    c["tolerance"], c["signals"] = p.rule.tolerance, len(p.signals)


def _faults(p: PartParams) -> tuple[Fault, ...]:
    rule = p.rule
    named = zip(p.signals, p.units, strict=True)
    labels = tuple(f"{name} [{unit}]" if unit else name for name, unit in named)
    one = p.units[0] if len(set(p.units)) == 1 else ""
    return (
        Fault(
            rule.name,
            f"{p.code}-64",
            rule.description or f"does not hold: {rule.holds}",
            labels[:EVIDENCE],
            Debounce(failed_ms=rule.failed_ms, passed_ms=rule.passed_ms),
            remedy="compare the signals named in the evidence with each other, and with the vehicle",
            tested=f"off the relation by [{one}]" if one else "off the relation by",
        ),
    )


def _residuals(p: PartParams) -> dict[str, Callable[[LastResult], Reading | None]]:
    read = residual_of(p)
    return {} if read is None else {p.rule.name: read}


def _part(rule: Rule, code: str, find: Callable[[str], Any], key: str) -> PartParams:
    """Return one relation with its programs.

    Raises:
        InputError: a text that is no relation, a signal that is not there, units that do not go together.
    """

    def unit_of(name: str) -> str | None:
        return str(find(name).unit or "") or None  # nothing said in the database is nothing known

    made: dict[str, Program] = {}
    for name, text in (("holds", rule.holds), ("when", rule.when)):
        if text is None:
            continue
        with under(f"{key}.{name}", text):
            made[name] = compile_text(text, unit_of)
            if not is_relation(text):
                raise InputError("this says nothing that is true or false: compare it with something", value=text)
    signals = tuple(dict.fromkeys(name for program in made.values() for name in program.signals))
    if not signals:
        raise InputError("there is no signal in it", key=f"{key}.holds", value=rule.holds)
    if len(signals) > MOST_SIGNALS:
        raise InputError(f"at most {MOST_SIGNALS} signals", key=key, value=len(signals))
    units = tuple(unit_of(name) or "" for name in signals)
    return PartParams(rule=rule, code=code, holds=made["holds"], when=made.get("when"), signals=signals, units=units)


def _parts(
    p: Any, find: Callable[[str], Any], give: Callable[[Iterable[str]], Mapping[str, str]]
) -> dict[str, PartParams]:
    assert isinstance(p, Params)
    codes = give(rule.name for rule in p.rule if rule.code is None)
    parts, wrong = {}, Gathered()
    for k, rule in enumerate(p.rule):
        with wrong:
            parts[rule.name] = _part(rule, rule.code or codes[rule.name], find, f"rule[{k}]")
    wrong.check()
    return parts


MONITOR = Monitor(
    type="rule",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    evidence=Evidence,
    step=step,
    connect=_connect,  # type: ignore[arg-type] # of its parts
    prepare=_prepare,  # type: ignore[arg-type]
    faults=_faults,  # type: ignore[arg-type]
    capabilities=(Blames(blames), Parts(_parts), Residuals(_residuals)),
)
