"""A gateway whose DoIP server is reached by sockets on 127.0.0.1, turned by hand or by a thread."""

import socket
import threading
from contextlib import contextmanager

from doip_rig import Net, cut

from gateway_testers.doip.door import DoipDoor


def free_port():
    """Return a port that neither TCP nor UDP has at present."""
    while True:
        with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            tcp.bind(("127.0.0.1", 0))
            try:
                udp.bind(tcp.getsockname())
            except OSError:
                continue
            return tcp.getsockname()[1]


class Clock:
    """The rig's time, as the engine's clock has it."""

    def __init__(self, rig):
        self._rig = rig

    def now(self):
        return self._rig.now


class Sockets:
    """A gateway's door, turned by hand or by a thread; ``rig`` has the gateway and its time."""

    def open(self):
        self.params = self.rig.gateway.config.output.doip
        self.door = DoipDoor(self.params, self.rig.gateway, Clock(self.rig))

    def pass_time(self, ms):
        self.rig.wait(ms, step=ms)

    def turn(self, count=4, ms=1):
        """Let the gateway and its door do what is due; ``ms`` of time a turn."""
        for _ in range(count):
            self.pass_time(ms)
            self.door.turn(self.rig.now / 1e9)

    def connect(self, port=None):
        """Return a socket of a tester, that waits for nothing."""
        made = socket.create_connection(("127.0.0.1", port or self.port))
        made.setblocking(False)
        self.turn()
        return made

    def exchange(self, made, data, until=None, turns=50):
        """Send bytes; returns what comes, as messages of DoIP. None in the list: the connection was closed."""
        if data:
            made.sendall(data)
        got, ended = b"", False
        for _ in range(turns):
            self.turn(1)
            try:
                more = made.recv(1 << 20)
            except BlockingIOError:
                if got and until is not None and until(got):
                    break
                continue
            got += more
            if not more:
                ended = True
                break
        return [(kind, body) for _, kind, body in cut(got)] + [None] * ended

    @contextmanager
    def running(self):
        """Have a thread turn it, for testers that wait; time passes as their waiting goes."""
        stop, failed = threading.Event(), []

        def work():
            try:
                while not stop.is_set():
                    self.turn(1)
                    stop.wait(0.0005)
            except BaseException as error:  # told by the test
                failed.append(error)

        thread = threading.Thread(target=work)
        thread.start()
        try:
            yield self
        finally:
            stop.set()
            thread.join()
            assert not failed, failed


class Wired(Sockets, Net):
    """A gateway with its door."""

    def __init__(self, folder, *, doip="", **more):
        self.port = free_port()
        super().__init__(folder, doip=f'port = {self.port}\nbind = ["127.0.0.1"]\n{doip}', **more)
        self.open()

    def close(self):
        self.door.close()
        self.rig.close()


@contextmanager
def wired(folder, **more):
    made = Wired(folder, **more)
    try:
        yield made
    finally:
        made.close()
