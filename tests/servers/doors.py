"""One gateway with all its doors: buses, status socket, page, command line; and those who come in by them.

Used by test_doors.py. Nothing of it waits for a clock: the status socket is turned by hand.
"""

import asyncio
import json
import socket
import threading

from doip_rig import Peer
from rig import Rig, write_config
from test_access import STANDS, by_j1939, by_mode_04
from uds_tester import EXTRA, Asked

from gateway_commands.faults import clear_faults
from gateway_fdi.errors import GatewayError
from gateway_serve.app import Page
from gateway_serve.guard import Guard, Rights
from gateway_serve.hub import Hub
from gateway_serve.status_socket import StatusSocket
from gateway_serve.wire import Splitter
from gateway_testers.doip.server import DoipServer

TOKEN = "control"
HEAD = {"host": "127.0.0.1", "content-type": "application/json"}


class Reader:
    """One who has opened the status socket."""

    def __init__(self, doors):
        self.doors = doors
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.socket.connect(str(doors.path))
        self.socket.setblocking(False)
        self.splitter, self.told = Splitter(), []
        doors.turn()

    def read(self):
        while True:
            try:
                data = self.socket.recv(1 << 20)
            except BlockingIOError:
                return self.told
            assert data, "sent away"
            self.told += [message for message, _ in self.splitter.feed(data)]

    def latest(self, kind):
        return [message for message in self.read() if message["kind"] == kind][-1]

    def ask(self, do, **keys):
        before = len([message for message in self.read() if message["kind"] == "answer"])
        self.socket.send(json.dumps({"id": before, "do": do, **keys}).encode() + b"\n")
        for _ in range(10):
            self.doors.turn()
            answers = [message for message in self.read() if message["kind"] == "answer"]
            if len(answers) > before:
                return answers[-1]
        raise AssertionError("no answer")

    def leave(self):
        self.socket.close()
        self.doors.turn()


class Doors:
    """A gateway whose vehicle stands or moves (message M1), with a fault of M0 that a tester confirms."""

    def __init__(self, folder, *, uds="", more="", watched=False):
        text = EXTRA.format(uds=uds) + "[output.obd]\n[output.j1939]\n[output.doip]\n" + STANDS + more
        self.memory = folder / "m.sqlite"
        self.memory.unlink(missing_ok=True)
        self.config = write_config(folder, extra=text)
        self.rig = Rig(self.config, self.memory, watched=watched)
        self.path = folder / "s"
        self.status = StatusSocket(self.path, self.rig.gateway)
        self.now_s = 1.0
        self.loop = None
        self.rig.wait(300)
        self.tester = Asked(self.rig)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.loop is not None:
            left = asyncio.all_tasks(self.loop)
            for each in left:
                each.cancel()
            self.loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
            self.loop.close()
        self.status.close()
        self.rig.close()

    @property
    def server(self):
        """The DoIP server."""
        return next(each for each in self.gateway.servers.all if isinstance(each, DoipServer))

    @property
    def gateway(self):
        return self.rig.gateway

    def drive(self, speed):
        self.rig.value(1, speed)

    def turn(self, seconds=0.001):
        """Let the gateway and its status socket do what is due, so long after."""
        self.now_s += seconds
        self.rig.wait(seconds * 1e3)
        self.status.turn(self.now_s)

    def reader(self):
        return Reader(self)

    # By each door: returns "done", or what it was refused with

    def by_uds(self, request):
        assert self.tester("1003").startswith("5003")
        answer = self.tester(request.replace(" ", "")).split(" ")[-1]
        return answer[4:6].upper() if answer.startswith("7f") else "done"

    def by_doip(self, request):
        tester = Peer(self)
        assert tester.activate() == 0x10
        assert tester("1003").startswith("5003")
        answer = tester(request)
        tester.close()
        return answer[4:6].upper() if answer.startswith("7f") else "done"

    def by_request(self, request):
        """By the status socket's own UDS."""
        reader = self.reader()
        answers = [reader.ask("request", tester="t", uds=each)["uds"][0] for each in ("1003", request)]
        assert answers[0].startswith("5003")
        reader.leave()
        return answers[1][4:6].upper() if answers[1].startswith("7f") else "done"

    def by_obd(self):
        answer = by_mode_04(self.rig)
        return answer[4:6].upper() if answer.startswith("7f") else "done"

    def by_j1939(self, pgn):
        return {0: "done", 1: "NACK", 2: "denied"}[by_j1939(self.rig, pgn)]

    def by_status(self, do, **keys):
        answer = self.reader().ask(do, **keys)
        return "done" if answer["ok"] else f"{answer['refused']:02X}"

    def by_page(self, do, **keys):
        code, text = self.post(f"/api/{do}", keys)
        return "done" if code == 200 else text.partition("0x")[2][:2]

    def by_sovd(self, method, path, body=None):
        own = "/sovd/v1/components/gateway"
        assert self.http("POST", f"{own}/locks", {"lock_expiration": 60})[0] == 201
        code, text = self.http(method, f"{own}/{path}", body)
        return "done" if code < 300 else f"{json.loads(text)['parameters']['nrc']:02X}"

    def post(self, path, body, token=TOKEN):
        """Have the page do something; returns status and text of its answer."""
        return self.http("POST", path, body, token)

    def http(self, method, path, body=None, token=TOKEN):
        """Ask the page's server; returns status and text of its answer."""
        if self.loop is None:
            self.loop = asyncio.new_event_loop()
            self.loop.run_until_complete(self._open())
        return self.loop.run_until_complete(self._ask(method, path, body, token))

    async def _open(self):
        self.hub = Hub(self.path)
        clients = {"anna": "anna"}
        self.app = Guard(Page(self.hub).app(), Rights(frozenset({"127.0.0.1"}), "", TOKEN, clients=clients))
        self.link = asyncio.create_task(self.hub.link.run())
        await self._until(lambda: self.hub.connected)

    async def _until(self, done):
        for _ in range(10_000):
            if done():
                return
            self.gateway.poll(self.rig.now)
            self.status.turn(self.now_s)
            await asyncio.sleep(0.0001)  # the fault memory's file is read in a thread
        raise AssertionError("it does not come")

    async def _ask(self, method, path, body, token):
        answer = {"body": b""}

        async def receive():
            return {"type": "http.request", "body": b"" if body is None else json.dumps(body).encode()}

        async def send(message):
            answer["code"] = message.get("status", answer.get("code"))
            answer["body"] += message.get("body", b"")

        path, _, query = path.partition("?")
        heads = {**HEAD, **({"authorization": f"Bearer {token}"} if token else {})}
        scope = {
            "type": "http", "method": method, "path": path, "raw_path": path.encode(), "query_string": query.encode(),
            "http_version": "1.1", "headers": [(k.encode(), v.encode()) for k, v in heads.items()],
            "client": ("127.0.0.1", 5), "server": ("127.0.0.1", 80), "scheme": "http", "root_path": "",
        }  # fmt: skip
        work = asyncio.create_task(self.app(scope, receive, send))
        await self._until(work.done)
        work.result()
        return answer["code"], answer["body"].decode()

    def by_command(self, **keys):
        said = []

        def work():
            try:
                clear_faults(None, None, memory=self.memory, json=True, **keys)
                said.append("done")
            except GatewayError as error:
                said.append(str(error).partition("0x")[2][:2])

        thread = threading.Thread(target=work)
        thread.start()
        while thread.is_alive():
            self.gateway.serve_requests()
            thread.join(0.005)
        return said[0]
