"""The contract of a virtual ECU: its parameters, the faults it can have, and the frames of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, Self, TypeAlias, TypeVar

import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from gateway.bus.frames import Frames
from gateway.signals.protection.params import ProtectionParams
from gateway.signals.protection.protection import Protection
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.errors import InputError

#: Version of this contract. A virtual ECU says for which it was written.
API = 2


class EcuParams(StrictModel):
    """Base of the parameters of a virtual ECU."""

    type: str
    name: str
    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    _checked: Mapping[str, ProtectionParams] = PrivateAttr(default_factory=dict)

    @property
    def checked(self) -> Mapping[str, ProtectionParams]:
        """How the configuration's checks say that messages of its bus are protected, by name."""
        return self._checked

    def with_protections(self, checked: Mapping[str, ProtectionParams]) -> Self:
        """Return parameters that know how messages of their bus are checked."""
        copy = self.model_copy()
        copy._checked = checked
        return copy

    @property
    def summary(self) -> str:
        """Its kind, for people."""
        return self.type


#: Description of a fault's key ``when``.
WHEN = 'only while this holds of signals on the bus: "Drive.Speed > 50"'


class EcuFault(StrictModel):
    """Base of a fault of a virtual ECU; ``kind`` says which.

    ``when`` is resolved for an ECU whose frames are made beforehand: it gets the fault once for each time that the
    condition holds, with ``from_s`` and ``to_s``, which its model must have. One that hears declares it again if it
    minds it.
    """

    kind: str
    ecu: str = Field(description="name of the ECU")
    when: str | None = Field(None, min_length=1, description=WHEN)


class TimedFault(EcuFault):
    """Base of a fault that begins at a time, and may end."""

    from_s: float = Field(0.0, ge=0, description="[s]")
    to_s: float | None = Field(None, description="[s]; default: the end")

    @model_validator(mode="after")
    def _ends_behind_its_begin(self) -> Self:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError("to_s must lie after from_s")
        return self


@dataclass(frozen=True)
class Truth:
    """A fault that was really injected.

    Attributes:
        t_ns: when [ns].
        kind: ``missed_pulses``, ``added_pulses``, or a wire fault's kind.
        count: pulses (or frames) concerned.
        tooth: index of the first tooth concerned, -1 where it does not apply.
    """

    t_ns: int
    kind: str
    count: int
    tooth: int = -1


def injected(times: Iterable[tuple[str, float, float | None]], duration_s: float, period_s: float) -> list[Truth]:
    """Return what lasting faults do within a run, counted in samples.

    Args:
        times: kind of each fault, when it begins, and when it ends [s]; None: with the run.
        duration_s: length of the run [s].
        period_s: between two samples [s].
    """
    ends = [(kind, begin, duration_s if to_s is None else min(to_s, duration_s)) for kind, begin, to_s in times]
    return [
        Truth(round(begin * 1e9), kind, round((end - begin) / period_s)) for kind, begin, end in ends if begin < end
    ]


@dataclass(frozen=True)
class Run:
    """Settings of a run.

    Attributes:
        duration_s: its length [s].
        bus: index of the ECU's bus.
        rng: source of all randomness.
        databases: database files of the bus.
        note: takes what a running ECU injects, when it does.
    """

    duration_s: float
    bus: int
    rng: np.random.Generator
    databases: Sequence[Path] = ()
    note: Callable[[Truth], None] = lambda fact: None


class Running(Protocol):
    """A virtual ECU that hears what is on its bus, and answers.

    Attributes:
        step_ns: how often it is to hear [ns].
    """

    step_ns: int

    def step(self, end_ns: int, heard: Frames) -> Frames:
        """Go on.

        Args:
            end_ns: until when [ns]; from where the last step ended, the first one from 0.
            heard: frames of all others on its bus since the last step, in order of time.

        Returns:
            frames that it sends in this time, in order of time, stamped from 0.
        """

    def close(self) -> None:
        """End it; more than once does no harm."""


P = TypeVar("P", bound=EcuParams)
F = TypeVar("F", bound=EcuFault)
T = TypeVar("T")
#: Within VirtualEcu ``type`` is its name.
Class: TypeAlias = type[T]


def _fits(_params: Any, _fault: Any) -> None:
    """Any fault fits."""


def _as_it_is(params: Any, _folder: Path, _key: str) -> Any:
    """Return parameters that name no files."""
    return params


@dataclass(frozen=True, kw_only=True)
class VirtualEcu(Generic[P, F]):
    """A type of virtual ECU.

    Attributes:
        type: its name in a scenario.
        api: version of the contract that it was written for: :data:`API`, as a number.
        params: pydantic model of its parameters.
        fault: pydantic model of its faults; None: it has none.
        frames: parameters, faults, run -> frames stamped from time 0, and injected faults; of one that ignores its bus.
        begin: parameters, faults, run -> the ECU running; of one that listens to its bus. One of the two.
        sends: parameters, database files -> messages that it sends, by name, with their protections, for faults that
            every ECU can have; None: any message of its bus.
        fits: parameters, fault -> raises ValueError where this ECU cannot have this fault.
        locate: parameters, folder of the scenario, key -> parameters with the paths of their files.
        step_ns: steps in which its frames are to be sent in real time [ns].
    """

    type: str
    api: int
    params: Class[P]
    fault: Class[F] | None
    frames: Callable[[P, Sequence[F], Run], tuple[Frames, list[Truth]]] | None = None
    begin: Callable[[P, Sequence[F], Run], Running] | None = None
    sends: Callable[[P, Sequence[Path]], Mapping[str, Protection]] | None = None
    fits: Callable[[P, F], None] = _fits
    locate: Callable[[P, Path, str], P] = _as_it_is
    step_ns: int = 10_000_000


def accepted(found: object, name: str) -> VirtualEcu[Any, Any]:
    """Return what a name stands for, if it is a virtual ECU of this contract.

    Raises:
        InputError: it is none, or one of another version.
    """
    if not isinstance(found, VirtualEcu):
        text = "this is no VirtualEcu, and no class with step(t, inputs)"
        raise InputError(f"{text}, but {type(found).__name__}", value=name)
    key = f'virtual ECU "{found.type}"'
    if found.api != API:
        raise InputError(
            f"written for version {found.api!r} of the contract, this gateway has {API}",
            key=f"{key}.api",
            value=found.api,
        )
    for field, base in (("params", EcuParams), ("fault", EcuFault)):
        model = getattr(found, field)
        if model is None and field == "fault":
            continue
        if not (isinstance(model, type) and issubclass(model, base)):
            raise InputError(f"a class that derives from {base.__name__}", key=f"{key}.{field}")
    if (found.frames is None) == (found.begin is None):
        raise InputError("it has frames, or it has begin: one of the two", key=f"{key}.frames")
    return found
