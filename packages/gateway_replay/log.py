"""A recorded log for the gateway of a configuration: its frames up to what damages it, then what it held."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from gateway.bus.frames import WOVEN, Frames
from gateway.bus.logs import LogReader
from gateway.common.times import zone_of
from gateway.config.model import Config
from gateway.config.reserved_ids import bus_instances
from gateway.engine.checks.unknown_ids import known_table
from gateway.signals.database import Database
from gateway.signals.payloads import looked_up
from gateway_fdi.errors import InputError
from gateway_replay.channels import channels_of
from gateway_replay.log_contents import Contents, contents

#: One in HEARD identifiers of a log may be known by chance, and one in KNOWN of those that are known may be in it.
HEARD, KNOWN = 4, 10


class Log:
    """A log to be replayed; to be iterated over once.

    Args:
        path: of it.
        config: whose buses it is read for.
        maps: channels of the log taken as buses, ``"channel=bus"`` each.

    Attributes:
        reader: of it.
        damage: what ended reading; None: nothing did.
        foreign: how many of its identifiers are known, if it is of another vehicle; "": it is not.

    Raises:
        InputError: it cannot be read at all, or a map is wrong.
    """

    def __init__(self, path: Path, config: Config, maps: Sequence[str] = ()) -> None:
        self._config, self._maps = config, tuple(maps)
        self._channels = channels_of(config, maps)
        self.reader = LogReader(path, self._channels, zone_of(config.clock.zone))
        self.damage: InputError | None = None
        self.foreign = ""

    def __iter__(self) -> Iterator[Frames]:
        """Yield its frames, batch by batch, none of another vehicle; damage ends them and is kept."""
        try:
            for frames in self.reader:
                yield frames[:0] if self.foreign else frames
        except InputError as error:
            self.damage = error

    def refuse_foreign(self, databases: Sequence[Database]) -> None:
        """Judge none of its frames if it is of another vehicle: the configuration knows hardly any of its identifiers.

        Two vehicles share some by chance, one in HEARD of the log and one in KNOWN of the configuration. It is read
        until there are more.
        """
        if not any(map(len, databases)):
            return
        pgn = {k for k, bus in enumerate(self._config.bus) if bus.match == "pgn"}
        known = [(k, bus.known, bus.groups) for k, bus in enumerate(bus_instances(self._config))]
        keys, rows = known_table([*enumerate(databases)], known, pgn)
        count, rows = int((rows >= 0).sum()), np.minimum(rows, 0)  # more may be known than rows have numbers
        heard: tuple[set[tuple[int, int]], set[tuple[int, int]]] = (set(), set())
        with suppress(InputError):  # told when it is read again
            for batch in LogReader(self.reader.path, self._channels, zone_of(self._config.clock.zone)):
                frames = batch[batch["can_id"] & WOVEN == 0]
                is_known = looked_up(frames, keys, rows) >= 0
                for found, some in zip(heard, (frames[~is_known], frames[is_known]), strict=True):
                    found.update(np.unique(some[["bus", "can_id"]]).tolist())
                total, ours = sum(map(len, heard)), len(heard[1])
                few = 0 < total >= HEARD * ours and count >= KNOWN * ours
                self.foreign = (f"{ours} of {total}" if ours else "none") if few else ""
                if ours and not few:
                    return

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
