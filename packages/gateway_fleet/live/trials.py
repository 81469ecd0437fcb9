"""A campaign in a car: in shadow, then reporting, then back; what is known of it survives the process.

=========  =====================================================================================================
state      the new limits
=========  =====================================================================================================
``shadow`` judge in a process of their own, which hears the same frames and tells nobody
``waits``  were no worse in shadow; the car is in no share yet
``active`` judge, and report; the memory says so with each failure
``back``   do not judge: told more causes, were withdrawn, are over or were never taken
=========  =====================================================================================================
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from gateway.config.load import config_of
from gateway.faults.fleet import FleetParams
from gateway_fdi.common.log import get_logger
from gateway_fdi.common.tomlfile import parse_toml, read_toml, validate
from gateway_fdi.errors import GatewayError
from gateway_fleet.live.campaign import BY_CHANCE, Campaign, above_rate, accepted, is_in, more_often
from gateway_fleet.live.limits import LimitsFile, applied
from gateway_fleet.live.signed_documents import KEYS, Keyring, content_of, next_keyring, opened, to_toml

SHADOW, WAITS, ACTIVE, BACK = "shadow", "waits", "active", "back"

log = get_logger(__name__)


class ShadowRun(Protocol):
    """A gateway that judges with other limits and reports nothing."""

    def begin(self, tables: dict[str, Any]) -> None:
        """Begin with the tables of a configuration."""

    def end(self) -> None:
        """End it, if it runs."""


@dataclass
class State:
    """Knowledge of a car's campaigns that is kept.

    Attributes:
        serial: greatest that was seen; nothing older is taken.
        state: of the last campaign, one of the above; "": there was none.
        document: that campaign, signed.
        keyring: that is believed, signed; "": the one that came with the car.
        hours, told, causes: in shadow: time, causes told by the new limits, and by the car's own.
        active_hours, active_causes: time in which they report, and causes told.
        bytes: of recordings that were told for it; ``recorded_ns``: when the last of them was [ns].
    """

    serial: int = 0
    state: str = ""
    document: str = ""
    keyring: str = ""
    hours: float = 0.0
    told: int = 0
    causes: int = 0
    active_hours: float = 0.0
    active_causes: int = 0
    bytes: int = 0
    recorded_ns: int = 0


class Trials:
    """Campaigns in a car.

    Args:
        car: the car; it has a file of limits.
        config: its configuration.
        keys: keyring that came with the car.
        file: where the state is kept.
        shadow: runs a gateway beside.
        reload: has the daemon read its configuration again.
        post: takes events for the fleet.

    Raises:
        GatewayError: the keyring is none of this fleet.
    """

    def __init__(
        self,
        car: FleetParams,
        config: Path,
        keys: Path,
        file: Path,
        *,
        shadow: ShadowRun,
        reload: Callable[[], None],
        post: Callable[[dict[str, Any]], None],
    ) -> None:
        assert car.limits is not None
        self._car, self._config, self._file, self._limits = car, config, file, Path(car.limits)
        self._shadow, self._reload, self._post = shadow, reload, post
        self.state = _read(file)
        self._keyring = self._believed(keys)
        self.campaign = self._current()
        if self.campaign is not None and self.state.state == SHADOW:
            self._begin_shadow(self.campaign)

    def _believed(self, keys: Path) -> Keyring:
        """Return the keyring that came with the car, or one that a root of it has led to."""
        document = keys.read_bytes()
        first = validate(_toml(document), Keyring, keys)
        found = opened(document, KEYS, first.root, Keyring)
        if found.fleet != self._car.name:
            raise GatewayError(f"{keys}: keys of fleet {found.fleet}; the car is of {self._car.name}")
        kept = self.state.keyring.encode()
        later = validate(_toml(kept), Keyring, self._file) if kept else found
        return later if later.serial > found.serial else found

    def _current(self) -> Campaign | None:
        """Return the campaign of the state; the state's file is the car's own: it was looked at when it came."""
        if self.state.state in ("", BACK):
            return None
        return validate(_toml(self.state.document.encode()), Campaign, self._file)

    # Documents

    def offer(self, document: bytes, now: datetime | None = None) -> str:
        """Take a document that came; returns why it is not taken, "" if it is."""
        try:
            if document.startswith(f"#signed {KEYS} ".encode()):
                self._keyring = next_keyring(document, self._keyring)
                self.state.keyring = document.decode()
                self._save()
                log.info("keys of the fleet have changed", serial=self._keyring.serial)
            else:
                self._take(accepted(document, self._keyring, self._car, self.state.serial, now or _now()), document)
        except GatewayError as error:
            log.warning("a document of the fleet is not taken", reason=str(error))
            return str(error)
        return ""

    def _take(self, campaign: Campaign, document: bytes) -> None:
        """Take a campaign that may be taken."""
        self.state.serial = campaign.serial
        self._save()
        before = self.campaign
        if campaign.withdrawn:
            if before is not None and before.name == campaign.name:
                self._back("withdrawn by the fleet")
            return
        if before is not None and (before.name, before.limit) == (campaign.name, campaign.limit):
            self.campaign, self.state.document = campaign, document.decode()
            self._save()
            self._settle()
            return
        if before is not None:
            self._back(f"campaign {campaign.name} comes after it")
        try:
            self._tables(campaign)
        except GatewayError as error:
            self._say(campaign, BACK, f"not taken: {error}")
            raise
        self.campaign = campaign
        self.state = State(campaign.serial, SHADOW, document.decode(), self.state.keyring)
        self._save()
        self._say(campaign, SHADOW, "")
        self._begin_shadow(campaign)
        self._settle()

    def _tables(self, campaign: Campaign) -> dict[str, Any]:
        """Return the configuration's tables with the limits of a campaign.

        Raises:
            GatewayError: they are not for this car, or change too much.
        """
        limits = LimitsFile(serial=campaign.serial, limit=campaign.limit)
        made = applied(read_toml(self._config), limits, self._car.most_change)
        config_of(made, self._config)
        return made

    def _begin_shadow(self, campaign: Campaign) -> None:
        try:
            self._shadow.begin(self._tables(campaign))
        except (GatewayError, OSError) as error:
            self._back(f"no shadow: {error}")

    # Time

    def drove(self, hours: float, causes: int, shadow_causes: int, now: datetime | None = None) -> None:
        """Note time driven, causes that the gateway told in it, and those that the shadow would have told."""
        if self.campaign is None:
            return
        if self.campaign.until <= (now or _now()):
            self._back("it is over")
            return
        state = self.state
        if state.state == SHADOW:
            state.hours += hours
            state.told += shadow_causes
            state.causes += causes
        elif state.state == ACTIVE:
            state.active_hours += hours
            state.active_causes += causes
        self._save()
        self._settle()

    def give_up(self, reason: str) -> None:
        """Have the configuration's own limits judge: the campaign cannot go on."""
        if self.campaign is not None:
            self._back(reason)

    def _settle(self) -> None:
        """Go on to the next state, if it is time."""
        campaign, state = self.campaign, self.state
        if campaign is None:
            return
        if state.state == SHADOW and state.hours >= campaign.shadow_hours:
            self._shadow.end()
            if more_often(state.told, state.hours, state.causes, state.hours) < BY_CHANCE:
                self._back("in shadow it would have told more causes")
                return
            self._change(WAITS, "no more causes in shadow")
        if state.state == WAITS and is_in(campaign.share, campaign.fleet, campaign.name, self._car.car):
            limits = [one.model_dump() for one in campaign.limit]
            _write(self._limits, to_toml({"serial": campaign.serial, "limit": limits}))
            self._change(ACTIVE, f"in a share of {campaign.share:.0%}")
            self._reload()
        if state.state == ACTIVE:
            chance = above_rate(state.active_causes, state.active_hours, campaign.control_per_hour)
            if chance < BY_CHANCE:
                self._back("it tells more causes than cars without it")

    def _change(self, state: str, reason: str) -> None:
        self.state.state = state
        self._save()
        if self.campaign is not None:
            self._say(self.campaign, state, reason)

    def _back(self, reason: str) -> None:
        """Have the configuration's own limits judge."""
        self._shadow.end()
        active = self._limits.exists()
        self._limits.unlink(missing_ok=True)
        self._change(BACK, reason)
        self.campaign = None
        if active:
            self._reload()

    def _say(self, campaign: Campaign, state: str, reason: str) -> None:
        log.info("campaign", campaign=campaign.name, serial=campaign.serial, state=state, reason=reason)
        active = bool(self.state.active_hours)
        hours, causes = (
            (self.state.active_hours, self.state.active_causes) if active else (self.state.hours, self.state.causes)
        )
        self._post({
            "event": "campaign", "t_ns": int(_now().timestamp() * 1e9), "serial": campaign.serial,
            "campaign": campaign.name, "state": state, "reason": reason, "hours": hours, "causes": causes,
            "told": self.state.told,
        })  # fmt: skip

    def _save(self) -> None:
        _write(self._file, json.dumps(asdict(self.state)))


def _now() -> datetime:
    return datetime.now(UTC)


def _toml(document: bytes) -> dict[str, Any]:
    return parse_toml(content_of(document))


def _write(path: Path, text: str) -> None:
    """Write a file that is there whole or not at all, and on the disk."""
    part = path.with_name(f".{path.name}.part")
    with part.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def _read(path: Path) -> State:
    """Return the state that was kept.

    Raises:
        GatewayError: it makes no sense: with a new one older campaigns could come again.
    """
    if not path.exists():
        return State()
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        made = State()
        for name, value in found.items():
            setattr(made, name, type(getattr(made, name))(value))
        return made
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise GatewayError(f"{path}: no state of campaigns: {error}; take it away to begin again") from error
