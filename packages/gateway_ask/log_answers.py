"""Answers of ECUs, and messages of several frames, in frames of a log that no gateway is fed: as one has them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gateway.bus.frames import Frames, chosen
from gateway.config.answer_bus import AnswerBus
from gateway.config.ecu import EcuParams
from gateway.config.model import Config
from gateway.signals.reassembly import woven_of
from gateway.signals.tables import DecodePlan
from gateway_ask.answers.answer_frames import FrameEncoder
from gateway_ask.clients.ecu import EcuClient
from gateway_ask.clients.poller import TELLS, Ecu, Poller
from gateway_ask.clients.protocols import Schedule


def ecus_of(config: Config, answers: Sequence[AnswerBus], schedule: Callable[[EcuParams], Schedule]) -> list[Ecu]:
    """Build the ECUs of a configuration.

    Args:
        config: the configuration.
        answers: buses of their answers, in the order of ``Config.answered``.
        schedule: returns what an ECU is asked.
    """
    made: list[Ecu] = []
    for at, (bus, ecus) in enumerate(config.answered.items()):
        for k, pages, lengths in zip(ecus, answers[at].pages, answers[at].lengths, strict=True):
            client = EcuClient(config.ecu[k], bus, *schedule(config.ecu[k]))
            made.append(Ecu(client, FrameEncoder(pages, lengths, len(config.bus) + at)))
    return made


class Answers:
    """Puts the frames of answers and of messages behind those that complete them; it asks nothing.

    Args:
        config: the configuration.
        answers: buses of the answers, in the order of ``Config.answered``.
        plan: of the signals that are decoded.

    Attributes:
        woven: how many frames of answers and messages there were.
    """

    def __init__(self, config: Config, answers: Sequence[AnswerBus], plan: DecodePlan) -> None:
        self._first, self._messages = len(config.bus), woven_of(plan)
        ecus = ecus_of(config, answers, lambda _: Schedule([], {}))
        self._asking = Poller(ecus, {}, lambda _: False, woven=self._messages)
        self.woven = 0

    @property
    def carrying(self) -> int:
        """Frames that carry parts of messages: they are no messages by themselves."""
        return 0 if self._messages is None else self._messages.carrying

    def add(self, frames: Frames) -> Frames:
        """Return frames, in order of time, with those of the answers that they complete."""
        made = self._asking.hear(frames)
        if made is frames:
            return frames
        self._asking.told.clear()  # DTCs are of the vehicle's memory, which a log has none of
        made = chosen(made, (made["bus"] < self._first) | (made["can_id"] != TELLS))
        self.woven += len(made) - len(frames)
        return made

    def notes(self) -> list[str]:
        """Return what came of messages of several frames, and of the answers, one line an ECU that said something."""
        said = [] if self._messages is None else self._messages.notes()
        for state in self._asking.states():
            known = sum(state[f"answers_{name}"] for name in ("decoded", "shorter", "longer"))
            unknown, refused, cut = (state[f"answers_{name}"] for name in ("unknown", "negative", "cut"))
            text = f"{known} answers decoded, {unknown} without a layout, {refused} refusals, {cut} cut off"
            some = known + unknown + refused + cut
            said.append(f"ECU {state['ecu']}: {text if some else 'no answer in this log'}")
        return said
