"""A configuration that was opened: the beginning of everything."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from gateway.bus.frames import FRAME, Frames
from gateway.common.calls import call_of
from gateway.config.load import config_of, load_config, placed
from gateway.config.model import Config as Tables
from gateway.config.resolve import protections
from gateway.runtime.assemble import Parts, prepare
from gateway.signals.frame_encoding import merged, sent
from gateway.signals.protection.params import ProtectionParams
from gateway_api.event_collector import EventCollector
from gateway_api.paths import Pathish, path_of, paths_of
from gateway_api.progress import Progress, shown
from gateway_api.run import Run
from gateway_api.session import Session
from gateway_api.thresholds import Calibrated, Targets
from gateway_api.words import spoken
from gateway_fdi.common.resources import beside_or_shipped
from gateway_fdi.common.tomlfile import input_errors
from gateway_fdi.errors import GatewayError, InputError, InputErrors, named
from gateway_replay.injector import injectors_of
from gateway_replay.log import Log

if TYPE_CHECKING:
    import can


class Config(Tables):
    """A configuration's tables as a model: keys are those of a file.

    Raises:
        InputErrors: every key that is wrong, with its value.
    """

    def __init__(self, **tables: Any) -> None:
        try:
            super().__init__(**tables)
        except ValidationError as error:
            raise input_errors(error, None, data=tables, model=Tables) from error


def open(config: Pathish | Mapping[str, Any] | Config, *, folder: Pathish | None = None) -> Setup:
    """Open a configuration; all that it names is looked up, and what is wrong is raised.

    Args:
        config: a file (a shipped one by its name, ``"gateway.toml"``, ``"configs/truck.toml"``), its tables, or the
            model that they make.
        folder: where files that tables name lie; None: the work folder. A file's own are beside it.

    Raises:
        InputError, InputErrors: every file, key, message, signal or fault that is wrong.
    """
    base = None if folder is None else path_of(folder, "folder")
    if isinstance(config, Tables):
        return Setup(placed(config, None, base))
    if isinstance(config, Mapping):
        return Setup(config_of(dict(config), None, base))
    file = beside_or_shipped(base or Path(), path_of(config, "config", "a path, tables, or a Config"))
    return Setup(load_config(file), file)


class Setup:
    """A configuration that was opened.

    Args:
        config: of it.
        file: that it was read from; None: it was made of tables.

    Attributes:
        config: its tables as models; they are not to be changed.
        file: that it was read from.

    Raises:
        InputError, InputErrors: a database, message, signal or fault that is wrong.
    """

    def __init__(self, config: Tables, file: Path | None = None) -> None:
        self.config, self.file = config, file
        self._parts: Parts | None = prepare(config, file)
        self._databases = self._parts.databases
        self._protections: Mapping[tuple[int, str], ProtectionParams] | None = None
        #: Choices where the configuration leaves them to the databases.
        self.notes: tuple[str, ...] = self._parts.notes
        #: Ids of all faults that it can report, and their DTCs.
        self.faults: dict[str, str] = {one.id: str(one.dtc) for one in self._parts.catalogue}

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of all signals, as ``signals=`` takes them: ``Message.Signal``, after the bus if there are several."""
        buses = [f"{bus.name}." if len(self.config.buses) > 1 else "" for bus in self.config.buses]
        return tuple(
            f"{bus}{message.name}.{signal.name}"
            for bus, database in zip(buses, self._databases, strict=True)
            for message in database
            for signal in message.signals
        )

    def __repr__(self) -> str:
        monitors = ", ".join(entry.name for entry in self.config.monitor)
        return f"Setup({self.config.name}: {len(self.faults)} faults; monitors {monitors})"

    def session(
        self,
        *,
        memory: Pathish | None = None,
        series: bool = False,
        signals: Sequence[str] = (),
        inject: Sequence[str] = (),
        seed: int = 1,
        send: Callable[[can.Message], object] | None = None,
    ) -> Session:
        """Begin an operation cycle that the caller feeds; to be used ``with``.

        Args:
            memory: file of the fault memory; None: it is gone afterwards.
            series: whether values of monitors over time are kept; that takes about fifteen times as long.
            signals: names of signals that are kept with them.
            inject: faults that are put into the messages, as ``"offset SPEED.SPEED=40 @10..12"``.
            seed: of their randomness.
            send: is called with each message that the gateway has for the bus: its own, answers to testers, requests to
                ECUs (``[[ecu]]``). None: its own and its answers are only counted, and no ECU is asked.

        Raises:
            InputError, InputErrors: a signal or a fault that is not there.
        """
        return self._begin(memory, series, signals, inject, seed, send, lasting=False)

    def _begin(
        self,
        memory: Pathish | None,
        series: bool,
        signals: Sequence[str],
        inject: Sequence[str],
        seed: int,
        send: Callable[[can.Message], object] | None,
        *,
        lasting: bool,
    ) -> Session:
        with spoken():
            parts, self._parts = (None, self._parts) if signals else (self._parts, None)
            observed = EventCollector(
                self.config,
                self.file,
                parts=parts,
                memory=None if memory is None else path_of(memory, "memory"),
                series=series,
                signals=signals,
                lasting=lasting,
            )
            try:
                injectors = injectors_of(self.config, observed.parts, _texts(inject, "inject"), seed)
            except GatewayError:
                observed.close()
                raise
            return Session(observed, injectors, send)

    def replay(
        self,
        log: Pathish | Frames,
        *,
        memory: Pathish | None = None,
        series: bool = False,
        signals: Sequence[str] = (),
        inject: Sequence[str] = (),
        seed: int = 1,
        maps: Sequence[str] = (),
        allow_empty: bool = False,
        allow_cut: bool = False,
        progress: Progress = False,
    ) -> Run:
        """Replay a log, one operation cycle long.

        Args:
            log: its file (any format that ``gateway replay`` takes), or frames.
            memory: as of :meth:`session`.
            series: as of :meth:`session`.
            signals: as of :meth:`session`.
            inject: as of :meth:`session`, times from the log's first frame on.
            seed: as of :meth:`session`.
            maps: channels of the log taken as buses, ``"channel=bus"`` each.
            allow_empty: a log without a frame of a configured bus is no error.
            allow_cut: nor is one that is cut off.
            progress: True: a bar; or a function that is called with the share done.

        Raises:
            InputError, InputErrors: the log cannot be read, is damaged, or has no frame of a configured bus.
        """
        with (
            self._begin(
                memory, series, signals, inject, seed, None, lasting=not isinstance(log, np.ndarray)
            ) as session,
            spoken(),
        ):
            if isinstance(log, np.ndarray):
                session.feed(log)
                return session.close()
            recorded = Log(path_of(log, "log", "a path, or frames"), self.config, _texts(maps, "maps"))
            if not allow_empty:
                recorded.refuse_foreign(self._databases)
            with shown(progress) as report:
                for frames in recorded:
                    session.feed(frames)
                    report(recorded.reader.bytes_done / max(recorded.reader.bytes_total, 1))
            found = recorded.contents(allow_empty=allow_empty, allow_cut=allow_cut)
            session.notes += found.notes
            if found.wrong:
                raise InputErrors(found.wrong)
            return session._end(complete=recorded.whole)

    def frames(
        self, t_s: ArrayLike, signals: Mapping[str, Mapping[str, ArrayLike]], *, bus: str | None = None
    ) -> Frames:
        """Return signals over time as frames, protected as the configuration says, to be replayed or fed.

        Args:
            t_s: times, shape (n,) [s].
            signals: message -> its signal -> values, shape (n,) or a number; others: 0.
            bus: name of the bus; None: the first one.

        Raises:
            InputError: a message or signal that is not there, or values of another shape.
        """
        names = [one.name for one in self.config.bus]
        if bus is not None and bus not in names:
            raise InputError(named("the buses are", bus, names), key="bus", value=bus)
        index = 0 if bus is None else names.index(bus)
        if self._protections is None:
            self._protections = protections(self.config)
        times = np.asarray(t_s, np.float64)
        made = [np.zeros(0, FRAME)]
        for name, columns in signals.items():
            message = self._databases[index].message(name)
            try:
                values = {key: np.broadcast_to(np.asarray(v, float), times.shape) for key, v in columns.items()}
            except ValueError as error:
                raise InputError(f"values of shape {times.shape}: {error}", key=name) from error
            protection = self._protections.get((index, name), ProtectionParams())
            made.append(sent(message, values, times, protection, bus=index))
        return merged(*made)

    def calibrate(
        self,
        logs: Sequence[Pathish],
        *,
        mtfa_s: float = Targets.mtfa_s,
        margin: float = Targets.margin,
        floor: float = Targets.floor,
        maps: Sequence[str] = (),
    ) -> Calibrated:
        """Find thresholds from healthy logs (docs/calibrate.md); :meth:`Calibrated.write` puts them into the file.

        Args:
            logs: healthy ones.
            mtfa_s: mean time between false alarms that is asked for, for stopping rules [s].
            margin: largest healthy T over its threshold, for CUSUM tests.
            floor: least threshold of these [nu].
            maps: channels of the logs taken as buses, ``"channel=bus"`` each.

        Raises:
            GatewayError: the configuration was made of tables.
            InputError, InputErrors: nothing can be calibrated, or a log is damaged.
        """
        if self.file is None:
            raise GatewayError("thresholds are kept in a configuration's file, and this one was made of tables")
        paths = paths_of(logs, "logs")
        targets = Targets(mtfa_s, margin, floor)
        with spoken():
            return Calibrated(self.file, call_of("calibrate")(self.file, paths, targets, tuple(maps)))


def _texts(values: Sequence[str], key: str) -> Sequence[str]:
    """Return a list that is one; a text alone would be taken letter by letter.

    Raises:
        InputError: it is a text.
    """
    if isinstance(values, str):
        raise InputError("a list", key=key, value=values)
    return values
