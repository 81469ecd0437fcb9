"""Third-party testers on the loopback bus: can-isotp below, udsoncan and gallia above it."""

import os
import socketserver
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import can
import isotp

REQUEST, FUNCTIONAL, RESPONSE = 0x7E0, 0x7DF, 0x7E8


def open_can(uri):
    """Join the loopback bus as python-can's socketcand client."""
    host, port = uri.removeprefix("loopback:").split(":")
    return can.Bus(interface="socketcand", host=host, port=int(port), channel="can0")


@contextmanager
def isotp_stack(uri, *, start=True, request=REQUEST, response=RESPONSE, **params):
    """Make can-isotp's own threaded stack on the loopback bus, and start it."""
    with open_can(uri) as bus:
        address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=request, rxid=response)
        stack = isotp.CanStack(bus, address=address, params={"tx_padding": 0, "blocking_send": True, **params})
        if start:
            stack.start()
        try:
            yield stack
        finally:
            if start:
                stack.stop()


@contextmanager
def lines_bridge(stack, path: Path):
    """Serve a unix socket that speaks hex lines (gallia's unix-lines) in front of an ISO-TP stack.

    What comes back unasked (0x78, then the answer) is passed on as it comes.
    """

    class Handler(socketserver.StreamRequestHandler):
        def handle(self):
            alive = threading.Event()
            alive.set()

            def pass_on():
                while alive.is_set():
                    answer = stack.recv(block=True, timeout=0.1)
                    if answer is not None:
                        try:
                            self.wfile.write(answer.hex().encode() + b"\n")
                        except OSError:
                            return

            reader = threading.Thread(target=pass_on, daemon=True)
            reader.start()
            for line in self.rfile:
                stack.send(bytes.fromhex(line.decode().strip()), send_timeout=2)
            alive.clear()
            reader.join()

    class Server(socketserver.ThreadingUnixStreamServer):
        daemon_threads = True

    with Server(str(path), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"unix-lines://{path}"
        finally:
            server.shutdown()


def gallia_command():
    """Return the scanner's command of this environment."""
    return [str(Path(sys.executable).with_name("gallia"))]


def quiet_environment(folder):
    """Return an environment in which the scanner writes only below a folder."""
    return {**os.environ, "GALLIA_ARTIFACTS_BASE": str(folder), "HOME": str(folder)}
