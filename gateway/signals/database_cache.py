"""Databases that were parsed before, kept beside the compiled kernels: to read one again takes an eighth of the time.

A file there is a pickle, which is code as kernels are: it is read where those are, under the same checks of owner and
rights. Its name is the digest of the database's bytes, the versions of all that has made it, and what mends dialects.
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from gateway_fdi.jit import cache

if TYPE_CHECKING:
    from cantools.database.can import Message

#: Smaller files are parsed each time: it takes some 40 ms [byte].
LEAST = 1 << 15
#: Databases that are kept: the newest.
KEPT = 64
_NAME, _SUFFIX, _AGAIN = "database", ".parsed", "this database is parsed again"
_PACKAGES = ("cantools", "bitstruct")
#: Modules that make messages of a file's bytes.
_MADE_BY = ("bounds", "compact", "containers", "dialect", "ranges")


def source_of(module: str) -> bytes:
    """Return the source of a module beside this one."""
    return Path(__file__).with_name(f"{module}.py").read_bytes()


def messages_of(data: bytes, kind: str, parse: Callable[[], list[Message]]) -> list[Message]:
    """Return the messages of a database by the bytes of its file; errors of ``parse`` are raised."""
    if len(data) < LEAST:
        return parse()
    made_by = (sys.version, kind, *map(source_of, _MADE_BY), *(version(package) for package in _PACKAGES))
    key = blake2b(data, digest_size=16, salt=blake2b(repr(made_by).encode(), digest_size=16).digest()).hexdigest()
    body = cache.read_body(f"{_NAME}-{key}{_SUFFIX}", _AGAIN)
    if body is not None:
        try:
            found: list[Message] = pickle.loads(body)  # noqa: S301 - of this user, as compiled kernels are
        except Exception as error:  # whatever a class that has changed raises
            cache.say_once(f"a kept database is not to be used ({error}): {_AGAIN}")
        else:
            return found
    found = parse()
    try:
        body = pickle.dumps(found, pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # as deep as it is, or with what no pickle takes
        cache.say_once(f"a parsed database cannot be kept ({error}): the next start parses it again")
    else:
        cache.write_body(_NAME, key, _SUFFIX, body, KEPT)
    return found
