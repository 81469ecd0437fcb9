"""Plans in files: what was chosen and written once is found again, so that a warm start needs no algebra.

They lie beside the compiled kernels, named by a digest of all that they are made of: the model, what the configuration
asks of it, and the sources of the structural analysis. A file that is damaged or cannot be written costs time, never
more.
"""

from __future__ import annotations

import hashlib
import json
import os
from functools import cache
from pathlib import Path
from typing import Any

import gateway_fdi.structure
from gateway_fdi.common import progress
from gateway_fdi.jit.cache import folder
from gateway_fdi.jit.owned import foreign, read_own, write_own
from gateway_plants.structural.monitor.plan import Plan, as_dict, from_dict

#: Plans that are kept: the newest.
KEPT = 64


@cache
def _generator() -> str:
    """Return a digest of the sources that write plans."""
    total = hashlib.blake2b(digest_size=16)
    sources = (*gateway_fdi.structure.__path__, str(Path(__file__).parent))
    for source in sources:
        for path in sorted(Path(source).rglob("*.py")):
            total.update(path.name.encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


def key_of(model: bytes, asked: dict[str, Any]) -> str:
    """Return the name of a plan.

    Args:
        model: contents of its file.
        asked: what the configuration asks of it, as JSON has it.
    """
    text = json.dumps(asked, sort_keys=True).encode()
    return hashlib.blake2b(b"\0".join([_generator().encode(), text, model]), digest_size=16).hexdigest()


def _file(key: str) -> Path:
    return folder() / "structural" / f"{key}.json"


def read(key: str) -> Plan | None:
    """Return a plan, None if it is not there, or not to be used."""
    try:
        head, _, body = read_own(_file(key)).partition(b"\n")
    except PermissionError as error:  # a plan is code, which is run
        progress.say(f"the choice of tests is not used ({error}): it is made again")
        return None
    except OSError:
        return None
    if hashlib.blake2b(body, digest_size=16).hexdigest().encode() != head:
        progress.say(f"{_file(key)}: damaged, so the tests are chosen again")
        return None
    return from_dict(json.loads(body))


def write(key: str, plan: Plan) -> None:
    """Keep a plan, if that is possible; old ones make room."""
    path = _file(key)
    body = json.dumps(as_dict(plan)).encode()
    draft = path.with_name(f".{key}.{os.getpid()}")
    try:
        path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
        if why := foreign(path.parent):
            raise PermissionError(why)
        write_own(draft, hashlib.blake2b(body, digest_size=16).hexdigest().encode() + b"\n" + body)
        draft.replace(path)
        for old in sorted(path.parent.glob("*.json"), key=lambda file: -file.stat().st_mtime)[KEPT:]:
            old.unlink(missing_ok=True)
    except OSError as error:
        progress.say(f"the choice of tests cannot be kept ({error}): the next start makes it again")
