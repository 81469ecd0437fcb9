"""What monitors of a linear plant share: matrices and signals by configuration, samples off the bus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, isnan, nan
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from gateway.monitors import contract
from gateway.monitors.accuracy import LateAccuracy
from gateway.monitors.contract import Connection, MonitorParams, Signal
from gateway.monitors.sampling import Sampling
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.jit import Record, f8s, i8, i8s, kernel, means
from gateway_fdi.structure.units import differ
from gateway_plants.linear.mathematics.plant import MOST_INPUTS, MOST_OUTPUTS, MOST_STATES, LinearPlant, discretised
from gateway_plants.linear.model_set import alignment

Matrix = tuple[tuple[float, ...], ...]

#: Why a sample is not judged: the state is being found (start, gap); a change has been seen and not been isolated yet;
#: no part explains what came.
FINDING, UNDECIDED, AMBIGUOUS = 1, 2, 4
#: Samples missing in a row over which a plant is predicted; behind more of them it is found anew.
MOST_MISSING = 5


#: Commands that are kept, each with its time, until their sample comes.
KEPT = 8
#: Share of the samples before which a command's frame comes, from which on it is cyclic; samples until that is known.
_CYCLIC, _LISTENED = 0.7, 40
#: Samples in a row behind which the number of a command's frames is right, and not their times.
_SURE = 3
#: Share of a period by which a command that comes a little behind its sample is still that one's.
EARLY = 0.1
#: Which of the samplings: a frame of commands, or a sample of the outputs.
COMMANDS, OUTPUTS = range(2)
#: Periods behind which a counter has gone round.
_ANEW = 64


class Const(Record):
    """Constants."""

    period_ns: i8 = means("period of the samples", "ns")
    inputs: i8 = means("commands")
    outputs: i8 = means("sensors")
    completing: i8 = means("the message that completes a sample, by its place in it")
    timed: i8 = means("1: all commands come in one message, whose counter says when each was due")
    command_counted: Annotated[i8s, MOST_INPUTS] = means("1: the command's message has an alive counter")


class State(Record):
    """State; of each command where it is an array."""

    started: i8 = means("1: there is a sample")
    t_ns: i8 = means("when the last sample was due", "ns")
    before_ns: i8 = means("when the sample before it was due", "ns")
    steps: i8 = means("samples since one that was whole")
    value: Annotated[f8s, MOST_INPUTS, KEPT] = means("values of the last frames")
    came_ns: Annotated[i8s, MOST_INPUTS, KEPT] = means("when they came", "ns")
    heard: Annotated[i8s, MOST_INPUTS] = means("frames in all")
    since: Annotated[i8s, MOST_INPUTS] = means("frames since the last sample")
    late: Annotated[i8s, MOST_INPUTS] = means("samples by which the newest frame comes after its own; 0: in time")
    lead_ns: Annotated[f8s, MOST_INPUTS] = means("time of its frame before its sample", "ns")
    share: Annotated[f8s, MOST_INPUTS] = means("share of the samples before which a frame came")
    listened: i8 = means("samples in these averages")
    ahead: Annotated[i8s, MOST_INPUTS] = means("frames more than samples, since one that came in time")
    off: Annotated[i8s, MOST_INPUTS] = means("samples by which its frames come later than its samples do")
    alike: Annotated[i8s, MOST_INPUTS] = means("samples in a row of which that is so")
    doubt: Annotated[i8s, MOST_INPUTS] = means("1: times and number of its frames contradict each other")
    told: Annotated[i8s, MOST_INPUTS] = means("its last alive counter")
    u: Annotated[f8s, MOST_INPUTS] = means("what holds from the present sample on")
    unsure: Annotated[i8s, MOST_INPUTS] = means("1: the frame that would say so is lost")
    gap: i8 = means("1: a command that is not cyclic was lost, some time since it was heard last")


class Watched(Record):
    """What the state of a monitor has of its samples."""

    sampling: State = means("samples off the bus")
    y: Annotated[f8s, MOST_OUTPUTS] = means("readings of the sample; NaN: it did not come")
    missing: i8 = means("samples that did not come")
    restarts: i8 = means("times that all began anew")
    commands_lost: i8 = means("samples whose command did not come")
    untested: i8 = means("samples that were not judged")
    reason: i8 = means("why the last sample was not judged: FINDING to AMBIGUOUS; 0: it was")


class Inputs(contract.SampledInputs):
    """Inputs."""

    u: Annotated[f8s, MOST_INPUTS] = means("commands")
    y: Annotated[f8s, MOST_OUTPUTS] = means("readings")
    command_counter: Annotated[f8s, MOST_INPUTS] = means("alive counter of each command")


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
    counter: str | None = Field(
        None,
        description='"Message.Signal", alive counter modulo 16 of the command\'s message: tells which of its '
        "frames are lost; one that comes before every sample is missed without it",
    )


class Output(StrictModel):
    """A sensor."""

    name: str = Field(description="of the sensor, for people and in the fault's id")
    signal: str = Field(description='"Message.Signal" that carries its reading')
    unit: str | None = Field(None, description="that the database must give; default: any")
    noise: float = Field(gt=0, description="standard deviation of its reading, resolution included")
    threshold: float | None = Field(None, gt=0, description="smallest fault that counts; default 10 noise")
    accuracy: LateAccuracy | None = Field(
        None,
        description='by how much it may be off, as { gain = "0.5 %", bias = "0.1 A", '
        'lag = "5 ms" }; without a bias that is a fifth of its threshold',
    )
    dtc: str | None = Field(None, description="default: C1B21-64 and so on")

    @model_validator(mode="after")
    def _has_its_unit(self) -> Self:
        bias = None if self.accuracy is None else self.accuracy.bias
        if bias is not None and differ(bias.unit, self.unit or ""):
            raise ValueError(f'accuracy.bias = "{bias}": its unit is "{self.unit}"')
        return self

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
        description="message that completes a sample, whatever the age of outputs in other messages; default: that of "
        "the last output, and a sample is lost if another output's frame is. The commands that hold from the sample on "
        "must have come by then",
    )
    counter: str | None = Field(
        None,
        description='"Message.Signal", alive counter modulo 16 of the message that completes a sample: tells which are '
        "lost, late or overtaken",
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
        if self.counter is not None and message_of(self.counter) != completing(self):
            raise ValueError(f'counter = "{self.counter}": of {completing(self)}, which completes a sample')
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
        "u": signals(p.input, MOST_INPUTS),
        "y": signals(p.output, MOST_OUTPUTS),
        "command_counter": [
            *(None if part.counter is None else Signal(part.counter) for part in p.input),
            *[None] * (MOST_INPUTS - len(p.input)),
        ],
    }


def completing(p: PlantParams) -> str:
    """Return the message that completes a sample."""
    return p.trigger or message_of(p.output[-1].signal)


def message_of(signal: str) -> str:
    """Return the message of ``"Message.Signal"``."""
    return signal.rpartition(".")[0]


def _samples(p: PlantParams) -> tuple[str, ...]:
    """Return the messages of a sample, in their order; the last one completes it."""
    if p.trigger is not None:
        return (p.trigger,)
    return (*dict.fromkeys(m for part in p.output if (m := message_of(part.signal)) != completing(p)), completing(p))


def triggers(p: PlantParams) -> tuple[str, ...]:
    """Return the messages that step it: those of a sample, and those of the commands."""
    return tuple(dict.fromkeys([*_samples(p), *(message_of(part.signal) for part in p.input)]))


def _timed(p: PlantParams) -> tuple[str, ...]:
    """Return the counter of all commands, if there is one."""
    told = {part.counter or "" for part in p.input}
    return tuple(told) if len(told) == 1 and "" not in told else ()


def samplings(p: PlantParams) -> tuple[Sampling, Sampling]:
    """Return how frames become samples: each frame of commands alone, and before them the outputs together."""
    counters, anew_ms = () if p.counter is None else (p.counter,), _ANEW * p.sample_ms
    timed, inputs = _timed(p), ("u", "command_counter")
    commands = Sampling("counter" if timed else "clock", p.sample_ms, inf, anew_ms, timed, inputs=inputs)
    if len(_samples(p)) > 1:
        outputs = Sampling("set", p.sample_ms, inf, anew_ms, counters, ordered=True, inputs=("y",))
    elif counters:
        outputs = Sampling("counter", p.sample_ms, inf, anew_ms, counters, inputs=("y",))
    else:
        outputs = Sampling("clock", p.sample_ms, inf, anew_ms, inputs=("y",))
    return commands, outputs


def prepare(c: Const, p: PlantParams) -> None:
    """Fill a record of Const."""
    c.period_ns, c.inputs, c.outputs = round(p.sample_ms * 1e6), len(p.input), len(p.output)
    c.completing = len(_samples(p)) - 1
    c.timed = bool(_timed(p))
    c.command_counted[: c.inputs] = [part.counter is not None for part in p.input]


@kernel
def _of_sample(s: State, c: Const, j: int, place: int, from_ns: int) -> int:
    """Return how many samples behind a time a command's frame begins to hold, by when it was due."""
    return int(np.floor((s.came_ns[j, place] + s.lead_ns[j] - from_ns) / c.period_ns + 0.5))


