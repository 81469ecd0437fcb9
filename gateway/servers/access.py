"""Rules of access: one for each kind of intervention, by any protocol.

Reading is free. An intervention that blinds the gateway, clears its memory, or changes kept values is *guarded*: unless
its rule says otherwise it needs the extended session, the lowest security level where there are any, and the conditions
of ``[access] when``. Protocols that know no sessions (OBD mode 04; DM3 and DM11) may clear where ``clear`` needs no
security; those conditions hold for them as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from gateway.faults.settings import ConditionSettings
from gateway_fdi.common.tomlfile import StrictModel

#: Diagnostic sessions by name (ISO 14229-1, 0x10).
SESSIONS = {"default": 0x01, "extended": 0x03}
_ALL = frozenset(SESSIONS.values())
_EXTENDED = frozenset({SESSIONS["extended"]})

#: Interventions of testers by UDS, and the service. Those that are guarded unless a rule says otherwise stand first.
GUARDED = {
    "reset": 0x11,
    "clear": 0x14,
    "communication": 0x28,
    "write": 0x2E,
    "routine": 0x31,
    "dtc_setting": 0x85,
}
FREE = {
    "session": 0x10,
    "read_dtcs": 0x19,
    "read_data": 0x22,
    "unlock": 0x27,
    "authenticate": 0x29,
    "events": 0x86,
}
#: Passing on of what does more than read, to ECUs behind a route.
ROUTE = "route"
#: Clearing by protocols that know no sessions.
SESSIONLESS = {"obd_clear": "OBD mode 04", "j1939_clear": "DM3 and DM11"}


class Conditions(StrictModel):
    """Signals in ranges."""

    when: tuple[ConditionSettings, ...] | None = Field(
        None, description="signals in ranges, else refused (0x22); default of what is guarded: those of [access]"
    )

    @field_validator("when")
    @classmethod
    def _now(cls, when: tuple[ConditionSettings, ...] | None) -> tuple[ConditionSettings, ...] | None:
        if any(condition.rise for condition in when or ()):
            raise ValueError("rise is for operation cycles, not for conditions of access")
        return when


class Access(Conditions):
    """In which sessions something is allowed, at which security level, and when."""

    sessions: tuple[Literal["default", "extended"], ...] = Field(
        ("default", "extended"), min_length=1, description="sessions in which it is allowed"
    )
    security: int = Field(0, ge=0, le=33, description="security level that it needs, 0: none")
    roles: tuple[str, ...] = Field((), description="roles (0x29) of which it needs one; none: anybody")


class SessionlessAccess(Conditions):
    """Whether something is allowed by a protocol that knows no sessions, and when."""

    allowed: bool | None = Field(None, description="default: if clear needs neither security nor a role")


class AccessParams(StrictModel):
    """Rules of access; one that is given replaces its default whole, but for ``when``."""

    when: tuple[ConditionSettings, ...] = Field(
        (), description="conditions of everything that is guarded, e.g. that the vehicle stands"
    )
    unprotected: tuple[str, ...] = Field(
        (),
        description="signals that conditions of access may ask for, though their messages have no checksum, no counter"
        " and no SecOC, so that one forged frame meets them",
    )
    stale_ms: float = Field(
        1000.0, gt=0, le=60_000, allow_inf_nan=False, description="a signal is unknown when it is older [ms]"
    )
    local_unlocked: bool = Field(
        False,
        description="true: interventions that need a security level or a role are open to the status socket, the page's"
        " control token and gateway faults clear",
    )
    watched: bool = Field(True, description="false: monitoring that is switched off is reported, but is no fault")
    trace_did: int | None = Field(
        0xFD10, ge=0x0100, le=0xFEFF, description="data identifier that reads interventions; none: it is not read"
    )
    session: Access | None = Field(None, description="entering another than the default session (0x10)")
    reset: Access | None = Field(None, description="reset (0x11)")
    clear: Access | None = Field(None, description="clearing (0x14)")
    read_dtcs: Access | None = Field(None, description="reading DTCs (0x19)")
    read_data: Access | None = Field(None, description="reading data (0x22)")
    unlock: Access | None = Field(None, description="security access (0x27)")
    authenticate: Access | None = Field(None, description="authentication (0x29)")
    communication: Access | None = Field(None, description="switching communication off (0x28)")
    write: Access | None = Field(None, description="writing (0x2E)")
    routine: Access | None = Field(None, description="routines (0x31)")
    dtc_setting: Access | None = Field(None, description="switching the setting of DTCs off (0x85)")
    events: Access | None = Field(None, description="responses on events (0x86)")
    route: Access | None = Field(
        None,
        description="requests by a route beside reading (10 01, 19, 22, 3E, OBD but 04 and 08); none: they are refused",
    )
    obd_clear: SessionlessAccess | None = Field(None, description="clearing by OBD (mode 04)")
    j1939_clear: SessionlessAccess | None = Field(None, description="clearing by J1939 (DM3, DM11)")

    @model_validator(mode="after")
    def _conditions_now(self) -> Self:
        if any(condition.rise for condition in self.when):
            raise ValueError("rise is for operation cycles, not for conditions of access")
        return self


@dataclass(frozen=True)
class Need:
    """Conditions of an intervention.

    Attributes:
        sessions: numbers of the sessions in which it is allowed.
        security: security level, 0: none.
        roles: of which the tester must have one; none: anybody.
        when: conditions on signals, all of which must be met.
        allowed: False: it is refused in any case.
    """

    sessions: frozenset[int] = _ALL
    security: int = 0
    when: tuple[ConditionSettings, ...] = ()
    allowed: bool = True
    roles: frozenset[str] = frozenset()

    @property
    def is_locked(self) -> bool:
        """Whether it needs a key or a role."""
        return bool(self.security or self.roles)


#: Conditions of each intervention, by its name.
Needs = Mapping[str, Need]


def needs_of(
    params: AccessParams, levels: Sequence[int], allowed_elsewhere: Mapping[str, bool], roles: Sequence[str] = ()
) -> Needs:
    """Return what each intervention needs.

    Args:
        params: the rules that the configuration gives.
        levels: security levels that there are.
        allowed_elsewhere: what keys of other tables allow or not, of interventions without sessions.
        roles: that there are; without security levels what is guarded needs any of them.
    """
    found: dict[str, Need] = {}
    least = min(levels, default=0)
    for name in (*GUARDED, *FREE):
        guarded = name in GUARDED
        rule: Access | None = getattr(params, name)
        when = params.when if guarded else ()
        if rule is None:
            any_role = frozenset(() if least else roles)
            found[name] = Need(_EXTENDED, least, when, roles=any_role) if guarded else Need()
            continue
        found[name] = _need_of(rule, when)
    route = params.route
    found[ROUTE] = Need(allowed=False) if route is None else _need_of(route, params.when)
    clear = found["clear"]
    for name in SESSIONLESS:
        other: SessionlessAccess = getattr(params, name) or SessionlessAccess()
        allowed = allowed_elsewhere.get(name) if other.allowed is None else other.allowed
        found[name] = Need(
            when=clear.when if other.when is None else other.when,
            allowed=not clear.is_locked if allowed is None else allowed,
        )
    return found


def _need_of(rule: Access, when: tuple[ConditionSettings, ...]) -> Need:
    sessions = frozenset(SESSIONS[session] for session in rule.sessions)
    return Need(sessions, rule.security, when if rule.when is None else rule.when, roles=frozenset(rule.roles))


def opened_by(needs: Needs, signal: str) -> list[str]:
    """Return the interventions whose conditions ask for a signal."""
    return [name for name, need in needs.items() if need.allowed and any(one.signal == signal for one in need.when)]


def signals_of(needs: Needs) -> set[str]:
    """Return the signals that conditions ask for, by their names in the configuration."""
    return {condition.signal for need in needs.values() for condition in need.when}
