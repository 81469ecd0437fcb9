"""Warmth and age of machine and battery, gains and biases of the electric sensors: what the tests take of them.

A winding at 120 degC has 39 % more resistance than at 20 degC, magnets lose 0.1 % a kelvin, a battery's resistance
doubles in its life, a current sensor is half an ampere off: none is a fault. They are slow errors
(:mod:`gateway_fdi.slow.filter`) of three equations that hold without a fault. With readings y = (1 + g) x + b of
voltage U, current I of the machine and I_b of the battery, w the machine's speed, told parameters R, k, R_b, U_oc:

    U - U_ctrl                     = U_ctrl g_U + b_U                                       [V]  (e7, e34)
    U_ctrl - k w - R I             = k w dk + R I dR - R I g_I - R b_I                      [V]  (e7, e8, e35)
    I U - (U_oc - R_b I_b) I_b     = U_oc I_b dU - R_b I_b^2 dR_b + U (I g_I + b_I) + I (U g_U + b_U)
                                     - (U_oc - 2 R_b I_b) (I_b g_b + b_b)                   [W]  (e5, e6, e11, e33)

to first order: put x = y - g y - b into the true equation and leave out products of errors. Call the three h_1' e,
h_2' e, h_3' e. The residuals are made of them: T1 is the first; T5 the second over k ratio; T6 minus the third over
U_b = U_oc - R_b I_b; and T2 = I_b - I (R I + k w) / U_b = T6 + I [(U - U_ctrl) + (U_ctrl - k w - R I)] / U_b. So what
is not known of them has the sensitivities h_1, h_2 / (k ratio), h_3 / U_b and (-h_3 + I (h_1 + h_2)) / U_b: what no
equation tells apart (a battery's voltage and the gain of a current) is no doubt of a test that has the same sum.

A set tells of them while the machine is used; of the machine while the clutch holds and no gear change is near. First
they are learned as fast as the noise lets them; meanwhile T2, T5 and T6 wait, and T1 doubts. What lies beyond the
bounds is left to the tests. While a test has fired, equations in which a fault may be that explains it are not
followed (:func:`_suspects`); all others are. If it gets no name, those grow older: the tests doubt as much as the
rates may have made meanwhile, up to the bounds. What was ageing, or a sensor's error, comes down; a fault does not.

Bounds and rates: copper 0.393 %/K (IEC 60228); NdFeB -0.09 to -0.12 %/K of remanence (IEC 60404-8-1), SmCo -0.04;
resistance of a cell: half to twice as much over 0 to 40 degC, twice at its end of life (ISO 12405-4, IEC 62660-1); its
open circuit voltage is taken from a curve, which ages by percents. Windings heat by some tenths of a kelvin a second at
peak torque, magnets and cells by hundredths. Sensors: of a data sheet.
"""

from __future__ import annotations

from math import sqrt

from gateway_fdi.jit import f8s, kernel
from gateway_fdi.slow import filter as slow
from gateway_fdi.structure.generator.runtime import interpolate
from gateway_plants.truck.monitor import alignment
from gateway_plants.truck.monitor.faults import BATTERY as SHORT
from gateway_plants.truck.monitor.faults import INVERTER, RESISTANCE, SENSOR
from gateway_plants.truck.monitor.messages import Inputs
from gateway_plants.truck.monitor.records import (
    B_BIAS,
    B_GAIN,
    CELLS,
    I_BIAS,
    I_GAIN,
    MAGNETS,
    OPEN,
    T1,
    U_BIAS,
    U_GAIN,
    WINDING,
    Const,
    State,
)

#: Bits of ``untested``: the machine's R and k are not known yet (T2, T5); the battery's R and U are not (T2, T6); the
#: machine is not used (T2, T5, T6); the clutch does not hold (T3, T4, T7; T2 and T5 where it is open).
MACHINE, BATTERY, IDLE, CLUTCH = 1, 2, 4, 8
#: Places of machine and battery.
OF_MACHINE, OF_BATTERY = range(2)
#: Parameters are known when what is not known of them makes less than this share of what their bounds do, for so many
#: blocks, or when so many have been taken.
KNOWN, BLOCKS, AT_LATEST = 0.12, 30, 1200

#: T_norm of T1 from which on the machine's voltage is not known, and nothing is followed.
DOUBTED = 0.3


@kernel
def machine_known(s: State, c: Const) -> bool:
    """Tell whether T2 and T5 can be tested."""
    return bool(c.follows == 0 or s.known[OF_MACHINE] >= BLOCKS)


