"""SOVD against programs that nobody here wrote, against those who mean harm, and against the death of its process."""

import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import pytest
from amount import FULL, amount
from hostile import PATIENCE_S, request, said
from kernel_can import wait_for
from processes import bus, gateway, process
from rig import write_config

from gateway_serve.guard import BODY_BYTES

pytestmark = pytest.mark.system

OWN = "/sovd/v1/components/gateway"
TOKENS = {"control": "control-" + "c" * 20, "anna": "anna-" + "a" * 20, "": "reading-" + "r" * 20}
CONFIG = """
[output.uds]
[[did]]
id = 0x0124
name = "Tester"
hex = "0102"
writable = true
[memory]
path = "faults.sqlite"
recording = { before_ms = 100.0, after_ms = 100.0 }
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A gateway with a trouble code (a message that is missing), and its server with three tokens."""
    folder = tmp_path_factory.mktemp("sovd")
    with bus(folder) as uri:
        write_config(folder, extra=CONFIG)
        text = (folder / "rig.toml").read_text().replace("virtual:rig", uri)
        (folder / "rig.toml").write_text(text.replace('message = "M0"\n', 'message = "M0"\ntimeout_ms = 100.0\n'))
        control = f"{TOKENS['control']}\nanna {TOKENS['anna']}\n"
        for name, token in (("read", TOKENS[""]), ("control", control)):
            (folder / name).write_text(token)
            (folder / name).chmod(0o600)
        with process("run", "rig.toml", "--status", "status", cwd=folder, ready="monitoring") as daemon:
            made = SimpleNamespace(folder=folder, daemon=daemon)
            with serving(made):
                wait_for(lambda: ask(made, "GET", f"{OWN}/faults")[1].get("items"))
                yield made


def serving(site):
    """The server, as a context."""
    options = ("--read-token-file", "read", "--control-token-file", "control")
    started = process("serve", "--status", "status", "--port", "0", *options, cwd=site.folder, ready="page:")

    class Serving:
        def __enter__(self):
            page = started.__enter__()
            site.page, site.port = page, int(re.search(r":(\d+)/", page.said)[1])
            wait_for(lambda: ask(site, "GET", f"{OWN}/modes/session")[0] == 200)
            return page

        def __exit__(self, *what):
            return started.__exit__(*what)

    return Serving()


def ask(site, method, path, body=None, who="control"):
    """Return status and answer."""
    heads = {"authorization": f"Bearer {TOKENS[who]}", "content-type": "application/json"}
    data = None if body is None else json.dumps(body).encode()
    asked = urllib.request.Request(f"http://127.0.0.1:{site.port}{path}", data, heads, method=method)
    try:
        with urllib.request.urlopen(asked, timeout=PATIENCE_S) as answer:
            status, text = answer.status, answer.read()
    except urllib.error.HTTPError as error:
        status, text = error.code, error.read()
    return status, json.loads(text) if text else {}


def told(site):
    """What has been done to the gateway, and what it knows."""
    listed = json.loads(gateway("faults", "list", "rig.toml", "--json", cwd=site.folder).stdout)
    done = json.loads(gateway("faults", "interventions", "rig.toml", "--json", cwd=site.folder).stdout)
    return [each["dtc"] for each in listed], done


def test_schemathesis_finds_nothing(site):
    """Its positive and negative data, and its own values of the parameters in paths beside those that there are."""
    seed = int(os.environ.get("GATEWAY_SEED", "52"))
    document = ask(site, "GET", "/sovd/v1/docs")[1]
    known = {
        "component_id": ["gateway", "A"], "area_id": ["b"], "app_id": ["b.M0"], "fault_code": ["U0100-87"],
        "data_id": ["did-0124", "M0.Value"], "configuration_id": ["did-0124"], "mode_id": ["session", "dtcsetting"],
        "operation_id": ["restart-cycle"], "category": ["recordings"], "bulk_data_id": ["U0100-87-1.log"],
    }  # fmt: skip
    for path in document["paths"].values():
        for operation in path.values():
            for each in operation["parameters"]:
                if each["in"] == "path" and each["name"] in known:
                    each["schema"] = {"anyOf": [{"enum": known[each["name"]]}, each["schema"]]}
    (site.folder / "document.json").write_text(json.dumps(document))
    size = ["--max-examples", "40"] if FULL else ["--max-examples", "1", "--phases", "fuzzing,stateful"]
    found = subprocess.run(
        [sys.executable, "-m", "schemathesis.cli", "run", "document.json", "--url", f"http://127.0.0.1:{site.port}/sovd/v1",
         "-H", f"Authorization: Bearer {TOKENS['control']}", "--exclude-path-regex", "events$", "--seed", str(seed),
         "--no-color", *size],
        cwd=site.folder, capture_output=True, text=True, timeout=1200, check=False,
    )  # fmt: skip
    print(found.stdout[-4000:])
    assert found.returncode == 0, found.stdout[-8000:]
    assert re.search(r"(\d+) generated, \1 passed", found.stdout)


