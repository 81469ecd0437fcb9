"""Everything goes wrong at random, from a seed, in a daemon in this process: nothing is silent, nothing is lost."""

import os

import pytest
import run as run_module
from amount import amount
from checks import Broken
from machine import Wire
from run import QUIET_S, Run, schedule_for
from schedule import draw, read, text_of

from gateway.bus.frames import empty
from gateway.engine.core import Engine
from gateway.faults.store import Store
from gateway.runtime.app import Gateway

SEEDS = [int(os.environ["GATEWAY_SEED"])] if "GATEWAY_SEED" in os.environ else range(1, 1 + amount(4, 2))
SECONDS = 30.0


@pytest.mark.evidence("Durability: machine")
@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=pytest.mark.long if k else ()) for k, seed in enumerate(SEEDS)]
)
def test_nothing_is_lost_and_nothing_is_silent(seed, tmp_path):
    schedule = schedule_for(seed, SECONDS - QUIET_S)
    print(text_of(schedule))
    run = Run(tmp_path, seed, SECONDS, schedule).play()
    print(run.summary())


def test_a_schedule_can_be_read_again():
    schedule = draw(1, 60.0)
    assert read(text_of(schedule)) == schedule
    assert draw(1, 60.0) == schedule
    assert draw(2, 60.0) != schedule


@pytest.mark.long
@pytest.mark.full("4 s")
def test_the_same_seed_is_the_same_run(tmp_path):
    """Or a failure could not be repeated."""
    told = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        run = Run(tmp_path / name, 9, 18.0, draw(9, 18.0 - QUIET_S)).play()
        told.append((run.summary(), run.digest.hexdigest()))
    assert told[0] == told[1]


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("uncounted", "frames put on it"),
        ("untold", "told as stored"),
        ("late", "was not answered"),
        ("stopped", "behind true time"),
    ],
)
@pytest.mark.usefixtures("caught")  # the checks raise in the loop
def test_what_is_wrong_is_found(kind, says, tmp_path, monkeypatch):
    """The checks can fail: frames that nobody counts, a store that writes nothing, a tester nobody hears, time
    that stops.
    """
    if kind == "uncounted":
        receive = Wire.receive

        def forgetful(wire, out):
            found = receive(wire, out)
            wire.statistics.received -= found > 8
            return found

        monkeypatch.setattr(Wire, "receive", forgetful)
    elif kind == "untold":
        monkeypatch.setattr(Store, "save", lambda *_: None)
    elif kind == "late":
        monkeypatch.setattr(Gateway, "poll", lambda *_: empty(0))
        monkeypatch.setattr(run_module, "RESPONSE", 0x7FF)
    else:
        step = Engine.process
        monkeypatch.setattr(Engine, "process", lambda e, f, sink: step(e, f[f["t_ns"] < e.now_ns + 1000], sink))
    schedule = read("500 jumps 200 50 virtual:a")
    with pytest.raises(Broken, match=says):
        Run(tmp_path, 1, 14.0, schedule).play()
