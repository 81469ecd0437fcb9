"""A fleet on the road, as processes over Debian's mosquitto: killed cars, killed collectors, links that are down."""

import json
import re
import signal
import socket
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from battery_bus import DBC
from kernel_can import wait_for
from road import Memory, broker, car_of, event, free_port, occurrences, plain, rows, waiting
from tls_files import write_tls

from gateway_fdi.errors import InputError
from gateway_fleet.cli.owner import fleet_publish, fleet_sign
from gateway_fleet.live import signed_documents
from gateway_fleet.live.batch import packed
from gateway_fleet.live.identity import car_id, new_key
from gateway_serve.broker import Broker, BrokerLink

pytestmark = pytest.mark.system

#: A car's daemon, as far as its queue goes: it says each number when it is on the disk.
DAEMON = """
import sys, time
from pathlib import Path
from road import Memory, car_of, event
memory = Memory(Path(sys.argv[1]), car_of())
n = int(sys.argv[2])
while True:
    memory.post(event(n), event(n + 1))
    assert memory.commit()
    print(n, n + 1, flush=True)
    n += 2
    time.sleep(0.02)
"""
GATEWAY = (sys.executable, "-c", "from gateway.cli import main; main()")
CONFIG = """
name = "van"
[[bus]]
name = "can0"
uri = "loopback:127.0.0.1:{port}"
[memory]
path = "{memory}"
[fleet]
name = "vans"
car = "c0ffee01"
model = "van"
software = "7.1"
"""


def gateway(folder, *words):
    """A command of the gateway, beside the test."""
    log = (folder / f"{words[1]}.log").open("ab")
    return subprocess.Popen([*GATEWAY, *map(str, words)], cwd=folder, stdout=log, stderr=log, env=plain())


@contextmanager
def ended(process, log=None):
    """Have a process end in any case; a test that fails shows whether it lived, and its log."""
    try:
        yield process
    finally:
        print(process.args[-8:], "has ended with", process.poll())
        process.kill()
        process.wait()
        print(log.read_text() if log else "")


def test_nothing_is_lost_or_twice_where_cars_collector_and_link_are_killed(tmp_path):
    memory, out, port = tmp_path / "faults.sqlite", tmp_path / "out", free_port()
    (tmp_path / "car.toml").write_text(CONFIG.format(port=free_port(), memory=memory))
    written, stopped = [], threading.Event()

    def drive():
        path = ":".join(sys.path)
        while not stopped.is_set():
            n = written[-1] + 1 if written else 1
            daemon = subprocess.Popen(
                [sys.executable, "-c", DAEMON, memory, str(n)],
                stdout=subprocess.PIPE,
                env={**plain(), "PYTHONPATH": path},
            )
            with ended(daemon):
                for line in daemon.stdout:
                    written.extend(map(int, line.split()))
                    if stopped.is_set() or written[-1] - n > 60:
                        break  # it is killed here
            written.extend(map(int, daemon.stdout.read().split()))  # it may have said more before its end

    driver = threading.Thread(target=drive)
    driver.start()
    words = ("fleet", "collect", out, "--fleet", "vans", "--broker", f"127.0.0.1:{port}", "--every", "1")
    try:
        wait_for(lambda: written)
        for _ in range(2):  # all of them are killed, the link first or last
            join = ("fleet", "join", f"127.0.0.1:{port}", "-c", "car.toml")
            with broker(tmp_path, port), ended(gateway(tmp_path, *words)), ended(gateway(tmp_path, *join)):
                before = sum(occurrences(out).values()) if out.exists() else 0
                wait_for(lambda b=before: sum(occurrences(out).values()) > b + 20)
        stopped.set()
        driver.join()
        with broker(tmp_path, port), ended(gateway(tmp_path, *words)) as collector:
            join = gateway(tmp_path, "fleet", "join", f"127.0.0.1:{port}", "-c", "car.toml")
            with ended(join):
                wait_for(lambda: len(occurrences(out)) >= len(written) and occurrences(out).keys() >= set(written))
                wait_for(lambda: waiting(memory) == [])  # "arrived" comes after the rows are on the collector's disk
            collector.send_signal(signal.SIGTERM)
            assert collector.wait(60) == 0
    finally:
        stopped.set()
        driver.join()
    found = occurrences(out)
    assert set(found) - set(written) <= {written[-1] + 1, written[-1] + 2} | set(range(1, written[-1])), (
        "none of nowhere"
    )
    ids = [(row["origin"], row["number"]) for row in rows(out)]
    assert len(ids) == len(set(ids)), "none is there twice"
    assert set(written) <= set(found), "none is lost"
    last = Memory(memory, car_of())
    assert last.store.tally().dropped == 0
    last.close()


