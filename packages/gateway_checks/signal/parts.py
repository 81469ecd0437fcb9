"""From the signals that a user names to parts of the monitor, one a message, limits in numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from cantools.database.can.signal import Signal

from gateway.signals.ranges import runs
from gateway_checks.signal.params import (
    MOST_CODES,
    MOST_LEVELS,
    MOST_RANGES,
    MOST_SIGNALS,
    MOST_VALUES,
    Level,
    Limits,
    Params,
    PartParams,
    Watched,
)
from gateway_fdi.errors import Gathered, InputError, nearest, under

#: Texts of values that stand for no value, in capitals.
_NONE = ("SNA", "INVALID", "NOT AVAILABLE", "NOT_AVAILABLE", "UNAVAILABLE", "NOT VALID", "UNDEFINED", "INIT", "ERROR")


def _choices(signal: Signal) -> dict[float, str]:
    """Return the texts of a signal's values: physical value -> text in capitals."""
    found = {}
    for raw, text in (signal.choices or {}).items():
        found[float(raw * signal.scale + signal.offset)] = str(text).upper()
    return found


def _is_none(text: str) -> bool:
    words = text.replace("_", " ").split()
    return any(name in text if " " in name or "_" in name else name in words for name in _NONE)


def no_value(signal: Signal) -> tuple[float, ...]:
    """Return the values of a signal that stand for none, by the texts that the database gives them."""
    return tuple(sorted(value for value, text in _choices(signal).items() if _is_none(text)))


def _codes(limits: Limits, signal: Signal, key: str) -> tuple[float, ...]:
    """Return the values that stand for no value.

    Raises:
        InputError: a text that no value has; too many.
    """
    choices = _choices(signal)
    if limits.invalid == "auto":
        found = list(no_value(signal))
    else:
        found = []
        for asked in limits.invalid:
            if isinstance(asked, str):
                having = [value for value, text in choices.items() if text == asked.upper()]
                if not having:
                    known = list(choices.values())
                    text = f"no value of {limits.signal} has this text{nearest(asked.upper(), known)}"
                    raise InputError(text, key=f"{key}.invalid", value=asked)
                found += having
            else:
                found.append(float(asked))
    if len(found) > MOST_CODES:
        raise InputError(f"at most {MOST_CODES} invalid codes", key=f"{key}.invalid", value=len(found))
    return tuple(sorted(found))


def _levels(limits: Limits, signal: Signal, find: Callable[[str], Signal], key: str) -> tuple[Level, ...]:
    """Return the multiplexers that select a signal, the outermost first.

    Raises:
        InputError: there is none, but its absence is to be watched; more than there is room for.
    """
    if limits.missing_ms is not None and signal.multiplexer_signal is None:
        text = "this signal is in every frame of its message; timeout_ms of the message's check watches that"
        raise InputError(text, key=f"{key}.missing_ms", value=limits.missing_ms)
    message = limits.signal.rpartition(".")[0]
    found: list[Level] = []
    while signal.multiplexer_signal is not None:
        name = f"{message}.{signal.multiplexer_signal}"
        outer = find(name)
        ranges = _selecting(outer, signal.multiplexer_ids or ())
        if len(ranges) > MOST_RANGES or len(found) == MOST_LEVELS:
            text = f"at most {MOST_LEVELS} multiplexers above one another, with {MOST_RANGES} ranges of values each"
            raise InputError(text, key=f"{key}.signal", value=limits.signal)
        found.append(Level(multiplexer=name, ranges=ranges))
        signal = outer
    return tuple(reversed(found))


