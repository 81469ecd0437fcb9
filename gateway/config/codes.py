"""DTCs that a configuration has given out: those that it names itself are barred."""

from __future__ import annotations

import re
from collections.abc import Iterable

from gateway.config.model import Config
from gateway.engine.checks import bus_health, message
from gateway.monitors.contract import Fault
from gateway.monitors.network_codes import NetworkCodes, Pair
from gateway.signals.database import Database
from gateway_fdi.common.tomlfile import texts_in
from gateway_fdi.errors import InputError

_CODE = re.compile(r"U[0-3][0-9A-F]{3}(-[0-9A-F]{2})?")


def network_codes(config: Config, faults: Iterable[Fault]) -> NetworkCodes:
    """Return who gives out codes: none that the configuration names anywhere, that a bus's health has, or a monitor.

    Args:
        config: the configuration.
        faults: of monitors that bring their own DTCs.
    """
    taken = {text for text in texts_in(config.model_dump(exclude_unset=True)) if _CODE.fullmatch(text)}
    taken |= {fault.dtc for fault in faults}
    taken |= set(bus_health.codes_of([bus.health for bus in config.buses]))
    if any(bus.codes == "same" for bus in config.buses):
        taken |= {message.LOST, message.INVALID}
    return NetworkCodes(taken)


def codes_of_messages(config: Config, databases: Iterable[Database], codes: NetworkCodes) -> dict[str, Pair]:
    """Return the base codes that checked messages have been given, by ``bus.Message``.

    Raises:
        InputError: there are not enough.
    """
    known, asked = set(), {}
    for k, (bus, database) in enumerate(zip(config.buses, databases, strict=True)):
        if bus.codes == "own":
            checked = {check.message for check in bus.check if database.has(check.message)}
            names = {f"{bus.name}.{name}" for name in {message.name for message in database} | checked}
            known |= names
            for j, check in enumerate(bus.check):
                name = f"{bus.name}.{check.message}"
                if name in names and not {"lost", "invalid"} <= check.model_fields_set:
                    asked[name] = f"{config.key_of_check(k, j)}.message"
    try:
        return dict(codes.pairs(known, asked))
    except InputError as error:
        raise InputError(error.message, key=asked[str(error.value)], value=error.value) from error
