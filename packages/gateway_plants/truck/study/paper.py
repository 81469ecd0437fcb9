"""The paper's systems, T1 to T4 with integral causality (ICDS) and with mixed (MCDS), on the monitor's T1, T2 and gate.

They take the road, the load and the engine as the model has them. The generators of T3 and T4 are made of the model
when this module is loaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gateway.common.extras import need
from gateway_fdi import cusum
from gateway_fdi.common.resources import shipped
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.cusum import FLOOR, MARGIN, nus, threshold
from gateway_fdi.isolation import machine, table
from gateway_fdi.jit import f8, i8, kernel, record, zeros
from gateway_fdi.linear_algebra import copy
from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.generator.sources import load_source
from gateway_plants.truck.ecu.control import PERIOD
from gateway_plants.truck.monitor import MONITOR, gate, isolation, monitor, motion, static
from gateway_plants.truck.monitor.faults import UNISOLATED
from gateway_plants.truck.monitor.params import Params
from gateway_plants.truck.monitor.records import T1, T2, fill_generator
from gateway_plants.truck.study import dynamic, excitation
from gateway_plants.truck.study.excitation import FIXED

Array = NDArray[np.float64]

#: The systems, and the tests of each.
TESTS = {"ICDS": ("T1", "T2", "T3_ICDS", "T4_ICDS"), "MCDS": ("T1", "T2", "T3_MCDS", "T4_MCDS")}
#: Residuals by their place, and quantities: name, and the residual's.
RESIDUALS = ("T3_ICDS", "T4_ICDS", "T3_MCDS", "T4_MCDS")
QUANTITIES = (
    *((f"T3_{condition}", "T3_ICDS") for condition in ("fixed", "signed", "absolute")),
    *((f"T4_{condition}", "T4_ICDS") for condition in ("fixed", "signed", "absolute")),
    ("T3_mixed", "T3_MCDS"),
    ("T4_mixed", "T4_MCDS"),
)
T3_FIXED, T3_SIGNED, T3_ABSOLUTE, T4_FIXED, T4_SIGNED, T4_ABSOLUTE, T3_MIXED, T4_MIXED = range(len(QUANTITIES))
#: T1 and T2 are the monitor's.
NAMES = ("T1", "T2", *(name for name, _ in QUANTITIES))


class Paper(StrictModel):
    """Parameters of the paper's systems.

    Attributes:
        monitor: of T1 and T2; sensors are taken as they are.
        filter_bandwidth: alpha of (20), of MCDS [rad/s].
        after_s: t_d of (39) [s].
        signed_charge: J_1 of (41) [As].
        absolute_charge: J_2 of (45) [As].
        nu: of T3 and T4, in the order of RESIDUALS [rad/s], of MCDS [rad/s2].
        thresholds: J, in the order of QUANTITIES, in units of nu.
    """

    monitor: Params = Params(follow=False)
    filter_bandwidth: float = Field(0.5, gt=0)
    after_s: float = Field(10.0, gt=0)
    signed_charge: float = Field(4000.0, gt=0)
    absolute_charge: float = Field(1000.0, gt=0)
    nu: tuple[float, ...] = (0.283, 0.283, 0.048, 0.048)
    thresholds: tuple[float, ...] = (50.0,) * len(QUANTITIES)


def _generator(name: str, outputs: Sequence[str] = ()) -> Any:
    """Return the module of a residual generator."""
    need("structure", "the paper's residual generators")
    from gateway_fdi.structure.generator.code import write  # noqa: PLC0415 - algebra is slow to load
    from gateway_fdi.structure.generator.realisation import realise  # noqa: PLC0415

    model = load_model(shipped("models/truck.toml"))
    choice = model.residuals[name]
    made = write(name, realise(model, choice.equations, choice.consistency, outputs=outputs))
    return load_source(made.name, made.source)


t3, t4 = _generator("T3_ICDS", ("I_em", "u_gb")), _generator("T4_ICDS", ("I_em", "u_gb"))
t3m, t4m = _generator("T3_MCDS"), _generator("T4_MCDS")

CONST = record(
    monitor=MONITOR.const,
    excitation=excitation.Const.dtype,
    cusum=(cusum.Const.dtype, len(QUANTITIES)),
    isolation=(isolation.Const.dtype, len(TESTS)),
    t3=t3.Const.dtype, t4=t4.Const.dtype, t3m=t3m.Const.dtype, t4m=t4m.Const.dtype,
)  # fmt: skip
STATE = record(
    monitor=MONITOR.state,
    begun=i8,
    three=dynamic.State.dtype,
    four=dynamic.State.dtype,
    residual=(f8, len(RESIDUALS)),
    cusum=(cusum.State.dtype, len(QUANTITIES)),
    norm=(f8, len(QUANTITIES)),
    level=(f8, len(isolation.TESTS)),
    isolation=(isolation.State.dtype, len(TESTS)),
    t3=t3.State.dtype, t4=t4.State.dtype, t3m=t3m.State.dtype, t4m=t4m.State.dtype,
)  # fmt: skip


def prepare(p: Paper, s: Any, c: Any) -> None:
    """Fill records of STATE and CONST."""
    model = load_model(shipped("models/truck.toml"))
    MONITOR.prepare(p.monitor, s.monitor, c.monitor)
    e = c.excitation
    e.after, e.signed, e.absolute = p.after_s, p.signed_charge, p.absolute_charge
    for field in ("t3", "t4", "t3m", "t4m"):
        fill_generator(p.monitor, getattr(c, field), model, p.filter_bandwidth)
    e.efficiency = c.t3.eta_em_0
    for k, (_, residual) in enumerate(QUANTITIES):
        nu = p.nu[RESIDUALS.index(residual)]
        cusum.prepare(c.cusum[k], nu, nu * p.thresholds[k], p.monitor.limit)
    for k, tests in enumerate(TESTS.values()):
        isolation.prepare_table(s.isolation[k], c.isolation[k], model, tests, 0.0)


class Generator(NamedTuple):
    """A residual generator: kernels and records of a generated module."""

    start: Any
    step: Any
    state: Any
    const: Any


@kernel
def _residual(g: Any, u: Any, begins: bool, speed: float, dt: float) -> float:
    """Step a residual generator, or begin it with a speed [rad/s]; returns its residual."""
    if begins:
        g.start(g.state, g.const, motion.Initial(speed))
    return float(g.step(g.state, g.const, u, dt))


@kernel
def _step_test(s: Any, c: Any, u: Any, dt: float, test: Any, at: int, integral: Any, mixed: Any) -> None:
    """Step T3 or T4, integral and mixed, or begin it again.

    Args:
        s: state.
        c: constants.
        u: inputs.
        dt: since the set before [s].
        test: of ``s``, T3 or T4.
        at: 0: T3, 1: T4.
        integral: its generator with integral causality.
        mixed: likewise, with mixed causality.
    """
    begins = test.on == 0
    speed, step = gate.speed(s.monitor.gate), 0.0 if begins else dt
    if begins:
        dynamic.begin(test)
    s.residual[at] = _residual(integral, u, begins, speed, step)
    s.residual[2 + at] = _residual(mixed, u, begins, speed, step)
    g, e = integral.state, test.excitation
    excitation.update(e, c.excitation, g.shown_I_em, g.shown_u_gb, step)
    settled = dynamic.settled(test)
    for condition in range(3):
        wanted = excitation.excited(e, c.excitation, condition)
        static.take(s, c, 3 * at + condition, s.residual[at], settled and wanted)
    g.omega_w += dynamic.correction(test, s.residual[at]) / integral.const.u_f
    static.take(s, c, T3_MIXED + at, s.residual[2 + at], excitation.excited(e, c.excitation, FIXED))


@kernel
def _motion(s: Any, c: Any, u: Any, dt: float) -> None:
    """Step T3 and T4 while the model holds."""
    if s.monitor.valid == 0:
        s.three.on, s.four.on = 0, 0
        return
    integral, mixed = Generator(t3.start, t3.step, s.t3, c.t3), Generator(t3m.start, t3m.step, s.t3m, c.t3m)
    _step_test(s, c, u, dt, s.three, 0, integral, mixed)
    if u.U_em_sens < c.monitor.least_volts:
        s.four.on = 0
        return
    if s.four.on == 0:
        # The battery is known all the time from T2; T4 runs for a while only.
        s.t4.SoC, s.t4m.SoC = s.monitor.t2.SoC, s.monitor.t2.SoC
    four, four_mixed = Generator(t4.start, t4.step, s.t4, c.t4), Generator(t4m.start, t4m.step, s.t4m, c.t4m)
    _step_test(s, c, u, dt, s.four, 1, four, four_mixed)


@kernel
def _decide(s: Any, c: Any, system: int, dt: float) -> int:
    """Return the fault that a system has isolated, UNISOLATED, or -1."""
    x, q, n = s.isolation[system], c.isolation[system], s.norm
    s.level[0], s.level[1] = s.monitor.norm[T1], s.monitor.norm[T2]
    if system == 0:  # remark 4: two conditions, either of which suffices
        s.level[2] = max(n[T3_SIGNED], n[T3_ABSOLUTE])
        s.level[3] = max(n[T4_SIGNED], n[T4_ABSOLUTE])
    else:
        s.level[2], s.level[3] = n[T3_MIXED], n[T4_MIXED]
    fired = 0
    for place in range(4):
        if s.level[place] > 1.0:
            fired |= 1 << place
    x.up[0] = fired
    machine.stand(x, q, int(dt * 1e9), int(s.monitor.use * 1e9))
    machine.decide(x, q, s.level, table.answer(x, q), machine.contradicted(x))
    return int(x.found)


@kernel
def _walk(s: Any, c: Any, u: Any, first: Any, flags: Any, rows: Any) -> None:
    """Take all sets; ``rows`` of no length: nothing is kept."""
    for k in range(u.shape[0]):
        m, dt = s.monitor, c.monitor.period
        if s.begun == 0:
            monitor.begin(m, c.monitor, u[k])
            t3.reset(s.t3, c.t3)
            t4.reset(s.t4, c.t4)
            t3m.reset(s.t3m, c.t3m)
            t4m.reset(s.t4m, c.t4m)
            s.begun, dt = 1, 0.0
        static.step(m, c.monitor, u[k], dt)
        motion.watch(m, c.monitor, u[k], dt)
        _motion(s, c, u[k], dt)
        for system in range(first.shape[0]):
            found = _decide(s, c, system, dt)
            if found >= 0 and first[system, found] < 0:
                first[system, found] = k
        m.use = 0.0
        if rows.shape[0] == 0:
            continue
        flags[k, 0] = m.valid == 1
        flags[k, 1] = s.four.on == 1 and dynamic.settled(s.four)
        copy(rows[k], s.residual, len(s.residual))
        copy(rows[k, len(s.residual) :], s.norm, len(s.norm))
        rows[k, len(s.residual) + len(s.norm)] = s.t4.shown_I_em


@dataclass(frozen=True)
class Trace:
    """Set by set.

    Attributes:
        t: time [s], shape (n,).
        valid: the model holds, shape (n,).
        settled: T4 runs, and its speed at the start has been corrected, shape (n,).
        residual: shape (n, 4), in the order of RESIDUALS; they keep their last value while they do not run.
        norm: T_norm, shape (n, quantities).
        current: of the machine as T4 computes it [A], shape (n,).
    """

    t: Array
    valid: NDArray[np.bool_]
    settled: NDArray[np.bool_]
    residual: Array
    norm: Array
    current: Array


@dataclass(frozen=True)
class Followed:
    """What the systems made of a drive.

    Attributes:
        first: of each system the second in which each fault was first told, infinite if never, shape (faults + 1,).
        peak: largest T_norm, in the order of NAMES, shape (quantities + 2,).
        trace: the rest, of no length if it was not asked for.
    """

    first: dict[str, Array]
    peak: Array
    trace: Trace


def _run(u: NDArray[np.void], p: Paper, length: int = 0) -> tuple[Any, Any, Any, Any]:
    s, c = zeros(1, STATE)[0], zeros(1, CONST)[0]
    prepare(p, s, c)
    first = np.full((len(TESTS), UNISOLATED + 1), -1, np.int64)
    flags = np.zeros((length, 2), np.bool_)
    rows = np.empty((length, len(RESIDUALS) + len(QUANTITIES) + 1))
    _walk(s, c, u, first, flags, rows)
    return s, first, flags, rows


def follow(u: NDArray[np.void], p: Paper, *, keep: bool = False) -> Followed:
    """Put a drive, the monitor's inputs, through the systems; ``keep`` its trace."""
    s, first, flags, rows = _run(u, p, len(u) if keep else 0)
    a, b = len(RESIDUALS), len(RESIDUALS) + len(QUANTITIES)
    trace = Trace(
        t=np.asarray(np.arange(len(rows)) * PERIOD, np.float64),
        valid=flags[:, 0],
        settled=flags[:, 1],
        residual=rows[:, :a],
        norm=rows[:, a:b],
        current=rows[:, -1],
    )
    told = np.where(first < 0, np.inf, first * PERIOD)
    peak = np.append(s.monitor.cusum["peak"][[T1, T2]], s.cusum["peak"])
    return Followed(dict(zip(TESTS, told, strict=True)), peak, trace)


