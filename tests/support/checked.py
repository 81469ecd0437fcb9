"""Frames of one message, and its checks through an engine."""

import cantools
import crccheck

from gateway.bus.frames import empty, put
from gateway.engine.build import build_engine
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.checks.message import Params
from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED
from gateway.signals.database import load_database
from gateway.signals.tables import SignalRef
from gateway_fdi.common.resources import shipped

MS = 1_000_000
ORACLE = cantools.database.load_file(shipped("dbc/crank.dbc")).get_message_by_name("CTW_PT4")


def frame(t_ms, count, pt0=100, corrupt=False, length=8):
    data = bytearray(ORACLE.encode({"Crc": 0, "FrameCnt": count % 256, "Pt0": pt0, "Pt1": 1, "Pt2": 2, "Pt3": 3}))
    data[0] = crccheck.crc.Crc8SaeJ1850.calc(bytes(data[1:]) + b"\x00\x07")
    if corrupt:
        data[5] ^= 0x10
    return (round(t_ms * MS), bytes(data[:length]))


def run(rows, **check):
    database = load_database([shipped("dbc/crank.dbc")])
    params = Params(
        message="CTW_PT4",
        **{
            "timeout_ms": 100.0,
            "counter": {"signal": "FrameCnt"},
            "crc": {"signal": "Crc", "data_id": 0x700},
            **check,
        },
    )
    ref = SignalRef(0, "CTW_PT4", "Pt0")
    engine = build_engine([(0, database)], [], [CheckInstance(params, 0, "c")], extra=[ref])
    frames = empty(len(rows))
    for k, (t_ns, data) in enumerate(rows):
        put(frames, k, t_ns, 0x700, data)
    seen = []

    def sink(events):
        seen.extend(
            (engine.faults[int(e["fault"])].id[2:], int(e["t_ns"]) // MS)
            for e in events
            if e["kind"] == QUALIFIED_FAILED
        )
        seen.extend(
            (engine.faults[int(e["fault"])].id[2:] + " passed", int(e["t_ns"]) // MS)
            for e in events
            if e["kind"] == QUALIFIED_PASSED
        )

    engine.process(frames, sink)
    return engine, seen, engine.signal(ref)
