"""An exception in one message, look or request of the page's process and of MQTT ends nothing else."""

import asyncio
import json
import random

import pytest
from amount import amount

from gateway.bus.frames import EXTENDED, empty, put
from gateway.common.fence import Fence
from gateway_ask.survey import LISTEN_NS, Survey
from gateway_serve.broker import Broker
from gateway_serve.guard import Guard, Rights
from gateway_serve.hub import Hub
from gateway_serve.metrics import Metrics
from gateway_serve.mqtt import Published, Publisher

MS = 1_000_000
HELLO = {
    "kind": "hello", "protocol": 1, "version": "0", "name": "x", "memory": None, "faults": [], "buses": [], "ecus": [],
    "identifiers": [], "levels": [], "s3_s": 5.0, "signals": [], "notes": [], "ended": "",
}  # fmt: skip
EVENT = {"kind": "event", "event": {"event": "clock", "t_ns": 1}}
#: Messages that no gateway sends.
WRONG = [
    {"kind": "tick"}, {"kind": "tick", "t_ns": "x"}, {"kind": "event"}, {"kind": "event", "event": []},
    {"kind": "event", "event": {"event": "security"}}, {"kind": "buses", "buses": 3}, {"kind": "messages"},
    {"kind": "missed"}, {"kind": "answer", "id": []}, {"kind": "answer", "id": {}}, {"kind": "hello", "protocol": 1},
    {"kind": "hello", "protocol": 1, "faults": [{}], "memory": 3, "buses": []}, {"kind": "none"},
]  # fmt: skip


def test_a_wrong_message_of_the_gateway_is_counted_and_the_next_one_is_shown(tmp_path, caught):
    async def serve(_reader, writer):
        for message in (HELLO, *WRONG, EVENT):
            writer.write(json.dumps(message).encode() + b"\n")
        await writer.drain()

    async def work():
        path = tmp_path / "status.sock"
        server = await asyncio.start_unix_server(serve, path)
        hub = Hub(path)
        running = asyncio.create_task(hub.run())
        while not any(event["event"] == "clock" for event in hub.events):
            assert not running.done()
            await asyncio.sleep(0.01)
        assert hub.connected
        running.cancel()
        server.close()
        return hub

    hub = asyncio.run(asyncio.wait_for(work(), 60))
    assert 8 <= hub.fence.first["gateway"] == len(caught) <= len(WRONG)
    text = Metrics(hub).text().decode()
    assert f'gateway_exceptions_total{{door="gateway",process="page",wall="first"}} {len(caught)}.0' in text
    assert 'gateway_exceptions_total{door="",process="gateway",wall="second"} 0.0' in text


def test_a_look_into_the_memory_that_fails_is_not_the_last(caught):
    class File:
        reads = 0

        def read(self, _faults):
            self.reads += 1
            if self.reads < 3:
                raise KeyError("planted")
            return {"reads": self.reads}

        def close(self):
            pass

    async def work():
        hub = Hub("none")
        hub.memory_file = File()
        reading = asyncio.create_task(hub._read_memory())
        while "reads" not in hub.memory:
            hub.ask_memory()
            await asyncio.sleep(0.01)
        reading.cancel()

    asyncio.run(asyncio.wait_for(work(), 60))
    assert len(caught) == 2


def rights():
    return Rights(frozenset({"127.0.0.1"}), "", "c" * 20)


async def answered(guard, path="/", headers=((b"host", b"127.0.0.1"),)):
    told = []

    async def receive():
        return {"type": "http.request", "body": b""}

    async def send(message):
        told.append(message)

    scope = {
        "type": "http", "method": "GET", "path": path, "raw_path": path.encode(), "query_string": b"",
        "headers": list(headers), "http_version": "1.1", "client": ("127.0.0.1", 1),
    }  # fmt: skip
    await guard(scope, receive, send)
    return told


@pytest.mark.parametrize("begun", [False, True])
def test_an_exception_in_a_request_is_answered_500_and_counted(caught, begun):
    fence = Fence()

    async def app(_scope, _receive, send):
        if begun:
            await send({"type": "http.response.start", "status": 200, "headers": []})
        raise MemoryError

    guard = Guard(app, rights(), wall=fence.wall("page"))
    told = asyncio.run(answered(guard))
    assert told[0]["status"] == (200 if begun else 500)
    assert fence.first == {"page": 1}
    told = asyncio.run(answered(guard, "/sovd/v1/components"))
    assert begun or json.loads(told[1]["body"]), "SOVD has its own form"
    assert len(caught) == 2


def test_mqtt_tells_the_rest_where_one_state_cannot_be_told(caught, monkeypatch):
    monkeypatch.setattr("gateway_serve.mqtt.LOOK_S", 0.01)
    monkeypatch.setattr("gateway_serve.mqtt.REST_S", 0.01)
    hub = Hub("none")
    made = Publisher(hub, Broker(host="127.0.0.1", port=1), Published(), "x")
    told, looks = [], 0

    class Client:
        def is_connected(self):
            nonlocal looks
            looks += 1
            if looks == 2:
                raise OSError("planted")
            return True

        def publish(self, topic, payload, **_more):
            if topic.endswith("monitoring"):
                raise ValueError("planted")
            told.append(topic)

        def connect_async(self, *_arguments, **_more):
            pass

        loop_start = loop_stop = disconnect = connect_async

    made._client = Client()
    made._end = lambda: None

    async def work():
        running = asyncio.create_task(made.run())
        while looks < 5:
            assert not running.done()
            await asyncio.sleep(0.01)
        running.cancel()

    asyncio.run(asyncio.wait_for(work(), 60))
    assert {topic.rpartition("/")[2] for topic in told} == {"status", "causes"}
    assert [str(error) for _, error, *_ in caught] == ["planted"] * 2
    assert hub.fence.first == {"mqtt": 2}


