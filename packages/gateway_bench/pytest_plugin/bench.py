"""A gateway in this process, virtual ECUs, and a clock that a test moves; on no bus, or on real ones in real time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools
import numpy as np

from gateway.bus.frames import EXTENDED, FD, Frames, empty, put
from gateway.common.trust import importable
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.pytest_plugin.wires import Inside, Outside, Wires, uris_of
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.contract import Truth
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import Scenario, located
from gateway_fdi.common.tomlfile import validate
from gateway_fdi.errors import GatewayError, InputError, named

#: Longest step of the clock [ns].
STEP_NS = 10_000_000
#: Clock's step while an answer is waited for [ns].
_FINE_NS = 1_000_000


@dataclass
class _Sender:
    """A virtual ECU: when it was switched on, and until when it has frames, by the bench's clock [ns]."""

    name: str
    player: Player
    begun_ns: int
    until_ns: int


class Bench:
    """A gateway of a configuration, driven by a test.

    Args:
        config: file of the configuration; its fault memory is not touched, one in this process stands for it.
        seed: of the virtual ECUs.
        buses: URI, or NAME=URI of each bus: real ones; none: frames stay in this process, and time costs nothing.

    Attributes:
        gateway: the gateway.
        events: events of the JSON contract so far.

    Raises:
        InputError, InputErrors: a configuration that is wrong.
    """

    def __init__(self, config: Path, seed: int = 1, buses: Sequence[str] = ()) -> None:
        self._folder = config.parent
        importable(self._folder)
        self.config = load_config(config)
        self.gateway = Gateway(self.config, file=config)
        self.events: list[dict[str, Any]] = []
        self._seed, self._now_ns, self._count = seed, 0, 0
        self._senders: list[_Sender] = []
        self._off: list[Truth] = []
        self._listeners: list[Callable[[Frames], None]] = []
        self._buses = {bus.name: index for index, bus in enumerate(self.config.bus)}
        self.gateway.listen(self.events.append)
        if buses:
            self.gateway.engine.warm()  # kernels are compiled before time passes
        self._wires: Wires = Outside(uris_of(buses, self._buses)) if buses else Inside()
        self.gateway.start(0)

    @property
    def now_s(self) -> float:
        """Time of the bench's clock [s]."""
        return self._now_ns / 1e9

    def on_frames(self, listener: Callable[[Frames], None]) -> None:
        """Call a function with all frames on the buses from now on: those of ECUs and testers, and the gateway's."""
        self._listeners.append(listener)

    def add(
        self,
        type_: str,
        *,
        faults: Sequence[Mapping[str, Any]] = (),
        wire: Sequence[Mapping[str, Any]] = (),
        duration_s: float = 60.0,
        **params: Any,
    ) -> str:
        """Switch on a virtual ECU; its time 0 is now.

        Args:
            type_: as in a scenario.
            faults: tables ``[[fault]]`` of a scenario, of this ECU.
            wire: tables ``[[wire]]``, of its frames.
            duration_s: how long it sends, at most [s].
            params: further keys of ``[[ecu]]``; files are relative to the configuration.

        Returns:
            its name.

        Raises:
            InputError, InputErrors: keys that are wrong.
        """
        data = {
            "name": type_,
            "duration_s": duration_s,
            "ecu": [{"type": type_, **params}],
            "fault": [dict(fault) for fault in faults],
            "wire": [dict(fault) for fault in wire],
        }
        scenario = located(validate(data, Scenario, None), self._folder)
        return self.play(scenario, self._seed + self._count)

    def play(self, scenario: Scenario, seed: int | None = None) -> str:
        """Switch on the virtual ECUs of a scenario; its time 0 is now.

        Args:
            scenario: of the ECUs.
            seed: instead of the scenario's.

        Returns:
            name of its first ECU, by which all of them are switched off.

        Raises:
            InputError: keys that are wrong.
        """
        self._count += 1
        player = player_of(scenario, self.config, seed=seed, stepwise=True)
        name = scenario.ecu[0].name
        self._senders.append(_Sender(name, player, self._now_ns, self._now_ns + round(scenario.duration_s * 1e9)))
        return name

    @property
    def truth(self) -> list[Truth]:
        """Faults that virtual ECUs have injected so far."""
        return self._off + [fact for sender in self._senders for fact in _truth(sender)]

    def set(self, signal: str, value: float | str) -> None:
        """Give a signal of a virtual ECU a value from its next frame on, instead of its course.

        Args:
            signal: "Message.Signal", or "bus.Message.Signal".
            value: in the signal's unit, or its text in the database.

        Raises:
            InputError: no virtual ECU sends it, or it cannot carry this.
        """
        wrong: InputError | None = None
        done = False
        for sender in self._senders:
            try:
                sender.player.overrides.set({signal: value})
                done = True
            except InputError as error:
                wrong = wrong or error
        if not done:
            raise wrong or InputError("no virtual ECU is switched on", key="signal", value=signal)

    def release(self, signal: str | None = None) -> None:
        """Let a signal go its course again; None: all that are set.

        Raises:
            InputError: it is not set.
        """
        having = [s for s in self._senders if signal is None or signal in s.player.overrides.values]
        if signal is not None and not having:
            known = [name for sender in self._senders for name in sender.player.overrides.values]
            raise InputError(named("set are", signal, known), key="signal", value=signal)
        for sender in having:
            sender.player.overrides.release(signal)

    def inject(self, ecu: str, **fault: Any) -> None:
        """Put a fault into what a virtual ECU sends, from now on.

        Args:
            ecu: its name.
            fault: keys of ``[[fault]]`` of every ECU: kind, signal or message, ...; times are by the ECU's own clock.

        Raises:
            InputError, InputErrors: no such ECU, keys that are wrong.
        """
        names = [sender.name for sender in self._senders]
        if ecu not in names:
            raise InputError(named("the virtual ECUs are", ecu, names), key="virtual ECU", value=ecu)
        self._senders[names.index(ecu)].player.inject({"ecu": ecu, **fault})

    def heal(self) -> None:
        """End all faults of messages and signals now."""
        for sender in self._senders:
            sender.player.heal()

    def switch_off(self, name: str) -> None:
        """Switch a virtual ECU off: it sends no more.

        Raises:
            InputError: there is none of this name.
        """
        names = [sender.name for sender in self._senders]
        if name not in names:
            raise InputError(named("the virtual ECUs are", name, names), key="virtual ECU", value=name)
        for sender in self._senders:
            if sender.name == name:
                self._off += _truth(sender)
                sender.player.close()
        self._senders = [sender for sender in self._senders if sender.name != name]

    def send(self, message: str, /, bus: str | None = None, **signals: Any) -> None:
        """Send one frame of a message now; signals that are not given are 0.

        Raises:
            InputError: a message, signal or value that is none.
        """
        index = self._bus(bus)
        found = self.gateway.databases[index].message(message)
        names = [signal.name for signal in found.signals]
        for name in signals:
            if name not in names:
                raise InputError(named(f"the signals of {message} are", name, names), key=message, value=name)
        try:
            data = found.encode({**dict.fromkeys(names, 0), **signals}, strict=False)
        except cantools.database.EncodeError as error:
            raise InputError(f"cannot be sent: {error}", value=message) from error
        can_id = found.frame_id | (EXTENDED if found.is_extended_frame else 0)
        self.send_frame(can_id, bytes(data), bus=index, fd=found.is_fd)

    def _bus(self, name: str | None) -> int:
        if (name is None and len(self._buses) > 1) or (name is not None and name not in self._buses):
            raise InputError(named("the buses are", name or "", self._buses), key="bus", value=name or "")
        return 0 if name is None else self._buses[name]

    def send_frame(self, can_id: int, payload: bytes, *, bus: int = 0, fd: bool = False) -> Frames:
        """Send one frame now; returns the frames that the gateway sends upon it.

        Args:
            can_id: identifier, with EXTENDED for one of 29 bits.
            payload: at most 8 bytes, with CAN FD 64.
            bus: index of the bus.
            fd: whether it is a CAN FD frame.
        """
        frames = empty(1)
        put(frames, 0, max(self._now_ns, 1), can_id, payload, bus=bus, flags=FD if fd else 0)
        return self._feed(self._wires.carry(frames, self._now_ns))

    def run(self, seconds: float) -> None:
        """Let time pass [s]."""
        self.run_until(self.now_s + seconds)

    def run_until(self, t_s: float) -> None:
        """Let time pass until the clock shows a time [s]; one that has passed is no error.

        Raises:
            GatewayError: a virtual ECU has no frames for this time.
        """
        end = round(t_s * 1e9)
        while self._now_ns < end:
            self.step(min(self._step_ns, end - self._now_ns))

    @property
    def _step_ns(self) -> int:
        """How long a step of the clock may be [ns]: as often as an ECU is to hear, or to send in real time."""
        real = isinstance(self._wires, Outside)
        steps = (s.player.step_ns if real else s.player.loop_ns for s in self._senders)
        return min(STEP_NS, *steps, STEP_NS)

    def step(self, step_ns: int = _FINE_NS) -> Frames:
        """Let a short time pass [ns]; returns the frames that the gateway sends meanwhile.

        Raises:
            GatewayError: a virtual ECU has no frames for this time.
        """
        until = self._now_ns + step_ns
        parts = [empty(0)]
        for sender in self._senders:
            if until > sender.until_ns:
                text = f"virtual ECU {sender.name!r} sends until {sender.until_ns / 1e9:g} s only: give it a duration_s"
                raise GatewayError(text)
            frames = sender.player.take(until - sender.begun_ns)
            frames["t_ns"] += sender.begun_ns
            parts.append(frames)
        frames = np.concatenate(parts)
        arrived = self._wires.carry(frames[np.argsort(frames["t_ns"], kind="stable")], until)
        sent = [self._feed(arrived)] if len(arrived) else []
        self._now_ns = until
        sent += [self._sent(self.gateway.advance(until)), self._sent(self.gateway.poll(until))]
        return np.concatenate(sent)

    def _feed(self, frames: Frames) -> Frames:
        self._heard(frames)
        self._reported(frames)
        return self._sent(self.gateway.feed(frames))

    def _sent(self, frames: Frames) -> Frames:
        """Send what the gateway sends, and tell it."""
        if len(frames):
            self._wires.send(frames)
            self._heard(frames)
        return self._reported(frames)

    def _heard(self, frames: Frames) -> None:
        """Have virtual ECUs hear frames of others: each has heard its own already."""
        for sender in self._senders:
            if sender.player.listens and len(frames):
                heard = frames.copy()
                heard["t_ns"] -= sender.begun_ns
                sender.player.hear(heard)

    def _reported(self, frames: Frames) -> Frames:
        if len(frames):
            for listener in self._listeners:
                listener(frames)
        return frames

    def close(self) -> None:
        """End the operation cycle."""
        try:
            self.gateway.stop(self._now_ns)
        finally:
            for sender in self._senders:
                sender.player.close()
            self._wires.close()
            self.gateway.close()


def _truth(sender: _Sender) -> list[Truth]:
    return [Truth(f.t_ns + sender.begun_ns, f.kind, f.count, f.tooth) for f in sender.player.truth]
