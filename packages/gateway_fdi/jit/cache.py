"""Compiled kernels in files: a kernel is compiled once, and loaded from then on. Databases and plans lie beside them.

A file is written under another name and then renamed, and begins with the digest of the rest: two processes may write
at once, and one that is cut off or changed is seen. A cache that cannot be read or written costs time, never more; the
reason is said once. Files that another user wrote, or could have written, are not used
(:mod:`gateway_fdi.jit.ownership`).
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from gateway_fdi.common import progress
from gateway_fdi.jit.ownership import foreign, read_own, write_own
from gateway_fdi.jit.settings import cache_directory

_MAGIC = b"gateway kernel 2\n"
_DIGEST = 16

#: Files of one kernel that are kept: the newest.
KEPT = 8  # of all its signatures


_said: set[str] = set()


def say_once(text: str) -> None:
    """Say something to the user, unless it was said before."""
    if text not in _said:
        _said.add(text)
        progress.say(text)


def folder() -> Path:
    """Return where compiled kernels are kept: the cache's folder, or a private one where that may be another's."""
    asked = cache_directory()
    why = foreign(asked)
    if not why:
        return asked
    private = _private()
    say_once(f"{asked}: not used, as {why}; compiled kernels are kept in {private.path}, {private.until}")
    return private.path


@dataclass(frozen=True)
class _Private:
    path: Path
    until: str
    held: tempfile.TemporaryDirectory[str] | None = None  # deletes it at the end


@cache
def _private() -> _Private:
    """Return a folder of this user: his own cache, else one of this process."""
    import platformdirs  # noqa: PLC0415 - few starts need it

    own = Path(platformdirs.user_cache_dir("ecu-gateway")) / "kernels"
    try:
        own.mkdir(mode=0o755, parents=True, exist_ok=True)
        if not foreign(own) and os.access(own, os.W_OK):
            return _Private(own, "the user's own cache")
    except OSError:
        pass  # there is no home
    held = tempfile.TemporaryDirectory(prefix="gateway-kernels-")  # with mode 0700
    return _Private(Path(held.name), "until this process ends", held)


@dataclass(frozen=True)
class Code:
    """Compiled code of an entry.

    Attributes:
        symbol: name of its C function.
        results: form of its result, as text.
        needs: symbols from elsewhere.
        code: object code.
        origin: its source, for packages that ship it: kernel, digest of its signature, key, files.
    """

    symbol: str
    results: str
    needs: tuple[str, ...]
    code: bytes
    origin: dict[str, Any] = field(default_factory=dict)


def _framed(body: bytes) -> bytes:
    return _MAGIC + hashlib.blake2b(body, digest_size=_DIGEST).digest() + body


def _body(data: bytes) -> bytes | None:
    """Return what a file's bytes hold; None if they are damaged."""
    body = data[len(_MAGIC) + _DIGEST :]
    return body if data == _framed(body) else None


def _pack(code: Code) -> bytes:
    head = {
        "symbol": code.symbol,
        "results": code.results,
        "needs": code.needs,
        "origin": code.origin,
    }
    return json.dumps(head).encode() + b"\n" + code.code


def unpack(data: bytes) -> Code | None:
    """Return the code in a file's bytes; None if they are damaged."""
    body = _body(data)
    return None if body is None else _code(body)


def _code(body: bytes) -> Code:
    head, _, code = body.partition(b"\n")
    values = json.loads(head)
    return Code(values["symbol"], values["results"], tuple(values["needs"]), code, values["origin"])


def read(name: str, key: str) -> Code | None:
    """Return the code of a kernel, None if it is not there, or not to be used."""
    body = read_body(f"{name}-{key}.kernel", "this kernel is compiled again")
    return None if body is None else _code(body)


def read_body(file: str, again: str) -> bytes | None:
    """Return what a file of the cache holds, None if it is not there, or not to be used.

    Args:
        file: its name.
        again: what happens instead, for the one who waits for it.
    """
    path = folder() / file
    try:
        body = _body(read_own(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        say_once(f"files of the cache cannot be read ({error}): {again}")
        return None
    if body is None:
        say_once(f"{path}: damaged, so {again}")
    return body


def write(name: str, key: str, code: Code, bitcode: bytes = b"") -> None:
    """Keep the code of a kernel, if that is possible; older ones of the same name make room.

    Args:
        name: of the kernel, with its module.
        key: digest of all that the code depends on.
        code: the code.
        bitcode: kept beside it, if there is any.
    """
    write_body(name, key, ".kernel", _pack(code), KEPT, bitcode)


def write_body(name: str, key: str, suffix: str, body: bytes, most: int, bitcode: bytes = b"") -> None:
    """Keep a file, if that is possible; older ones of the same name make room, ``most`` stay (see :func:`write`)."""
    kept = folder()
    draft = kept / f".{name}-{key}.{os.getpid()}"
    try:
        kept.mkdir(mode=0o755, parents=True, exist_ok=True)
        write_own(draft, _framed(body))
        if bitcode:
            (kept / f"{name}-{key}.bc").write_bytes(bitcode)
        draft.replace(kept / f"{name}-{key}{suffix}")
        _prune(kept, name, suffix, most)
    except OSError as error:
        say_once(f"files cannot be kept in the cache ({error}): the next start does the same work again")
        try:
            draft.unlink(missing_ok=True)
        except OSError:
            return


def _changed(path: Path) -> float:
    """When a file was changed; 0 if another process has just deleted it."""
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def _prune(kept: Path, name: str, suffix: str, most: int) -> None:
    """Delete all but the newest files of a name."""
    files = sorted(kept.glob(f"{name}-*{suffix}"), key=_changed, reverse=True)
    for path in files[most:]:
        path.unlink(missing_ok=True)


def size() -> tuple[int, int]:
    """Return how many compiled kernels are kept, and their bytes."""
    sizes = []
    for path in folder().glob("*.kernel"):
        with suppress(FileNotFoundError):  # another process may forget it meanwhile
            sizes.append(path.stat().st_size)
    return len(sizes), sum(sizes)
