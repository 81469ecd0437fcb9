"""A scenario's player for the gateway of a configuration: its buses, databases and protections."""

from __future__ import annotations

from gateway.config.model import Config
from gateway.config.resolve import protections
from gateway_bench.vecu.message_faults import MessageFault
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.registry import VIRTUAL_ECUS
from gateway_bench.vecu.scenario import Scenario


def player_of(scenario: Scenario, config: Config, *, seed: int | None = None, stepwise: bool = False) -> Player:
    """Return the player of a scenario.

    Args:
        scenario: to play.
        config: of the gateway.
        seed: instead of the scenario's.
        stepwise: signals may be set while it runs.

    Raises:
        InputError: an ECU names a bus that is not there, or messages that cannot carry what it sends, ...
    """
    buses = {bus.name: index for index, bus in enumerate(config.bus)}
    databases = {index: bus.database for index, bus in enumerate(config.bus)}
    wanted = stepwise or any(isinstance(fault, MessageFault) for fault in scenario.fault)
    wanted = wanted or any(VIRTUAL_ECUS[ecu.type].sends is not None for ecu in scenario.ecu)
    known = protections(config) if wanted else {}
    return Player(scenario, buses, seed=seed, databases=databases, protections=known, stepwise=stepwise)
