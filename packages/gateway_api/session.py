"""A gateway that the caller feeds."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Self

from gateway.bus.frames import Frames, joined, to_message
from gateway_api.event_collector import EventCollector
from gateway_api.messages import Messages, batch_of
from gateway_api.run import Event, Run
from gateway_api.words import spoken
from gateway_fdi.errors import GatewayError
from gateway_replay.channels import channels_of
from gateway_replay.injector import FaultInjector
from gateway_replay.replay import Cycle, FrameConsumer

if TYPE_CHECKING:
    import can

    from gateway_replay.injection import Injector


class Session:
    """One operation cycle of a gateway, from the first message to the end of ``with``.

    A session reads no clock: time is that of the messages' stamps. It has no thread, and changes nothing beside the
    fault memory that it was given.

    Attributes:
        notes: remarks for people, of the run.
        unsent: frames that the gateway made for the bus while nobody took them (``send``).
    """

    def __init__(
        self,
        observed: EventCollector,
        injectors: list[Injector],
        send: Callable[[can.Message], object] | None,
    ) -> None:
        self._observed, self._send = observed, send
        self.notes = observed.notes
        consumer: FrameConsumer = observed.fed
        if injectors:
            consumer = FaultInjector(consumer, injectors, observed.gateway)
        self._cycle = Cycle(consumer)
        config = observed.gateway.config
        self._buses = [bus.name for bus in config.bus]
        self._channels = channels_of(config)
        self._run: Run | None = None
        self.unsent = 0

    def feed(self, messages: Messages, *, bus: str | None = None) -> list[Event]:
        """Take messages in order of time; returns the events that they made.

        Args:
            messages: a message of python-can, several, or a batch of frames.
            bus: name of the bus that they were on; None: by their channels.

        Raises:
            InputError: these are no messages, or of a channel that is no bus.
            GatewayError: the session is over.
        """
        self._refuse_if_over()
        with spoken():
            frames = batch_of(messages, self._channels, bus, self._buses)
        since = len(self._observed.events)
        if len(frames) and not self._cycle.count:
            self._observed.begin_ns = int(frames[0]["t_ns"])
        self._put_out(self._cycle.take(frames))
        return self._observed.events[since:]

    def advance(self, t_s: float) -> list[Event]:
        """Let time pass without messages; returns the events that it made.

        Args:
            t_s: time, by the clock of the stamps [s]; one that has passed changes nothing.

        Raises:
            GatewayError: no message has come, or the session is over.
        """
        self._refuse_if_over()
        if not self._cycle.count:
            raise GatewayError("time passes from the first message on: feed one")
        since = len(self._observed.events)
        self._put_out(self._observed.fed.advance(round(t_s * 1e9) - self._observed.gateway.engine.offset_ns))
        return self._observed.events[since:]

    def _put_out(self, frames: Frames) -> None:
        if self._send is None:
            self.unsent += len(frames)
            return
        gateway = self._observed.gateway
        for frame in joined([frames, gateway.poll(gateway.engine.now_ns)]):
            self._send(to_message(frame, self._buses[int(frame["bus"])]))

    def _refuse_if_over(self) -> None:
        if self._run is not None:
            raise GatewayError("this session is over: open another one")

    @property
    def run(self) -> Run:
        """Its results; while it goes on, those so far."""
        return self._observed.run(self._cycle.count) if self._run is None else self._run

    def close(self) -> Run:
        """End the operation cycle, and the session; returns what came of it. It may be called again."""
        return self._end(complete=True)

    def _end(self, *, complete: bool) -> Run:
        if self._run is None:
            try:
                self._cycle.end(self._observed.gateway.engine.now_ns, complete=complete)
                self._run = self._observed.run(self._cycle.count)
            finally:
                self._observed.close()
        return self._run

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the session; after an error without a verdict."""
        if kind is None:
            self.close()
        else:
            self._observed.close()
