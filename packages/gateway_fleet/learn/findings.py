"""Faults that the learning drive itself may have: nothing is learned of them in silence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gateway_fleet.learn.gaps import CYCLIC, SLOW_NS, WINDOW_NS, cycle_ns, sending
from gateway_fleet.learn.observe import Observation, Seen
from gateway_fleet.learn.protections import ProtectionFound

#: A cyclic message was gone for this number of its cycles, and this time [ns].
GONE, GONE_NS = 20.0, 1_000_000_000
#: It came twice as often where a row of its gaps took less than this share of its time.
TWICE = 0.6
#: It froze where no more than this share of its other frames repeat the one before, of this number.
REPEATED, LEAST_FRAMES = 0.002, 100


def findings(
    observation: Observation, found: Mapping[tuple[int, str], ProtectionFound], buses: Sequence[str]
) -> list[str]:
    """Return them, one line each: checksums that some frames do not have, messages gone, frozen, or sent twice."""
    said = []
    for key, seen in observation.seen.items():
        name = f"{buses[key[0]]}.{key[1]}"
        nearly = found[key].nearly
        if nearly is not None:
            said.append(
                f"{name}: {nearly.protection.name} is right in {nearly.matched} of {nearly.frames} different frames"
                f" ({100 * nearly.matched / nearly.frames:.0f} %): its sender or another gave wrong ones"
            )
        said += [f"{name}: {text}" for text in _of_time(seen)]
    return said


def _of_time(seen: Seen) -> list[str]:
    gaps, samples = seen.gaps, seen.samples
    cycle = cycle_ns(gaps)
    if cycle == 0.0:
        return []
    said, least_ns = [], max(GONE * cycle, GONE_NS)
    if gaps.largest_ns > least_ns:
        said.append(f"gone for {gaps.largest_ns * 1e-9:.1f} s while others came; its cycle is {cycle * 1e-6:.3g} ms")
    twice = [
        row * cycle
        for row, span_ns in gaps.spans_ns.items()
        if row * cycle >= WINDOW_NS and 0 < span_ns < TWICE * row * cycle
    ]
    if twice and cycle <= SLOW_NS and sending(gaps) == CYCLIC:
        said.append(f"sent twice as often as its cycle for {0.5e-9 * max(twice):.1f} s and more")
    others = seen.frames - samples.rest_frames
    if (
        samples.rest_ns > least_ns
        and others >= LEAST_FRAMES
        and samples.again - samples.rest_frames <= REPEATED * others
    ):
        said.append(f"frozen for {samples.rest_ns * 1e-9:.1f} s; else no frame repeats the one before")
    return said
