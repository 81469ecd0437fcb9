"""Plug-in of questions to a car."""

from gateway.plugin import Plugin

PLUGIN = Plugin(
    commands={"survey": "gateway_ask.commands:survey", "import": "gateway_ask.commands:import_"},
    calls={
        "answer_buses": "gateway_ask.answer_buses:answer_buses",
        "asking": "gateway_ask.asking:asking",
    },
)
