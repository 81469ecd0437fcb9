"""Faults of a signal, each with its failure type (SAE J2012-DA, table of failure type bytes)."""

from __future__ import annotations

from gateway.monitors.contract import MAX_RESULTS, Blame, Debounce, Fault
from gateway_checks.signal.params import MOST_SIGNALS, PartParams, Watched

BELOW, ABOVE, LOW, HIGH, GRADIENT, STUCK, INVALID, UNDEFINED, ALL_ONES, NOISE, MISSING = range(11)

#: Kind -> name, failure type byte, description, what to do.
KINDS = (
    ("below", "21", "below what its circuit can give", "check the sensor's wires: short to ground, open circuit"),
    ("above", "22", "above what its circuit can give", "check the sensor's wires: short to battery, open circuit"),
    ("low", "84", "below the plausible range", "compare with another measurement; check the sensor"),
    ("high", "85", "above the plausible range", "compare with another measurement; check the sensor"),
    ("gradient", "27", "changes faster than it can", "check for a loose contact"),
    ("stuck", "2A", "does not move where it must", "check the sensor, its mounting, and its sender"),
    ("invalid", "86", "its sender says that it has no value", "read the sender's own DTCs"),
    ("undefined", "81", "has a value that the database does not know", "check the sender's software and the database"),
    ("all_ones", "29", "all bits are set", "check the sender: not initialised, or no value"),
    ("noise", "2F", "scatters more than it may", "check screening and ground of the sensor"),
    ("missing", "31", "does not come while its message does", "check which multiplexed signals the sender sends"),
)
assert MOST_SIGNALS * len(KINDS) <= MAX_RESULTS, "a part reports all that it finds"

#: Share of the errors of a signal that its own limits see: the others leave it plausible.
_SEEN = 0.5
#: How likely a signal does not move where it must, because the other one is wrong that says so.
_BESIDE = 0.01
#: How likely it does not move where it must, because its message repeats one payload: all of 21 that were tried.
_STANDS = 1.1

#: Its time has passed when a test fails, and one frame that has the signal is all that it needs.
_AT_ONCE = Debounce(failed_after=1, passed_after=1, jump_down=True)


def kinds_of(watched: Watched) -> list[int]:
    """Return which faults a signal can have."""
    p = watched.limits
    asked = (
        p.electrical is not None,
        p.electrical is not None,
        p.plausible is not None,
        p.plausible is not None,
        p.gradient is not None,
        p.stuck is not None,
        bool(watched.codes),
        bool(watched.values),
        watched.ones is not None,
        p.noise is not None,
        p.missing_ms is not None,
    )
    return [kind for kind, is_asked in enumerate(asked) if is_asked]


def _tested(kind: int, watched: Watched) -> str:
    """Return what a kind of fault compares with its limit, with its unit."""
    unit = watched.unit
    if kind in (BELOW, ABOVE, LOW, HIGH):
        return f"value [{unit}]" if unit else "value"
    if kind == GRADIENT:
        return f"change [{unit or 'its unit'}/s]"
    if kind == NOISE:
        return f"scatter [{unit}]" if unit else "scatter"
    stuck = watched.limits.stuck
    if kind == STUCK and stuck is not None and stuck.moving is None:
        return "share of values that move" if stuck.share is not None else "does not move for [s]"
    return "away [s]" if kind == MISSING else ""


def faults(p: PartParams) -> tuple[Fault, ...]:
    """Return the faults of a part's signals, in the order of the signals and of :data:`KINDS`."""
    found = []
    for watched in p.watched:
        unit = f" [{watched.unit}]" if watched.unit else ""
        debounce = Debounce(failed_ms=watched.limits.failed_ms, passed_ms=watched.limits.passed_ms)
        stuck = watched.limits.stuck
        for kind in kinds_of(watched):
            name, failure_type, text, remedy = KINDS[kind]
            found.append(
                Fault(
                    f"{watched.name}.{name}",
                    f"{watched.code}-{failure_type}",
                    f"{watched.limits.signal}: {text}",
                    ("away [s]",) if kind == MISSING else (f"value{unit}", f"before{unit}"),
                    _AT_ONCE if kind == MISSING else debounce,
                    remedy=remedy,
                    tested=_tested(kind, watched),
                    window_s=stuck.seconds or 0.0 if kind == STUCK and stuck is not None else 0.0,
                )
            )
    return tuple(found)


def blames(p: PartParams) -> dict[str, list[Blame]]:
    """Return what each fault blames: its signal; one that does not move, its message and what says that it must."""
    found = {}
    for watched in p.watched:
        own = watched.limits.signal
        asked = watched.limits.stuck
        other = None if asked is None else asked.during or asked.moving
        kinds = kinds_of(watched)
        for kind in kinds:
            beside = [Blame(other, share=_BESIDE)] if kind == STUCK and other not in (None, own) else []
            beside += [Blame(own, "frozen", _STANDS)] if kind == STUCK else []
            found[f"{watched.name}.{KINDS[kind][0]}"] = [Blame(own, share=_SEEN / len(kinds)), *beside]
    return found
