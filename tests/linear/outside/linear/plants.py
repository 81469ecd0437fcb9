"""Three plants of other make, one of them not linear: own equations, parameters and solver.

Each gives its true matrices for any physical parameters, so that a user's parameters can be told wrong: the gateway is
configured with the matrices of the wrong ones.

Sources: 747: Matlab's "jetdemo" (Boeing 747, Mach 0.8, 40 000 ft), lateral motion. Tanks: Johansson, "The
quadruple-tank process", IEEE Trans. CST 8(3), 2000, Table I, P-, minimum phase.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import expm


@dataclass(frozen=True)
class Plant:
    """A plant.

    ``build``: parameters -> A, B; ``c``; ``names``: inputs, outputs; ``noise``: of outputs; ``state_noise``: per root
    of a second; ``resolution``: of each signal, inputs first; ``drive``: (rng, samples) -> commands; ``faults``: name
    -> size; ``slopes``: of a plant that is not linear, (levels' deviation, commands) -> derivatives.
    """

    name: str
    parameters: dict
    build: object
    c: np.ndarray
    inputs: tuple
    outputs: tuple
    period: float
    noise: np.ndarray
    state_noise: np.ndarray
    resolution: tuple
    drive: object
    actuator: np.ndarray
    sensor: np.ndarray
    sizes: dict = field(default_factory=dict)
    slopes: object = None

    def wrong(self, share, rng):
        """Return A, B with each parameter off by ``share``, up or down."""
        off = {k: v * (1.0 + share * rng.choice([-1.0, 1.0])) for k, v in self.parameters.items()}
        return self.build(**off)

    @property
    def true(self):
        return self.build(**self.parameters)


def _servo(L, R, k, Jm, Jl, c, d, bm, bl):
    a = [
        [-R / L, -k / L, 0, 0],
        [k / Jm, -(bm + d) / Jm, d / Jm, -c / Jm],
        [0, d / Jl, -(bl + d) / Jl, c / Jl],
        [0, 1, -1, 0],
    ]
    return np.array(a, float), np.array([[1 / L], [0], [0], [0]], float)


def _steps(levels, hold_s, period, smooth_s=0.0):
    """Return a driver: steps to random levels, held for about hold_s, through a first-order lag."""

    def drive(rng, samples):
        u = np.zeros((samples, len(levels)))
        for i, level in enumerate(levels):
            k = 0
            while k < samples:
                length = max(round(rng.uniform(0.3, 1.7) * hold_s / period), 1)
                u[k : k + length, i] = rng.uniform(-level, level)
                k += length
            if smooth_s:
                keep, value = np.exp(-period / smooth_s), 0.0
                for k in range(samples):
                    value = keep * value + (1 - keep) * u[k, i]
                    u[k, i] = value
        return u

    return drive


SERVO = Plant(
    "servo",
    {"L": 6e-3, "R": 1.1, "k": 0.09, "Jm": 3e-4, "Jl": 9e-4, "c": 4.0, "d": 0.02, "bm": 2e-4, "bl": 1.5e-3},
    _servo,
    np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0]], float),
    ("U",),
    ("WM", "WL", "I"),
    0.005,
    np.array([0.3, 0.3, 0.03]),
    np.array([0.02, 1.0, 1.0, 1e-3]),
    (1e-3, 0.02, 0.02, 1e-3),
    _steps([12.0], 1.6, 0.005),
    np.array([0.3]),
    np.array([3.0, 3.0, 0.3]),
    {"WM": 8.0, "WL": 8.0, "I": 0.8, "U": 1.0, "U3": 3.0},
)

_747_A = [[-0.0558, -0.9968, 0.0802, 0.0415], [0.598, -0.115, -0.0318, 0], [-3.05, 0.388, -0.465, 0], [0, 0.0805, 1, 0]]
_747_B = [[0.00729, 0.0], [-0.475, 0.00775], [0.153, 0.143], [0, 0]]


def _jet(**entries):
    a, b = np.array(_747_A), np.array(_747_B)
    for name, value in entries.items():
        matrix = a if name[0] == "a" else b
        matrix[int(name[1]), int(name[2])] = value
    return a, b


JET = Plant(
    "jet",
    {f"a{i}{j}": _747_A[i][j] for i in range(4) for j in range(4) if _747_A[i][j] not in (0, 1)}
    | {f"b{i}{j}": _747_B[i][j] for i in range(4) for j in range(2) if _747_B[i][j]},
    _jet,
    np.eye(4),
    ("RUD", "AIL"),
    ("BETA", "YAW", "ROLL", "PHI"),
    0.05,
    np.array([2e-3, 1e-3, 2e-3, 2e-3]),
    np.array([2e-4, 2e-4, 5e-4, 1e-5]),
    (1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4),
    _steps([0.04, 0.08], 4.0, 0.05, 0.3),
    np.array([0.01, 0.02]),
    np.array([0.02, 0.01, 0.02, 0.02]),
    {"BETA": 0.06, "YAW": 0.03, "ROLL": 0.06, "PHI": 0.06, "RUD": 0.03, "AIL": 0.06},
)


def _tanks(A1, A2, A3, A4, a1, a2, a3, a4, k1, k2, g1, g2):
    h, g = np.array([12.4, 12.7, 1.8, 1.4]), 981.0
    area, hole = np.array([A1, A2, A3, A4]), np.array([a1, a2, a3, a4])
    time = area / hole * np.sqrt(2 * h / g)
    a = np.diag(-1.0 / time)
    a[0, 2], a[1, 3] = A3 / (A1 * time[2]), A4 / (A2 * time[3])
    b = np.zeros((4, 2))
    b[0, 0], b[1, 1] = g1 * k1 / A1, g2 * k2 / A2
    b[2, 1], b[3, 0] = (1 - g2) * k2 / A3, (1 - g1) * k1 / A4
    return a, b


TANKS = Plant(
    "tanks",
    {
        "A1": 28.0,
        "A2": 32.0,
        "A3": 28.0,
        "A4": 32.0,
        "a1": 0.071,
        "a2": 0.057,
        "a3": 0.071,
        "a4": 0.057,
        "k1": 3.33,
        "k2": 3.35,
        "g1": 0.7,
        "g2": 0.6,
    },
    _tanks,
    np.eye(4),
    ("V1", "V2"),
    ("H1", "H2", "H3", "H4"),
    1.0,
    np.array([0.02, 0.02, 0.02, 0.02]),
    np.array([2e-3, 2e-3, 2e-3, 2e-3]),
    (1e-3, 1e-3, 5e-3, 5e-3, 5e-3, 5e-3),
    _steps([0.8, 0.8], 120.0, 1.0),
    np.array([0.1, 0.1]),
    np.array([0.2, 0.2, 0.2, 0.2]),
    {"H1": 1.0, "H2": 1.0, "H3": 0.6, "H4": 0.6, "V1": 0.4, "V2": 0.4},
)


def _torricelli(p, v0=3.0):
    """Return the tanks' own equations, as deviations from where pumps of v0 keep them."""
    area, hole = (np.array([p[f"{letter}{k}"] for k in (1, 2, 3, 4)]) for letter in "Aa")
    split = np.array([[p["g1"] * p["k1"], 0], [0, p["g2"] * p["k2"]]])
    rest = np.array([[0, (1 - p["g2"]) * p["k2"]], [(1 - p["g1"]) * p["k1"], 0]])
    pump, upper = np.vstack([split, rest]), np.array([[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0], [0, 0, 0, 0]])
    drain = upper - np.eye(4)
    begin = (np.linalg.solve(-drain, pump @ [v0, v0]) / hole) ** 2 / 1962.0

    def slopes(x, u):
        return (drain @ (hole * np.sqrt(1962.0 * np.maximum(begin + x, 0.0))) + pump @ (v0 + u)) / area

    return slopes


#: The tanks as they are: their levels move by up to half of themselves, what drains by its root.
LEVELS = replace(TANKS, name="levels", slopes=_torricelli(TANKS.parameters))

PLANTS = {plant.name: plant for plant in (SERVO, JET, TANKS)}


@dataclass(frozen=True)
class Fault:
    """A fault: ``part``: input or output; ``kind``: offset, gain, stuck, drift [1/s], noise; from ``at`` [s] on.

    Warming is none: a gain that goes to ``size`` more within WARM_S.
    """

    part: str
    kind: str
    size: float
    at: float


#: Time in which a sensor warms up [s].
WARM_S = 60.0


def _spoil(column, fault, time, rng):
    """Put a fault into the samples of an input or output, in place."""
    on = time >= fault.at
    if fault.kind == "offset":
        column[on] += fault.size
    elif fault.kind == "drift":
        column[on] += fault.size * (time[on] - fault.at)
    elif fault.kind == "gain":
        column[on] *= fault.size
    elif fault.kind == "warming":
        column[on] *= 1 + fault.size * np.minimum((time[on] - fault.at) / WARM_S, 1.0)
    elif fault.kind == "stuck":
        column[on] = column[np.argmax(on)]
    elif fault.kind == "noise":
        column[on] += rng.normal(0.0, fault.size, on.sum())
    else:
        raise ValueError(fault.kind)


def _held(plant, x, u, parts=5):
    """Return x a period later by Runge and Kutta's rule, commands held."""
    h = plant.period / parts
    for _ in range(parts):
        a = plant.slopes(x, u)
        b = plant.slopes(x + h / 2 * a, u)
        c = plant.slopes(x + h / 2 * b, u)
        x = x + h / 6 * (a + 2 * b + 2 * c + plant.slopes(x + h * c, u))
    return x


def simulate(plant, seconds, rng, faults=()):
    """Return outputs as sensors read them, and commands as told, sample by sample."""
    a, b = plant.true
    n, m = b.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a, b
    whole = expm(block * plant.period)
    phi, gamma = whole[:n, :n], whole[:n, n:]
    samples = round(seconds / plant.period)
    u = plant.drive(rng, samples)
    u = np.round(u / plant.resolution[:m]) * plant.resolution[:m]
    acts = u.copy()
    time = np.arange(samples) * plant.period
    for fault in faults:
        if fault.part in plant.inputs:
            _spoil(acts[:, plant.inputs.index(fault.part)], fault, time, rng)
    w = rng.normal(0.0, 1.0, (samples, n)) * plant.state_noise * np.sqrt(plant.period)
    push = acts @ gamma.T + w
    x, states = np.zeros(n), np.empty((samples, n))
    for k in range(samples):
        states[k] = x
        x = phi @ x + push[k] if plant.slopes is None else _held(plant, x, acts[k]) + w[k]
    y = states @ plant.c.T + rng.normal(0.0, 1.0, (samples, len(plant.c))) * plant.noise
    for fault in faults:
        if fault.part in plant.outputs:
            _spoil(y[:, plant.outputs.index(fault.part)], fault, time, rng)
    return y, u
