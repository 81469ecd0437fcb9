"""The kernel's wall clock is set while the daemon runs on the kernel's CAN, whose stamps are of that clock."""

import json
import threading
import time
from contextlib import contextmanager

import pytest
from bench_config import beat, write_config
from kernel_can import can_frame, daemon, raw, wait_for

from gateway.bus.logs import LogReader
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_replay.replay import replay

pytestmark = pytest.mark.vcan

GW_DTC = 0x6F0
MORE = """
[output.uds]
s3_ms = 1500
[record]
folder = "{folder}/ring"
[clock]
heals_after_s = 1.0
"""


@contextmanager
def clock_set_back():
    """The test kernel's clock is the same for the next test."""
    ahead = time.time() - time.monotonic()
    try:
        yield
    finally:
        time.clock_settime(time.CLOCK_REALTIME, time.monotonic() + ahead)


def set_clock(step_s):
    time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME) + step_s)


class Ecu:
    """Beats each 20 ms of true time while it is not silent."""

    def __init__(self):
        self.silent = self._ended = False
        self.sent = 0
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        with raw("vcan0") as sock:
            while not self._ended:
                if not self.silent:
                    sock.send(can_frame(0x300, beat(self.sent)))
                    self.sent += 1
                time.sleep(0.02)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended = True
        self._thread.join()


def dtcs(running):
    return [(e["dtc"], e["status"] & 1) for e in running.events() if e["event"] == "dtc"]


def session(tester):
    """Ask for the active session; None where nobody answers."""
    tester.send(can_frame(0x7E0, bytes.fromhex("0322f18600000000")))
    return answer(tester)[4]


def answer(tester):
    limit = time.monotonic() + 120
    while time.monotonic() < limit:
        frame = tester.recv(16)
        if frame[:2] == b"\xe8\x07":
            return frame[8:]
    raise AssertionError("no answer")


def cyclic_frames(tester, seconds, wanted):
    """Wait for DTC frames with the all-clear, or the first of a list: so many, and so much true time at least."""
    count, begun = 0, time.monotonic()
    while time.monotonic() < begun + seconds or count < wanted:
        assert time.monotonic() < begun + 120, "where time stands still none comes"
        try:
            frame = tester.recv(16)
        except TimeoutError:
            continue
        count += frame[:2] == b"\xf0\x06" and (frame[13] == 1 or frame[8:11] == bytes(3))


@pytest.mark.parametrize(
    ("step_s", "place"),
    [
        (3600.0, "traffic"), (-3600.0, "silence"), (-0.5, "traffic"),
        *(pytest.param(*case, marks=pytest.mark.full("like the others")) for case in (
            (3600.0, "silence"), (-3600.0, "traffic"), (-0.5, "silence"),
        )),
    ],
)  # fmt: skip
def test_time_goes_on_where_the_kernels_clock_is_set(step_s, place, tmp_path):
    config = write_config(tmp_path, more=MORE.format(folder=tmp_path), timeout_ms=3000.0)
    with (
        clock_set_back(),
        daemon(config, cwd=tmp_path) as running,
        raw("vcan0") as tester,
        Ecu() as ecu,
    ):
        tester.settimeout(0.1)
        wait_for(lambda: ecu.sent > 20)
        tester.send(can_frame(0x7E0, bytes.fromhex("0210030000000000")))
        tester.settimeout(120)
        assert answer(tester)[:2].hex() == "0650"
        assert session(tester) == 3
        if place == "silence":
            ecu.silent = True
            time.sleep(0.3)  # less than the timeout
        set_clock(step_s)
        tester.settimeout(0.1)
        cyclic_frames(tester, 4.5, 3)
        (clock,) = [e for e in running.events() if e["event"] == "clock"]
        assert clock["step_s"] == pytest.approx(step_s, abs=0.2)
        assert abs(clock["t_ns"] - time.time_ns()) < 120e9, "told by the clock as it is now"
        tester.settimeout(120)
        assert session(tester) == 1, "S3 has passed"
        wait_for(lambda: ("U3000-62", 0) in dtcs(running))
        missed = [d for d in dtcs(running) if d[0] == "U0100-87"]
        if place == "traffic":
            assert missed == [], "no message was missed"
            ecu.silent = True
            wait_for(lambda: ("U0100-87", 1) in dtcs(running))
        else:
            assert missed == [("U0100-87", 1)], "in true time"
        ecu.silent = False
        wait_for(lambda: ("U0100-87", 0) in dtcs(running))
    assert running.code == 0
    events = running.events()
    told = [e for e in events if e["event"] in ("dtc", "clock")]
    codes = [(e["dtc"], e["status"] & 1) for e in told if e["event"] == "dtc"]
    assert sorted(codes) == [("U0100-87", 0), ("U0100-87", 1), ("U3000-62", 0), ("U3000-62", 1)]
    assert events[-1]["counters"]["clock_steps"] == 1
    assert [json.loads(line)["event"] for line in running.log] == ["wall clock was set"]
    # The recording says the same.
    again = []
    gateway = Gateway(load_config(config))
    gateway.listen(again.append)
    replay(gateway, LogReader(tmp_path / "ring"))
    assert [e for e in again if e["event"] in ("dtc", "clock")] == told