def test_the_command_asks_by_uds(site):
    requests = ("22F186", "1003", "22F186", "14FFFFFF", "ba")
    asked = gateway("request", *requests, "--status", "status", cwd=site.folder)
    said = [line.split("  ") for line in asked.stdout.splitlines()]
    assert [line[:2] for line in said[:4]] == [
        ["22F186", "62F18601"], ["1003", "5003003201F4"], ["22F186", "62F18603"], ["14FFFFFF", "54"],
    ]  # fmt: skip
    assert said[4] == ["ba", "7FBA11", "refused: service not supported (0x11)"]
    assert asked.returncode == 1
    wrong = gateway("request", "22F186", "--ecu", "brakes", "--status", "status", cwd=site.folder)
    assert wrong.returncode == 2
    assert "brakes" in wrong.stderr


def attacks(draw, lock):
    """Yield (kind, method, path, headers, body, refusals) for ever: each is refused, whoever asks."""
    write = [
        *(("DELETE", path, None) for path in ("faults", "faults/U0100-87")),
        *(
            ("PUT", f"modes/{mode}", {"value": value})
            for mode, value in (("session", "extended"), ("dtcsetting", "off"))
        ),
        *(("POST", f"operations/{name}/executions", {}) for name in ("restart-cycle", "compact")),
        ("PUT", "status/restart", None),
        ("PUT", "configurations/did-0124", {"data": {"raw": "0304"}}),
    ]
    steal = [
        ("DELETE", f"locks/{lock}", None), ("PUT", f"locks/{lock}", {"lock_expiration": 1}),
        ("POST", "locks", {"lock_expiration": 3600}),
    ]  # fmt: skip
    while True:
        method, path, body = draw.choice(write + steal)
        token = draw.choice(["", "nobody", TOKENS["control"][:-1], TOKENS["control"].upper(), "x" * 4000])
        yield "no right", method, path, {"Authorization": f"Bearer {token}"}, body, {401}
        method, path, body = draw.choice(write + steal)
        yield "reader", method, path, {"Authorization": f"Bearer {TOKENS['']}"}, body, {401}
        anna = {"Authorization": f"Bearer {TOKENS['anna']}"}
        method, path, body = draw.choice(write + steal)
        yield "another's lock", method, path, anna, body, {403, 409}
        name = draw.choice(["..", "%2e%2e", "%00", "a%0Ab", "%ff", lock[:-1]])
        path = f"{draw.choice(['locks', 'modes', 'faults'])}/{name}"
        yield "other names", draw.choice(["DELETE", "PUT"]), path, anna, {"lock_expiration": 5}, {400, 403, 404, 405}
        other = draw.choice([b"[" * 9000, b"{", b'{"lock_expiration": 1e999}', b"\xff\xfe", draw.randbytes(200)])
        yield "nonsense", "POST", "locks", anna, other, {400}
        yield "method", draw.choice(["PATCH", "TRACE", "OPTIONS", "BREW"]), "faults", anna, None, {405}
        yield "long path", "GET", "faults?" + "a" * 9000, anna, None, {414}
        yield "origin", "POST", "locks", {**anna, "Origin": "http://evil.example"}, {"lock_expiration": 5}, {403}
        yield "kind", "POST", "locks", {**anna, "Content-Type": "text/plain"}, {"lock_expiration": 5}, {415}


def memory_of(pid):
    return int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())[1])


def unread(site, count):
    """Return connections to the events of a subscription that nobody reads."""
    found = []
    for _ in range(count):
        body = {"resource": f"{OWN}/faults", "interval": "fast", "duration": 600}
        source = ask(site, "POST", f"{OWN}/cyclic-subscriptions", body)[1]["event_source"]
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.connect(("127.0.0.1", site.port))
        connection.sendall(request(site.port, source, Authorization=f"Bearer {TOKENS['']}"))
        assert connection.recv(12) == b"HTTP/1.1 200"
        found.append(connection)
    return found


