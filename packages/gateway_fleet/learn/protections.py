"""How a message is protected: counter and checksum, or E2E profile, found in frames and proven on others."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray

from gateway.signals.bits import LONGEST, field_of
from gateway.signals.payloads import bits_of
from gateway.signals.protection.auto import automatic
from gateway_fdi.errors import InputError
from gateway_fleet.learn.checksums import any_claim, nearly, rivals, rule_claim
from gateway_fleet.learn.claims import Claim, called_checksum, proven
from gateway_fleet.learn.counters import CounterFound, candidates, likelier, of_raw
from gateway_fleet.learn.profiles import e2e_claim
from gateway_fleet.learn.protection_check import Payloads

#: Different frames that a rule is looked for in, and that it is proven on, at most.
MOST_FOUND_WITH, MOST_PROOF = 256, 4096


@dataclass(frozen=True)
class ProtectionFound:
    """Protection of a message.

    Attributes:
        counter: alive counter that is a signal; None: there is none, or it belongs to an E2E header.
        claim: checksum or E2E profile; None: none was found.
        unexplained: signals that are called as checksums are, and whose rule was not found.
        frames: different ones that were looked at.
        rules: of the checksum that all of them have, in kinds: two of a kind are the same for this message. Of several
            kinds nobody knows which is the sender's.
        nearly: a rule that most frames have, where none has all; None: there is none.
    """

    counter: CounterFound | None
    claim: Claim | None
    unexplained: tuple[str, ...]
    frames: int
    rules: Sequence[Sequence[Claim]] = ()
    nearly: Claim | None = None

    def among(self, proven_beside: Set[str]) -> ProtectionFound:
        """Return it without rules that others rival, but for one that is proven of other messages of the bus.

        Args:
            proven_beside: names of carmakers' rules.
        """
        if len(self.rules) < 2:
            return self
        backed = [one for kind in self.rules if (one := next((c for c in kind if c.maker in proven_beside), None))]
        return replace(self, claim=backed[0], rules=[backed]) if len(backed) == 1 else replace(self, claim=None)


def protection_found(
    message: Message,
    file: Path,
    runs: Sequence[Payloads],
    *,
    whole: bool = True,
    cycles: Sequence[NDArray[np.float64]] | None = None,
) -> ProtectionFound:
    """Find what protects a message.

    Args:
        message: in its database.
        file: the database.
        runs: frames of it, each run without a gap.
        whole: False: only its counter is looked for.
        cycles: of each run, the times of its frames in cycles of the message; None: it has no cycle.
    """
    named = tuple(signal.name for signal in message.signals if called_checksum(signal.name))
    if message.length > LONGEST:  # which neither has a rule
        return ProtectionFound(None, None, named, 0)
    frames, follows, between = joined(message.length, runs, cycles)
    counter = _counter(message, frames, follows, between)
    if not whole:
        return ProtectionFound(counter, None, named, len(frames))
    found_with, proof = _split(frames)
    claim = said = None
    if len(found_with):
        said = _as_the_database_says(message, file, _all(found_with, proof))
        claim = (
            said
            # A maker's rule has no constant of its own that frames could have been taken for: all of them prove it.
            or rule_claim(message, counter, found_with, _all(found_with, proof))
            or e2e_claim(message, found_with, proof)
            or any_claim(message, counter, found_with, proof)
        )
    if claim is not None and "e2e" in claim.keys:
        counter = None
    taken = set() if claim is None else {str(part.get("signal")) for part in claim.keys.values()}
    left = () if claim is not None and "e2e" in claim.keys else tuple(name for name in named if name not in taken)
    rules: list[list[Claim]] = []
    if claim is not None:
        rules = [[claim]] if claim is said else rivals(message, claim, counter, _all(found_with, proof))
    mostly = nearly(message, counter, _all(found_with, proof)) if claim is None and len(found_with) else None
    return ProtectionFound(counter, claim, left, len(found_with) + len(proof), rules, mostly)


def joined(
    length: int, runs: Sequence[Payloads], cycles: Sequence[NDArray[np.float64]] | None
) -> tuple[Payloads, NDArray[np.bool_], NDArray[np.float64] | None]:
    """Return the frames of a length of all runs, whether the next one follows each, and the cycles between them."""
    right = [run[run.lengths == length] for run in runs]
    words = np.concatenate([run.words for run in right]) if right else np.zeros((0, 8), np.uint64)
    lengths = np.concatenate([run.lengths for run in right]) if right else np.zeros(0, np.int64)
    between = None
    if cycles is not None and right:
        times = [time[run.lengths == length] for time, run in zip(cycles, runs, strict=True)]
        between = np.diff(np.concatenate(times))
    return Payloads(words, lengths), _follows([len(run) for run in right]), between


def _follows(lengths: Sequence[int]) -> NDArray[np.bool_]:
    """Return for each frame but the last whether the next one is of the same run."""
    ends = np.cumsum(lengths)
    follows = np.ones(max(int(ends[-1]) - 1, 0) if len(ends) else 0, np.bool_)
    for end in ends[:-1]:
        if 0 < end <= len(follows):
            follows[end - 1] = False
    return follows


def _counter(
    message: Message, frames: Payloads, follows: NDArray[np.bool_], cycles: NDArray[np.float64] | None
) -> CounterFound | None:
    if len(frames) < 2:
        return None
    fields = candidates(message)
    each: list[tuple[tuple[bool, bool, bool], int, CounterFound]] = []
    for signal in fields:
        raw = bits_of(frames.words, field_of(signal)).astype(np.int64)
        found = of_raw(signal.name, raw, follows, signal.length, cycles, len(fields))
        rank = None if found is None else likelier(found, signal.length)
        if found is not None and rank is not None and not (called_checksum(signal.name) and (rank[1] or rank[2])):
            each.append((rank, len(each), found))
    return min(each)[2] if each else None


def _split(frames: Payloads) -> tuple[Payloads, Payloads]:
    """Return different frames in two heaps: to find a rule with, and to prove it on."""
    if not len(frames):
        return frames, frames
    _, places = np.unique(frames.words, axis=0, return_index=True)
    places = np.sort(places)
    half = min(MOST_FOUND_WITH, len(places) // 2)
    # The first heap is a piece of the drive, so that its counter goes up; the second is spread over all of it.
    rest = places[half:]
    step = max(1, len(rest) // MOST_PROOF)
    return frames[places[:half]], frames[rest[::step]]


def _all(one: Payloads, other: Payloads) -> Payloads:
    return Payloads(np.concatenate([one.words, other.words]), np.concatenate([one.lengths, other.lengths]))


def _as_the_database_says(message: Message, file: Path, proof: Payloads) -> Claim | None:
    """Return what names and attributes say, if the frames prove it."""
    said, _ = automatic(message, file)
    keys: dict[str, Any] = said.model_dump(exclude_unset=True, exclude_none=True, exclude={"counter", "protection"})
    try:
        return proven(message, keys, proof) if keys else None
    except InputError:
        return None  # it does not fit the message: a counter that the rule needs has another name
