"""Priors, supplies and grounds by configuration, put into what is derived."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from gateway.engine.depends.params import DiagnosisParams, SupplyParams
from gateway.engine.depends.parts import Network, Seen, component, strongest
from gateway_fdi.diagnosis.system import PRIORS
from gateway_fdi.errors import Gathered, InputError, InputErrors, nearest

Depends = Mapping[str, tuple[Seen, ...]]


def configured(found: Depends, params: DiagnosisParams, network: Network) -> dict[str, tuple[Seen, ...]]:
    """Return what tests see, with the supplies of a configuration and its priors.

    Raises:
        InputErrors: a supply feeds, or a prior names, what is not there.
    """
    made, wrong = dict(found), Gathered()
    for k, supply in enumerate(params.supply):
        for j, name in enumerate(supply.feeds):
            with wrong:
                made = _fed(made, supply, name, network, f"diagnosis.supply[{k}].feeds[{j}]")
    wrong.check()
    return _weighed(made, params.priors)


def _fed(found: Depends, supply: SupplyParams, name: str, network: Network, key: str) -> dict[str, tuple[Seen, ...]]:
    """Return what tests see, with a supply behind what it feeds.

    Raises:
        InputError: no test sees this.
    """
    fed = _named(name, found, network, key)
    own = component(supply.kind, supply.name)

    def behind(one: Seen) -> Seen:
        return Seen(own, supply.share * one.power, f"feeds {name}", one.component.name)

    return {
        fault: strongest([*seen, *(behind(one) for one in seen if one.component.name in fed)])
        for fault, seen in found.items()
    }


def _named(name: str, found: Depends, network: Network, key: str) -> set[str]:
    """Return the components that a user means; buses need not be named.

    Raises:
        InputError: there is none.
    """
    known = {one.component.name: one.component.kind for seen in found.values() for one in seen}
    buses = ["", *(f"{bus}." for bus in network.names)]
    kinds = ("signal", "message", "ecu", "actuator", "sensor")
    fed = {f"{kind} {bus}{name}" for kind in kinds for bus in buses} & known.keys()
    if not fed:
        names = [one.partition(" ")[2] for one, kind in known.items() if kind in kinds]
        short = [one.partition(".")[2] for one in names]
        raise InputError(f"no test sees this{nearest(name, [*short, *names])}", key=key, value=name)
    return fed


def _weighed(found: Depends, priors: Mapping[str, float]) -> dict[str, tuple[Seen, ...]]:
    """Return what tests see, with other priors.

    Raises:
        InputErrors: there is no such kind or component.
    """
    names = {one.component.name for seen in found.values() for one in seen}
    kinds = {one.component.kind for seen in found.values() for one in seen} | PRIORS.keys()
    unknown = [name for name in priors if name not in names and name not in kinds]
    if unknown:
        text = "no kind of component, nor one by its name"
        raise InputErrors(
            [InputError(text + nearest(n, [*kinds, *names]), key=f"diagnosis.priors.{n}", value=n) for n in unknown]
        )

    def other(seen: Iterable[Seen]) -> tuple[Seen, ...]:
        return tuple(
            one._replace(component=replace(one.component, prior=prior))
            if (prior := priors.get(one.component.name, priors.get(one.component.kind))) is not None
            else one
            for one in seen
        )

    return {fault: other(seen) for fault, seen in found.items()} if priors else dict(found)
