"""The daemon on the kernel's CAN with can-utils, can-isotp, and the kernel's own J1939 as peers."""

import json
import re
import signal
import socket
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import can
import cantools
import isotp
import numpy as np
import pytest
import warm
from bench_config import beat, write_config
from kernel_can import can_frame, candump, daemon, events_in, raw, wait_for
from processes import GATEWAY
from scenario_runs import unhurried

from gateway.bus.frames import payload
from gateway.bus.logs import LogReader
from gateway_fdi.common.resources import shipped

pytestmark = pytest.mark.vcan

MESSAGE = cantools.database.load_file(shipped("dbc/gateway.dbc")).get_message_by_name("GW_DTC")
#: Random frames that the storm has at least.
STORM = 4000


def packets(interface):
    return int(Path(f"/sys/class/net/{interface}/statistics/tx_packets").read_text())


@pytest.fixture(scope="module", autouse=True)
def storm(tmp_path_factory):
    """Thousands of random frames of every kind on vcan1, with a daemon that takes them all, beside the first tests."""
    with ThreadPoolExecutor(1) as beside:
        weathered = beside.submit(weather, tmp_path_factory.mktemp("storm"))
        yield
        weathered.result()


def weather(folder):
    config = write_config(folder, more=f'[record]\nfolder = "{folder}/ring"\nsegment_mb = 0.1\n')
    before = packets("vcan1")
    with daemon(config, cwd=folder, bus="socketcan:vcan1") as running:
        cangen = subprocess.Popen(
            ["cangen", "vcan1", "-g", "8", "-I", "r", "-L", "r", "-D", "r", "-m", "-i"],
            stderr=subprocess.PIPE,
        )
        wait_for(lambda: packets("vcan1") - before > STORM or cangen.poll() is not None, seconds=600)
        assert cangen.poll() is None, cangen.stderr.read()
        assert running.poll() is None, "still there"
        cangen.terminate()
        cangen.wait(60)
        time.sleep(0.5)
        sent = packets("vcan1") - before
    # Between this count and its end the daemon goes on with what it sends each second, and hears it.
    most = packets("vcan1") - before
    assert running.code == 0
    assert not [line for line in running.log if "Traceback" in line]
    (end,) = [e for e in running.events() if e["event"] == "bus" and e["state"] == "closed"]
    assert sent > STORM
    heard = end["received"] + end["overflow"]
    assert sent <= heard <= most <= sent + 200, "theirs and our own, which came back"
    assert end["rejected"] == 0
    recorded = [frame for batch in LogReader(folder / "ring") for frame in batch]
    conditions = sum(int(frame["can_id"]) == 0x20000000 for frame in recorded)
    assert len(recorded) - conditions == end["received"]
    assert len(list((folder / "ring").iterdir())) > 1


def ask(request):
    """Ask the daemon with can-isotp over python-can; returns the answer as hex digits."""
    address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E0, rxid=0x7E8)
    with can.Bus("vcan0", interface="socketcan") as bus:
        stack = isotp.CanStack(bus, address=address)
        stack.start()
        try:
            stack.send(bytes.fromhex(request))
            answer = stack.recv(block=True, timeout=120)
        finally:
            stack.stop()
    return "" if answer is None else answer.hex()


def reports(log):
    """Return what candump saw of the DTC frames that tell a change of a crankshaft DTC, decoded by cantools.

    Without the number of all DTCs: how long a daemon waits for its ECU decides about another one.
    """
    frames = np.concatenate(list(LogReader(log)))
    seen = [MESSAGE.decode(payload(f)) for f in frames if int(f["can_id"]) == MESSAGE.frame_id]
    wanted = [v for v in seen if v["Index"] == 0 and int(v["Dtc"]) >> 8 == 0x0336]
    return [{name: v for name, v in report.items() if name != "Count"} for report in wanted]


