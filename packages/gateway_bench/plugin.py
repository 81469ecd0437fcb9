"""Plug-in of the bench: virtual ECUs that are no plants, scenarios, and the speed of this machine."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    ecus={name: f"gateway_bench.vecu.{name}:ECU" for name in ("fmu", "responder", "restbus", "table")},
    commands={name: f"gateway_bench.commands:{name}" for name in ("demo", "simulate", "control", "bus")},
    calls={
        "simulate": "gateway_bench.simulation:simulate",
        "scenario_schema": "gateway_bench.vecu.scenario_schema:schema",
    },
    measures={"speed": "gateway_bench.cli.measure:Speed"},
)