def test_nobody_gets_in_by_what_means_harm_and_the_gateway_is_unmoved(site):
    seed = int(os.environ.get("GATEWAY_SEED", time.time_ns() % 10**6))
    print(f"seed {seed}")
    status, made = ask(site, "POST", f"{OWN}/locks", {"lock_expiration": 3600})
    assert status == 201
    held = unread(site, 20)
    before, drawn, kinds = told(site), attacks(random.Random(seed), made["id"]), Counter()
    began = {"page": memory_of(site.page.pid), "daemon": memory_of(site.daemon.pid)}
    for _ in range(amount(10_000, 1000)):
        kind, method, path, headers, body, refusals = next(drawn)
        data = b"" if body is None else body if isinstance(body, bytes) else json.dumps(body).encode()
        headers = {"Content-Type": "application/json", "Content-Length": len(data), "Connection": "close"} | {
            name.replace("-", "_"): value for name, value in headers.items()
        }
        headers = {name.replace("_", "-"): value for name, value in headers.items()}
        status, heard = said(site.port, request(site.port, f"{OWN}/{path}", method, data, **headers))
        assert status in refusals, (kind, status, heard[:300])
        assert b'"error_code"' in heard.partition(b"\r\n\r\n")[2], (kind, heard)
        kinds[kind, status] += 1
    for size in (BODY_BYTES + 1, 10 << 20):
        for who in TOKENS:
            assert ask(site, "POST", f"{OWN}/locks", "x" * size, who=who)[0] == 413
    for (kind, status), count in sorted(kinds.items()):
        print(f"{kind:16} {status} {count:5}")
    now = {"page": memory_of(site.page.pid), "daemon": memory_of(site.daemon.pid)}
    print(f"memory [kB] {began}, then {now}")
    assert now["page"] < began["page"] + 48_000
    assert now["daemon"] < began["daemon"] + 16_000
    assert told(site) == before
    for connection in held:
        connection.close()
    assert ask(site, "DELETE", f"{OWN}/locks/{made['id']}")[0] == 204


def test_a_server_that_is_killed_leaves_no_lock_no_session_and_no_setting(site):
    """kill -9 within a locked session: the gateway is as before at once, a new server finds no lock."""
    assert ask(site, "POST", f"{OWN}/locks", {"lock_expiration": 3600})[0] == 201
    assert ask(site, "PUT", f"{OWN}/modes/dtcsetting", {"value": "off"})[0] == 200
    site.page.send_signal(signal.SIGKILL)
    site.page.wait(60)
    began = time.monotonic()
    wait_for(lambda: told(site)[1][-1]["action"] == "dtc_setting_ended")
    print(f"seen after {time.monotonic() - began:.1f} s")
    with serving(site):
        assert ask(site, "GET", f"{OWN}/modes/dtcsetting")[1]["value"] == "on"
        assert ask(site, "GET", f"{OWN}/locks")[1] == {"items": []}
        assert ask(site, "GET", f"{OWN}/modes/session")[1]["value"] == "default"
        assert ask(site, "POST", f"{OWN}/locks", {"lock_expiration": 5}, who="anna")[0] == 201


@pytest.mark.full("a client is generated in half a minute")
def test_a_generated_client_lists_reads_locks_and_clears(site):
    """By openapi-python-client, of the document alone."""
    with serving(site):
        (site.folder / "client.json").write_text(json.dumps(ask(site, "GET", "/sovd/v1/docs")[1]))
        subprocess.run(
            [sys.executable, "-m", "openapi_python_client", "generate", "--path", "client.json", "--meta", "none",
             "--output-path", "sovd_client", "--overwrite"],
            cwd=site.folder, check=True, capture_output=True,
        )  # fmt: skip
        program = f"""
from sovd_client import AuthenticatedClient
from sovd_client.models import LockRequest
from sovd_client.api.components import (
    get_components_by_component_id_faults as faults, get_components_by_component_id_faults_by_fault_code as fault,
    post_components_by_component_id_locks as lock, delete_components_by_component_id_faults as clear,
    delete_components_by_component_id_locks_by_lock_id as unlock, get_components as components)
client = AuthenticatedClient("http://127.0.0.1:{site.port}/sovd/v1", "{TOKENS["control"]}")
print([each.id for each in components.sync(client=client).items])
(first,) = [each for each in faults.sync("gateway", client=client).items if each.code == "U0100-87"]
print(first.code, first.status.test_failed)
print(fault.sync("gateway", first.code, client=client).environment_data.snapshots is not None)
made = lock.sync("gateway", client=client, body=LockRequest(lock_expiration=30))
print(made.owned, clear.sync_detailed("gateway", client=client).status_code.value)
print(unlock.sync_detailed("gateway", made.id, client=client).status_code.value)
"""
        found = subprocess.run(
            [sys.executable, "-c", program], cwd=site.folder, capture_output=True, text=True, check=False
        )
        assert found.stdout.split("\n")[:-1] == ["['gateway', 'A']", "U0100-87 1", "True", "True 204", "204"], (
            found.stderr
        )