@kernel
def command(s: State, c: Const, u: Inputs) -> bool:
    """Take a frame of commands; tells whether it is one, and no sample."""
    if u.which != COMMANDS:
        return False
    for j in range(c.inputs):
        if isnan(u.u[j]):
            continue  # it comes in another message
        place = s.heard[j] % KEPT
        s.value[j, place], s.came_ns[j, place] = u.u[j], u.t_ns
        s.late[j] = 0
        if c.timed == 1 and s.share[j] >= _CYCLIC:
            s.came_ns[j, place] -= int(1e9 * u.waited[0])
            s.late[j] = 1 - _of_sample(s, c, j, place, s.t_ns)
        if c.command_counted[j] == 1:
            told = int(u.command_counter[j])
            # A frame that comes twice is one.
            if s.heard[j] > 0 and told == s.told[j]:
                continue
            if s.heard[j] > 0 and (told - s.told[j]) % 16 != 1 and s.share[j] < _CYCLIC:
                s.gap = 1
            s.told[j] = told
        s.heard[j] += 1
        s.since[j] += 1
    return True


@kernel
def late(s: State, c: Const, aligned: alignment.State, waits: alignment.Const) -> None:
    """Take commands that come behind their samples, which wait for them."""
    for i in range(c.inputs):
        if s.late[i] > 0:
            value = s.value[i, (s.heard[i] - 1) % KEPT]
            alignment.late(aligned, waits, i, value, s.late[i] - 1)
            s.late[i] = 0


