"""What monitors of a linear plant share: matrices and signals by configuration, samples off the bus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Self

from pydantic import Field, model_validator

from gateway.common.tomlfile import StrictModel
from gateway.fdi.linear.plant import LinearPlant, discretised
from gateway.fdi.pi_bank.bank import MOST_INPUTS, MOST_OUTPUTS, MOST_STATES
from gateway.jit import Record, f8, f8s, i8, kernel
from gateway.monitors import contract
from gateway.monitors.contract import Connection, MonitorParams, Signal

Matrix = tuple[tuple[float, ...], ...]

#: Samples missing in a row over which a plant is predicted; behind more of them it is found anew.
MOST_MISSING = 5


class Const(Record):
    """Constants."""

    period_ns: i8
    counted: i8


class State(Record):
    """State: ``t_ns`` of the last sample, and its ``counter``."""

    started: i8
    t_ns: i8
    counter: i8


class Inputs(contract.Inputs):
    """Inputs."""

    y: Annotated[f8s, MOST_OUTPUTS]
    u: Annotated[f8s, MOST_INPUTS]
    counter: f8


class Input(StrictModel):
    """A command to an actuator."""

    name: str = Field(description="of the actuator, for people and in the fault's id")
    signal: str = Field(description='"Message.Signal" that carries the command')
    unit: str | None = Field(None, description="that the database must give; default: any")
    threshold: float = Field(gt=0, description="smallest fault that counts [the signal's unit]")
    drift: float | None = Field(
        None, gt=0, description="of a fault in a second, standard deviation; default threshold / 10"
    )
    dtc: str | None = Field(None, description="default: C1B11-64 and so on")


class Output(StrictModel):
    """A sensor."""

    name: str = Field(description="of the sensor, for people and in the fault's id")
    signal: str = Field(description='"Message.Signal" that carries its reading')
    unit: str | None = Field(None, description="that the database must give; default: any")
    noise: float = Field(gt=0, description="standard deviation of its reading, resolution included")
    threshold: float | None = Field(None, gt=0, description="smallest fault that counts; default 10 noise")
    dtc: str | None = Field(None, description="default: C1B21-64 and so on")

    @property
    def limit(self) -> float:
        """Its threshold, own or default."""
        return 10.0 * self.noise if self.threshold is None else self.threshold


class PlantParams(MonitorParams):
    """x' = A x + B u, y = C x; each input and output a signal on the bus."""

    sample_ms: float = Field(gt=0, le=60_000, description="between two samples [ms]")
    a: Matrix = Field(description="A, one list a row [1/s if continuous]")
    b: Matrix = Field(description="B, one list a row")
    c: Matrix = Field(description="C, one list a row")
    discrete: bool = Field(False, description="the matrices are Phi and Gamma of a sample already")
    states: tuple[str, ...] = Field((), description="names of the states, for messages")
    state_noise: float | tuple[float, ...] = Field(
        1e-4,
        description="disturbance of the states, of each or of all, per root of a second",
    )
    input: tuple[Input, ...] = Field(
        min_length=1,
        max_length=MOST_INPUTS,
        description="the plant's commands, one a column of b; one at least, its actuators are what is watched",
    )
    output: tuple[Output, ...] = Field(
        min_length=1, max_length=MOST_OUTPUTS, description="the plant's sensors, one a row of c"
    )
    trigger: str | None = Field(
        None,
        description="message that completes a sample; default: that of the last output. The commands that hold "
        "from the sample on must have come by then",
    )
    counter: str | None = Field(
        None, description='"Message.Signal", alive counter modulo 16: tells which samples are lost'
    )
    mtfa_s: float = Field(1e6, gt=0, description="mean time between false alarms [s]")

    @model_validator(mode="after")
    def _shapes_fit(self) -> Self:
        plant = self.plant
        if plant.states > MOST_STATES:
            raise ValueError(f"{plant.states} states; at most {MOST_STATES}")
        for what, rows, named in (
            ("inputs", plant.inputs, len(self.input)),
            ("outputs", plant.outputs, len(self.output)),
        ):
            if rows != named:
                raise ValueError(f"the matrices have {rows} {what}, but {named} are named")
        for what, count in (("states", len(self.states)), ("state_noise", len(self.disturbance))):
            if count not in (0, plant.states):
                raise ValueError(f"{what} has {count} entries, the plant {plant.states} states")
        if not all(value >= 0.0 for value in self.disturbance):
            raise ValueError("state_noise is a standard deviation: not negative")
        names = [part.name for part in self.input] + [part.name for part in self.output]
        if len(set(names)) != len(names):
            raise ValueError("two inputs or outputs share a name")
        return self

    @property
    def plant(self) -> LinearPlant:
        """The plant in discrete time."""
        return discretised(self.a, self.b, self.c, self.sample_ms * 1e-3, discrete=self.discrete)

    @property
    def disturbance(self) -> tuple[float, ...]:
        """Noise of each state."""
        if isinstance(self.state_noise, tuple):
            return self.state_noise
        return (self.state_noise,) * len(self.a)

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(part.name for part in self.output)


def connect(p: PlantParams) -> Mapping[str, Connection]:
    """Return what the inputs of a linear plant's monitor are connected to."""

    def signals(parts: Sequence[Input | Output], most: int) -> list[Signal | None]:
        return [*(Signal(part.signal, part.unit) for part in parts), *[None] * (most - len(parts))]

    return {
        "y": signals(p.output, MOST_OUTPUTS),
        "u": signals(p.input, MOST_INPUTS),
        "counter": None if p.counter is None else Signal(p.counter),
    }


def triggers(p: PlantParams) -> tuple[str, ...]:
    """Return the message that steps it."""
    return (p.trigger or p.output[-1].signal.rpartition(".")[0],)


def prepare(c: Const, p: PlantParams) -> None:
    """Fill a record of Const."""
    c.period_ns, c.counted = round(p.sample_ms * 1e6), p.counter is not None


@kernel
def samples(s: State, c: Const, u: Inputs) -> int:
    """Return how many samples further this frame is: 0: it was seen already; more than 1: some are missing."""
    told = int(u.counter) if c.counted == 1 else 0
    steps = 1
    if s.started == 1:
        waited = (u.t_ns - s.t_ns + c.period_ns // 2) // c.period_ns
        steps = (told - s.counter) % 16 if c.counted == 1 else max(waited, 1)
        # A counter that has gone round tells nothing.
        if c.counted == 1 and waited > 16:
            steps = waited
    s.started, s.t_ns, s.counter = 1, u.t_ns, told
    return int(steps)
