"""A diagnostic layer: its dictionary, its services, and the states that they need (ISO 22901-1, 7.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

from gateway_testers.odx.dictionary import Dictionary, Param, const, echo, params_of, value
from gateway_testers.odx.xml import free, group, named, node


@dataclass(frozen=True)
class Needed:
    """Conditions of a service, and the states that it leads to.

    Attributes:
        states: chart -> its states in which it is served; a chart that is not named does not matter.
        enters: (chart, state) that it leads to.
        says: other conditions, for people.
    """

    states: Mapping[str, Sequence[str]] = field(default_factory=dict)
    enters: Sequence[tuple[str, str]] = ()
    says: str = ""


class Layer:
    """A layer that is being made.

    Args:
        name: beginning of its ids.
        charts: state charts: name -> states, the first one at the start.
    """

    def __init__(self, name: str, charts: Mapping[str, Sequence[str]]) -> None:
        self.name, self._charts = name, charts
        self.dictionary = Dictionary(name)
        self._services: list[Element] = []
        self._requests: list[Element] = []
        self._responses: list[Element] = []
        self._taken: set[str] = set()

    def service(
        self,
        name: str,
        sid: int,
        request: Sequence[Param],
        response: Sequence[Param],
        needed: Needed,
        *,
        semantic: str,
        long: str = "",
    ) -> None:
        """Add a service; ``request`` and ``response`` are what follows the service identifier."""
        name = free(name, self._taken)
        asks, answers = f"{self.name}.RQ.{name}", f"{self.name}.PR.{name}"
        own = const("SID", sid, semantic="SERVICE-ID")
        positive = const("SID", sid + 0x40, semantic="SERVICE-ID")
        self._requests.append(named("REQUEST", f"RQ_{name}", params_of([own, *request]), ID=asks))
        self._responses.append(named("POS-RESPONSE", f"PR_{name}", params_of([positive, *response]), ID=answers))
        states = [
            node("PRE-CONDITION-STATE-REF", ID_REF=self._state(chart, state))
            for chart, each in needed.states.items()
            for state in each
        ]
        leads = [
            node("STATE-TRANSITION-REF", ID_REF=self._transition(chart, source, target))
            for chart, target in needed.enters
            for source in self._charts[chart]
        ]
        self._services.append(
            named(
                "DIAG-SERVICE",
                name,
                node("DESC", node("p", needed.says)) if needed.says else None,
                group("PRE-CONDITION-STATE-REFS", states),
                group("STATE-TRANSITION-REFS", leads),
                node("REQUEST-REF", ID_REF=asks),
                node("POS-RESPONSE-REFS", node("POS-RESPONSE-REF", ID_REF=answers)),
                long=long,
                ID=f"{self.name}.SERVICE.{name}",
                SEMANTIC=semantic,
            )
        )

    def _state(self, chart: str, state: str) -> str:
        return f"{self.name}.STATE.{chart}.{state}"

    def _transition(self, chart: str, source: str, target: str) -> str:
        return f"{self.name}.STATE-TRANSITION.{chart}.{source}.{target}"

    def _chart(self, name: str, states: Sequence[str]) -> Element:
        moves = [
            named(
                "STATE-TRANSITION",
                f"{source}_{target}",
                node("SOURCE-SNREF", SHORT_NAME=source),
                node("TARGET-SNREF", SHORT_NAME=target),
                ID=self._transition(name, source, target),
            )
            for target in states
            for source in states
        ]
        return named(
            "STATE-CHART",
            name,
            node("SEMANTIC", name.upper()),
            node("STATE-TRANSITIONS", *moves),
            node("START-STATE-SNREF", SHORT_NAME=states[0]),
            node("STATES", *(named("STATE", state, ID=self._state(name, state)) for state in states)),
            ID=f"{self.name}.STATE-CHART.{name}",
        )

    def content(self, refusals: Mapping[int, str]) -> list[Element | None]:
        """Return the content of the layer; ``refusals``: texts of negative response codes."""
        answer = [
            const("SID", 0x7F, semantic="SERVICE-ID"),
            echo("RequestedSID", 0, semantic="SERVICEIDRQ"),
            value("NRC", self.dictionary.number("B", texts=refusals)),
        ]
        refusal = named("GLOBAL-NEG-RESPONSE", "NR", params_of(answer), ID=f"{self.name}.NR")
        return [
            self.dictionary.content(),
            node("DIAG-COMMS", *self._services),
            node("REQUESTS", *self._requests),
            node("POS-RESPONSES", *self._responses),
            node("GLOBAL-NEG-RESPONSES", refusal),
            group("STATE-CHARTS", [self._chart(*each) for each in self._charts.items()]),
        ]