@kernel
def _contradicts(s: State, c: Const, j: int, steps: int) -> bool:
    """Return whether the times of a cyclic command say something else than the number of its frames.

    A sample that waits L periods alone lets L more commands come before it. Where fewer have come the commands waited,
    too, as behind a sender that stood still. Once, frames may also be lost; where it stays so their number is right.
    """
    if c.timed == 1 or s.listened < _LISTENED or s.share[j] < _CYCLIC:
        s.off[j] = 0
        return False
    late = _of_sample(s, c, j, (s.heard[j] - 1) % KEPT, s.before_ns) - steps
    s.ahead[j] = s.ahead[j] + s.since[j] - steps if late > 0 else 0
    off = late - s.ahead[j] if late > 0 else 0
    s.alike[j] = s.alike[j] + 1 if off == s.off[j] else 1
    s.off[j] = off
    return bool(off != 0 and s.alike[j] < _SURE)


@kernel
def _listen(s: State, c: Const, steps: int) -> None:
    """Learn how long before its sample each command comes, and whether it does before each."""
    s.listened += 1
    for j in range(c.inputs):
        if s.heard[j] == 0:
            continue
        most = 2.0 if c.timed == 1 else 1.0  # one that comes late is there for the next sample, too
        s.share[j] += (min(s.since[j] / steps, most) - s.share[j]) / min(s.listened, 200)
        s.doubt[j] = _contradicts(s, c, j, steps)
        if s.since[j] == 1 and steps == 1 and s.off[j] == 0:
            lead = float(s.t_ns - s.came_ns[j, (s.heard[j] - 1) % KEPT])
            if (
                c.timed == 1
            ):  # it may be the frame before, as its own comes late: what is known is the place in a period
                off = lead - s.lead_ns[j]
                s.lead_ns[j] += (off - c.period_ns * round(off / c.period_ns)) / min(s.listened, 16)
                s.lead_ns[j] -= c.period_ns * np.floor(s.lead_ns[j] / c.period_ns + EARLY)
            else:
                s.lead_ns[j] += (min(max(lead, 0.0), float(c.period_ns)) - s.lead_ns[j]) / min(s.listened, 16)