@kernel
def battery_known(s: State, c: Const) -> bool:
    """Tell whether T2 and T6 can be tested."""
    return bool(c.follows == 0 or s.known[OF_BATTERY] >= BLOCKS)


@kernel
def _sensitivities(s: State, c: Const, u: Inputs, ratio: float, open_volts: float) -> None:
    """Put what each error adds to the second and third equation, at a set as read, into ``h_2`` and ``h_3``."""
    drop, cells = c.t2.R_em, c.t6.R_b * u.I_b_sens
    s.h_2[WINDING], s.h_2[MAGNETS] = drop * u.I_em_sens, c.t2.k_i * ratio * u.omega_gb_sens
    s.h_2[I_GAIN], s.h_2[I_BIAS] = -drop * u.I_em_sens, -drop
    power, inner = u.I_em_sens * u.U_em_sens, open_volts - 2.0 * cells
    s.h_3[OPEN], s.h_3[CELLS] = open_volts * u.I_b_sens, -cells * u.I_b_sens
    s.h_3[U_GAIN], s.h_3[U_BIAS], s.h_3[I_GAIN], s.h_3[I_BIAS] = power, u.I_em_sens, power, u.U_em_sens
    s.h_3[B_GAIN], s.h_3[B_BIAS] = -inner * u.I_b_sens, -inner


@kernel
def _mode(s: State, c: Const) -> int:
    """Return what is done with a block: all is learned first."""
    return slow.FOLLOWING if machine_known(s, c) and battery_known(s, c) else slow.LEARNS


@kernel
def _count(s: State, c: Const, part: int, h: f8s, first: int, second: int) -> None:
    """Count the blocks of a part, and those in which its two errors are known, by the sensitivities of its equation."""
    if s.known[part] >= BLOCKS:
        return
    one = h[first] * (c.ageing.high[first] - c.ageing.low[first])
    other = h[second] * (c.ageing.high[second] - c.ageing.low[second])
    s.taken[part] += 1
    if slow.doubt(s.ageing, c.ageing, h) <= KNOWN * sqrt(one * one + other * other):
        s.known[part] += 1
    elif s.taken[part] >= AT_LATEST:
        s.known[part] = BLOCKS


@kernel
def _voltage(s: State, c: Const, u: Inputs) -> None:
    """Follow the first equation."""
    left = alignment.doubt(s.alignment)
    if slow.add(s.blocks[0], s.h_1, u.U_em_sens - u.U_em_ctrl, c.voltage_noise * c.voltage_noise + left * left):
        slow.update(s.ageing, c.ageing, s.blocks[0], slow.COLOURED, _mode(s, c))


@kernel
def _machine(s: State, c: Const, u: Inputs, ratio: float) -> None:
    """Follow the second."""
    speed, left = c.t2.k_i * ratio * c.speed_noise, alignment.doubt(s.alignment)
    variance = c.voltage_noise * c.voltage_noise + speed * speed + left * left
    rest = u.U_em_ctrl - s.h_2[MAGNETS] - s.h_2[WINDING]
    if slow.add(s.blocks[1], s.h_2, rest, variance):
        slow.update(s.ageing, c.ageing, s.blocks[1], slow.COLOURED, _mode(s, c))
        _count(s, c, OF_MACHINE, s.h_2, WINDING, MAGNETS)


@kernel
def _battery(s: State, c: Const, u: Inputs) -> None:
    """Follow the third."""
    rest = u.I_em_sens * u.U_em_sens - s.h_3[OPEN] - s.h_3[CELLS]
    if slow.add(s.blocks[2], s.h_3, rest, c.power_noise * c.power_noise):
        slow.update(s.ageing, c.ageing, s.blocks[2], slow.COLOURED, _mode(s, c))
        _count(s, c, OF_BATTERY, s.h_3, OPEN, CELLS)


@kernel
def _suspects(s: State) -> int:
    """Return the faults, as bits, whose equations do not hold: the one that has its name, or those that may get it."""
    if s.named >= 0:
        return 1 << s.named
    found = s.explained if s.fired != 0 else 0
    if s.norm[T1] > DOUBTED:
        found |= 1 << INVERTER | 1 << SENSOR
    return found