def calibrated(p: Paper, healthy: list[NDArray[np.void]], *, floor: float = FLOOR) -> Paper:
    """Return parameters with nu and J from healthy drives, as ``gateway calibrate`` finds them."""
    sums = []
    for u in healthy:
        s = _run(u, p)[0]
        sums += [[np.append(s.monitor.cusum[key][[T1, T2]], s.cusum[key]) for key in ("samples", "total", "squares")]]
    nu = nus(["T1", "T2", *(residual for _, residual in QUANTITIES)], np.sum(sums, axis=0))

    def with_thresholds(found: Sequence[float]) -> Paper:
        of_monitor = {"nu": p.monitor.nu.model_copy(update={name: nu[name] for name in ("T1", "T2")})}
        js = p.monitor.thresholds.model_copy(update={"T1": found[0], "T2": found[1]})
        mine = p.monitor.model_copy(update={**of_monitor, "thresholds": js})
        levels = tuple(nu[name] for name in RESIDUALS)
        return p.model_copy(update={"monitor": mine, "nu": levels, "thresholds": tuple(found[2:])})

    opened = with_thresholds([1e9] * len(NAMES))
    peaks = np.max([follow(u, opened).peak for u in healthy], axis=0) * 1e9
    return with_thresholds([threshold(peak, MARGIN, floor) for peak in peaks])
