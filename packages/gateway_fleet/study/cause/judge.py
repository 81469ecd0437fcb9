"""What diagnoses are worth, against what was put in."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gateway_fleet.study.cause.cases import Truth
from gateway_fleet.study.cause.drive import Told

#: Where more than two groups are looked at together: diagnoses of each.
_EACH = 4
#: Nothing else may have so much of the first one's probability.
_TENTH = 0.1
#: Share of the first one's probability from which on another one is as likely: they are told with four digits.
_EQUAL = 0.995


@dataclass(frozen=True)
class Verdict:
    """What came of one run.

    Attributes:
        before: a cause was told, or a fault failed, before any was there.
        seen: a test failed while the fault was there.
        place: of the truth among diagnoses, but for what is alike, 1: the first; 0: it is none of them.
        told_apart: nothing is alike: by the model's structure no other parts explain all that these faults do.
        alone: it is the first, and nothing else has a tenth of its probability.
        cause: it is told as the cause, and nothing else.
        chance: probability of the likeliest of what was told last, with all that is the truth if it is; 0: nothing.
        right: 1: it is the truth; 0: it is not; of several that are told as equally likely, the share that is.
        healthy: healthy components that were told as a cause at some time.
        last: what was told last, for people.
    """

    before: bool
    seen: bool
    place: int
    told_apart: bool
    alone: bool
    cause: bool
    chance: float
    right: float
    healthy: tuple[str, ...]
    last: str


def judge(
    told: Sequence[Told],
    truths: Sequence[Truth],
    begin_s: float,
    end_s: float,
    alike: Collection[Truth] = (),
) -> Verdict:
    """Judge what was told of faults that were there from one time to another.

    Args:
        told: what was told.
        truths: of each fault.
        begin_s: when the first of them begins [s].
        end_s: when the last one ends [s].
        alike: other parts that explain all that the faults do; with more parts, they still do.
    """
    during = [one for one in told if begin_s <= one.t_s <= end_s and one.groups]
    before = any(one.t_s < begin_s and one.groups for one in told)
    right = frozenset().union(*truths)
    causes = {name for one in during for group in one.groups for name in group["cause"] or ()}
    healthy = tuple(sorted(causes - right))
    if not during:
        return Verdict(before, False, 0, not alike, False, False, 0.0, 0.0, healthy, "")
    groups = during[-1].groups
    (_, chance), *_ = every = _together(groups)
    equal = [_is(chosen, truths) for chosen, p in every if p >= _EQUAL * chance]
    hit = sum(equal) / len(equal)
    if hit == 1.0:
        chance = min(sum(p for chosen, p in every if _is(chosen, truths)), 1.0)
    weighed = [one for one in every if _is(one[0], truths) or not any(less <= one[0] for less in alike)]
    places = [k for k, chosen in enumerate((chosen for chosen, _ in weighed), 1) if _is(chosen, truths)]
    whole = [group["cause"] for group in groups]
    near = [chosen for chosen, p in weighed if p >= _TENTH * weighed[0][1]]
    alone = bool(near) and all(_is(chosen, truths) for chosen in near)
    cause = None not in whole and _is(frozenset(itertools.chain.from_iterable(whole)), truths)
    place = places[0] if places else 0
    return Verdict(before, True, place, not alike, alone, cause, chance, hit, healthy, _text(groups))


def _is(chosen: frozenset[str], truths: Sequence[Truth]) -> bool:
    return len(chosen) == len(truths) and all(chosen & truth for truth in truths)


def _together(groups: Sequence[Mapping[str, Any]]) -> list[tuple[frozenset[str], float]]:
    """Return what may be wrong as a whole with its probability, likeliest first."""
    each = [group["causes"][: _EACH if len(groups) > 2 else None] for group in groups]
    whole = [
        (
            frozenset(itertools.chain.from_iterable(one["components"] for one in chosen)),
            math.prod(one["probability"] for one in chosen),
        )
        for chosen in itertools.product(*each)
    ]
    return sorted(whole, key=lambda one: -one[1])


def _text(groups: Sequence[Mapping[str, Any]]) -> str:
    return " | ".join(
        f"{'+'.join(g['failed'])}: "
        + ", ".join(f"{' & '.join(c['components']) or 'false alarm'} {c['probability']:.3g}" for c in g["causes"][:3])
        for g in groups
    )