def _selecting(multiplexer: Signal, ids: Iterable[int]) -> tuple[tuple[float, float], ...]:
    """Return the ranges of a multiplexer's value in which its raw number is one of some, half a step wider."""
    ends = 1 << multiplexer.length
    raws = runs(ids)
    if multiplexer.is_signed:
        parts = (
            (max(low, half), min(high, half + ends // 2 - 1), half) for low, high in raws for half in (0, ends // 2)
        )
        raws = [(low - 2 * half, high - 2 * half) for low, high, half in parts if low <= high]
    half = abs(multiplexer.scale) / 2
    found = [sorted(raw * multiplexer.scale + multiplexer.offset for raw in ends_of) for ends_of in raws]
    return tuple((float(least - half), float(greatest + half)) for least, greatest in found)


def _watched(limits: Limits, signal: Signal, code: str, levels: tuple[Level, ...], key: str) -> Watched:
    """Return a signal with its limits in numbers.

    Raises:
        InputError: something that the database does not say, or that cannot be.
    """
    values: tuple[float, ...] = ()
    if limits.undefined:
        values = tuple(sorted(_choices(signal)))
        if not values:
            raise InputError("the database gives its values no texts", key=f"{key}.undefined", value=limits.signal)
        if len(values) > MOST_VALUES:
            raise InputError(f"at most {MOST_VALUES} values", key=f"{key}.undefined", value=len(values))
    ones = None
    if limits.all_ones:
        if signal.is_float:
            raise InputError("a floating-point signal", key=f"{key}.all_ones", value=limits.signal)
        raw = -1 if signal.is_signed else (1 << signal.length) - 1
        ones = float(raw * signal.scale + signal.offset)
    name = limits.name or limits.signal.rpartition(".")[2]
    return Watched(
        limits=limits, name=name, code=code, unit=signal.unit or "",
        codes=_codes(limits, signal, key), values=values, ones=ones, levels=levels,
    )  # fmt: skip


def parts(
    p: Any, find: Callable[[str], Signal], give: Callable[[Iterable[str]], Mapping[str, str]]
) -> dict[str, PartParams]:
    """Return the parts of the monitor by name, one or more a message.

    Args:
        p: parameters as configured.
        find: ``"Message.Signal"`` -> the signal.
        give: names -> a network code for each.

    Raises:
        InputError: a signal that is not there; something that the database does not say.
    """
    assert isinstance(p, Params)
    codes = give(limits.signal for limits in p.signal if limits.code is None)
    by_message: dict[str, list[Watched]] = {}
    wrong = Gathered()
    for k, limits in enumerate(p.signal):
        with wrong:
            watched = _one(limits, find, limits.code or codes[limits.signal], f"signal[{k}]")
            by_message.setdefault(limits.signal.rpartition(".")[0], []).append(watched)
    wrong.check()
    return {
        f"{message}.{at // MOST_SIGNALS}": PartParams(signal=tuple(w.limits for w in some), watched=tuple(some))
        for message, found in by_message.items()
        for at in range(0, len(found), MOST_SIGNALS)
        for some in [found[at : at + MOST_SIGNALS]]
    }


def _one(limits: Limits, find: Callable[[str], Signal], code: str, key: str) -> Watched:
    """Return one signal with its limits in numbers.

    Raises:
        InputError: as :func:`parts`.
    """
    with under(f"{key}.signal", limits.signal):
        signal = find(limits.signal)
    _refuse_unknown(limits, find, key)
    watched = _watched(limits, signal, code, _levels(limits, signal, find, key), key)
    if watched.codes or watched.values or watched.ones is not None or _asks(limits):
        return watched
    raise InputError("nothing is asked of it", key=key, value=limits.signal)


def _refuse_unknown(limits: Limits, find: Callable[[str], Signal], key: str) -> None:
    """Refuse a signal that says when another must move, and is not there."""
    for name in ("during", "moving"):
        other = None if limits.stuck is None else getattr(limits.stuck, name)
        if other is not None:
            with under(f"{key}.stuck.{name}", other):
                find(other)


def _asks(p: Limits) -> bool:
    asked = (p.electrical, p.plausible, p.gradient, p.stuck, p.noise, p.missing_ms)
    return any(limit is not None for limit in asked)
