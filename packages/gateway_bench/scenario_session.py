"""Scenarios for the gateway of their configuration: opened, and played in one process."""

from __future__ import annotations

from pathlib import Path

from gateway.cli.present import find_scenario
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.config.resolve import protections
from gateway_bench.vecu.message_faults import MessageFault
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.registry import VIRTUAL_ECUS
from gateway_bench.vecu.scenario import Scenario, load_scenario
from gateway_fdi.errors import InputError


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


def opened(name: Path, seed: int | None = None, *, stepwise: bool = False) -> tuple[Scenario, Config, Player]:
    """Return a scenario, the configuration of its gateway, and its player.

    Args:
        name: its file, or the name of a shipped one.
        seed: instead of the scenario's.
        stepwise: signals may be set while it runs.

    Raises:
        InputError, InputErrors: the scenario or its configuration is wrong.
    """
    file = find_scenario(name)
    scenario = load_scenario(file)
    config = load_config(scenario.config)
    try:
        return scenario, config, player_of(scenario, config, seed=seed, stepwise=stepwise)
    except InputError as error:
        raise error.within(file) from error
