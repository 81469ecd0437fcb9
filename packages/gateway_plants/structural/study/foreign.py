"""Plants of other make: lightly damped, stiff, not linear. Each is a model as a user writes it, and an ODE of its own.

The ODE is solved by SciPy (:mod:`.drives`), apart from the gateway's code.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_plants.structural.study.model_text import written

Array = NDArray[np.float64]
Numbers = Mapping[str, float]


@dataclass(frozen=True)
class Plant:
    """A plant.

    Attributes:
        name: of the plant and of its model.
        model: as a user writes it, in TOML.
        period_s: between two samples.
        p: its parameters, faults' among them.
        begin: p -> state at 0.
        slopes: (state, commands, p) -> derivatives.
        commands: (rng, seconds) -> times and held values of the commands.
        measured: (states, commands, p) -> what the sensors show, in the order of the known variables.
        knowns: known variables.
        noise: standard deviation of each.
        faults: fault -> parameters that it changes.
        uncertain: parameters of which the model's values may be off.
        bias: of each sensor, at most half of what its data sheet says.
        told: lines of a configuration that say so.
        options: further lines of a configuration.
        seconds: of a drive with a fault.
        linear: the slopes are linear in the state.
    """

    name: str
    model: str
    period_s: float
    p: Numbers
    begin: Callable[[Numbers], tuple[float, ...]]
    slopes: Callable[[Any, Any, Numbers], Any]
    commands: Callable[[np.random.Generator, float], tuple[Array, Array]]
    measured: Callable[[Any, Any, Numbers], Sequence[Any]]
    knowns: tuple[str, ...]
    noise: tuple[float, ...]
    faults: Mapping[str, Numbers]
    uncertain: tuple[str, ...]
    bias: tuple[float, ...]
    told: str
    options: str = ""
    seconds: float = 60.0
    linear: bool = True


def _levels(
    count: int, every: float, low: float, high: float
) -> Callable[[np.random.Generator, float], tuple[Array, Array]]:
    """Return commands that jump to a level drawn at random, ``every`` seconds."""

    def drawn(rng: np.random.Generator, seconds: float) -> tuple[Array, Array]:
        t = np.arange(0.0, seconds, every)
        return t, rng.uniform(low, high, (len(t), count))

    return drawn


def _spring(x: Any, u: Any, p: Numbers) -> Any:
    return [x[1], (u[0] * p["gain"] - p["k"] * x[0] - p["d"] * x[1]) / p["m"]]


SPRING = Plant(
    "spring",
    written(
        unknown={"x": "m", "v": "m/s", "F": "N"},
        known=("u", "y", "w"),
        faults={"f_F": "the force", "f_y": "the position's sensor", "f_w": "the speed's sensor"},
        parameters={"m": 1.0, "k": 100.0, "d": 0.02},
        e1=("F = u * (1 + f_F)", "F"),
        e2=("m * der(v) = F - k * x - d * v", "der(v) F x"),
        e3=("der(x) = v", "der(x) v"),
        e4=("y = x + f_y", "x"),
        e5=("w = v + f_w", "v"),
    ),
    0.01,
    {"m": 1.0, "k": 100.0, "d": 0.02, "gain": 1.0, "y": 0.0, "w": 0.0},
    lambda _: (0.0, 0.0),
    _spring,
    _levels(1, 5.0, -20.0, 20.0),
    lambda x, u, p: (u[0], x[0] + p["y"], x[1] + p["w"]),
    ("u", "y", "w"),
    (0.0, 1e-3, 1e-2),
    {"f_F": {"gain": 0.7}, "f_y": {"y": 0.1}, "f_w": {"w": 0.5}},
    ("m", "k", "d"),
    (0.0, 5e-3, 0.025),
    """uncertain = { m = "20 %", k = "20 %", d = "20 %" }
