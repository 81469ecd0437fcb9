"""A campaign: limits that a fleet's owner signs, for whom, until when. It can do nothing else.

A car takes a campaign of its own fleet, model and software, once, if it is newer than all before. It judges with the
new limits beside the old ones and tells nothing for some hours (shadow); then cars of its share report by them, 1 %,
10 %, all: a car of a smaller share is in each larger one. It goes back by itself.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import datetime
from fnmatch import fnmatchcase

from pydantic import AwareDatetime, Field

from gateway.faults.fleet import NAME, FleetParams
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.errors import InputError
from gateway_fleet.live.limits import Limit
from gateway_fleet.live.signed_documents import CAMPAIGN, Keyring, is_over, opened

#: Shares of the fleet, one after the other.
SHARES = (0.01, 0.1, 1.0)
#: Chance below which causes are told more often than before: in the car itself, and by the fleet's tables.
BY_CHANCE = 1e-3


class Campaign(StrictModel):
    """A change of limits: for whom, until when."""

    fleet: str = Field(pattern=NAME, description="the fleet")
    name: str = Field(pattern=NAME, description="of the campaign")
    serial: int = Field(ge=1, lt=2**53, description="larger than that of all campaigns of the fleet before")
    first: int = Field(0, ge=0, lt=2**53, description="serial number of its first stage; 0: this is the first")
    until: AwareDatetime = Field(description="then the configuration's own limits judge again")
    model: str = Field("*", max_length=64, description="cars of this model line; * and ? stand for others")
    software: str = Field("*", max_length=64, description="cars of this software; * and ? stand for others")
    share: float = Field(0.01, gt=0, le=1, description="share of the cars that report by the limits, after the shadow")
    shadow_hours: float = Field(
        10.0, ge=0, le=1000, description="time driven in which they judge and do not report [h]"
    )
    control_per_hour: float = Field(
        0.01, gt=0, le=1000, description="causes that cars tell by their own limits, as the tables have it [1/h]"
    )
    withdrawn: bool = Field(False, description="the configuration's own limits judge again, now")
    tests: tuple[str, ...] = Field(
        ("*",), max_length=64, description="tests whose statistics are told; * stands for others"
    )
    recordings: tuple[str, ...] = Field(
        (), max_length=64, description="faults whose recorded frames are told; * and ? stand for others"
    )
    bytes: int = Field(1_000_000, ge=0, le=10**9, description="of recordings that a car tells for it, at most")
    limit: tuple[Limit, ...] = Field((), max_length=10_000, description="limits")


def accepted(document: bytes, keyring: Keyring, car: FleetParams, last: int, now: datetime) -> Campaign:
    """Return the campaign of a document, if a car may take it.

    Args:
        document: signed.
        keyring: that the car believes.
        car: the car.
        last: greatest serial number that it has seen.
        now: the time.

    Raises:
        InputError, InputErrors: it may not.
    """
    found = opened(document, CAMPAIGN, keyring.signer, Campaign)
    if found.fleet != car.name:
        raise InputError("a campaign of another fleet", key="fleet", value=found.fleet)
    if found.serial <= last:
        raise InputError(f"not newer than campaign {last}", key="serial", value=found.serial)
    if is_over(found.until, now):
        raise InputError("it is over", key="until", value=found.until.isoformat())
    for name, wanted, own in (("model", found.model, car.model), ("software", found.software, car.software)):
        if not fnmatchcase(own, wanted):
            raise InputError(f"not for this car: {own!r}", key=name, value=wanted)
    return found


def is_in(share: float, fleet: str, name: str, car: str) -> bool:
    """Return whether a car is in a share of the fleet, as a hash of campaign and car draws it."""
    digest = hashlib.sha256(f"{fleet}/{name}/{car}".encode()).digest()
    return int.from_bytes(digest[:7], "big") / 2**56 < share


def more_often(times: int, hours: float, before: int, before_hours: float) -> float:
    """Return the chance of this number of causes, or more, at the rate of before (binomial, given their sum).

    Args:
        times: causes now.
        hours: in which they came [h].
        before: causes of before.
        before_hours: in which those came [h].
    """
    from scipy.stats import binom  # noqa: PLC0415 - slow to load

    if not (times and hours > 0.0 and before_hours > 0.0):
        return 1.0
    return float(binom.sf(times - 1, times + before, hours / (hours + before_hours)))


def above_rate(times: int, hours: float, per_hour: float) -> float:
    """Return the chance of this number of causes, or more, in these hours at a rate (Poisson)."""
    from scipy.stats import poisson  # noqa: PLC0415 - slow to load

    return float(poisson.sf(times - 1, per_hour * hours)) if times else 1.0


def next_stage(
    campaign: Campaign, by_limits: Sequence[tuple[int, int, float]], least_hours: float
) -> tuple[Campaign | None, str]:
    """Return the next stage of a campaign, None: it is not time; and why.

    Args:
        campaign: as it is now.
        by_limits: serial number of the limits that judged, causes, hours driven; 0: the configuration's own.
        least_hours: driven by the new limits before there is a next stage.
    """
    stages = range(campaign.first or campaign.serial, campaign.serial + 1)
    now = [(causes, hours) for serial, causes, hours in by_limits if serial in stages]
    control = [(causes, hours) for serial, causes, hours in by_limits if serial == 0]
    times, hours = sum(c for c, _ in now), sum(h for _, h in now)
    before, before_hours = sum(c for c, _ in control), sum(h for _, h in control)
    said = f"{times} causes in {hours:.1f} h, by their own limits {before} in {before_hours:.1f} h"
    chance = more_often(times, hours, before, before_hours)
    following = campaign.model_copy(update={"serial": campaign.serial + 1, "first": stages.start})
    if chance < BY_CHANCE:
        return following.model_copy(update={"withdrawn": True}), f"withdrawn: {said}, by chance {chance:.1g}"
    if hours < least_hours:
        return None, f"it is not time: {said}; {least_hours:g} h are wanted"
    larger = [share for share in SHARES if share > campaign.share]
    if not larger:
        return None, f"all cars have it: {said}"
    rate = max(before, 1) / max(before_hours, 1.0)
    return following.model_copy(
        update={"share": larger[0], "control_per_hour": min(rate, 1000.0)}
    ), f"{larger[0]:.0%}: {said}"
