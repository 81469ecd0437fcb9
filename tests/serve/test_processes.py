"""The page beside a gateway: it comes with it, goes with it, and what becomes of it changes nothing else."""

import json
import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
import warm
from kernel_can import wait_for
from processes import bus, gateway, process

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]


def state_of(url):
    """The first message of the stream: all that the page shows."""
    with urllib.request.urlopen(f"{url}api/stream") as stream:
        assert stream.readline() == b"event: state\n"
        return json.loads(stream.readline().removeprefix(b"data: "))


def page_in(lines):
    """The address of the page, once it has been said."""
    found = re.search(r"page: (http://\S+?/)", "".join(lines))
    return found[1] if found else None


def test_a_demo_shows_truth_and_dtc_and_ends_in_good_order(tmp_path):
    started = warm.Popen(
        [sys.executable, "-c", "from gateway.cli import main; main()", "demo", "--serve", "--no-open", "--port", "0",
         "--speed", "8"],
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=(tmp_path / "said").open("w"),
    )  # fmt: skip
    try:
        url = wait_for(lambda: page_in([(tmp_path / "said").read_text()]))
        wait_for(lambda: state_of(url)["connected"])
        wait_for(lambda: {"injected", "dtc"} <= {event["event"] for event in state_of(url)["events"]})
        wait_for(lambda: [entry["dtc"] for entry in state_of(url)["memory"]["entries"]] == ["P0336-39"])
        shown = state_of(url)
        assert (
            next(e["text"] for e in shown["events"] if e["event"] == "injected")
            == "sensor misses pulses, 1 at tooth 20"
        )
        assert "Pulse away from its place: " in " ".join(shown["memory"]["entries"][0]["words"])
        wait_for(lambda: "stays until" in (tmp_path / "said").read_text())
        assert started.poll() is None
        wait_for(lambda: state_of(url)["hello"]["ended"] == "The scenario crank_missed_tooth has ended after 8 s.")
        assert [entry["dtc"] for entry in state_of(url)["memory"]["entries"]] == ["P0336-39"], "it is still there"
    finally:
        started.send_signal(signal.SIGINT)
        assert started.wait(120) == 0
    with pytest.raises(OSError, match="refused"):
        state_of(url)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"


def child_of(pid):
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return int(children[0]) if children else None


def test_a_page_that_is_killed_leaves_the_daemon_alone_and_one_of_a_daemon_that_is_killed_ends(tmp_path):
    with bus(tmp_path) as uri:
        text = (ROOT / "gateway.toml").read_text().replace("loopback:127.0.0.1:29536", uri)
        (tmp_path / "gateway.toml").write_text(text)
        options = ("run", "gateway.toml", "--serve", "--port", "0")
        with process(*options, cwd=tmp_path, ready="monitoring") as daemon:
            url = wait_for(lambda: page_in(daemon.log))
            wait_for(lambda: state_of(url)["connected"])
            os.kill(child_of(daemon.pid), signal.SIGKILL)
            wait_for(lambda: "monitoring goes on" in "".join(daemon.log))
            assert gateway("doctor", "gateway.toml", "--running", cwd=tmp_path).returncode == 0
        assert daemon.code == 0
        assert not (tmp_path / "faults.sqlite.status").exists()
        with process(*options, cwd=tmp_path, ready="monitoring") as daemon:
            url = wait_for(lambda: page_in(daemon.log))
            page = child_of(daemon.pid)
            assert os.sched_getscheduler(page) == os.SCHED_IDLE, "it takes no time from the gateway"
            daemon.send_signal(signal.SIGKILL)
            wait_for(lambda: not alive(page))
        assert (tmp_path / "faults.sqlite.status").exists(), "left behind, to be replaced"
