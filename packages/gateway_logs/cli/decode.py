"""``gateway decode``: logs as tables of signals."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.bus.logs import LogReader
from gateway.cli.present import find_config, print_json, say
from gateway.common.extras import need
from gateway.common.times import zone_of
from gateway.config.load import load_config
from gateway.config.model import BusConfig, Config
from gateway.config.resolve import answer_buses, load_databases
from gateway_ask.log_answers import Answers
from gateway_fdi.errors import InputError, InputErrors
from gateway_logs.corpus import Recording, find
from gateway_logs.decode.parquet_tables import Lake, Written
from gateway_replay.channels import channels_of

#: Stamps before this are no wall time: 1980-01-01 [ns].
_WALL_NS = 315_532_800 * 10**9


@dataclass
class _Decoded:
    recording: Recording
    reader: LogReader
    written: Written
    wall: bool
    wrong: InputError | None
    seconds: float
    answers: Answers

    def event(self) -> dict[str, Any]:
        """Return it in the form of the JSON contract."""
        return {
            "event": "decoded",
            "log": str(self.recording.path),
            "device": self.recording.device,
            "frames": self.frames,
            "answers": self.answers.woven,
            "rows": self.written.rows,
            "files": [str(path) for path in self.written.files],
            "foreign": self.foreign,
            "seconds": self.seconds,
            "notes": self.notes(),
            "reasons": [str(error) for error in self.problems],
        }

    @property
    def frames(self) -> int:
        """Frames of the log."""
        return self.written.frames - self.answers.woven

    @property
    def foreign(self) -> int:
        """Frames of no message, which carry no part of one either."""
        return self.written.foreign - self.answers.carrying

    @property
    def problems(self) -> list[InputError]:
        """Errors of the log."""
        return [*self.reader.problems, *([self.wrong] if self.wrong else [])]

    def notes(self) -> list[str]:
        """Return what people should know, one line each."""
        notes = [
            f"{count} frames of {name} have a multiplexer value that the database does not describe"
            for name, count in self.written.unselected.items()
        ]
        for name, short in self.written.short.items():
            lengths = f"{short.least} to {short.most}" if short.least < short.most else str(short.least)
            lost = f": not in them {', '.join(short.signals)}" if short.signals else ""
            notes.append(f"{short.count} frames of {name} are shorter than the database says, {lengths} bytes{lost}")
        if self.foreign:
            notes.append(f"{self.foreign} of {self.frames} frames are of no message of the database")
        notes += self.answers.notes()
        if not self.wall and self.written.rows:
            notes.append("the log has no wall time: its rows are in 1970")
        return notes + self.reader.passed_over.notes()


def decode(
    logs: Sequence[str],
    out: Path,
    *,
    databases: Sequence[Path],
    config: Path | None,
    ecu: Path | None,
    maps: Sequence[str],
    device: str | None,
    numbers: bool,
    zone: str | None = None,
    json: bool,
) -> int:
    """Decode logs into tables; returns the exit code.

    Raises:
        InputError, InputErrors: a log, database or configuration that is wrong; the part that could be read has been
            written.
    """
    need("parquet", "Parquet files", key="--out")
    if databases and config is not None:
        raise InputError("either databases or a configuration", key="--database", value=str(databases[0]))
    recordings = find(logs, device)
    channels: dict[str, int] | None = None
    if databases and maps:
        raise InputError("goes with --config or --ecu", key="--map", value=maps[0])
    loaded = _configured(databases, config, ecu)
    if not databases:
        channels = channels_of(loaded, maps)
    pgn = [k for k, bus in enumerate(loaded.bus) if bus.match == "pgn"]
    answers = answer_buses(loaded)
    known = [*load_databases(loaded), *(bus.database for bus in answers)]
    lake = Lake(out, known, pgn=pgn, numbers=numbers)
    told = [note for database in known for note in database.notes]
    for note in () if json else told:
        say(f"database: {note}")
    wrong: list[InputError] = []
    for recording in recordings:
        done = _decoded(lake, recording, channels, Answers(loaded, answers, lake.plan), zone or loaded.clock.zone)
        wrong += done.problems
        if json:
            event = done.event()
            print_json({**event, "notes": [*told, *event["notes"]]})
            continue
        rate = done.frames / done.seconds if done.seconds else 0.0
        print(
            f"{recording.path}: {done.frames} frames, {done.written.rows} rows in"
            f" {len(done.written.files)} files, {rate:,.0f} frames/s"
        )
        for note in done.notes():
            say(f"{recording.path}: {note}")
    if wrong:
        raise InputErrors(wrong)
    return 0


def _configured(databases: Sequence[Path], config: Path | None, ecu: Path | None) -> Config:
    """Return buses with their databases and ECUs: of a configuration, a file of ECUs, or databases for all frames.

    Raises:
        InputError, InputErrors: a file that is wrong; databases beside a file of several buses.
    """
    if ecu is not None and config is not None:
        raise InputError(
            "either a configuration, which has its own [[ecu]], or a file of them", key="--ecu", value=str(ecu)
        )
    if not databases:
        return load_config(find_config(config if ecu is None else ecu))
    if ecu is None:
        return Config(bus=(BusConfig(name="all", uri="virtual:all", database=tuple(databases)),))
    asked = load_config(ecu)
    if len(asked.bus) > 1:
        raise InputError("of several buses: name the databases in it, as database of each [[bus]]", file=ecu, key="bus")
    bus = asked.bus[0].model_copy(update={"database": (*asked.bus[0].database, *databases)})
    return asked.model_copy(update={"bus": (bus,)})


def _decoded(
    lake: Lake, recording: Recording, channels: dict[str, int] | None, answers: Answers, zone: str
) -> _Decoded:
    begun = time.monotonic()
    reader = LogReader(recording.path, channels, zone_of(zone))
    tables = lake.begin(recording.device, f"{recording.name}-{recording.digest()}")
    wrong: InputError | None = None
    wall = True
    try:
        try:
            for frames in reader:
                origin_ns = reader.origin_ns
                wall = wall and (not len(frames) or int(frames["t_ns"][0]) + origin_ns >= _WALL_NS)
                tables.add(answers.add(frames), origin_ns)
        except InputError as error:
            wrong = error
        written = tables.finish()
    except BaseException:
        tables.abandon()
        raise
    return _Decoded(recording, reader, written, wall, wrong, time.monotonic() - begun, answers)
