"""Plans in files: what was chosen and written once is found again, so that a warm start needs no algebra.

They lie in the cache of the compiled kernels, named by a digest of all that they are made of: the model, what the
configuration asks of it, and the sources of the structural analysis.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import gateway_fdi.structure
from gateway_fdi.jit import cache as files
from gateway_plants.structural.monitor.plan import Plan, from_dict

#: Plans that are kept: the newest.
KEPT = 64
_NAME, _SUFFIX = "plan", ".json"


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


def read(key: str) -> Plan | None:
    """Return a plan, None if it is not there, or not to be used."""
    body = files.read_body(f"{_NAME}-{key}{_SUFFIX}", "the tests are chosen again")
    return None if body is None else from_dict(json.loads(body))


def write(key: str, plan: Plan) -> None:
    """Keep a plan, if that is possible; old ones make room."""
    files.write_body(_NAME, key, _SUFFIX, json.dumps(asdict(plan)).encode(), KEPT)
