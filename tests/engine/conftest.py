"""A small database and a scripted monitor, to look at the engine alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from gateway.bus.frames import EXTENDED, FD, empty, put
from gateway.engine.build import build_engine
from gateway.engine.checks import message
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.instances import MonitorInstance
from gateway.monitors import contract
from gateway.monitors.contract import (
    TIMER,
    Debounce,
    Fault,
    Monitor,
    MonitorParams,
    Readout,
    Signal,
    report,
)
from gateway.signals.database import load_database
from gateway_fdi.jit import Record, f8, i8, kernel, labels, means

DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 256 Alpha: 8 A
 SG_ Crc : 0|8@1+ (1,0) [0|255] "" B
 SG_ Count : 8|4@1+ (1,0) [0|15] "" B
 SG_ Value : 16|16@1- (0.5,0) [-1000|1000] "V" B
BO_ 257 Beta: 8 A
 SG_ Value : 0|16@1+ (1,0) [0|65535] "V" B
BO_ 2566844926 Gamma: 8 A
 SG_ Value : 0|16@1+ (1,0) [0|65535] "V" B
"""


class Params(MonitorParams):
    """Fails above the limit; wakes itself up if asked."""

    messages: tuple[str, ...] = ("Alpha",)
    signals: tuple[str, ...] = ("Alpha.Value",)
    limit: float = 10.0
    wake_ms: float = 0.0
    tag: float = 0.0


class State(Record):
    steps: i8
    last_ns: i8
    total: f8


class Const(Record):
    limit: f8
    wake_ns: i8
    tag: f8


class Inputs(contract.Inputs):
    a: f8
    b: f8


class Evidence(Record):
    tag: f8
    total: f8 = means("sum")


@kernel
def step(s, c, u, out):
    s.steps += 1
    s.last_ns = u.t_ns
    if u.trigger == TIMER:
        report(out, 1, True, 1.0, 0.0)
        return
    if c.wake_ns > 0:
        out.wake_ns = u.t_ns + c.wake_ns
        report(out, 1, False, 0.0, 0.0)
    s.total += u.a
    e = report(out, 0, u.a > c.limit, u.a, c.limit)
    e.tag, e.total = c.tag, s.total


def _prepare(p, s, c):
    c.limit = p.limit
    c.wake_ns = int(p.wake_ms * 1e6)
    c.tag = p.tag


def _connect(p):
    signals = [Signal(name, triggers=name.rpartition(".")[0] in p.messages) for name in p.signals]
    return dict(zip(("a", "b"), [*signals, None, None], strict=False))


def _faults(_):
    return (
        Fault("high", "C1000-00", "too high", labels(Evidence), Debounce(2, 2)),
        Fault("silent", "C1001-00", "woken by the timer", (), Debounce(1, 1)),
    )


SCRIPTED = Monitor(
    type="scripted",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    evidence=Evidence,
    step=step,
    connect=_connect,
    triggers=lambda p: p.messages,
    prepare=_prepare,
    faults=_faults,
    capabilities=(Readout(("steps", "last_ns", "total")),),
)


@pytest.fixture(scope="session")
def database(tmp_path_factory):
    path = tmp_path_factory.mktemp("dbc") / "small.dbc"
    path.write_text(DBC)
    return load_database([path])


@pytest.fixture
def build(database):
    def make(*monitors, checks=(), **options):
        instances = [
            MonitorInstance(name, SCRIPTED, Params(**params), 0, priority) for name, priority, params in monitors
        ]
        rows = [CheckInstance(message.Params(**check), 0, f"comm.{check['message']}") for check in checks]
        return build_engine([(0, database)], instances, rows, **options)

    return make


class Collector:
    """Keeps copies of the events, as plain tuples."""

    def __init__(self):
        self.events = []

    def __call__(self, events):
        self.events += [
            (
                int(e["t_ns"]),
                int(e["fault"]),
                int(e["kind"]),
                int(e["result"]),
                int(e["fdc"]),
                float(e["value"]),
                float(e["threshold"]),
                tuple(np.asarray(e["evidence"]).tolist()),
            )
            for e in events
        ]


def batch(*rows):
    """Make a batch from (t_ms, can_id, payload)."""
    frames = empty(len(rows))
    for k, (t_ms, can_id, payload) in enumerate(rows):
        put(frames, k, round(t_ms * 1e6), can_id, payload, flags=FD if len(payload) > 8 else 0)
    return frames


def alpha(t_ms, volts, count=0, crc=0):
    return (
        t_ms,
        256,
        bytes([crc, count]) + round(volts * 2).to_bytes(2, "little", signed=True) + bytes(4),
    )


def beta(t_ms, value):
    return (t_ms, 257, value.to_bytes(2, "little") + bytes(6))


@pytest.fixture
def tools():
    return SimpleNamespace(Collector=Collector, batch=batch, alpha=alpha, beta=beta, EXTENDED=EXTENDED)