#: Rules that are deployed.
ACL = (Path(__file__).resolve().parents[2] / "deploy" / "fleet" / "acl").read_text()


def test_by_certificates_a_car_tells_for_itself_only(tmp_path):
    """By the broker's rules, and by HTTP by the collector's own."""
    write_tls(tmp_path, ("broker", "collector", "c0ffee01", "c0ffee02"))
    (tmp_path / "acl").write_text(ACL)
    for path in tmp_path.iterdir():
        path.chmod(0o644)
    port, http = free_port(), free_port()
    more = (
        f"allow_anonymous false\ncafile {tmp_path}/ca.pem\ncertfile {tmp_path}/broker.pem\n"
        f"keyfile {tmp_path}/broker.key\n"
        f"require_certificate true\nuse_identity_as_username true\nacl_file {tmp_path}/acl\n"
    )
    memory, out = tmp_path / "faults.sqlite", tmp_path / "out"
    (tmp_path / "car.toml").write_text(CONFIG.format(port=free_port(), memory=memory))
    car = Memory(memory, car_of())
    car.post(event(1), event(2))
    car.commit()
    payload, _ = packed(car_of(), car.store.outgoing(), car.store.tally())
    other, _ = packed(car_of("c0ffee02"), car.store.outgoing(), car.store.tally())
    car.close()
    by = [("--ca", "ca.pem", "--certificate", f"{who}.pem", "--key", f"{who}.key") for who in ("collector", "c0ffee01")]
    address = f"127.0.0.1:{port}"
    told = []

    def thief(name, topics, take):
        of = Broker(
            host="127.0.0.1",
            port=port,
            tls=True,
            ca=tmp_path / "ca.pem",
            certificate=tmp_path / f"{name}.pem",
            key=tmp_path / f"{name}.key",
        )
        link = BrokerLink(of, "thief", topics, take)
        link.begin()
        wait_for(lambda: link.is_there)
        return link

    words = (
        "fleet",
        "collect",
        out,
        "--fleet",
        "vans",
        "--broker",
        address,
        "--http",
        f"127.0.0.1:{http}",
        "--every",
        "1",
    )
    with broker(tmp_path, port, more), ended(gateway(tmp_path, *words, *by[0]), tmp_path / "collect.log"):
        wait_for(lambda: "broker reached" in (tmp_path / "collect.log").read_text())
        link = thief("c0ffee02", ["fleet/vans/car/+/events", "fleet/#"], lambda *came: told.append(came))
        link.publish("fleet/vans/car/c0ffee01/events", payload)  # for another car
        link.publish("fleet/vans/car/c0ffee02/events", payload)  # another car's
        wait_for(lambda: "of another car than its sender" in (tmp_path / "collect.log").read_text())
        assert occurrences(out) == {}
        with ended(gateway(tmp_path, "fleet", "join", address, "-c", "car.toml", *by[1])):
            wait_for(lambda: occurrences(out) == {1: 1, 2: 1})
        link.end()
        assert told == [], "and hears nothing of others"
        import ssl

        context = ssl.create_default_context(cafile=tmp_path / "ca.pem")
        server = f"https://127.0.0.1:{http}/fleet"
        url = f"{server}/vans/car/c0ffee02/events"
        with pytest.raises((urllib.error.URLError, ConnectionError, ssl.SSLError)) as ended_by:
            urllib.request.urlopen(urllib.request.Request(url, other), context=context, timeout=120)
        assert "Connection refused" not in str(ended_by.value), "the collector listens"
        context.load_cert_chain(tmp_path / "c0ffee01.pem", tmp_path / "c0ffee01.key")
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(urllib.request.Request(url, other), context=context, timeout=120)
        with pytest.raises(urllib.error.HTTPError, match="404"):
            stranger = urllib.request.Request(f"{server}/others/car/c0ffee02/events", other)
            urllib.request.urlopen(stranger, context=context)
        # By HTTP, with the right certificate: what has come by the broker is known.
        own = urllib.request.Request(f"{server}/vans/car/c0ffee01/events", payload)
        again = urllib.request.urlopen(own, context=context)
        assert "arrived" in json.loads(again.read())
        more = Memory(memory, car_of())
        more.post(event(3))
        more.commit()
        more.close()
        with ended(gateway(tmp_path, "fleet", "join", f"https://127.0.0.1:{http}", "-c", "car.toml", *by[1])):
            wait_for(lambda: occurrences(out) == {1: 1, 2: 1, 3: 1})