sensors = { y = { gain = "1 %", bias = 0.01 }, w = { gain = "1 %", bias = 0.05 } }
""",
    "start = { x = 0.0, v = 0.0 }\nconfirm_s = 2\n",
    60.0,
)


def _buck(x: Any, u: Any, p: Numbers) -> Any:
    """The input's ripple, 0.5 V at 20 rad/s, is the states' last two."""
    return [
        (p["sw"] * u[0] * (24.0 + 0.5 * x[2]) - p["R_L"] * x[0] - x[1]) / p["L"],
        (x[0] - x[1] / p["R"]) / p["C"],
        20.0 * x[3],
        -20.0 * x[2],
    ]


BUCK = Plant(
    "buck",
    written(
        unknown={"I": "A", "V": "V", "Vin": "V", "D": "1"},
        known=("d", "i", "v", "vin"),
        faults={
            "f_sw": "the switch", "f_RL": "the choke's resistance", "f_R": "the load",
            "f_i": "the current's sensor", "f_v": "the voltage's sensor", "f_vin": "the input voltage's sensor",
        },
        parameters={"L": 0.002, "C": 0.002, "R_L": 0.1, "R": 10.0},
        e1=("D = d * (1 - f_sw)", "D"),
        e2=("L * der(I) = D * Vin - R_L * (1 + f_RL) * I - V", "der(I) V Vin D I"),
        e3=("C * der(V) = I - V / R * (1 + f_R)", "der(V) I"),
        e4=("i = I + f_i", "I"),
        e5=("v = V + f_v", "V"),
        e6=("vin = Vin + f_vin", "Vin"),
    ),
    0.001,
    {"L": 2e-3, "C": 2e-3, "R_L": 0.1, "R": 10.0, "sw": 1.0, "i": 0.0, "v": 0.0, "vin": 0.0},
    lambda _: (1.2, 12.0, 0.0, 1.0),
    _buck,
    _levels(1, 0.5, 0.4, 0.6),
    lambda x, u, p: (u[0], x[0] + p["i"], x[1] + p["v"], 24.0 + 0.5 * x[2] + p["vin"]),
    ("d", "i", "v", "vin"),
    (0.0, 0.02, 0.05, 0.05),
    {
        "f_sw": {"sw": 0.9}, "f_RL": {"R_L": 0.6}, "f_R": {"R": 6.0}, "f_i": {"i": 0.4}, "f_v": {"v": 1.0},
        "f_vin": {"vin": 1.5},
    },
    ("L", "C", "R_L", "R"),
    (0.0, 0.025, 0.05, 0.05),
    """uncertain = { L = "20 %", C = "20 %", R_L = "40 %", R = "15 %" }
sensors = { i = { gain = "1 %", bias = 0.05 }, v = { gain = "1 %", bias = 0.1 }, vin = { gain = "1 %", bias = 0.1 } }
""",
    "start = { I = 1.2, V = 12.0 }\nsettle_s = 1\nconfirm_s = 1\n",
    20.0,
)  # fmt: skip


def _motor(x: Any, u: Any, p: Numbers) -> Any:
    return [(u[0] - p["R"] * x[0] - p["k"] * x[1]) / p["L"], (p["k"] * x[0] - p["b"] * x[1]) / p["J"]]


MOTOR = Plant(
    "stiff_motor",
    written(
        unknown={"I": "A", "omega": "rad/s"},
        known=("u", "i", "w"),
        faults={
            "f_R": "the winding's resistance",
            "f_b": "the bearing's friction",
            "f_i": "the current's sensor",
            "f_w": "the speed's sensor",
        },
        parameters={"L": 0.0002, "R": 0.5, "k": 0.05, "b": 0.001, "J": 0.002},
        e1=("L * der(I) = u - R * (1 + f_R) * I - k * omega", "der(I) omega"),
        e2=("J * der(omega) = k * I - b * (1 + f_b) * omega", "der(omega) I"),
        e3=("i = I + f_i", "I"),
        e4=("w = omega + f_w", "omega"),
    ),
    0.01,
    {"L": 2e-4, "R": 0.5, "k": 0.05, "b": 1e-3, "J": 2e-3, "i": 0.0, "w": 0.0},
    lambda _: (0.0, 0.0),
    _motor,
    _levels(1, 2.0, 6.0, 12.0),
    lambda x, u, p: (u[0], x[0] + p["i"], x[1] + p["w"]),
    ("u", "i", "w"),
    (0.0, 0.02, 0.2),
    {"f_R": {"R": 0.75}, "f_b": {"b": 2e-3}, "f_i": {"i": 1.0}, "f_w": {"w": 8.0}},
    ("R", "k", "b", "J"),
    (0.0, 0.025, 0.25),
    """uncertain = { R = "20 %", k = "15 %", b = "30 %", J = "15 %" }
