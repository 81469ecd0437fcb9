"""Buses of answers, of the layouts that a configuration names."""

from __future__ import annotations

from collections.abc import Mapping

from gateway.config.answer_bus import AnswerBus
from gateway.config.ecu import EcuParams
from gateway.config.model import Config
from gateway_ask.answers.layout import AnswerLayout, layouts_for, layouts_of_obd, read_layouts
from gateway_ask.answers.model import Address
from gateway_ask.answers.pages import answer_bus
from gateway_fdi.errors import Gathered, under


def address_of(params: EcuParams) -> Address:
    """Return the address of an ECU, as files of layouts have it."""
    place = params.place
    return Address(place.request, place.response, place.target, place.tester)


def answer_buses(config: Config) -> tuple[AnswerBus, ...]:
    """Read the layouts of ECUs' answers; returns a bus of answers for each bus that has ECUs.

    Raises:
        InputError, InputErrors: every file that cannot be read.
    """
    made, wrong = [], Gathered()
    for ecus in config.answered.values():
        found: list[tuple[str, Mapping[tuple[int, int], AnswerLayout]]] = []
        for k in ecus:
            ecu = config.ecu[k]
            layouts = layouts_of_obd([read.key for read in ecu.read], whole="protocol" in ecu.model_fields_set)
            for at, path in enumerate(ecu.signals):
                with wrong, under(f"ecu[{k}].signals[{at}]", str(path)):
                    layouts += read_layouts(path)
            found.append((ecu.name, layouts_for(layouts, address_of(ecu))))
        with wrong, under(f"ecu[{ecus[-1]}]" if ecus else "ecu"):
            made.append(answer_bus(found))
    wrong.check()
    return tuple(made)
