"""Closes a loop: a model's inputs follow signals on the bus, its outputs become messages in their cycles.

Of each step the model gets the values before it, and its outputs are of the step's begin: of two ECUs that hear each
other, none is ahead of the other, in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from gateway.bus.frames import EXTENDED, FD, Frames, empty, put
from gateway.signals.bits import mask_of
from gateway.signals.database import Database
from gateway.signals.protection.protection import Protection
from gateway.signals.signal_access import ChangedMessage, ChangedSignal, words_of
from gateway_bench.vecu.conditions import Condition, within
from gateway_bench.vecu.contract import Run, Truth
from gateway_bench.vecu.databases import database_of
from gateway_bench.vecu.loop_params import ACTUATOR, LoopFault, LoopParams
from gateway_bench.vecu.message_faults import Effect
from gateway_bench.vecu.restbus.params import RestbusParams
from gateway_bench.vecu.restbus.selection import Sent, sent
from gateway_bench.vecu.restbus.signals import start_value
from gateway_fdi.common.tomlfile import key_path
from gateway_fdi.errors import InputError, named, under


class Model(Protocol):
    """The model in the loop."""

    def step(self, t: float, inputs: Mapping[str, float]) -> Mapping[str, float]:
        """Return the outputs at a time [s], and go on from there with inputs that hold until the next step."""

    def close(self) -> None:
        """End it; more than once does no harm."""


@dataclass
class _Input:
    message: ChangedMessage
    signal: ChangedSignal


class _Out:
    """One message that is sent."""

    def __init__(self, one: Sent, database: Database, params: LoopParams, bus: int) -> None:
        name = one.message.name
        tables = {table.name: table for table in params.message}
        self._message = ChangedMessage(bus, database, name, one.protection)
        owned = int.from_bytes(self._message.protection.owned.tobytes(), "little")
        self._words = np.zeros(8, np.uint64)
        self._signals: list[tuple[str, ChangedSignal]] = []
        for signal in one.message.signals:
            if signal.length > 64:
                continue
            own, field = f"{name}.{signal.name}", ChangedSignal(bus, database, name, signal.name)
            if (own in params.outputs or own in params.constants) and mask_of(field.row) & owned:
                key = key_path(("outputs" if own in params.outputs else "constants", own))
                raise InputError("the message's protection makes this signal", key=key, value=own)
            if own in params.outputs:
                self._signals.append((own, field))
            else:
                field.put(self._words, params.constants.get(own, start_value(signal)))
        self.period_ns = round(one.period_s * 1e9)
        self.due_ns = round(tables[name].at_ms * 1e6) if name in tables else 0
        self._length, self._bus, self._count = one.message.length, bus, 0
        self._can_id = one.message.frame_id | (EXTENDED if one.message.is_extended_frame else 0)
        self._flags = FD if one.message.is_fd else 0

    def frame(self, outputs: Mapping[str, float], stamp_ns: int) -> Frames:
        """Return the next frame; ``outputs``: "Message.Signal" -> value."""
        words = self._words.copy()
        for own, field in self._signals:
            field.put(words, outputs[own])
        self._message.renew(words, self._length, self._count)
        self._count += 1
        made = empty(1)
        put(made, 0, stamp_ns, self._can_id, words.tobytes()[: self._length], bus=self._bus, flags=self._flags)
        return made


class _Actuator:
    """A fault of an actuator: the model gets another input than the bus says.

    Raises:
        InputError: a condition that is none.
    """

    def __init__(self, fault: LoopFault, run: Run, database: Database, key: str) -> None:
        self._fault, self._run, self.input = fault, run, fault.input
        self._effect = Effect(ACTUATOR[fault.kind], fault.size or 0.0, run.rng)
        self._condition = None
        if fault.when is not None:
            with under(key, fault.when):
                self._condition = Condition(fault.when, run.bus, database)
        self._first_ns, self._count, self._noted = -1, 0, False

    def hear(self, frames: Frames) -> None:
        """Take what was on the buses before the next step."""
        if self._condition is not None:
            self._condition.take(frames)

    def __call__(self, value: float, t_ns: int, step_ns: int) -> float:
        """Return what the model gets at a time [ns], for a step [ns]."""
        active = bool(within(np.array([t_ns]), self._fault.from_s, self._fault.to_s, self._condition)[0])
        if self._condition is None:
            self._note_once(t_ns, step_ns, active=active)
        else:
            self._count_steps(t_ns, step_ns, active=active)
        return self._effect(value, t_ns, active=active)

    def _note_once(self, t_ns: int, step_ns: int, *, active: bool) -> None:
        """Note when it begins; how long it is there is known."""
        if active and not self._noted:
            self._noted = True
            last = self._run.duration_s if self._fault.to_s is None else min(self._fault.to_s, self._run.duration_s)
            self._run.note(Truth(t_ns, self._fault.kind, round((last * 1e9 - t_ns) / step_ns)))

    def _count_steps(self, t_ns: int, step_ns: int, *, active: bool) -> None:
        """Note it when its condition holds no longer: each time."""
        if active:
            self._first_ns = t_ns if self._first_ns < 0 else self._first_ns
            self._count += 1
        if not active or t_ns + step_ns >= self._run.duration_s * 1e9:
            self.end()

    def end(self) -> None:
        """Note what it did, if it did something since the last time."""
        if self._count:
            self._run.note(Truth(self._first_ns, self._fault.kind, self._count))
        self._first_ns, self._count = -1, 0


class Loop:
    """A running model.

    Args:
        params: of the ECU.
        faults: of its actuators.
        run: its settings.
        model: returns the model; made last, when all else is right.

    Raises:
        InputError: signals that are not there, ...
    """

    def __init__(self, params: LoopParams, faults: Sequence[LoopFault], run: Run, model: Callable[[], Model]) -> None:
        database = database_of(run.databases)
        self.step_ns = round(params.step_ms * 1e6)
        self._params, self._run = params, run
        self._inputs = {name: self._input(name, database) for name in params.inputs}
        self._values = {name: params.start.get(name, 0.0) for name in params.names}
        _check(params, database)
        self._out = [_Out(one, database, params, run.bus) for one in messages(params, database)]
        self._faults = [_Actuator(fault, run, database, f"faults[{k}].when") for k, fault in enumerate(faults)]
        self._next_ns = 0
        self._model = model()

    def _input(self, name: str, database: Database) -> _Input:
        """Return what an input follows.

        Raises:
            InputError: no such signal.
        """
        text = self._params.inputs[name]
        message, _, signal = text.rpartition(".")
        with under(key_path(("inputs", name)), text):
            if not message:
                raise InputError('a signal is named "Message.Signal"', value=text)
            found = ChangedSignal(self._run.bus, database, message, signal)
            return _Input(ChangedMessage(self._run.bus, database, message, Protection()), found)

    def step(self, end_ns: int, heard: Frames) -> Frames:
        """Go on until a time [ns], after what was heard; returns what it sends."""
        self._hear(heard)
        for fault in self._faults:
            fault.hear(heard)
        made = [empty(0)]
        while self._next_ns < end_ns:
            t_ns, self._next_ns = self._next_ns, self._next_ns + self.step_ns
            said = self._model.step(t_ns * 1e-9, self._driven(t_ns))
            outputs = self._checked(said, t_ns)
            for out in self._out:
                while out.due_ns < self._next_ns:
                    late = abs(self._run.rng.normal(0.0, self._params.jitter_ms * 1e6)) if self._params.jitter_ms else 0
                    made.append(out.frame(outputs, out.due_ns + round(late)))
                    out.due_ns += out.period_ns
        frames = np.concatenate(made)
        return frames[np.argsort(frames["t_ns"], kind="stable")]

    def _hear(self, heard: Frames) -> None:
        """Take the newest value of each input."""
        for name, one in self._inputs.items() if len(heard) else ():
            for k in np.flatnonzero(one.message.among(heard))[::-1]:
                value = one.signal.value(words_of(heard[k]), int(heard[k]["length"]))
                if not np.isnan(value):
                    self._values[name] = value
                    break

    def _driven(self, t_ns: int) -> dict[str, float]:
        """Return the inputs with the faults of the actuators in them."""
        values = dict(self._values)
        for fault in self._faults:
            values[fault.input] = fault(values[fault.input], t_ns, self.step_ns)
        return values

    def _checked(self, said: Mapping[str, float], t_ns: int) -> dict[str, float]:
        """Return signal -> value.

        Raises:
            InputError: an output that is missing, or no number.
        """
        found = {}
        for own, output in self._params.outputs.items():
            key, when = key_path(("outputs", own)), f"at {t_ns * 1e-9:.4f} s"
            if output not in said:
                raise InputError(named(f"{when} the outputs are", output, said), key=key, value=output)
            try:
                found[own] = float(said[output])
            except (TypeError, ValueError):
                found[own] = float("nan")
            if not np.isfinite(found[own]):
                raise InputError(f"{when} this output is no number: {said[output]!r}", key=key, value=output)
        return found

    def close(self) -> None:
        """End the model."""
        for fault in self._faults:
            fault.end()
        self._model.close()


def _check(params: LoopParams, database: Database) -> None:
    """Refuse outputs and constants that name no signal, and a signal that is both.

    Raises:
        InputError: names close ones.
    """
    for table in ("outputs", "constants"):
        for own in getattr(params, table):
            key = key_path((table, own))
            message, _, signal = own.rpartition(".")
            if not message:
                raise InputError('a signal is named "Message.Signal"', key=key, value=own)
            with under(key, own):
                database.signal(message, signal)
    for k, one in enumerate(params.message):
        if not any(known.name == one.name for known in database):
            text = named("the messages are", one.name, [known.name for known in database])
            raise InputError(text, key=f"message[{k}].name", value=one.name)
    both = params.outputs.keys() & params.constants.keys()
    if both:
        raise InputError("this signal is an output, too", key="constants", value=sorted(both)[0])


def messages(params: LoopParams, database: Database, *, log: bool = True) -> list[Sent]:
    """Return the messages that it sends, chosen and protected as those of a rest bus are.

    Raises:
        InputError: a message without a cycle, ...
    """
    return sent(
        RestbusParams(
            type="restbus",
            name=params.name,
            messages=params.sent,
            message=params.message,
            cycle_ms=params.cycle_ms,
            protection=params.protection,
        ).with_protections(params.checked),
        database,
        log=log,
    )


def sends(params: LoopParams, databases: Sequence[Path]) -> dict[str, Protection]:
    """Return the messages that it sends, by name, with their protections."""
    return {one.message.name: one.protection for one in messages(params, database_of(databases), log=False)}
