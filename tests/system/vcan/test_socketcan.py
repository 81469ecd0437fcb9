"""SocketCAN on vcan0, with python-can and can-utils as peers."""

import json
import select
import signal
import subprocess
import sys
import time

import can
import cantools
import isotp
import numpy as np
import pytest

from gateway.bus.candump import parse
from gateway.bus.frames import BRS, EXTENDED, FD, REMOTE, empty, payload, put
from gateway.bus.uri import open_bus
from gateway.errors import BusError
from gateway.resources import shipped

pytestmark = pytest.mark.vcan

GATEWAY = [sys.executable, "-c", "from gateway.cli import main; main()"]


def take(bus, count):
    out = empty(count)
    got = 0
    while got < count and select.select([bus.fileno()], [], [], 5)[0]:
        got += bus.receive(out[got:])
    return out[:got]


def ask(request):
    """Ask the daemon with can-isotp over python-can; returns the answer as hex digits."""
    address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E0, rxid=0x7E8)
    with can.Bus("vcan0", interface="socketcan") as bus:
        stack = isotp.CanStack(bus, address=address)
        stack.start()
        try:
            stack.send(bytes.fromhex(request))
            answer = stack.recv(block=True, timeout=20)
        finally:
            stack.stop()
    return "" if answer is None else answer.hex()


def test_frames_of_all_kinds_both_ways():
    sent = empty(4)
    put(sent, 0, 0, 0x123, b"\x01\x02", bus=6)
    put(sent, 1, 0, 0x12345678 | EXTENDED, bytes(range(48)), bus=6, flags=FD | BRS)
    put(sent, 2, 0, 0x77 | REMOTE, b"", bus=6)
    put(sent, 3, 0, 0x7FF, bytes(8), bus=6)
    with (
        open_bus("socketcan:vcan0?rcvbuf=1000000", 6) as ours,
        can.Bus("vcan0", interface="socketcan", fd=True) as theirs,
        open_bus("socketcan:vcan0", 6) as other,
    ):
        ours.send(sent)
        for frame in sent:
            message = theirs.recv(5)
            assert message.arbitration_id == int(frame["can_id"]) & 0x1FFFFFFF
            assert message.is_extended_id == bool(int(frame["can_id"]) & EXTENDED)
            assert message.is_remote_frame == bool(int(frame["can_id"]) & REMOTE)
            assert message.is_fd == bool(int(frame["flags"]) & FD)
            assert bytes(message.data) == payload(frame)
            theirs.send(message)
        for bus in (ours, other):
            got = take(bus, 4 if bus is ours else 8)
            got = got[-4:]
            assert all(abs(int(t) - time.time_ns()) < 60 * 10**9 for t in got["t_ns"])
            assert (np.diff(got["t_ns"]) > 0).all(), "the kernel's own stamps"
            got["t_ns"] = 0
            np.testing.assert_array_equal(got, sent)


def test_kernel_filters_keep_foreign_frames_back():
    with (
        open_bus("socketcan:vcan0", 0) as ours,
        can.Bus("vcan0", interface="socketcan") as theirs,
    ):
        ours.set_filters([0x700, 0x18FECA00 | EXTENDED])
        for can_id, extended in ((0x701, False), (0x700, True), (0x700, False), (0x18FECA00, True)):
            theirs.send(can.Message(arbitration_id=can_id, is_extended_id=extended))
        assert take(ours, 2)["can_id"].tolist() == [0x700, 0x18FECA00 | EXTENDED]
        assert ours.receive(empty(1)) == 0


def test_an_interface_that_is_not_there_is_a_clear_error():
    with pytest.raises(BusError, match="ip link add dev nosuch0 type vcan"):
        open_bus("socketcan:nosuch0")


def test_the_daemon_on_vcan0_seen_by_candump(tmp_path):
    """Daemon and virtual ECU as processes; candump's log of the DTC frames decodes with cantools."""
    message = cantools.database.load_file(shipped("dbc/gateway.dbc")).get_message_by_name("GW_DTC")
    with (tmp_path / "dtc.log").open("wb") as log, (tmp_path / "events").open("wb") as events:
        dump = subprocess.Popen(["candump", "-L", "vcan0,6F0:7FF"], stdout=log)
        daemon = subprocess.Popen(
            [*GATEWAY, "run", str(shipped("gateway.toml")), "--bus", "socketcan:vcan0", "--json",
             "--memory", str(tmp_path / "f.sqlite")],
            stdout=events,
        )  # fmt: skip
        try:
            drive = subprocess.run(
                [*GATEWAY, "simulate", "crank_missed_tooth", "--bus", "socketcan:vcan0", "--check",
                 "--wait", "120"],
                capture_output=True,
                text=True,
                timeout=200,
                check=False,
            )  # fmt: skip
            answers = [ask(request) for request in ("3e00", "190208", "03")]
        finally:
            daemon.send_signal(signal.SIGTERM)
            code = daemon.wait(30)
            dump.terminate()
            dump.wait(10)
    assert drive.returncode == 0, drive.stdout + drive.stderr
    assert code == 0
    assert answers[0] == "7e00"
    assert answers[1].startswith("5902ff")
    assert "033629" in answers[1], "over ISO-TP, on the kernel's own CAN"
    assert "0336" in answers[2]
    lines = (tmp_path / "dtc.log").read_bytes().splitlines()
    frames, wrong = parse(lines, 1, tmp_path / "dtc.log", None)
    assert wrong is None
    seen = [message.decode(payload(frame)) for frame in frames]
    assert {"Dtc": 0x033629, "Status": 0x2F, "FaultDetectionCounter": 127}.items() <= next(
        values for values in seen if values["Dtc"] == 0x033629
    ).items()
    last = json.loads((tmp_path / "events").read_text().splitlines()[-1])
    assert last["event"] == "summary"
    # Three requests and a flow control: kernel filters kept CTW_BASE and our own frames back.
    assert last["counters"]["unknown"] == 4
