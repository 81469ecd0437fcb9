"""Which messages of a database are sent, in which cycle, how protected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gateway.signals.containers import CONTAINED
from gateway.signals.database import Database
from gateway.signals.identity import sticks_out
from gateway.signals.protection.auto import automatic
from gateway.signals.protection.params import CHECKSUM_KEYS, ProtectionParams, protection_for
from gateway.signals.protection.protection import Protection
from gateway_bench.vecu.restbus.params import RestbusMessage, RestbusParams
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError, named, under

if TYPE_CHECKING:
    from cantools.database.can import Message

_log = get_logger(__name__)

#: As many messages are named in a line of the log.
_NAMED = 8


@dataclass(frozen=True)
class Sent:
    """A message that is sent.

    Attributes:
        message: of the database.
        period_s: its cycle [s].
        protection: counter, checksum, header.
    """

    message: Message
    period_s: float
    protection: Protection


def sent(params: RestbusParams, database: Database, *, log: bool = True) -> list[Sent]:
    """Return what a rest bus sends.

    Args:
        params: of the ECU.
        database: of its bus.
        log: say in the log what is not sent, or sent without its protection; once is enough.

    Raises:
        InputError: nodes or messages that are not there, a message that cannot be sent, none at all.
    """
    chosen = _chosen(params, database)
    tables: dict[str, tuple[int, RestbusMessage | None]] = {}
    for k, table in enumerate(params.message):
        if table.name not in chosen:
            text = named("the messages sent are", table.name, chosen)
            raise InputError(text, key=f"message[{k}].name", value=table.name)
        tables[table.name] = k, table
    found, without_cycle, broken = [], [], []
    for name, message in chosen.items():
        place, own = tables.get(name, (-1, None))
        if message.length > 64 or any(sticks_out(message, signal) for signal in message.signals):
            broken.append(name)
            continue
        period_ms = (own.period_ms if own else None) or message.cycle_time or params.cycle_ms
        if not period_ms:
            if own is not None or name in params.messages:
                key = f"message[{place}].period_ms" if own else "messages"
                raise InputError("the database gives no cycle time: give period_ms, or cycle_ms", key=key, value=name)
            without_cycle.append(name)
            continue
        found.append(
            Sent(message, float(period_ms) * 1e-3, _protection(params, own, place, message, database, log=log))
        )
    if not found:
        text = f"none of {len(chosen)} messages has a cycle time in the database: give cycle_ms"
        raise InputError(text, key="cycle_ms")
    if not log:
        return found
    _warn(params, without_cycle, "no cycle time in the database, and no cycle_ms")
    _warn(params, broken, "signals beyond its end")
    return found


def _warn(params: RestbusParams, names: list[str], why: str) -> None:
    """Say which messages are not sent."""
    if names:
        shown = ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")
        text = "messages of the rest bus that are not sent"
        _log.warning(text, ecu=params.name, why=why, count=len(names), messages=shown)


def _chosen(params: RestbusParams, database: Database) -> dict[str, Message]:
    """Return the messages asked for, by name, in the database's order."""
    everything = {message.name: message for message in database if message.protocol != CONTAINED}
    if not everything:
        raise InputError("the bus has no database", key="bus", value=params.bus or "")
    nodes = {node for message in everything.values() for node in message.senders}
    for key, names, known, what in (
        ("nodes", params.nodes, nodes, "the nodes that send are"),
        ("messages", params.messages, everything.keys(), "the messages are"),
        ("without", params.without, everything.keys(), "the messages are"),
    ):
        for k, name in enumerate(names):
            if name not in known:
                raise InputError(named(what, name, known), key=f"{key}[{k}]", value=name)
    asked = bool(params.nodes or params.messages)
    return {
        name: message
        for name, message in everything.items()
        if (not asked or name in params.messages or set(message.senders) & set(params.nodes))
        and name not in params.without
    }


def usual(checked: Mapping[str, ProtectionParams], message: Message, database: Database) -> ProtectionParams:
    """Return how a message is protected of which the scenario says nothing.

    Args:
        checked: protections by the configuration's checks, by message; it goes before the database, which may not say
            all.
        message: of the database.
        database: of its bus.
    """
    given = checked.get(message.name)
    if given is not None and any(getattr(given, name) is not None for name in CHECKSUM_KEYS):
        return given
    found, _ = automatic(message, database.file_of(message.name))
    says = any(getattr(found, name) is not None for name in (*CHECKSUM_KEYS, "counter"))
    return found if says or given is None else given


def _protection(
    params: RestbusParams, table: RestbusMessage | None, k: int, message: Message, database: Database, *, log: bool
) -> Protection:
    """Return how a message is protected.

    Raises:
        InputError: a protection of its own that does not fit it.
    """
    own = table is not None and table.protected
    asked: ProtectionParams | None = table if own else None
    if own and table is not None and table.protection == "auto":
        asked, _ = automatic(message, database.file_of(message.name))
    elif not own and params.protection == "auto":
        asked = usual(params.checked, message, database)
    if asked is None:
        return Protection()
    try:
        return protection_for(message, asked)
    except InputError as error:
        if own:
            with under(f"message[{k}]"):
                raise
        if log:
            _log.warning("sent without a protection", ecu=params.name, message=message.name, why=error.message)
        return Protection()
