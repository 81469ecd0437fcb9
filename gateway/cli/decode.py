"""``gateway decode``: logs as tables of signals."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.bus.corpus import Recording, find
from gateway.bus.ring import Recorded, read_recording
from gateway.cli.present import find_config, print_json, say
from gateway.common.extras import need
from gateway.config.channels import channels_of
from gateway.config.load import load_config
from gateway.decode.lake import Lake, Written
from gateway.signals.database import load_database
from gateway_fdi.errors import InputError, InputErrors

#: Stamps before this are no wall time: 1980-01-01 [ns].
_WALL_NS = 315_532_800 * 10**9


@dataclass
class _Decoded:
    recording: Recording
    reader: Recorded
    written: Written
    wall: bool
    wrong: InputError | None
    seconds: float

    def event(self) -> dict[str, Any]:
        """Return it in the form of the JSON contract."""
        return {
            "event": "decoded",
            "log": str(self.recording.path),
            "device": self.recording.device,
            "frames": self.written.frames,
            "rows": self.written.rows,
            "files": [str(path) for path in self.written.files],
            "foreign": self.written.foreign,
            "seconds": self.seconds,
            "notes": self.notes(),
            "reasons": [str(error) for error in self.problems],
        }

    @property
    def problems(self) -> list[InputError]:
        """Errors of the log."""
        return [*self.reader.problems, *([self.wrong] if self.wrong else [])]

    def notes(self) -> list[str]:
        """Return what people should know, one line each."""
        notes = [f"{count} frames of {name} left out: {why}" for (name, why), count in self.written.left_out.items()]
        if self.written.foreign:
            notes.append(f"{self.written.foreign} of {self.written.frames} frames are of no message of the database")
        if not self.wall and self.written.rows:
            notes.append("the log has no wall time: its rows are in 1970")
        if self.reader.passed_over:
            notes.append(f"{len(self.reader.passed_over)} places could not be read: {self.reader.passed_over[0]}")
        return notes


def decode(
    logs: Sequence[str],
    out: Path,
    *,
    databases: Sequence[Path],
    config: Path | None,
    maps: Sequence[str],
    device: str | None,
    numbers: bool,
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
    if databases:
        lake = Lake(out, [load_database(databases)], numbers=numbers)
        if maps:
            raise InputError("goes with --config", key="--map", value=maps[0])
    else:
        loaded = load_config(find_config(config))
        channels = channels_of(loaded, maps)
        pgn = [k for k, bus in enumerate(loaded.bus) if bus.match == "pgn"]
        lake = Lake(out, [load_database(bus.database) for bus in loaded.bus], pgn=pgn, numbers=numbers)
    wrong: list[InputError] = []
    for recording in recordings:
        done = _decoded(lake, recording, channels)
        wrong += done.problems
        if json:
            print_json(done.event())
            continue
        rate = done.written.frames / done.seconds if done.seconds else 0.0
        print(
            f"{recording.path}: {done.written.frames} frames, {done.written.rows} rows in"
            f" {len(done.written.files)} files, {rate:,.0f} frames/s"
        )
        for note in done.notes():
            say(f"{recording.path}: {note}")
    if wrong:
        raise InputErrors(wrong)
    return 0


def _decoded(lake: Lake, recording: Recording, channels: dict[str, int] | None) -> _Decoded:
    begun = time.monotonic()
    reader = read_recording(recording.path, channels)
    tables = lake.begin(recording.device, f"{recording.name}-{recording.digest()}")
    wrong: InputError | None = None
    wall = True
    try:
        try:
            for frames in reader:
                origin_ns = reader.origin_ns
                wall = wall and (not len(frames) or int(frames["t_ns"][0]) + origin_ns >= _WALL_NS)
                tables.add(frames, origin_ns)
        except InputError as error:
            wrong = error
        written = tables.finish()
    except BaseException:
        tables.abandon()
        raise
    return _Decoded(recording, reader, written, wall, wrong, time.monotonic() - begun)
