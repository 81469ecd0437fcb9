"""Which logs there are, and of which device each is."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from glob import glob, has_magic
from itertools import takewhile
from pathlib import Path

from gateway.bus.log_source import ARCHIVE, compression_of, segments
from gateway.bus.logs import is_format
from gateway.common.extras import installed
from gateway_fdi.errors import InputError
from gateway_logs.formats.parquet import is_frame_log

#: Hexadecimal digits of a digest that names a recording.
DIGITS = 16


@dataclass(frozen=True)
class Recording:
    """A log, or a folder of segments, which are one.

    Attributes:
        path: of it.
        device: whose it is.
    """

    path: Path
    device: str

    @property
    def files(self) -> list[Path]:
        """Its files, in order."""
        return segments(self.path) if self.path.is_dir() else [self.path]

    @property
    def name(self) -> str:
        """Its name without what tells the format."""
        name = self.path.name
        if self.path.is_dir():
            return name
        name = name[: len(name) - len(compression_of(self.path))]
        suffix = Path(name).suffix
        return name[: len(name) - len(suffix)] if is_format(suffix) else name

    def digest(self) -> str:
        """Return what names its contents: the first digits of their SHA-256.

        Raises:
            InputError: it cannot be read.
        """
        total = hashlib.sha256()
        try:
            for file in self.files:
                with file.open("rb") as stream:
                    while block := stream.read(1 << 20):
                        total.update(block)
        except OSError as error:
            raise InputError(error.strerror or str(error), file=self.path) from error
        return total.hexdigest()[:DIGITS]


def is_log(path: Path) -> bool:
    """Tell by its name whether a file is a log; of Parquet, which may be any table, by its columns."""
    if path.suffix.lower() == ".parquet":
        return installed("parquet") and is_frame_log(path)
    packed = compression_of(path)
    if packed == ARCHIVE:
        return True
    name = path.stem if packed else path.name
    return is_format(Path(name).suffix)


def _below(folder: Path) -> Iterator[Path]:
    """Yield the recordings in a folder and its folders, in order of their names."""
    if segments(folder):
        yield folder
        return
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if path.is_dir():
            yield from _below(path)
        elif is_log(path):
            yield path


def _device(path: Path, root: Path) -> str:
    """Return the first folder below the root, or else the folder that the log is in."""
    inside = path.relative_to(root).parts if path.is_relative_to(root) else ()
    if path.is_dir():
        return inside[0] if inside else path.absolute().name
    return inside[0] if len(inside) > 1 else path.absolute().parent.name or "device"


def _matching(pattern: str) -> Iterator[Path]:
    """Yield the recordings of a pattern; folders that match are looked into."""
    for text in sorted(glob(pattern, recursive=True)):  # noqa: PTH207 - an absolute pattern, too
        path = Path(text)
        if path.is_dir():
            if not pattern.rstrip("/").endswith("**") or segments(path):
                yield from _below(path)
        elif is_log(path) and not segments(path.parent):
            yield path


def find(patterns: Sequence[str | Path], device: str | None = None) -> list[Recording]:
    """Return the recordings that patterns stand for, each once, in order.

    Args:
        patterns: logs, folders, or patterns as of a shell (``logs/**``). A folder of segments that ``gateway record``
            made is one recording.
        device: whose they all are; None: the first folder below the pattern's fixed part, e.g. ``A`` of
            ``logs/A/1.log`` for ``logs/**``, or the folder that the log is in.

    Raises:
        InputError: a pattern that stands for nothing, a file that is no log.
    """
    found: dict[Path, Recording] = {}
    for one in patterns:
        pattern = str(one)
        path = Path(pattern)
        if has_magic(pattern) and not path.exists():
            root = Path(*takewhile(lambda part: not has_magic(part), path.parts))
            paths = list(_matching(pattern))
        elif path.is_dir():
            root, paths = path, list(_below(path))
        elif path.exists():
            root, paths = path.parent, [path]
        else:
            raise InputError("No such file or directory", file=path)
        if not paths:
            raise InputError("no logs here", value=pattern)
        for each in paths:
            found.setdefault(each.absolute(), Recording(each, device or _device(each, root)))
    return list(found.values())
