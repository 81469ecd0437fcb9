"""The monitor ``filter``: a filter of filterpy's, and tests of its innovations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gateway.monitors.contract import (
    Blame,
    Blames,
    Connection,
    Debounce,
    Family,
    Fault,
    Monitor,
    Notes,
    Parts,
    Quantities,
    Quantity,
    Readout,
    Sampled,
)
from gateway.monitors.plain import calls
from gateway.monitors.plain.monitor import OfPython
from gateway_fdi import run_length, stopping
from gateway_fdi.errors import InputError
from gateway_fdi.quantiles import chi2_above
from gateway_plants.filter import author, kernel
from gateway_plants.filter.kernel import MOST, Const, Evidence, Inputs, State
from gateway_plants.filter.params import Params, PartParams
from gateway_plants.filter.python import Made, Stepper

TYPE, API = "filter", 2
#: Passed results that heal a fault: of windows, and of a mode's samples.
HEALED_WINDOWS, HEALED = 4, 100
#: Share of another measurement, an input or the model in a bias.
_ELSE = 0.3


def share(p: Params, faults: int) -> float:
    """Return the false alarms of each test in a sample.

    Raises:
        InputError: more than one in ten.
    """
    found = p.false_per_hour * p.period_ms / 3.6e6 / faults
    if not 1e-11 < found * max(p.window, 1) < 0.1:
        text = f"{found:.2g} false alarms of each test in a sample: 1e-11 to 0.1, and in a window of them"
        raise InputError(text, key="false_per_hour", value=p.false_per_hour)
    return found


def fill(p: Params, made: Made, s: Any, c: Any) -> None:
    """Fill state and constants of a monitor."""
    faults, m = author.names(p, made), len(p.z)
    c.states, c.measured, c.inputs = min(made.states, MOST), m, len(p.u)
    for name, value in made.matrices.items():
        getattr(c, name)[tuple(slice(k) for k in value.shape)] = value
    c.alpha = getattr(made.filter, "_alpha_sq", 1.0)
    c.missing, c.settle, c.modes, c.mode_limit = p.missing, p.settle, made.modes, p.mode_limit
    c.nis, c.fading = (faults.index(name) if name in faults else -1 for name in ("nis", "fading"))
    c.bias = next((k for k, name in enumerate(faults) if name.startswith("bias_")), -1)
    if not made.modes:
        rate = share(p, len(faults))
        c.window = p.window
        c.limit[:] = np.inf
        c.limit[1 : m * p.window + 1] = chi2_above(rate * p.window, np.arange(1, m * p.window + 1))
        level = run_length.cusum(1.0 / rate, 0.5 * p.shift)
        stopping.prepare(c.cusum, "cusum", level, drift=0.5 * p.shift)
        if c.fading >= 0:
            stopping.prepare(c.fade, "gma", run_length.fading(1.0 / rate, p.forget, m), forget=p.forget)
    s.anew, s.u[: len(p.u)] = 1, np.nan
    if not made.matrices:
        c.call, s.number = calls.address(), calls.enter(Stepper(p, made).on(s), s)


def _connect(p: Params) -> dict[str, Connection]:
    return {
        "z": [*p.measured, *[None] * (MOST - len(p.z))],
        "u": [*p.given_in, *[None] * (MOST - len(p.u))],
    }


def _parts(
    made: Made, p: Params, _: Callable[[str], Any], give: Callable[[Iterable[str]], Mapping[str, str]]
) -> dict[str, PartParams]:
    own = {f"{p.filter}.{name}": name for name in author.names(p, made) if name not in p.codes}
    given = {own[name]: code for name, code in give(own).items()}
    return {"": PartParams(**p.model_dump(exclude_unset=True), given=p.codes | given)}


def _faults(made: Made, p: PartParams) -> tuple[Fault, ...]:
    shown = ("nis", *(f"innovation {k + 1}" for k in range(3)), *(f"x{k + 1}" for k in range(4)))
    found = []
    for name in author.names(p, made):
        test, _, of = name.partition("_")
        text, tested = {
            "nis": (f"innovations of {p.window} samples are larger than the filter says", "sum of NIS"),
            "fading": ("innovations are larger than the filter says", "fading mean of NIS"),
            "bias": (f"the innovation of {of.partition('_')[2]} is biased", "CUSUM of the innovation"),
            "mode": (f"the filter finds the mode {of}", "probability of the mode"),
        }[test]
        debounce = Debounce(1, HEALED if test == "mode" else HEALED_WINDOWS)
        found.append(Fault(name, f"{p.given[name]}-00", text, shown, debounce, tested=tested))
    return tuple(found)


def _blames(made: Made, p: Params) -> dict[str, list[Blame]]:
    """Return what each fault blames: the measurement whose innovation is biased first, else all; and the model."""
    found = {}
    for name in author.names(p, made):
        own = int(name.split("_")[1]) if name.startswith("bias_") else 0
        parts = [Blame(one.name, share=_ELSE if own and k != own else 1.0) for k, one in enumerate(p.measured, start=1)]
        parts += [Blame(one.name, share=_ELSE) for one in p.given_in]
        found[name] = [*parts, Blame("model", "model", _ELSE)]
    return found


def _quantities(made: Made, p: Params) -> tuple[Quantity, ...]:
    innovations = [Quantity(f"innovation {one.name}", one.unit or "") for one in p.measured]
    states = [Quantity(f"x{k + 1}") for k in range(min(made.states, MOST))]
    modes = [Quantity(f"mode {name}", limit=p.mode_limit if k else np.nan) for k, name in enumerate(p.modes)]
    return (Quantity("nis"), *innovations, *states, *modes)


def _values(made: Made, p: Params, s: Any) -> list[float]:
    n = min(made.states, MOST)
    return [float(s["nis"]), *s["y"][: len(p.z)].tolist(), *s["x"][:n].tolist(), *s["mode"][: len(p.modes)].tolist()]


def _told(p: Params, made: Made) -> tuple[str, ...]:
    how = "compiled" if made.matrices else "in Python"
    what = f"{made.kind} of {made.states} states, {how}"
    if made.modes:
        return (f"{what}; a mode above {p.mode_limit:g} is a fault: no rate of false alarms is known",)
    each = share(p, len(author.names(p, made))) * 3.6e6 / p.period_ms
    return (f"{what}; {each:.3g} false alarms per hour of each test, if its model holds",)


def _made(p: Params, _: Path) -> Monitor[Params]:
    signals = [one.name for one in (*p.measured, *p.given_in)]
    twice = [name for k, name in enumerate(signals) if name in signals[:k]]
    if twice:
        raise InputError("this signal is there twice", key="z", value=twice[0])
    return _monitor_of(p.model_dump_json(exclude_unset=True), author.maker(p))


@lru_cache(maxsize=32)
def _monitor_of(keys: str, make: Callable[[], Any]) -> Monitor[Params]:
    p = Params.model_validate_json(keys)
    made = author.checked(p, make)
    if not made.modes:
        share(p, len(author.names(p, made)))
    return OfPython(
        type=TYPE,
        api=API,
        params=Params,
        state=State,
        const=Const,
        inputs=Inputs,
        evidence=Evidence,
        step=kernel.step,
        connect=_connect,
        prepare=lambda p, s, c: fill(p, made, s, c),
        faults=lambda p: _faults(made, p),
        capabilities=(
            Blames(lambda p: _blames(made, p)),
            *(() if made.matrices else (calls.FAILURE,)),
            Notes(lambda p: _told(p, made)),
            Parts(lambda p, find, give: _parts(made, p, find, give)),
            Quantities(lambda p: _quantities(made, p), lambda s: _values(made, p, s)),
            Readout(("nis", "seen", "samples", "begun", "left_out")),
            Sampled(lambda p: p.sampling),
        ),
        place=author.file_of(make),
    )


FAMILY = Family(type=TYPE, api=API, params=Params, made=_made)