def test_a_broker_without_mqtt_5_is_spoken_to_in_3_1_1():
    """One of before 2018 refuses the version in the words of 3.1.1, and closes."""
    versions, published = [], threading.Event()

    def serve(listener):
        while not published.is_set():
            peer, _ = listener.accept()
            with peer:
                connect = peer.recv(1000)
                versions.append(connect[8])
                if connect[8] != 4:
                    peer.sendall(b"\x20\x02\x00\x01")  # unacceptable protocol version
                    continue
                peer.sendall(b"\x20\x02\x00\x00")
                data = b""
                while b"payload" not in data and (more := peer.recv(1000)):
                    data += more
                published.set()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=serve, args=(listener,), daemon=True).start()
        link = BrokerLink(Broker(host="127.0.0.1", port=listener.getsockname()[1]), "x", [], lambda *_: None)
        link.begin()
        wait_for(lambda: link.is_there)
        link.publish("a", b"payload")
        assert published.wait(60)
        link.end()
    assert versions[:2] == [5, 4]


def test_ids_are_made_by_the_owners_key_and_tell_no_vin(tmp_path):
    path = tmp_path / "owner.key"
    new_key(path)
    assert path.stat().st_mode & 0o077 == 0
    with pytest.raises(InputError, match="exists"):
        new_key(path)
    first = car_id("WVWZZZ1JZXW000001", path)
    assert re.fullmatch("[0-9a-f]{24}", first)
    assert car_id("wvwzzz1jzxw000001", path) == first != car_id("WVWZZZ1JZXW000002", path)
    with pytest.raises(InputError, match="ISO 3779"):
        car_id("WVWZZZ1JZXW00000O", path)


CAR = """
[[bus]]
name = "can0"
uri = "loopback:127.0.0.1:{bus}"
database = ["battery.dbc"]
health = {{ watched = false }}
[[monitor]]
name = "voltage"
type = "signal"
signal = [{{ signal = "BATT.Volts", plausible = [10.0, 15.0] }}]
[memory]
path = "{folder}/faults.sqlite"
[status]
socket = "{folder}/status"
[fleet]
name = "vans"
car = "c0ffee01"
limits = "{folder}/limits.toml"
"""


def test_a_campaign_comes_by_the_broker_judges_in_shadow_then_in_the_daemon_and_is_withdrawn(tmp_path):
    (tmp_path / "battery.dbc").write_text(DBC)
    (tmp_path / "car.toml").write_text(CAR.format(bus=free_port(), folder=tmp_path))
    root, signer = (signed_documents.new_private(tmp_path / name) for name in ("root", "signer"))
    keys = {"fleet": "vans", "serial": 1, "root": [root], "signer": [signer]}
    (tmp_path / "keys").write_bytes(
        signed_documents.sign("keys", signed_documents.to_toml(keys), signed_documents.private_of(tmp_path / "root"))
    )
    port, out = free_port(), tmp_path / "out"
    at = f"127.0.0.1:{port}"

    def publish(serial, **more):
        told = {
            "fleet": "vans", "name": "warm", "serial": serial, "until": datetime.now(UTC) + timedelta(days=1),
            "share": 1.0, "shadow_hours": 0.0005, "limit": [{"test": "voltage.Volts.high", "limit": 15.5}], **more,
        }  # fmt: skip
        (tmp_path / "campaign.toml").write_text(signed_documents.to_toml(told))
        assert fleet_sign(tmp_path / "campaign.toml", tmp_path / "signer", tmp_path / "signed") == 0
        by = dict.fromkeys(("password_file", "ca", "certificate", "key"), None)
        assert fleet_publish(tmp_path / "signed", at, user="", **by) == 0

    def states():
        told = (json.loads(row["body"]) for row in rows(out) if row["kind"] == "campaign")
        return [event["state"] for event in sorted(told, key=lambda event: event["t_ns"])]

    log = tmp_path / "run.log"
    with log.open("wb") as said, broker(tmp_path, port):
        daemon = subprocess.Popen([*GATEWAY, "run", "car.toml"], cwd=tmp_path, stdout=said, stderr=said)
        words = ("fleet", "collect", out, "--fleet", "vans", "--broker", at, "--every", "1")
        with ended(daemon), ended(gateway(tmp_path, *words)):
            publish(3)
            join = gateway(tmp_path, "fleet", "join", at, "-c", "car.toml", "--keys", "keys")
            with ended(join):
                wait_for(lambda: out.exists() and states() == ["shadow", "waits", "active"])
                wait_for(lambda: "new configuration" in log.read_text())
                publish(4, withdrawn=True)
                wait_for(lambda: states() == ["shadow", "waits", "active", "back"])
                wait_for(lambda: log.read_text().count("new configuration") == 2)
                join.send_signal(signal.SIGTERM)
                assert join.wait(60) == 0
    limits = {json.loads(row["body"])["state"]: row["limits"] for row in rows(out) if row["kind"] == "campaign"}
    assert limits["back"] in (0, 3)
    assert not list(tmp_path.glob("shadow.sqlite*"))
    assert not list(tmp_path.glob(".car.shadow.toml"))