@kernel
def _follow(s: State, c: Const, u: Inputs, counts: bool, dt: float) -> None:
    """Follow what no fault is suspected in, and put what is found into the constants of T2, T5 and T6."""
    ratio = interpolate(c.t2.f_3_x, c.t2.f_3_y, u.gear) * c.t2.u_em
    _sensitivities(s, c, u, ratio, interpolate(c.t6.f_1_x, c.t6.f_1_y, s.t6.SoC))
    suspects = _suspects(s)
    machine, battery = machine_known(s, c), battery_known(s, c)
    if suspects & (1 << INVERTER | 1 << SENSOR) == 0 or not (machine and battery):
        _voltage(s, c, u)
    near = counts and s.blanking.quiet == 0 and int(u.gear) == s.blanking.gear
    if near and (suspects & (1 << INVERTER | 1 << RESISTANCE) == 0 or not machine):
        _machine(s, c, u, ratio)
    if suspects & (1 << SHORT | 1 << SENSOR) == 0 or not battery:
        _battery(s, c, u)
    # While a name is awaited its tests stay as sharp as they are; a short circuit's and a resistance's have fired.
    awaited = s.named < 0 and s.fired != 0 and s.unisolated == 0
    if suspects != 0 and not awaited and s.named not in (SHORT, RESISTANCE):
        slow.age(s.ageing, c.ageing, dt)
    e = s.ageing.taken
    s.winding, s.magnets, s.open_volts, s.cells = e[WINDING], e[MAGNETS], e[OPEN], e[CELLS]
    s.q2.R_em, s.q2.k_i = c.t2.R_em * (1.0 + e[WINDING]), c.t2.k_i * (1.0 + e[MAGNETS])
    s.q5.R_em, s.q5.k_i = s.q2.R_em, s.q2.k_i
    s.q2.R_b = s.q6.R_b = c.t6.R_b * (1.0 + e[CELLS])
    for k in range(len(s.q6.f_1_y)):
        s.q2.f_1_y[k] = s.q6.f_1_y[k] = c.t6.f_1_y[k] * (1.0 + e[OPEN])


@kernel
def step(s: State, c: Const, u: Inputs, used: bool, counts: bool, dt: float) -> None:
    """Take a set; what is found goes into the constants of T2, T5 and T6 and into the readings.

    Args:
        u: inputs; ``corrected`` are those with what is found of the sensors' errors taken off.
        used: the machine is.
        counts: the clutch holds, too.
        dt: since the set before [s].
    """
    slow.wait(s.ageing, dt)
    s.h_1[U_GAIN], s.h_1[U_BIAS] = u.U_em_ctrl, 1.0
    if used:
        _follow(s, c, u, counts, dt)
    e = s.ageing.taken
    v = s.corrected
    v.U_em_sens = (u.U_em_sens - e[U_BIAS]) / (1.0 + e[U_GAIN])
    v.I_em_sens = (u.I_em_sens - e[I_BIAS]) / (1.0 + e[I_GAIN])
    v.I_b_sens = (u.I_b_sens - e[B_BIAS]) / (1.0 + e[B_GAIN])


@kernel
def voltage_doubt(s: State, c: Const) -> float:
    """Return what is not known of T1 [V], standard deviation."""
    if c.follows == 0:
        return 0.0
    return slow.doubt(s.ageing, c.ageing, s.h_1) + alignment.doubt(s.alignment) / slow.GUARD


@kernel
def doubts(s: State, c: Const, u: Inputs) -> tuple[float, float, float]:
    """Return what is not known of T2 [A], T5 [rad/s] and T6 [A] while the machine is used, standard deviations."""
    if c.follows == 0:
        return 0.0, 0.0, 0.0
    inside = max(-s.h_3[B_BIAS], 1.0)
    for k in range(len(s.h)):
        s.h[k] = u.I_em_sens * (s.h_1[k] + s.h_2[k]) - s.h_3[k]
    ratio = interpolate(s.q5.f_3_x, s.q5.f_3_y, u.gear) * s.q5.u_em
    late = alignment.doubt(s.alignment) / slow.GUARD
    two, six = slow.doubt(s.ageing, c.ageing, s.h) / inside, slow.doubt(s.ageing, c.ageing, s.h_3) / inside
    five = (slow.doubt(s.ageing, c.ageing, s.h_2) + late) / (s.q5.k_i * ratio) if ratio > 0.0 else 0.0
    return two, five, six


@kernel
def untested(s: State, c: Const, used: bool) -> int:
    """Return why tests are not at work, as bits."""
    bits = 0 if machine_known(s, c) else MACHINE
    if not battery_known(s, c):
        bits |= BATTERY
    if not used:
        bits |= IDLE
    if s.watched == 0:
        bits |= CLUTCH
    return bits
