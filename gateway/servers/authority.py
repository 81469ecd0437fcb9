"""One authority for every intervention, by any asker: whether it is allowed now, and when its effect ends.

Testers (UDS), scan tools (OBD mode 04, DM3, DM11) and processes of this machine (status socket, page, command line) all
ask here. The rules are those of :mod:`gateway.servers.access`; protocols only put the answer into their own words.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

from gateway.faults.interventions import DONE, Intervention
from gateway.servers.access import SESSIONS, Need, Needs
from gateway.servers.tester_control import TesterControl

#: How often the conditions of lasting interventions are looked at [ns].
WATCH_NS = 100_000_000
_DEFAULT, _EXTENDED = SESSIONS["default"], SESSIONS["extended"]


class Refusal(IntEnum):
    """Why an intervention is refused, as the negative response code of UDS; NONE: it is allowed."""

    NONE = 0x00
    CONDITIONS = 0x22
    SECURITY = 0x33
    ROLE = 0x34
    SESSION = 0x7F

    @property
    def words(self) -> str:
        """The reason for people."""
        return _WORDS[self]


_WORDS = {
    Refusal.NONE: "allowed",
    Refusal.CONDITIONS: "its conditions are not met now ([access] when)",
    Refusal.SECURITY: "it needs a security level, or is not allowed here ([access])",
    Refusal.ROLE: "it needs a role ([access])",
    Refusal.SESSION: "it is not allowed in this session ([access])",
}


@dataclass(frozen=True)
class Asker:
    """An asker, as far as rules look at it.

    Attributes:
        session: number of the diagnostic session; None: of a protocol that knows no sessions.
        security: security level that is unlocked, 0: none.
        role: as which role he is authenticated, "": none.
    """

    session: int | None = None
    security: int = 0
    role: str = ""


#: OBD mode 04, DM3, DM11.
SESSIONLESS_ASKER = Asker()


class Authority:
    """Says of each intervention whether it is allowed, and knows all that is switched off for a while.

    Args:
        needs: conditions of each intervention.
        control: the gateway; says whether conditions are met.
        local_unlocked: whether a process of this machine counts as unlocked.
    """

    def __init__(self, needs: Needs, control: TesterControl, *, local_unlocked: bool = False) -> None:
        self.control = control
        self._needs, self._local_unlocked = needs, local_unlocked
        self._holders: list[Holder] = []

    def need(self, action: str, *, undoing: bool = False) -> Need:
        """Return the conditions of an action; "": an action without a rule. Undoing needs nothing."""
        return self._needs[action] if action and not undoing else Need()

    def session_refusal(self, need: Need, asker: Asker) -> Refusal:
        """Return SESSION if it is not allowed in the asker's session."""
        good = asker.session is None or asker.session in need.sessions
        return Refusal.NONE if good else Refusal.SESSION

    def security_refusal(self, need: Need, asker: Asker) -> Refusal:
        """Return ROLE or SECURITY if the asker lacks it."""
        if need.roles and asker.role not in need.roles:
            return Refusal.ROLE
        good = need.allowed and need.security in (0, asker.security)
        return Refusal.NONE if good else Refusal.SECURITY

    def conditions_refusal(self, need: Need) -> Refusal:
        """Return CONDITIONS if one is not met now."""
        return Refusal.NONE if self.control.meets(need.when) else Refusal.CONDITIONS

    def refusal(self, action: str, asker: Asker) -> Refusal:
        """Return why an asker may not do this now, in the standard's order of checks; NONE: it may."""
        need = self.need(action)
        return self.session_refusal(need, asker) or self.security_refusal(need, asker) or self.conditions_refusal(need)

    def local_refusal(self, action: str) -> Refusal:
        """Return why a process of this machine may not do this now; NONE: it may.

        An action that is not allowed in the default session begins an extended one, as a tester would, by the rule of
        sessions.
        """
        need = self.need(action)
        session = _DEFAULT if _DEFAULT in need.sessions else _EXTENDED
        asker = Asker(session)
        if self._local_unlocked:
            asker = Asker(session, need.security, next(iter(sorted(need.roles)), ""))
        begun = Refusal.NONE if session == _DEFAULT else self.refusal("session", Asker(_DEFAULT))
        return begun or self.refusal(action, asker)

    # Lasting interventions

    def holder(self, name: str, note: Callable[[str], None], *, yields: bool = False) -> Holder:
        """Return a holder that may switch something off for a while.

        Args:
            name: its own; also for people.
            note: keeps and tells that something has ended: its action.
            yields: whether its switching off ends when another holder undoes the same.
        """
        made = Holder(self, name, note, yields=yields)
        self._holders.append(made)
        return made

    def leave(self, holder: Holder) -> None:
        """End all that a holder has switched off that does not come again."""
        holder.end()
        self._holders.remove(holder)

    def lasting(self) -> list[tuple[str, str]]:
        """Return all that is switched off: whose it is, and its action."""
        return [(holder.name, action) for holder in self._holders for action in holder.actions]

    def end_yielding(self, actions: tuple[str, ...]) -> None:
        """End the same actions of holders that give way to an undoing by another."""
        for holder in self._holders:
            if holder.yields:
                holder.end(actions)


