"""A daemon in this process with all its doors open, on clocks that a test makes, and peers that never wait."""

import json
import socket
import ssl
import struct

from daemon_rig import World
from doip_rig import GATEWAY, TESTER, cut, message
from doip_wire import free_port
from rig import write_config
from tls_files import write_tls

ACTIVATE = message(5, struct.pack(">HBI", TESTER, 0, 0))

TEXT = """
[output.uds]
[output.doip]
port = {port}
bind = ["127.0.0.1"]
[output.doip.tls]
certificate = "gateway.pem"
key = "gateway.key"
port = {tls}
required = {required}
[status]
socket = "{status}"
[report]
socket = "{report}"
[[report.reporter]]
name = "battery"
events_per_s = 10000.0
fault = [{{ name = "hot", dtc = "P0A7E-00", description = "a cell is too hot" }}]
"""


def uds(request, source=TESTER):
    return message(0x8001, struct.pack(">HH", source, GATEWAY) + bytes.fromhex(request))


class Bench:
    """The daemon; scripts that :meth:`play` runs wait by ``yield from``."""

    def __init__(self, folder, *, required=False):
        self.world, self.port, self.tls = World(), free_port(), free_port()
        self.status, self.report = folder / "status.sock", folder / "report.sock"
        write_tls(folder)
        self.folder = folder
        text = TEXT.format(**{**vars(self), "required": str(required).lower()})
        self.config = write_config(folder, extra=text)
        self.daemon = self.world.daemon(self.config, folder / "faults.sqlite")
        self.fence = self.daemon.gateway.fence

    @property
    def doip(self):
        return self.daemon._asked["doip"]

    def play(self, script):
        self.world.play(self.daemon, script)

    def wait(self, seconds=0.05):
        return self.world.wait(seconds)

    def connect(self, port=None):
        made = socket.create_connection(("127.0.0.1", port or self.port))
        made.setblocking(False)
        return made

    def client(self, path=None, kind=socket.SOCK_STREAM):
        made = socket.socket(socket.AF_UNIX, kind)
        made.connect(str(path or self.status))
        made.setblocking(False)
        return made

    def reporter(self):
        return self.client(self.report, socket.SOCK_SEQPACKET)

    def context(self, version=None):
        made = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        made.check_hostname = False
        made.load_verify_locations(self.folder / "ca.pem")
        if version is not None:
            made.minimum_version = made.maximum_version = version
        return made

    def shaken(self, version=None, made=None):
        """Connect by TLS; yields while the handshake goes on, returns the stream."""
        one = Shaken(made or self.connect(self.tls), self.context(version))
        yield from one.shake(self)
        return one

    # Honest clients: each is answered, whatever else goes on.

    def ask_all(self, reader=None):
        """Have each door answer one honest request."""
        yield from self.wait(0.01)
        one = self.connect()
        assert (yield from self.exchange(one, ACTIVATE + uds("22f186")))[-1][-4:] == b"\x62\xf1\x86\x01"
        one.close()
        tls = yield from self.shaken()
        tls.write(ACTIVATE + uds("22f186"))
        assert (yield from tls.read(self, lambda got: got.endswith(b"\x62\xf1\x86\x01")))
        tls.socket.close()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
            made.connect(("127.0.0.1", self.port))
            made.setblocking(False)
            made.send(message(1))
            yield from self.wait(0.02)
            assert made.recv(100)[2:4] == b"\x00\x04"
        reader = reader or self.client()
        reader.send(b'{"id": "honest", "do": "present"}\n')
        yield from self.wait(0.03)
        assert [each["ok"] for each in answers(reader) or () if each["id"] == "honest"] == [True]
        one = self.reporter()
        one.send(json.dumps({"fault": "battery.hot", "result": "passed"}).encode())
        yield from self.wait(0.02)
        assert json.loads(one.recv(4096))["ok"]
        one.send(b'{"goodbye": true}')
        yield from self.wait(0.01)
        one.close()
        reader.close()
        yield from self.wait(0.02)

    def exchange(self, made, data):
        """Send; returns the payloads of what comes. Ends of connections are None."""
        if data:
            made.sendall(data)
        yield from self.wait(0.03)
        try:
            got = made.recv(1 << 20)
        except BlockingIOError:
            return []
        except ConnectionResetError:
            return [None]
        return [body for _, _, body in cut(got)] or [None]


class Shaken:
    """A tester by TLS, over memory: each record can be sent, bent, or kept back."""

    def __init__(self, made, context):
        self.socket, self.context = made, context
        self.incoming, self.out = ssl.MemoryBIO(), ssl.MemoryBIO()
        self.tls = context.wrap_bio(self.incoming, self.out)

    def step(self):
        """One step of the handshake; returns what it would send. None: it is over."""
        try:
            self.tls.do_handshake()
        except ssl.SSLWantReadError:
            return self.out.read()
        self.socket.sendall(self.out.read())
        return None

    def hear(self):
        try:
            data = self.socket.recv(1 << 16)
        except BlockingIOError:
            return False
        self.incoming.write(data)
        return bool(data)

    def shake(self, bench):
        for _ in range(200):
            data = self.step()
            if data is None:
                return
            if data:
                self.socket.sendall(data)
            yield from bench.wait(0.005)
            self.hear()
        raise AssertionError("no handshake")

    def write(self, data):
        self.tls.write(data)
        self.socket.sendall(self.out.read())

    def read(self, bench, until):
        got = b""
        for _ in range(100):
            yield from bench.wait(0.005)
            self.hear()
            try:
                got += self.tls.read(1 << 16)
            except ssl.SSLWantReadError:
                pass
            if until(got):
                return got
        return b""


def answers(reader):
    """Return the answers among what a reader of the status socket has got; None: it was sent away."""
    data = b""
    while True:
        try:
            more = reader.recv(1 << 20)
        except BlockingIOError:
            break
        except ConnectionResetError:
            return None
        if not more:
            return None
        data += more
    found = []
    while b"\n" in data:
        head, _, data = data.partition(b"\n")
        message = json.loads(head)
        data = data[message.get("size", 0) :]
        if message["kind"] == "answer":
            found.append(message)
    return found


def bent(rng, data):
    """Return bytes with some changed, cut off, doubled, put in; or noise."""
    made = bytearray(data)
    for _ in range(rng.randrange(4)):
        what, at = rng.randrange(5), rng.randrange(len(made) + 1)
        if what == 0 and made:
            made[at % len(made)] = rng.randrange(256)
        elif what == 1 and made:
            made[at % len(made)] ^= 1 << rng.randrange(8)
        elif what == 2:
            del made[at:]
        elif what == 3:
            made[at:at] = rng.randbytes(rng.randrange(1, 9))
        else:
            made += made[at:]
    return bytes(made[: 1 << 16])
