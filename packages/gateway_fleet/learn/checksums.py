"""The checksum that frames have: a known rule, else a sum, an exclusive or, or any CRC with its constants."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain
from typing import Any

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal

from gateway.signals.bits import field_of, mask_of
from gateway.signals.payloads import bits_of
from gateway.signals.protection.crc import KNOWN
from gateway.signals.protection.rules import RULES
from gateway_fleet.learn.claims import RIGHT, Claim, called_checksum, covered, fitting, owned, proven
from gateway_fleet.learn.counters import CounterFound, signal_of
from gateway_fleet.learn.crcs import crcs
from gateway_fleet.learn.protection_check import Payloads, judged

Keys = dict[str, Any]

#: Frames that a rule must have before the others are looked at.
FIRST_LOOK = 12
#: Bits of a checksum: of one that is called so, of another.
LEAST_BITS, LEAST_BITS_UNNAMED, MOST_BITS = 4, 8, 64
#: Fields of a message that are not called checksums, and looked at as if they were.
MOST_UNNAMED = 8
#: A field that is not called a checksum is taken for one if this number of bytes beside it change, one may count. So
#: many must change in both halves before a constant is learned beside them: else it is not seen how they go in.
LEAST_BYTES = 2
#: Payloads that two rules must agree on to be one.
MADE_UP = 256
#: Share of its frames from which on a rule is the message's, though others are wrong.
MOSTLY = 0.6


def candidates(message: Message, frames: Payloads, counter: CounterFound | None) -> list[Signal]:
    """Return the signals that may be the checksum: those that are called so first, then what looks like one."""
    named, others = [], []
    undescribed = [each for each in _undescribed(message) if _busy(each, message, frames, counter)]
    for signal in message.signals:
        if signal.is_float or signal.is_signed or signal.length > MOST_BITS or signal.multiplexer_ids:
            continue
        if counter is not None and signal.name == counter.signal:
            continue
        if called_checksum(signal.name) and signal.length >= LEAST_BITS:
            named.append(signal)
        elif signal.length >= LEAST_BITS_UNNAMED and signal.length % 8 == 0 and _busy(signal, message, frames, counter):
            others.append(signal)
    return named + (undescribed + others)[:MOST_UNNAMED]


def _undescribed(message: Message) -> list[Signal]:
    """Return the bytes that no signal of the database lies in, as a configuration names them, the last first."""
    from cantools.database.can.signal import Signal as Made  # noqa: PLC0415 - not where no database is read

    taken = 0
    for signal in message.signals:
        taken |= mask_of(field_of(signal))
    return [Made(f"byte {k}", 8 * k, 8) for k in reversed(range(message.length)) if not taken >> (8 * k) & 0xFF]


def _busy(signal: Signal, message: Message, frames: Payloads, counter: CounterFound | None) -> bool:
    """Return whether a field changes as a checksum does, and other bytes do, too."""
    values = bits_of(frames.words, field_of(signal))
    if len(np.unique(values)) < min(24, len(frames) // 8):
        return False
    own = mask_of(field_of(signal))
    if counter is not None:
        own |= mask_of(field_of(signal_of(message, counter)))
    changing = (frames.bytes != frames.bytes[0]).any(axis=0)
    least = LEAST_BYTES if counter is None else LEAST_BYTES - 1
    return sum(bool(moved) and not own >> (8 * k) & 0xFF for k, moved in enumerate(changing)) >= least


def rule_claim(message: Message, counter: CounterFound | None, found_with: Payloads, proof: Payloads) -> Claim | None:
    """Return the carmaker's rule that frames of a message have, None if there is none.

    Args:
        message: whose frames all have its length.
        counter: of the message, for lists of ids by its value.
        found_with: frames, different ones.
        proof: others.
    """
    return _first(message, counter, found_with, proof, _named)


def any_claim(message: Message, counter: CounterFound | None, found_with: Payloads, proof: Payloads) -> Claim | None:
    """Return a known CRC, a sum, an exclusive or, or a CRC with any polynomial; arguments of :func:`rule_claim`."""
    return _first(message, counter, found_with, proof, _unnamed)


def rivals(message: Message, claim: Claim, counter: CounterFound | None, frames: Payloads) -> list[list[Claim]]:
    """Return the rules that frames have, each with those that are the same for this message; the claim's come first.

    Two rules that say the same of all frames seen may differ on those to come: where only a counter moves a sum is an
    exclusive or.

    Args:
        message: of the frames.
        claim: rule that was found; of an E2E profile, whose header says more, no rivals are looked for.
        counter: of the message.
        frames: all.
    """
    name = (claim.keys.get("checksum") or claim.keys.get("crc") or {}).get("signal")
    signal = next((each for each in (*message.signals, *_undescribed(message)) if each.name == name), None)
    if signal is None:
        return [[claim]]
    rng = np.random.default_rng(0)
    random = rng.integers(0, 256, (MADE_UP, 8 * frames.words.shape[1]), np.uint8)
    random[:, message.length :] = 0
    keep = owned(claim.protection.field)
    if counter is not None:  # its values were all seen
        keep = keep | owned(field_of(signal_of(message, counter)))
    seen = frames[rng.integers(0, len(frames), MADE_UP)]
    made_up = Payloads(seen.words & keep | random.view(np.uint64) & ~keep, seen.lengths)
    kinds = {judged(made_up, claim.protection).computed.tobytes(): [claim]}
    for keys in chain(
        _rules(message, signal, counter, frames),
        (keys for keys, _ in _unnamed(message, signal, counter, frames)),
    ):
        asked = fitting(message, keys)
        assert asked is not None
        made = Claim(keys, asked, len(frames), int(judged(frames, asked).good.sum()))
        kinds.setdefault(judged(made_up, asked).computed.tobytes(), []).append(made)
    return list(kinds.values())


def nearly(message: Message, counter: CounterFound | None, frames: Payloads) -> Claim | None:
    """Return a carmaker's rule, or a known CRC, that most frames have, but not all; None: there is none.

    Args:
        message: of the frames.
        counter: of the message.
        frames: different ones.
    """
    alive = {} if counter is None else {"counter": counter.keys(signal_of(message, counter).length)}
    for signal in candidates(message, frames, counter):
        rules = [{"checksum": {"rule": rule, "signal": signal.name}} for rule in RULES]
        crcs_ = [{"crc": {"signal": signal.name, "algorithm": k}} for k, c in KNOWN.items() if c.width == signal.length]
        for keys in (*rules, *(rule | alive for rule in rules if alive), *crcs_):
            asked = fitting(message, keys)
            if asked is None:
                continue
            good = judged(frames, asked).good
            if MOSTLY <= good.mean() < RIGHT and proven(message, keys, frames[good], hypotheses=1 << 8) is not None:
                return Claim(keys, asked, len(frames), int(good.sum()))
    return None


Hypotheses = Callable[[Message, Signal, CounterFound | None, Payloads], Iterator[tuple[Keys, int]]]


def _first(
    message: Message, counter: CounterFound | None, found_with: Payloads, proof: Payloads, hypotheses: Hypotheses
) -> Claim | None:
    for signal in candidates(message, found_with, counter):
        for keys, free_bits in hypotheses(message, signal, counter, found_with):
            claim = proven(message, keys, proof, free_bits=free_bits, hypotheses=1 << 8)
            if claim is not None:
                return claim
    return None


def _named(
    message: Message, signal: Signal, counter: CounterFound | None, frames: Payloads
) -> Iterator[tuple[Keys, int]]:
    """Yield rules that fit the frames, and the bits that were free to be chosen for them [bit]."""
    yield from ((keys, 0) for keys in _rules(message, signal, counter, frames))


def _unnamed(
    message: Message, signal: Signal, counter: CounterFound | None, frames: Payloads
) -> Iterator[tuple[Keys, int]]:
    """Yield rules that fit the frames, and the bits that were free to be chosen for them [bit]."""
    values = bits_of(frames.words, field_of(signal))
    if signal.length > 8 and int(np.bitwise_or.reduce(values ^ values[0])) != (1 << signal.length) - 1:
        return  # the checksum may be a part of the field: that of a byte never carries into the next one
    yield from ((keys, 16) for keys in _known(message, signal, frames))
    if signal.length <= 16:
        yield from ((keys, signal.length) for keys in _sums(message, signal, frames))
    yield from crcs(message, signal, counter, frames, _ranges(message, signal))


def _fits(message: Message, keys: Keys, frames: Payloads) -> bool:
    asked = fitting(message, keys)
    if asked is None or not judged(frames[:FIRST_LOOK], asked).good.all():
        return False
    return bool(judged(frames, asked).good.mean() > 0.98)


def _rules(message: Message, signal: Signal, counter: CounterFound | None, frames: Payloads) -> Iterator[Keys]:
    """Yield the carmakers' rules that fit; those that go by the counter's value with its name."""
    alive: Keys = {}
    if counter is not None:
        alive = {"counter": counter.keys(signal_of(message, counter).length)}
    for rule in RULES:
        keys = {"checksum": {"rule": rule, "signal": signal.name}}
        if _fits(message, keys, frames):
            yield keys
        elif alive and _fits(message, keys | alive, frames):
            yield keys | alive


def _known(message: Message, signal: Signal, frames: Payloads) -> Iterator[Keys]:
    """Yield the known CRCs, alone and with the identifier as data id."""
    low, high = message.frame_id & 0xFF, message.frame_id >> 8 & 0xFF
    for name, crc in KNOWN.items():
        if crc.width != signal.length:
            continue
        for data_id in (None, message.frame_id & 0xFFFF, {"bytes": [low, high], "place": "before"}):
            more = {} if data_id is None else {"data_id": data_id}
            keys = {"crc": {"signal": signal.name, "algorithm": name, **more}}
            if _fits(message, keys, frames):
                yield keys


def _ranges(message: Message, signal: Signal) -> Iterator[Keys]:
    """Yield ranges of a checksum: the whole payload, the bytes after its own, the bytes before it."""
    yield {}
    own = mask_of(field_of(signal))
    bytes_ = [k for k in range(message.length) if own >> (8 * k) & 0xFF]
    if bytes_[0] > 0 and bytes_[-1] + 1 < message.length:  # else one of these is the whole payload
        yield {"over": (bytes_[-1] + 1, message.length)}
        yield {"over": (0, bytes_[0])}


def _sums(message: Message, signal: Signal, frames: Payloads) -> Iterator[Keys]:
    """Yield sums and exclusive ors with the constant that the first frame asks for, those that need none first.

    A constant may stand for bits that did not change: of two rules the one without it says more of what will come.
    """
    limit = (1 << signal.length) - 1
    found: list[tuple[int, Keys]] = []
    for over in _ranges(message, signal):
        for rule in ("sum", "xor"):
            for of in ("bytes", "nibbles"):
                for negative in (False, True) if rule == "sum" else (False,):
                    keys: Keys = {"rule": rule, "signal": signal.name, "of": of, **over}
                    if negative:
                        keys["negative"] = True
                    asked = fitting(message, {"checksum": keys})
                    if asked is None:
                        continue
                    first = judged(frames[:1], asked)
                    one, other = int(first.received[0]), int(first.computed[0])
                    plus = one ^ other if rule == "xor" else (one - other) & limit
                    made = {"checksum": keys | ({"plus": plus} if plus else {})}
                    if _fits(message, made, frames) and (not plus or _shown(message, made, frames)):
                        found.append((plus, made))
    yield from (made for _, made in sorted(found, key=lambda one: one[0] != 0))


def _shown(message: Message, keys: Keys, frames: Payloads) -> bool:
    """Return whether frames show how bytes go in: enough of them change in both halves."""
    asked = fitting(message, keys)
    assert asked is not None
    mask = covered(frames, asked, message.length)
    changed = Payloads(np.bitwise_or.reduce((frames.words ^ frames.words[0]) & mask, axis=0)[None], frames.lengths)
    return int(((changed.bytes & 0xF > 0) & (changed.bytes >> 4 > 0)).sum()) >= LEAST_BYTES