#: Longest description of a process and its reason [characters].
MOST_WORDS = 120


def local_intervention(
    action: str, request: bytes, by: str, refusal: Refusal, *, force: bool = False, why: str = ""
) -> Intervention:
    """Return the record of what a process of this machine did, or was refused.

    Args:
        action: name of its rule.
        request: that a tester would have sent.
        by: name of the asker, for people.
        refusal: by the rules.
        force: whether they were overridden.
        why: the reason that was given.
    """
    forced = f"; forced over 0x{refusal:02X}" if force and refusal else "; forced" if force else ""
    words = f"{by}{forced}{f': {why}' if why else ''}"
    told = "".join(c if c.isprintable() else "?" for c in words[:MOST_WORDS])
    outcome = DONE if force else int(refusal)
    return Intervention(0, "local", "", 0, action, request, outcome, role=told)


#: Actions that last until they are undone, or their session ends.
LASTING = ("communication", "dtc_setting")


class Holder:
    """Actions of one asker that last: they end with its session, with their conditions, or when they are undone.

    See :meth:`Authority.holder`.

    Attributes:
        name: its own.
        yields: whether its actions end when another holder undoes the same.
        receive: whether it leaves the reception of normal messages on.
        send: whether it leaves their sending on.
    """

    def __init__(self, authority: Authority, name: str, note: Callable[[str], None], *, yields: bool) -> None:
        self._authority, self._note = authority, note
        self.name, self.yields = name, yields
        self.receive = self.send = True
        self._lasting: dict[str, bool] = {}  # action -> whether it was forced

    @property
    def actions(self) -> list[str]:
        """Its actions that last."""
        return sorted(self._lasting)

    def set_dtcs(self, on: bool, *, forced: bool = False) -> None:
        """Let test results count, or not (ISO 14229-1, 0x85).

        Args:
            on: whether they are to count.
            forced: whether it lasts though its conditions are not met.
        """
        self._mark("dtc_setting", on, forced)
        self._authority.control.set_dtcs(on, self.name)

    def set_communication(self, *, receive: bool, send: bool, forced: bool = False) -> None:
        """Switch normal communication (ISO 14229-1, 0x28); ``forced`` as for :meth:`set_dtcs`."""
        self._mark("communication", receive and send, forced)
        self.receive, self.send = receive, send
        self._authority.control.set_communication(receive=receive, send=send, by=self.name)

    def _mark(self, action: str, on: bool, forced: bool) -> None:
        if on:
            self._lasting.pop(action, None)
            self._authority.end_yielding((action,))
        else:
            self._lasting[action] = forced

    @property
    def watches(self) -> bool:
        """Whether something lasts that has conditions which were not overridden."""
        return any(self._authority.need(name).when and not forced for name, forced in self._lasting.items())

    def end_unmet(self) -> None:
        """End what lasts though its conditions are met no longer."""
        unmet = [
            name
            for name, forced in self._lasting.items()
            if not forced and self._authority.conditions_refusal(self._authority.need(name))
        ]
        self.end(unmet)

    def end(self, actions: tuple[str, ...] | list[str] = LASTING) -> None:
        """End what lasts of these actions, and tell it."""
        for name in sorted(set(actions).intersection(self._lasting)):
            del self._lasting[name]
            self._note(f"{name}_ended")
            if name == "dtc_setting":
                self._authority.control.set_dtcs(True, self.name)
            else:
                self.receive = self.send = True
                self._authority.control.set_communication(receive=True, send=True, by=self.name)
