"""A gateway with a DoIP server on the rig's clock, and testers without sockets."""

import struct
from contextlib import contextmanager

from rig import Rig, write_config
from uds_tester import DIDS

from gateway_testers.doip.server import DoipServer

TESTER, GATEWAY, FUNCTIONAL = 0x0E00, 0x1000, 0xE400
DOIP = '[output.uds]\n{uds}\n[output.doip]\neid = "0123456789AB"\ngid = "BA9876543210"\n{doip}\n' + DIDS


def message(kind, body=b"", version=3, length=None):
    return struct.pack(">BBHI", version, version ^ 0xFF, kind, len(body) if length is None else length) + body


def cut(data):
    """Return (version, type, payload) of each message."""
    made = []
    while data:
        version, inverse, kind, length = struct.unpack(">BBHI", data[:8])
        assert inverse == version ^ 0xFF
        assert len(data) >= 8 + length
        made.append((version, kind, bytes(data[8 : 8 + length])))
        data = data[8 + length :]
    return made


class Peer:
    """One TCP connection, by calls."""

    def __init__(self, net, ip="192.0.2.1", secure=False, certificate=""):
        self.net = net
        self.one = net.server.connect(ip, net.rig.now, secure=secure)
        self.one.certificate = certificate

    @property
    def closed(self):
        return self.one.ends

    def send(self, data):
        self.net.server.receive(self.one, data, self.net.rig.now)
        self.net.rig.gateway.servers.wake(self.net.server)

    def take(self):
        """Return what was sent to it, as (type, payload)."""
        data = bytes(self.one.out)
        self.one.out.clear()
        return [(kind, body) for _, kind, body in cut(data)]

    def ask(self, kind, body=b"", **more):
        self.take()
        self.send(message(kind, body, **more))
        return self.take()

    def activate(self, source=TESTER, kind=0):
        """Return the code of the response; None: there is none yet."""
        self.source = source
        return codes(self.ask(5, struct.pack(">HBI", source, kind, 0)))

    def uds(self, request, target=GATEWAY, source=None):
        """Return the acknowledge's type and code, and the answers as hex digits."""
        address = struct.pack(">HH", self.source if source is None else source, target)
        (kind, body), *answers = self.ask(0x8001, address + bytes.fromhex(request))
        return kind, body[4], [answer[4:].hex() for _, answer in answers]

    def __call__(self, request):
        kind, code, answers = self.uds(request.replace(" ", ""))
        assert (kind, code) == (0x8002, 0)
        return " ".join(answers)

    def close(self):
        self.net.server.disconnect(self.one)


def codes(told):
    found = [body[4] for kind, body in told if kind == 6]
    return found[0] if found else None


class Net:
    """The gateway and its DoIP server."""

    def __init__(self, folder, uds="", doip="", more="", memory=None, messages=3):
        self.config = write_config(folder, messages, extra=DOIP.format(uds=uds, doip=doip) + more)
        self.rig = Rig(self.config, memory)
        self.rig.wait(300)
        (self.server,) = [each for each in self.rig.gateway.servers.all if isinstance(each, DoipServer)]

    def peer(self, **more):
        return Peer(self, **more)

    def tester(self, source=TESTER, **more):
        made = Peer(self, **more)
        assert made.activate(source) == 0x10
        return made

    def wait(self, seconds):
        """Let time pass; two turns, so that what is due at its end is done."""
        self.rig.wait(seconds * 1e3, step=max(round(seconds * 50), 1))
        self.rig.wait(1, step=1)

    def udp(self, kind, body=b"", **more):
        data = self.server.identity.answer(message(kind, body, **more), len(self.server.active))
        return [(kind, body) for _, kind, body in cut(data)]


@contextmanager
def net(folder, **more):
    made = Net(folder, **more)
    try:
        yield made
    finally:
        made.rig.close()
