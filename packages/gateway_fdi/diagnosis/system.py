"""What there is: components that can be faulty, and tests that see them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.errors import InputError

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

#: Prior probability of a component that says none, by its kind. Whatever is built seldom fails: what counts is how they
#: compare. Sensors and actuators have wires, connectors and moving parts; whole ECUs and buses fail less often, so do
#: single messages of an ECU.
PRIORS = {
    "sensor": 1e-3,
    "actuator": 1e-3,
    "plant": 1e-3,
    "signal": 1e-3,
    "supply": 3e-4,
    "message": 3e-4,
    "ecu": 3e-4,
    "bus": 1e-4,
    "model": 1e-4,
    "second sender": 1e-4,
    "frozen": 8e-5,
}
#: Of any other kind.
OTHER_PRIOR = 3e-4


@dataclass(frozen=True)
class Component:
    """Something that can be faulty.

    Attributes:
        name: of it alone.
        kind: one of :data:`PRIORS`, or another word.
        prior: probability that it is faulty, above 0, at most 0.5; None: by its kind.
        of: name of the component that this is one way to fail of, and is told as; "": it is no such way.
    """

    name: str
    kind: str = ""
    prior: float | None = None
    of: str = ""

    @property
    def told(self) -> str:
        """Name that people are told."""
        return self.of or self.name


class Link(NamedTuple):
    """That a test sees a component.

    Attributes:
        component: its name.
        power: probability that the test fails within its delay if this component alone is faulty, above 0, below 1.
        gain: residual of the test for an error of the component of size 1; NaN: not known.
        via: name of another component of this test whose error it sees then, as of a message the signal; "": none.
    """

    component: str
    power: float
    gain: float = math.nan
    via: str = ""


@dataclass(frozen=True)
class Test:
    """A test.

    Attributes:
        name: of it alone.
        links: components that its failure blames.
        false_alarm: probability that it fails though all of them are well, above 0, below 1.
        delay_s: it sees a fault so long after it began, as often as its power says [s].
        noise: standard deviation of its residual without a fault, its unit; NaN: its residual says nothing of sizes.
        gain_error: by what share gains are wrong, 0 to 1.
    """

    __test__ = False  # none of pytest's

    name: str
    links: tuple[Link, ...]
    false_alarm: float = 1e-4
    delay_s: float = 0.0
    noise: float = math.nan
    gain_error: float = 0.05


class System:
    """Components and tests, as arrays.

    Args:
        components: with names of their own.
        tests: likewise.

    Attributes:
        odds: logarithm of prior odds, shape (components,).
        false_alarm: shape (tests,).
        delay_ns: shape (tests,) [ns].
        noise, gain_error: shape (tests,).
        link_test, link_component, power, gain: of each link, tests one after the other, shape (links,).
        via: place of the link of the same test that a link goes by, or its own, shape (links,).

    Raises:
        InputError: a name that is there twice or not at all, a probability that is none.
    """

    def __init__(self, components: Sequence[Component], tests: Sequence[Test]) -> None:
        self.components, self.tests = tuple(components), tuple(tests)
        self.place = _places("component", [one.name for one in components])
        self.test_place = _places("test", [one.name for one in tests])
        priors = [_prior(one) for one in components]
        self.odds: Floats = np.array([math.log(p / (1.0 - p)) for p in priors])
        self.false_alarm: Floats = np.array([_share(t.name, "false_alarm", t.false_alarm) for t in tests])
        self.delay_ns: Ints = np.array([_delay(t) for t in tests], np.int64)
        self.noise: Floats = np.array([t.noise for t in tests], float)
        self.gain_error: Floats = np.array([t.gain_error for t in tests], float)
        places: list[int] = []
        power: list[float] = []
        gain: list[float] = []
        via: list[int] = []
        for test in tests:
            _refuse_twice(test)
            own = {link.component: len(via) + k for k, link in enumerate(test.links)}
            via += [own.get(link.via, own[link.component]) for link in test.links]
            for link in test.links:
                if link.component not in self.place:
                    raise InputError(f"test {test.name}: there is no component {link.component!r}")
                places.append(self.place[link.component])
                power.append(_share(test.name, f"power for {link.component}", link.power))
                gain.append(link.gain)
        self.link_component: Ints = np.array(places, np.int64)
        self.power: Floats = np.array(power, float)
        self.gain: Floats = np.array(gain, float)
        self.via: Ints = np.array(via, np.int64)
        self._counts: Ints = np.array([len(t.links) for t in tests], np.int64)
        self.link_test: Ints = np.repeat(np.arange(len(tests)), self._counts)

    @cached_property
    def of_test(self) -> list[Ints]:
        """Links of each test."""
        return np.split(np.arange(len(self.link_test)), np.cumsum(self._counts)[:-1]) if self.tests else []

    @cached_property
    def by_component(self) -> Ints:
        """All links, components one after the other, each in the order of the tests."""
        return np.argsort(self.link_component, kind="stable")

    @cached_property
    def log_escape(self) -> Floats:
        """Logarithm of how likely each link's component escapes its test."""
        return np.log1p(-self.power)

    @cached_property
    def of_component(self) -> list[Ints]:
        """Links of each component, in the order of the tests."""
        counts = np.bincount(self.link_component, minlength=len(self.components))
        return np.split(self.by_component, np.cumsum(counts)[:-1]) if self.components else []


def _places(what: str, names: Iterable[str]) -> dict[str, int]:
    places: dict[str, int] = {}
    for name in names:
        if name in places:
            raise InputError(f"two {what}s are called {name}")
        places[name] = len(places)
    return places


def _prior(one: Component) -> float:
    prior = PRIORS.get(one.kind, OTHER_PRIOR) if one.prior is None else one.prior
    if not 0.0 < prior <= 0.5:
        raise InputError(f"component {one.name}: prior = {prior}: above 0, at most 0.5")
    return prior


def _share(test: str, what: str, value: float) -> float:
    if not 0.0 < value < 1.0:
        raise InputError(f"test {test}: {what} = {value}: above 0, below 1")
    return value


def _delay(test: Test) -> int:
    if not 0.0 <= test.delay_s <= 1e9:
        raise InputError(f"test {test.name}: delay_s = {test.delay_s}: 0 to 1e9 s")
    if test.noise <= 0.0 or not 0.0 <= test.gain_error <= 1.0:
        raise InputError(f"test {test.name}: noise above 0, or NaN; gain_error 0 to 1")
    return round(test.delay_s * 1e9)


def _refuse_twice(test: Test) -> None:
    names = [link.component for link in test.links]
    if len(set(names)) < len(names):
        raise InputError(f"test {test.name}: a component is linked twice")
