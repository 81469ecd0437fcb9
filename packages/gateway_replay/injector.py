"""A gateway that is fed frames with faults in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gateway.bus.frames import Frames
from gateway.config.model import Config
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import Parts
from gateway_replay.injection import Injector, parse_injection
from gateway_replay.replay import FrameConsumer


def injectors_of(config: Config, parts: Parts, texts: Sequence[str], seed: int) -> list[Injector]:
    """Return what puts faults into the frames of a log.

    Args:
        config: of the gateway.
        parts: of it.
        texts: the faults, as :data:`gateway_replay.injection.USAGE` has them.
        seed: of all randomness.

    Raises:
        InputError: a fault that is none.
    """
    names = [bus.name for bus in config.buses]
    pgn = [k for k, bus in enumerate(config.bus) if bus.match == "pgn"]
    asked = [parse_injection(text, names, parts.databases) for text in texts]
    return [
        Injector(one, parts.databases, parts.checks, np.random.default_rng([seed, k]), pgn=pgn)
        for k, one in enumerate(asked)
    ]


class FaultInjector:
    """A gateway that is fed frames with faults in them.

    Args:
        consumer: to be fed.
        injectors: put the faults in.
        gateway: that is fed in the end. No log has the answers of ECUs; it makes them of frames, so their faults are
            put in behind that.
    """

    def __init__(self, consumer: FrameConsumer, injectors: Sequence[Injector], gateway: Gateway) -> None:
        self._gateway, self._injectors = consumer, injectors
        self._of_answers = [each for each in injectors if each.bus >= len(gateway.config.bus)]
        gateway.asking.alter = self._altered if self._of_answers else None
        self.start, self.stop, self.without_own = consumer.start, consumer.stop, consumer.without_own

    def feed(self, frames: Frames) -> Frames:
        """Feed the frames with all faults."""
        for injector in self._injectors:  # those of answers find none, and note when the log begins
            frames = injector.apply(frames)
        return self._gateway.feed(frames)

    def _altered(self, frames: Frames) -> Frames:
        for injector in self._of_answers:
            frames = injector.apply(frames)
        return frames