def test_a_broker_that_sends_nonsense_ends_nothing(tmp_path):
    """Bytes by chance, of a broker that takes the connection again and again."""
    seed = 5
    print(f"seed {seed}")
    rng = random.Random(seed)

    async def work():
        count = 0

        async def serve(_reader, writer):
            nonlocal count
            count += 1
            first = rng.choice([b"", b"\x20\x02\x00\x00", b"\x20\x02\x00\x00", b"\x20\x02\x00\x05"])
            for _ in range(rng.randrange(4)):
                writer.write(first + rng.choice([b"\x30", b"\x40\x02", b"\xe0\x00", b"\x90\x03"]) + rng.randbytes(20))
                first = b""
            await asyncio.sleep(0.01)
            writer.close()

        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        made = Publisher(
            Hub(tmp_path / "none"),
            Broker(host="127.0.0.1", port=server.sockets[0].getsockname()[1]),
            Published(),
            "x",
        )
        made._client.reconnect_delay_set(1, 1)
        running = asyncio.create_task(made.run())
        while count < amount(60, 4):
            assert not running.done()
            await asyncio.sleep(0.05)
        thread = made._client._thread
        assert thread.is_alive(), "it goes on"
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        server.close()

    asyncio.run(asyncio.wait_for(work(), 300))


def test_answers_by_chance_end_no_survey():
    """What ECUs say is looked through to the end, whatever it is; nothing is caught by a wall."""
    seed = 6
    print(f"seed {seed}")
    rng, ids = random.Random(seed), [0x7E0, 0x72E, 0x7E8, EXTENDED | 0x18DAF13C, EXTENDED | 0x18FECA00]
    for _ in range(amount(300, 10)):
        made, t_ns, asked = Survey(1000.0, physical=(0x720, 0x726, 0x7E0, EXTENDED | 0x18DA3CF1)), 0, []
        for _ in range(1500):
            heard = empty(rng.randrange(4) if t_ns > LISTEN_NS else 0)
            for k in range(len(heard)):
                request = rng.choice(asked) if asked else b"\x22"
                kinds = [
                    bytes([rng.randrange(9)]) + bytes([(request[1:2] or b"\0")[0] + 0x40 & 0xFF]) + request[2:],
                    b"\x03\x7f" + request[1:2] + bytes([rng.choice([0x11, 0x21, 0x31, 0x78, 0x7F])]),
                    bytes([0x10 | rng.randrange(2), rng.randrange(256)]) + rng.randbytes(6),
                    bytes([0x20 | rng.randrange(16)]) + rng.randbytes(7),
                    rng.randbytes(rng.randrange(9)),
                ]
                put(heard, k, t_ns, rng.choice(ids), rng.choice(kinds)[:8])
            out = made.poll(t_ns, heard)
            asked += [bytes(frame["data"][: int(frame["length"])]) for frame in out]
            asked, t_ns = asked[-6:], t_ns + 20 * MS
            if made.done:
                break
        for said in made.found.ecus.values():
            if said is not None:
                assert said.services is not None
                assert isinstance(said.vin, str)
                assert (said.parts, said.pids, said.dtcs) is not None


def test_requests_by_chance_are_answered(tmp_path):
    """Values of any type to the page and to SOVD: no answer is 500."""
    pytest.importorskip("httpx")
    from starlette.testclient import TestClient

    from gateway_serve.app import Page

    hub = Hub(tmp_path / "none")
    app = Guard(Page(hub).app(), rights(), hub.on_refused, hub.fence.wall("page"))
    client = TestClient(app, base_url="http://127.0.0.1", raise_server_exceptions=False)
    values = ["", "x", "\ud800", "-1", "1e99", "nan", "[]", "{}", "%00", "a" * 500, "0", "9" * 40]
    bodies = [None, [], {}, 0, "x", {"dtc": []}, {"dtc": {}}, {"dtc": "\ud800"}, {"force": "x"}, {"why": []}, [[]]]
    token = {"authorization": f"Bearer {'c' * 20}", "content-type": "application/json"}
    paths = ["/api/history", "/api/recording/P0336-39/1", "/metrics", "/sovd/v1/components/gateway/faults"]
    for path in paths:
        for value in values:
            for name in ("fault", "faults", "from", "to", "status[key]", "scope", "include-schema"):
                query = {name: value.encode("utf-8", "surrogatepass")}
                assert client.get(path, params=query).status_code != 500, (path, query)
    for path in ("clear", "cycle", "settings", "present"):
        for body in bodies:
            told = client.post(f"/api/{path}", content=json.dumps(body), headers=token)
            assert told.status_code in (400, 409), (path, body, told.status_code)
    for method, path in (("PUT", "modes/session"), ("POST", "locks"), ("DELETE", "faults"), ("PUT", "data/x")):
        for body in bodies:
            told = client.request(
                method, f"/sovd/v1/components/gateway/{path}", content=json.dumps(body), headers=token
            )
            assert told.status_code != 500, (path, body)
    assert not hub.fence.first