sensors = { i = { gain = "1 %", bias = 0.05 }, w = { gain = "1 %", bias = 0.5 } }
""",
    "start = { I = 0.0, omega = 0.0 }\nsettle_s = 3\nconfirm_s = 2\n",
    60.0,
)


def _tanks(h: Any, u: Any, p: Numbers) -> Any:
    q = [p[f"a{k + 1}"] * np.sqrt(2 * 981.0 * max(h[k], 0.0)) for k in range(4)]
    u1, u2 = u[0] * p["p1"], u[1] * p["p2"]
    return [
        (q[2] - q[0] + 0.7 * 3.33 * u1) / 28.0, (q[3] - q[1] + 0.6 * 3.35 * u2) / 32.0,
        (0.4 * 3.35 * u2 - q[2]) / 28.0, (0.3 * 3.33 * u1 - q[3]) / 32.0,
    ]  # fmt: skip


_HOLES = {"a1": 0.071, "a2": 0.057, "a3": 0.071, "a4": 0.057}


def _tank_model() -> str:
    flows = ("q3 - q1 + 0.7 * Q1", "q4 - q2 + 0.6 * Q2", "0.4 * Q2 - q3", "0.3 * Q1 - q4")
    equations = {}
    for k, flow in enumerate(flows, start=1):
        size = 28.0 if k in (1, 3) else 32.0
        equations[f"b{k}"] = (f"{size} * der(h{k}) = {flow}", f"der(h{k})")
        equations[f"o{k}"] = (f"q{k} = a{k} * sqrt(1962 * h{k})", f"q{k}")
        equations[f"s{k}"] = (f"y{k} = h{k} + f_{k}", f"h{k}")
    return written(
        unknown={name: unit for k in "1234" for name, unit in ((f"h{k}", "cm"), (f"q{k}", ""))} | {"Q1": "", "Q2": ""},
        known=("u1", "u2", "y1", "y2", "y3", "y4"),
        faults=dict.fromkeys(("f_1", "f_2", "f_3", "f_4", "f_p1", "f_p2"), ""),
        parameters=_HOLES,
        **equations,
        p1=("Q1 = 3.33 * (1 - f_p1) * u1", "Q1"),
        p2=("Q2 = 3.35 * (1 - f_p2) * u2", "Q2"),
    )


TANKS = Plant(
    "quad",
    _tank_model(),
    1.0,
    _HOLES | {"p1": 1.0, "p2": 1.0, "y1": 0.0, "y2": 0.0, "y3": 0.0, "y4": 0.0},
    lambda _: (12.3, 12.8, 1.6, 1.4),
    _tanks,
    _levels(2, 150.0, 2.7, 3.3),
    lambda h, u, p: (*u, *(h[k] + p[f"y{k + 1}"] for k in range(4))),
    ("u1", "u2", "y1", "y2", "y3", "y4"),
    (0.0, 0.0, 0.02, 0.02, 0.02, 0.02),
    {
        "f_1": {"y1": 1.0}, "f_2": {"y2": 1.0}, "f_3": {"y3": 0.4}, "f_4": {"y4": 0.4}, "f_p1": {"p1": 0.8},
        "f_p2": {"p2": 0.8},
    },
    tuple(_HOLES),
    (0.0, 0.0, 0.05, 0.05, 0.05, 0.05),
    """uncertain = { a1 = "20 %", a2 = "20 %", a3 = "20 %", a4 = "20 %" }
