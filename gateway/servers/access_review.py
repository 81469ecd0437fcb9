"""Errors and weak places of rules of access: for the check of a configuration, not for the gateway."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from gateway.servers.access import FREE, GUARDED, ROUTE, SESSIONLESS, SESSIONS, Access, AccessParams, Needs, opened_by
from gateway.signals.protection.params import CHECKSUM_KEYS, ProtectionParams
from gateway_fdi.errors import InputError, nearest


def wrong_rules(
    params: AccessParams, levels: Sequence[int], roles: Sequence[str] = (), uds: Collection[str] = ()
) -> Iterator[InputError]:
    """Yield the rules that no asker can meet.

    Args:
        params: all rules that the configuration gives.
        levels: security levels that there are.
        roles: that there are.
        uds: names of the rules that the UDS server's own table gives.
    """
    for name in (*GUARDED, *FREE, ROUTE):
        rule: Access | None = getattr(params, name)
        if rule is None:
            continue
        table = "output.uds" if name in uds else "access"
        for k, role in enumerate(rule.roles):
            if role not in roles:
                there = ", ".join(roles) or "none"
                text = f"there is no such role (output.uds.authentication.roles: {there}){nearest(role, roles)}"
                yield InputError(text, key=f"{table}.{name}.roles[{k}]", value=role)
        if rule.roles and name in ("session", "authenticate"):
            text = "nobody has a role in the default session, so that this could never be met"
            yield InputError(text, key=f"{table}.{name}.roles", value=", ".join(rule.roles))
        if not rule.security:
            continue
        key = f"{table}.{name}.security"
        if rule.security not in levels:
            there = ", ".join(str(level) for level in levels) or "none"
            yield InputError(f"no such security level is set up (output.uds.security: {there})", key=key,
                             value=rule.security)  # fmt: skip
        elif name in ("session", "unlock"):
            text = "nothing is unlocked in the default session, so that this could never be met"
            yield InputError(text, key=key, value=rule.security)


def forgeable(
    needs: Needs, asked: Mapping[str, tuple[str, str]], checked: Mapping[str, ProtectionParams], accepted: Sequence[str]
) -> tuple[list[InputError], list[str]]:
    """Return conditions of access that one forged frame meets, as errors, and what other frames open, one line each.

    Args:
        needs: of each intervention.
        asked: signal of conditions -> a key that asks for it; its message, as ``bus.Message``.
        checked: message -> how it is protected; messages that are not checked are missing.
        accepted: signals whose messages need no protection.
    """
    wrong, told = [], []
    for k, name in enumerate(accepted):
        if name not in asked:
            text = f"no condition of access asks for this signal{nearest(name, asked)}"
            wrong.append(InputError(text, key=f"access.unprotected[{k}]", value=name))
    for signal, (key, message) in asked.items():
        protection, opens = checked.get(message, ProtectionParams()), opened_by(needs, signal)
        tied = any(getattr(protection, name) is not None for name in CHECKSUM_KEYS)
        counted = any(getattr(protection, name) is not None for name in ("counter", "e2e", "secoc"))
        if not opens or (tied and counted):
            continue
        locks = ", beside a key or role" if all(needs[name].is_locked for name in opens) else ""
        what = f"meets it and opens {', '.join(opens)}{locks}"
        if tied:
            told.append(f"{key}: {message} has a checksum and no counter: a frame of before, sent again, {what}")
        elif counted:
            told.append(f"{key}: {message} has a counter and no checksum: a forged frame that counts on {what}")
        elif signal in accepted:
            told.append(f"{key}: {message} has no checksum and no counter: one forged frame {what}; it is accepted")
        else:
            text = (
                f"{message} has no checksum, no counter and no SecOC here: one forged frame {what}; have its protection"
                f' checked ([[bus.check]]), or accept it: [access] unprotected = ["{signal}"]'
            )
            wrong.append(InputError(text, key=key, value=signal))
    return wrong, told


def ways_around(needs: Needs, levels: Sequence[int], *, uds: bool, obd: bool, j1939: bool) -> Iterator[str]:
    """Yield the ways by which an intervention is easier than it looks, one line each.

    Args:
        needs: of each intervention.
        levels: security levels that there are.
        uds: whether there is a UDS server.
        obd: whether there is an OBD server.
        j1939: whether there is a J1939 server.
    """
    if uds:
        yield from _open_doors(needs, levels)
    clear = needs["clear"]
    for name, there in (("obd_clear", obd), ("j1939_clear", j1939)):
        need, what = needs[name], SESSIONLESS[name]
        if not there or not need.allowed:
            continue
        if uds and clear.is_locked:
            lock = f"security level {clear.security}" if clear.security else "role"
            yield f"access.{name}: {what} can clear without the {lock} that 0x14 needs"
        if uds and set(clear.when) - set(need.when):
            yield f"access.{name}: {what} can clear without the conditions that 0x14 needs"
        if not clear.is_locked and not need.when:
            yield f"access.{name}: anybody on the bus can clear by {what} at any time: no condition, no security"


def _open_doors(needs: Needs, levels: Sequence[int]) -> Iterator[str]:
    """Yield what is guarded and is not, and services that do what another one guards better."""
    bare = [name for name in GUARDED if not needs[name].is_locked and not needs[name].when]
    for name in bare:
        if levels or SESSIONS["default"] in needs[name].sessions:
            where = "any" if SESSIONS["default"] in needs[name].sessions else "the extended"
            yield f"access.{name}: anybody may do 0x{GUARDED[name]:02X} in {where} session: no condition, no security"
    if not levels and len(bare) == len(GUARDED):
        yield (
            "access: anybody who begins the extended session may clear, reset and switch monitoring off: no condition"
            " ([access] when), no security level ([output.uds] security)"
        )
    reset, routine = needs["reset"], needs["routine"]
    if (reset.is_locked and not routine.is_locked) or set(reset.when) - set(routine.when):
        yield "access.routine: routine 0x0201 begins a new operation cycle with less than 0x11 needs"
