"""Each key of each monitor with absurd values: taken, or refused by one line that names the key; no traceback.

A number of absurd size may be taken; one that is none, or has no end, is not.
"""

import math
import random
from typing import get_args

import pytest
import tomlkit
from amount import FULL
from pydantic import BaseModel

from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway.monitors.registry import MONITORS
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped
from gateway_fdi.common.tomlfile import read_toml
from gateway_fdi.errors import InputError, InputErrors
from gateway_fdi.jit import COMPILED

pytestmark = pytest.mark.skipif(not COMPILED, reason="nothing is stepped")

SEED = 28
#: A configuration of each type of monitor. One of `method` has a fitted file beside it (tests/arena/test_monitor.py).
CONFIGS = {
    "crank_sync": "crank_30_2",
    "hybrid_powertrain": "truck",
    "linear_observer": "linear_belt",
    "pi_bank": "linear_belt",
    "redundant_pair": "pedal",
    "redundant_triple": "pedal_three",
    "rule": "signals",
    "sender_clock": "clocks",
    "signal": "signals",
    "steering_angle": "steering",
    "structural": "motor",
}
#: What is put in the place of each key.
VALUES = {
    "text": "x", "nan": math.nan, "inf": math.inf, "minus inf": -math.inf, "negative": -1.0, "huge": 1e300,
    "large integer": 10**12, "zero": 0, "tiny": 1e-300, "list": [], "matrix of nan": [[math.nan]], "table": {},
    "true": True,
}  # fmt: skip
#: Values that must not be taken.
NONE = ("nan", "inf", "minus inf", "matrix of nan")
#: Cases of each type in a short run.
SAMPLED = 14


def models(annotation):
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in models(part)]


def keys(model, given, at=()):
    """Yield the paths of all keys that a table can have, in the tables below it, too; lists by their first entry."""
    for name, field in model.model_fields.items():
        yield (*at, name)
        here = given.get(name) if isinstance(given, dict) else None
        below = models(field.annotation)
        if isinstance(here, list):
            yield from ((*at, name, 0),) if here and not isinstance(here[0], dict) else ()
        for one in below:
            if isinstance(here, list):
                yield from keys(one, here[0], (*at, name, 0)) if here else ()
            elif field.annotation is one or isinstance(here, dict):
                yield from keys(one, here or {}, (*at, name))
        if isinstance(here, dict) and not below:
            yield from ((*at, name, key) for key in here)


def put(table, path, value):
    """Return a table with another value at a path."""
    if not path:
        return value
    if isinstance(path[0], int):
        return [put(one, path[1:], value) if k == path[0] else one for k, one in enumerate(table)]
    return {**table, path[0]: put(table.get(path[0], {}), path[1:], value)}


def cases():
    rng = random.Random(SEED)
    for kind, name in CONFIGS.items():
        entry = next(e for e in read_toml(shipped(f"configs/{name}.toml"))["monitor"] if e["type"] == kind)
        paths = list(dict.fromkeys(keys(MONITORS.get(kind).params, entry)))
        every = [(kind, name, path, value) for path in paths for value in VALUES]
        yield from every if FULL else rng.sample(every, SAMPLED)


def test_every_type_is_here():
    assert {kind for kind in MONITORS if "." not in kind and ":" not in kind} - {"method", "filter"} == set(CONFIGS)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # what overflows in a design is refused or has no effect
def test_check_names_what_is_wrong_by_its_key(tmp_path):
    print("seed", SEED)
    wrong = []
    for kind, name, path, value in cases():
        source = shipped(f"configs/{name}.toml")
        table = read_toml(source)
        entry = next(e for e in table["monitor"] if e["type"] == kind)
        text = tomlkit.dumps({"name": "t", "bus": table["bus"], "monitor": [put(entry, path, VALUES[value])]})
        file = tmp_path / "configs" / "c.toml"
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
        key = "monitor[0]" + "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
        try:
            config = load_config(file)
            gateway = Gateway(config, None, file=file)
            for each in config.monitor:
                monitor, params = monitor_of(each)
                _ = (*monitor.warnings(params), *monitor.notes(params))
            gateway.close()
        except (InputError, InputErrors) as error:
            errors = error.errors if isinstance(error, InputErrors) else [error]
            if not any((e.key or "").startswith("monitor[0]") for e in errors):
                wrong.append((kind, key, value, f"no key: {error}"))
            if value in NONE and not any((e.key or "").startswith(f"monitor[0].{path[0]}") for e in errors):
                wrong.append((kind, key, value, f"another key: {error}"))
        except Exception as error:  # what a user would see as a traceback
            wrong.append((kind, key, value, repr(error)[:200]))
        else:
            if value in NONE:
                wrong.append((kind, key, value, "taken"))
    assert wrong == []