def test_a_scenario_live_and_the_same_by_canplayer_give_the_same_dtc_frames(tmp_path):
    """Daemon and virtual ECU as processes; then candump's log of it to a second daemon, played by canplayer."""
    live, again = tmp_path / "live", tmp_path / "again"
    live.mkdir()
    scenario = unhurried(shipped("scenarios/crank_missed_tooth.toml"), tmp_path)
    again.mkdir()
    with (
        candump("-L", "vcan0", log=live / "all.log"),
        daemon(shipped("gateway.toml"), cwd=live) as running,
    ):
        drive = warm.run(
            [*GATEWAY, "simulate", str(scenario), "--bus", "socketcan:vcan0", "--check",
             "--wait", "120"],
            capture_output=True, text=True, timeout=1000, check=False,
        )  # fmt: skip
        answers = [ask(request) for request in ("3e00", "190208", "03")]
    assert drive.returncode == 0, drive.stdout + drive.stderr
    assert running.code == 0
    assert answers[0] == "7e00"
    assert answers[1].startswith("5902ff")
    assert "033639" in answers[1], "over ISO-TP, on the kernel's own CAN"
    assert "0336" in answers[2]
    seen = reports(live / "all.log")
    assert {"Dtc": 0x033639, "Status": 0x2F, "FaultDetectionCounter": 127}.items() <= seen[0].items()
    assert len(seen) == 2
    # Three requests and a flow control: kernel filters kept CTW_BASE and our own frames back.
    assert events_in(live)[-1]["counters"]["unknown"] == 4

    ecu_only = tmp_path / "ecu.log"
    ecu_only.write_text(
        "".join(f"{line}\n" for line in (live / "all.log").read_text().splitlines() if re.search(r" 70[0-9]#", line))
    )
    with (
        candump("-L", "vcan0", log=again / "all.log"),
        daemon(shipped("gateway.toml"), cwd=again) as running,
    ):
        subprocess.run(["canplayer", "-I", str(ecu_only)], check=True, timeout=1000)
        wait_for(lambda: len(reports(again / "all.log")) == 2)
    assert running.code == 0
    assert reports(again / "all.log") == seen


def test_cansend_feeds_and_python_can_sees(tmp_path):
    config = write_config(tmp_path, timeout_ms=60_000.0)
    with daemon(config, cwd=tmp_path) as running, can.Bus("vcan0", interface="socketcan") as tester:
        for k in (0, 1, 3, 5, 7, 9):
            subprocess.run(["cansend", "vcan0", f"300#{beat(k).hex()}"], check=True)
        limit = time.monotonic() + 120
        seen = set()
        while "U0401-82" not in seen and time.monotonic() < limit:
            got = tester.recv(1)
            if got is not None and got.arbitration_id == MESSAGE.frame_id:
                number = int(MESSAGE.decode(bytes(got.data))["Dtc"])
                seen.add({0xC40182: "U0401-82"}.get(number, hex(number)))
        assert "U0401-82" in seen, "the alive counter jumped"
        # Error frames as a controller's driver makes them.
        with raw("vcan0") as driver:
            driver.send(can_frame(0x20000040, bytes(8)))
            wait_for(lambda: dtcs(running).get("U0001-88") == 1)
            driver.send(can_frame(0x300, beat(10)))
            wait_for(lambda: dtcs(running).get("U0001-88") == 0)
    assert running.events()[-1]["buses"] == {"chassis": {"bus_off": 1}}


def dtcs(running):
    return {e["dtc"]: e["status"] & 1 for e in running.events() if e["event"] == "dtc"}


J1939 = """
[fault."chassis.Beat.timeout"]
spn = 639
fmi = 9
[fault."chassis.Beat.counter"]
spn = 639
fmi = 19
indicator = true
"""


