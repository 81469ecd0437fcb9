"""LiU-ICE: recordings of an engine's test bench, by Linköping University (Jung, Frisk, Krysander, arXiv 2408.13269).

The files are the university's to give; who has them puts them into a folder: ``wltp_NF.csv`` without a fault, and
``wltp_f_pic_090.csv`` and so on, each with a column ``time``, 20 samples a second and the fault from 120 s on. A
structural model beside them, ``model.toml``, lets methods run that need equations; its known variables are
:data:`COLUMNS`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gateway_arena.contract import SAMPLES, Array, Record, WithoutSlopes, cut
from gateway_arena.trial import Records
from gateway_fdi.errors import InputError
from gateway_fdi.structure.file import load_own_model
from gateway_fdi.structure.model import Model

#: Known variable of the benchmark's model -> column of its files, in small letters.
COLUMNS = {
    "y_p_ic": "intercooler_pressure",
    "y_T_ic": "intercooler_temperature",
    "y_p_im": "intake_manifold_pressure",
    "y_W_af": "air_mass_flow",
    "y_omega_e": "engine_speed",
    "y_alpha_th": "throttle_position",
    "y_u_wg": "wastegate_position",
    "y_wfc": "injected_fuel_mass",
    "y_T_amb": "ambient_temperature",
    "y_p_amb": "ambient_pressure",
}
#: When a fault begins, and time between two samples [s].
ONSET_S, PERIOD_S = 120.0, 0.05
#: Share of a drive without a fault that methods learn from; the rest sets thresholds.
SHARE = 0.3
_NAME = re.compile(r"_(NF|f_[a-z]+)(?:_[^_]*)?\.csv$")


class Engine(WithoutSlopes):
    """The bench as the arena takes it (:class:`gateway_arena.contract.Plant`): records are cut from the files.

    Raises:
        InputError: no files of this format; one that lacks a column, or has a value that is no number.
    """

    name, source, period_s = "liu_ice", "engine test bench, Linköping; Jung, Frisk, Krysander 2024", PERIOD_S
    commands: tuple[str, ...] = ()
    knowns = tuple(COLUMNS)

    def __init__(self, folder: Path) -> None:
        self._fine: list[Array] = []
        self._bad: list[tuple[str, str, Array]] = []
        for file in sorted(folder.glob("*.csv")):
            if found := _NAME.search(file.name):
                values = _read(file)
                if found[1] == "NF":
                    self._fine.append(values)
                else:
                    self._bad.append((found[1], file.name, values))
        if not self._fine or not self._bad:
            text = "no files of LiU-ICE: one without a fault, as wltp_NF.csv, and others, as wltp_f_pic_090.csv"
            raise InputError(text, file=folder, key="--data")
        faults = tuple(sorted({fault for fault, *_ in self._bad}))
        own = folder / "model.toml"
        self.model = (
            load_own_model(own, key="--data") if own.is_file() else Model(self.name, (), (), self.knowns, faults)
        )
        for wrong in {*self.knowns} ^ {*self.model.knowns} | {*faults} - {*self.model.faults}:
            raise InputError(
                f"known variables are {', '.join(COLUMNS)}; faults {', '.join(faults)}", file=own, value=wrong
            )
        self.sizes: Mapping[str, str] = {
            fault: ", ".join(name for one, name, _ in self._bad if one == fault) for fault in faults
        }
        steps = np.concatenate([np.diff(values, axis=0) for values in self._fine])
        self.noise = tuple((steps.std(0) / np.sqrt(2.0)).tolist())

    def records(self) -> Records:
        """Return the records, a minute each: of a file with a fault two before it, and one in whose middle it begins.

        Raises:
            InputError: the drives are too short.
        """
        pieces = [piece for values in self._fine for piece in cut(values)]
        learned = max(4, round(SHARE * len(pieces)))
        first = round(ONSET_S / PERIOD_S)
        begin = first - SAMPLES // 2
        short = [name for _, name, values in self._bad if len(values) < begin + SAMPLES]
        if short or len(pieces) <= learned:
            text = (
                f"a drive of {(begin + SAMPLES) * PERIOD_S:g} s at least, and {learned + 1} min of them without a fault"
            )
            raise InputError(text, key="--data", value=short[0] if short else "NF")
        fine = [_record(piece) for piece in pieces]
        before = [_record(piece) for _, _, values in self._bad for piece in cut(values[:first])]
        bad = [_record(values[begin : begin + SAMPLES], fault, SAMPLES // 2) for fault, _, values in self._bad]
        return Records(tuple(fine[:learned]), tuple(fine[learned:]), tuple(before), (), tuple(bad))

    def record(self, seed: int, fault: str = "", off: float = 0.0, size: float = 1.0) -> Record:
        """Return a record of the files (:class:`gateway_arena.contract.Plant`), again and again the same ones."""
        del off, size
        given = self.records()
        some = [one for one in given.faulty if one.fault == fault] if fault else given.healthy
        return some[seed % len(some)]


def _read(file: Path) -> Array:
    """Return the columns of a file, shape (n, knowns).

    Raises:
        InputError: a column is missing; a value is no number; the samples are not 50 ms apart.
    """
    with file.open(encoding="utf-8-sig") as stream:
        names = [name.strip().strip('"').lower() for name in stream.readline().split(",")]
        for column in ("time", *COLUMNS.values()):
            if column not in names:
                raise InputError(f"there is no such column; it has {', '.join(names)}", file=file, value=column)
        try:
            table = np.loadtxt(stream, delimiter=",", ndmin=2)
        except ValueError as error:
            raise InputError(f"numbers: {error}", file=file) from error
    wrong = np.argwhere(~np.isfinite(table))
    if len(wrong):
        row, column = wrong[0].tolist()
        raise InputError("no number", file=file, line=row + 2, value=names[column])
    steps = np.diff(table[:, names.index("time")])
    late = np.flatnonzero(np.abs(steps - PERIOD_S) > PERIOD_S / 2)
    if len(late):
        text = f"samples are {PERIOD_S:g} s apart, not {steps[late[0]]:g} s"
        raise InputError(text, file=file, line=int(late[0]) + 3, value="time")
    return np.ascontiguousarray(table[:, [names.index(column) for column in COLUMNS.values()]])


def _record(values: Array, fault: str = "", onset: int = SAMPLES) -> Record:
    return Record(np.arange(float(len(values))) * PERIOD_S, values, fault, onset)
