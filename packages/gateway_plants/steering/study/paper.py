"""What a reader of paper 001 looks for, beside what comes out here."""

from __future__ import annotations

from collections.abc import Sequence

from gateway_bench.cli.study import Claim, claim
from gateway_plants.steering.study.estimators import EKF3, FF, FF_HELD, LO, NAMES, REDUCED, WARM, Accuracy
from gateway_plants.steering.study.operations import Load

#: Table 1: multiplications, integrators, trigonometric and logic.
TABLE_1 = {
    "Luenberger": (19, 3, 4),
    "reduced Luenberger": (24, 2, 4),
    "EKF3 dq": (115, 13, 4),
    "feedforward": (7, 2, 6),
}
OBSERVERS = tuple(NAMES[k] for k in (LO, REDUCED, EKF3))
FEEDFORWARD, HELD = NAMES[FF], NAMES[FF_HELD]


def claims(estimators: Sequence[Accuracy], loads: Sequence[Load]) -> list[Claim]:
    """Return what the paper has, and what comes out here: 1 ms, means of voltages in the stator's frame."""
    by = {
        (row.estimator, row.resistance): row for row in estimators if (row.period_ms, row.voltages) == (1, "alpha beta")
    }

    def each(name: str, resistance: float = 1.0, form: str = ".0f") -> str:
        """Return an error of the three observers, then of the feedforward filter, then of the one that is held."""
        values = [getattr(by[one, resistance], name) for one in (*OBSERVERS, FEEDFORWARD, HELD)]
        shown = [format(value, form) for value in values]
        return f"{', '.join(shown[:3])} against {shown[3]}, held {shown[4]} deg"

    def follow(name: str, resistance: float = 1.0) -> bool:
        """Tell whether all three observers are better than the feedforward filter, held or not."""
        worst = max(getattr(by[one, resistance], name) for one in OBSERVERS)
        return bool(worst < min(getattr(by[one, resistance], name) for one in (FEEDFORWARD, HELD)))

    found = []
    counted = {row.method: (row.multiplications, row.integrators, row.trigonometric_and_logic) for row in loads}
    for method, printed in TABLE_1.items():
        ours, why = counted[method], "how it counts is not said"
        text = f"Table 1: {method}"
        found.append(claim(text, ", ".join(map(str, printed)), ", ".join(map(str, ours)), printed == ours, why))
    costs = sorted(TABLE_1, key=lambda method: counted[method][0])
    order = sorted(TABLE_1, key=lambda method: TABLE_1[method][0])
    found.append(claim("Table 1: cheapest, dearest", f"{order[0]}, {order[-1]}", f"{costs[0]}, {costs[-1]}",
                       (costs[0], costs[-1]) == (order[0], order[-1])))  # fmt: skip
    why = "the load is taken for speed; the order depends on what is held at rest"
    found.append(claim("Figs. 4, 5, conclusion: observers track, feedforward drifts; rms", "observers better",
                       each("angle_rms"), follow("angle_rms"), why))  # fmt: skip
    found.append(claim("the same, worst in a second of rest", "observers better", each("standstill"),
                       follow("standstill"), why))  # fmt: skip
    fast, least = by[FEEDFORWARD, 1.0].fast, min(by[one, 1.0].fast for one in OBSERVERS)
    found.append(claim("Fig. 6: above 20 rad/s, drift in 50 ms", "feedforward better", each("fast", form=".2f"),
                       fast < least, "the reduced observer is better; with a warm winding none is"))  # fmt: skip
    still, load = by[NAMES[EKF3], 1.0].standstill, by["EKF4 dq + load", 1.0].standstill
    found.append(claim("Fig. 7: EKF at rest keeps an offset; an extra state cures it", "no number",
                       f"{still:.0f} deg in 1 s; with the load as a state {load:.0f}", load < 0.1 * still))  # fmt: skip
    full, reduced = (by[NAMES[k], 1.0].angle_rms for k in (LO, REDUCED))
    found.append(claim("full and reduced observer differ little", "not significant", f"{full:.0f}, {reduced:.0f} deg",
                       abs(full / reduced - 1) < 0.1, "at rest"))  # fmt: skip
    found.append(Claim(f"temperature, future work: resistance {100 * WARM:.0f} %, rms", "none",
                       each("angle_rms", WARM), "measured here alone"))  # fmt: skip
    found.append(Claim("the same, above 20 rad/s", "none", each("fast", WARM, ".2f"), "measured here alone"))
    return found