sensors.y1 = { gain = "1 %", bias = 0.1 }
sensors.y2 = { gain = "1 %", bias = 0.1 }
sensors.y3 = { gain = "1 %", bias = 0.1 }
sensors.y4 = { gain = "1 %", bias = 0.1 }
""",
    "start = { h1 = 12.3, h2 = 12.8, h3 = 1.6, h4 = 1.4 }\nsettle_s = 60\nconfirm_s = 60\n",
    1800.0,
    linear=False,
)  # fmt: skip


def _turbine(x: Any, u: Any, p: Numbers) -> Any:
    rotor, generator, twist, torque = x
    shaft = p["K"] * twist + p["B"] * (rotor - generator / p["N"])
    return [
        (u[1] * p["tr"] - shaft - p["Br"] * rotor) / p["Jr"],
        (p["eta"] * shaft / p["N"] - p["Bg"] * generator - torque) / p["Jg"],
        rotor - generator / p["N"],
        p["a"] * (u[0] * p["conv"] - torque),
    ]


def _gusts(rng: np.random.Generator, seconds: float) -> tuple[Array, Array]:
    """Return the converter's torque, and a rotor's torque that nearly balances it, new every 10 s."""
    t = np.arange(0, seconds, 10.0)
    torque = rng.uniform(14_000, 20_000, len(t))
    return t, np.stack([torque, (torque + 45.6 * 152.0) * 95 / 0.97 * rng.uniform(0.97, 1.03, len(t))], 1)


_SHAFT = {"Jr": 55e6, "Jg": 390.0, "K": 2.7e9, "B": 775.49, "Br": 7.11, "Bg": 45.6, "N": 95.0, "eta": 0.97, "a": 50.0}

#: Odgaard, Stoustrup, Kinnaert: Fault-Tolerant Control of Wind Turbines: A Benchmark Model (2013), its drive train.
WIND = Plant(
    "wind",
    written(
        unknown=dict.fromkeys(("wr", "wg", "th", "Tg", "Tr", "tw"), ""),
        known=("uT", "uR", "r1", "r2", "g1", "g2", "tg"),
        faults=dict.fromkeys(("f_wr1", "f_wr2", "f_wg1", "f_wg2", "f_Tgm", "f_conv", "f_tr"), ""),
        parameters=_SHAFT,
        e1=("Tr = uR * (1 + f_tr)", "Tr"),
        e2=("tw = K * th + B * (wr - wg / N)", "tw th"),
        e3=("Jr * der(wr) = Tr - tw - Br * wr", "der(wr) Tr tw"),
        e4=("Jg * der(wg) = eta * tw / N - Bg * wg - Tg", "der(wg) tw Tg"),
        e5=("der(th) = wr - wg / N", "der(th) wr wg"),
        e6=("der(Tg) = a * (uT * (1 + f_conv) - Tg)", "der(Tg) Tg"),
        e7=("r1 = wr + f_wr1", "wr"),
        e8=("r2 = wr + f_wr2", "wr"),
        e9=("g1 = wg + f_wg1", "wg"),
        e10=("g2 = wg + f_wg2", "wg"),
        e11=("tg = Tg + f_Tgm", "Tg"),
    ),
    0.01,
    _SHAFT | {"r1": 0.0, "r2": 0.0, "g1": 0.0, "g2": 0.0, "tg": 0.0, "conv": 1.0, "tr": 1.0},
    lambda p: (1.6, 152.0, (17_000 + 45.6 * 152.0) * 95 / 0.97 / p["K"], 17_000.0),
    _turbine,
    _gusts,
    lambda x, u, p: (*u, x[0] + p["r1"], x[0] + p["r2"], x[1] + p["g1"], x[1] + p["g2"], x[3] + p["tg"]),
    ("uT", "uR", "r1", "r2", "g1", "g2", "tg"),
    (0.0, 0.0, 0.0251, 0.0251, 0.0158, 0.0158, 0.9),
    {
        "f_wr1": {"r1": 0.2}, "f_wr2": {"r2": 0.2}, "f_wg1": {"g1": 5.0}, "f_wg2": {"g2": 5.0}, "f_Tgm": {"tg": 1000.0},
        "f_conv": {"conv": 0.95}, "f_tr": {"tr": 0.95},
    },
    ("Jr", "Jg", "K", "B"),
    (0.0, 0.0, 0.01, 0.01, 0.25, 0.25, 85.0),
    """uncertain = { Jr = "20 %", Jg = "20 %", K = "20 %", B = "20 %" }
sensors.r1 = { gain = "1 %", bias = 0.02 }
sensors.r2 = { gain = "1 %", bias = 0.02 }
sensors.g1 = { gain = "1 %", bias = 0.5 }
sensors.g2 = { gain = "1 %", bias = 0.5 }
sensors.tg = { gain = "1 %", bias = 170.0 }
""",
    "start = { wr = 1.6, wg = 152.0, th = 8.68e-4, Tg = 17000.0 }\nsettle_s = 5\nconfirm_s = 2\n"
    "noise = { r1 = 0.0251, r2 = 0.0251, g1 = 0.0158, g2 = 0.0158, tg = 0.9 }\n",
    60.0,
)  # fmt: skip

#: By name.
PLANTS = {plant.name: plant for plant in (SPRING, BUCK, MOTOR, TANKS, WIND)}