@kernel
def commands(s: State, c: Const, u: Inputs, at: int) -> None:
    """Find what the commands are from a sample on, ``at`` samples behind the one before; sets ``u`` and ``unsure``."""
    for j in range(c.inputs):
        s.unsure[j] = 0
        if s.heard[j] == 0:
            s.u[j] = s.u[j] if isnan(u.u[j]) else u.u[j]
            continue
        found, newest = False, -1
        for back in range(min(s.heard[j], KEPT)):
            place = (s.heard[j] - 1 - back) % KEPT
            which = _of_sample(s, c, j, place, s.before_ns) - s.off[j]
            if which <= at:
                newest, found = place, which == at
                break
        if newest >= 0:
            s.u[j] = s.value[j, newest]
        if not found and s.listened >= _LISTENED and s.share[j] >= _CYCLIC:
            s.unsure[j] = 1
        if s.doubt[j] == 1:
            s.unsure[j] = 1


@kernel
def begin_anew(s: Watched, steps: int) -> bool:
    """Take a sample that is so many samples further; tells whether too many are missing to predict the plant."""
    s.reason = 0
    lost = steps - 1 > MOST_MISSING or s.sampling.gap == 1
    s.restarts += 1 if lost else 0
    return bool(lost)


@kernel
def take(s: Watched, c: Const, u: Inputs, at: int, came: bool) -> None:
    """Find readings and commands of a sample, ``at`` samples behind the one before; it came, or it is predicted."""
    commands(s.sampling, c, u, at)
    lost = 0
    for j in range(c.inputs):
        lost = max(lost, s.sampling.unsure[j])
    s.commands_lost += lost
    s.missing += 0 if came else 1
    for j in range(c.outputs):
        s.y[j] = u.y[j] if came else nan


@kernel
def taken(s: Watched) -> None:
    """Count a sample that was not judged, and begin to wait for the next one's commands."""
    s.untested += 1 if s.reason > 0 else 0
    s.sampling.since[:] = 0
    s.sampling.gap = 0


@kernel
def samples(s: State, c: Const, u: Inputs) -> int:
    """Return how many samples further this one is; more than 1: some are missing; 0: it is missing itself, in part."""
    s.steps += int(u.gap)
    if u.missing != 0.0:
        return 0
    steps, s.steps = s.steps, 0
    due_ns = u.t_ns - int(1e9 * u.waited[c.completing])
    s.before_ns = s.t_ns if s.started == 1 else due_ns - c.period_ns
    s.started, s.t_ns = 1, due_ns
    _listen(s, c, steps)
    return int(steps)
