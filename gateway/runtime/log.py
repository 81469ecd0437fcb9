"""A recorded log for the gateway of a configuration: its frames up to what damages it, then what it held."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from gateway.bus.frames import WOVEN, Frames
from gateway.bus.log_contents import Contents, contents
from gateway.bus.ring import read_recording
from gateway.common.times import zone_of
from gateway.config.channels import channels_of
from gateway.config.known import bus_instances
from gateway.config.model import Config
from gateway.engine.checks.strangers import known_table
from gateway.signals.database import Database
from gateway.signals.payloads import looked_up
from gateway_fdi.errors import InputError


class Log:
    """A log to be replayed; to be iterated over once.

    Args:
        path: of it.
        config: whose buses it is read for.
        maps: channels of the log taken as buses, ``"channel=bus"`` each.

    Attributes:
        reader: of it.
        damage: what ended reading; None: nothing did.
        foreign: whether it is of another vehicle (:meth:`refuse_foreign`).

    Raises:
        InputError: it cannot be read at all, or a map is wrong.
    """

    def __init__(self, path: Path, config: Config, maps: Sequence[str] = ()) -> None:
        self._config, self._maps = config, tuple(maps)
        self._channels = channels_of(config, maps)
        self.reader = read_recording(path, self._channels, zone_of(config.clock.zone))
        self.damage: InputError | None = None
        self.foreign = False

    def __iter__(self) -> Iterator[Frames]:
        """Yield its frames, batch by batch, none of another vehicle; damage ends them and is kept."""
        try:
            for frames in self.reader:
                yield frames[:0] if self.foreign else frames
        except InputError as error:
            self.damage = error

    def refuse_foreign(self, databases: Sequence[Database]) -> None:
        """Judge none of its frames if the configuration knows none of their identifiers: it is of another vehicle.

        It is read up to the first that is known.

        Args:
            databases: of each bus.
        """
        if not any(map(len, databases)):
            return
        pgn = {k for k, bus in enumerate(self._config.bus) if bus.match == "pgn"}
        known = [(k, bus.known, bus.groups) for k, bus in enumerate(bus_instances(self._config))]
        keys, rows = known_table([*enumerate(databases)], known, pgn)
        rows = np.minimum(rows, 0)  # more may be known than rows have numbers
        with suppress(InputError):  # told when it is read again
            for frames in read_recording(self.reader.path, self._channels, zone_of(self._config.clock.zone)):
                if (looked_up(frames, keys, rows) >= 0).any():
                    return
                self.foreign = self.foreign or bool((frames["can_id"] & WOVEN == 0).any())

    @property
    def whole(self) -> bool:
        """Whether it was read to its end, and that is the end of what was recorded."""
        return self.damage is None and not self.reader.problems

    def contents(self, *, named: bool = True, allow_empty: bool = False, allow_cut: bool = False) -> Contents:
        """Return what it held, after it was read.

        Args:
            named: the maps are for this log: a channel that it does not have is an error.
            allow_empty: a log without a frame of a configured bus is no error.
            allow_cut: nor is one that is cut off.
        """
        return contents(
            self.reader,
            {bus.name: bus.channel for bus in self._config.bus},
            self._channels,
            asked=[text.rpartition("=")[0] for text in self._maps] if named else (),
            damage=self.damage,
            foreign=self.foreign,
            allow_empty=allow_empty,
            allow_cut=allow_cut,
        )