def test_the_kernels_j1939_receives_dm1_by_bam_and_asks_for_dm2(tmp_path):
    config = write_config(tmp_path, timeout_ms=2000.0, more=J1939)
    config.write_text(config.read_text() + "\n[output.j1939]\naddress = 0xF9\n")
    no_name, no_pgn = socket.J1939_NO_NAME, socket.J1939_NO_PGN
    with (
        daemon(config, cwd=tmp_path) as running,
        socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_J1939) as tester,
        raw("vcan0") as ecu,
    ):
        tester.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        tester.bind(("vcan0", no_name, no_pgn, 0x20))
        tester.settimeout(120)
        for k in (0, 2, 4, 6, 8):
            ecu.send(can_frame(0x300, beat(k)))
        wait_for(lambda: dtcs(running) == {"U0401-82": 1, "U0100-87": 1})
        limit = time.monotonic() + 240
        dm1 = b""
        while len(dm1) != 10 and time.monotonic() < limit:
            data, (_, _, pgn, address) = tester.recvfrom(256)
            if (pgn, address) == (0xFECA, 0xF9):
                dm1 = data
        # Lamps, then two DTCs of SPN 639: FMI 9 and 19, each once.
        assert dm1[0] >> 6 == 1, "malfunction indicator on"
        assert {dm1[2:6], dm1[6:10]} == {
            bytes([0x7F, 0x02, 9, 1]),
            bytes([0x7F, 0x02, 19, 1]),
        }
        # One heals; DM2 on request has it, if the message was not missing again when the request came.
        count = 9
        dm2 = b""
        while not dm2 and time.monotonic() < limit:
            for k in range(count, count + 9):
                ecu.send(can_frame(0x300, beat(k)))
            count += 9
            wait_for(lambda: dtcs(running)["U0100-87"] == 0)
            tester.sendto(bytes.fromhex("cbfe00"), ("vcan0", no_name, 0xEA00, 0xF9))
            pgn = address = 0
            while (pgn, address) != (0xFECB, 0xF9) and time.monotonic() < limit:
                data, (_, _, pgn, address) = tester.recvfrom(256)
            dm2 = data if dtcs(running)["U0100-87"] == 0 else b""
        assert dm2[2:6] == bytes([0x7F, 0x02, 9, 1]), "previously active"
        assert dm2[6:] == b"\xff\xff"
    assert running.code == 0


def test_sighup_under_traffic_loses_no_frame_and_no_memory(tmp_path):
    config = write_config(tmp_path, timeout_ms=60_000.0)
    text = config.read_text()
    with daemon(config, cwd=tmp_path) as running, raw("vcan0") as ecu, raw("vcan0") as ears:
        ears.settimeout(120)
        sent = 0

        def send(count):
            nonlocal sent
            for _ in range(count):
                frame = can_frame(0x300, beat(sent))
                ecu.send(frame)
                while ears.recv(16) != frame:  # it is in the daemon's queue, too, before the next, or the daemon's end
                    pass
                sent += 1
                time.sleep(0.005)

        def answers(state):
            return [e for e in running.events() if e["event"] == "config" and e["state"] == state]

        send(20)
        sent += 100  # a jump, three times: the DTC that must not be lost
        for _ in range(3):
            send(1)
            sent += 100
        sent -= 100
        wait_for(lambda: dtcs(running).get("U0401-82") == 1)
        config.write_text(text.replace("60000.0", "50000.0").replace('"beat"', '"changed"', 1))
        running.send_signal(signal.SIGHUP)
        while not answers("reloaded"):
            send(10)
        config.write_text(text.replace('"Beat"', '"Nobody"'))
        running.send_signal(signal.SIGHUP)
        while not answers("refused"):
            send(10)
        send(60)
        received = sent
    events = running.events()
    (refused,) = answers("refused")
    assert "beat.toml" in refused["reason"]
    assert "Nobody" in refused["reason"]
    (end,) = [e for e in events if e["event"] == "bus" and e["state"] == "closed"]
    assert (end["received"], end["overflow"]) == (received - 300, 0), "all that was sent"
    assert end["received"] == events[-1]["decoded"], "counted over both configurations"
    changes = [(e["dtc"], e["status"] & 1, e["occurrence"]) for e in events if e["event"] == "dtc"]
    assert changes == [("U0401-82", 1, 1), ("U0401-82", 0, 1)], "set, healed 50 frames later, once"
    listed = warm.run(
        [*GATEWAY, "faults", "list", "--json", "--memory", "f.sqlite"],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert [entry["dtc"] for entry in json.loads(listed)] == ["U0401-82"]
