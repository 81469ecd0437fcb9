"""Batches by HTTP: ``POST /fleet/NAME/car/CAR/events``, answered when all of it is on the disk."""

from __future__ import annotations

import ssl
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError
from gateway_fleet.live.batch import MOST_SENT
from gateway_fleet.live.collect import Came, arrived, sender

#: How long a car waits for its answer, and a connection for the next bytes [s]; connections at a time.
ANSWER_S, QUIET_S, MOST = 20.0, 10.0, 64

log = get_logger(__name__)


def name_of(certificate: Any) -> str:
    """Return the common name of a certificate, "" if there is none."""
    subject = (certificate or {}).get("subject", ())
    return next((value for part in subject for key, value in part if key == "commonName"), "")


class Door(ThreadingHTTPServer):
    """Takes batches by HTTP.

    Args:
        address: host and port.
        fleet: whose cars these are.
        put: takes what came.
        certificate, key: of this server; None: without TLS.
        ca: whose certificates of cars are believed; the common name is the car. None: cars show none.

    Raises:
        InputError: the address is taken, or a certificate is none.
    """

    daemon_threads = True

    def __init__(
        self,
        address: tuple[str, int],
        fleet: str,
        put: Callable[[Came], None],
        *,
        certificate: Path | None = None,
        key: Path | None = None,
        ca: Path | None = None,
    ) -> None:
        self.fleet, self.put, self.named = fleet, put, ca is not None
        self._room = threading.BoundedSemaphore(MOST)
        self._context: ssl.SSLContext | None = None
        try:
            if certificate is not None:
                self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
                self._context.load_cert_chain(certificate, key)
                if ca is not None:
                    self._context.load_verify_locations(ca)
                    self._context.verify_mode = ssl.CERT_REQUIRED
            super().__init__(address, _Handler)
        except OSError as error:
            raise InputError(f"cannot listen: {error}", key="--http", value=f"{address[0]}:{address[1]}") from error

    def begin(self) -> None:
        """Listen, in a thread."""
        threading.Thread(target=self.serve_forever, name="fleet-http", daemon=True).start()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread; beyond the most it waits its turn, or is closed."""
        if not self._room.acquire(timeout=1.0):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection; the handshake of TLS is in its own thread, so that nobody waits for it."""
        try:
            request.settimeout(QUIET_S)
            if self._context is not None:
                request = self._context.wrap_socket(request, server_side=True)
            super().process_request_thread(request, client_address)
        except OSError as error:
            log.info("a connection is refused", peer=client_address[0], reason=str(error))
            self.shutdown_request(request)
        finally:
            self._room.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log what ended a connection."""
        log.warning("a connection ended", peer=client_address[0], exc_info=True)


class _Handler(BaseHTTPRequestHandler):
    """One connection."""

    server: Door
    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        car = sender(self.path.strip("/"), self.server.fleet)
        length = self.headers.get("Content-Length", "")
        if not car:
            self._say(404, b"no car of this fleet")
        elif self.server.named and name_of(self.connection.getpeercert()) != car:
            self._say(403, b"the certificate is another car's")
        elif not length.isdigit() or int(length) > MOST_SENT:
            self.close_connection = True
            self._say(413, b"a length, not above the most")
        else:
            self._take(car, self.rfile.read(int(length)))

    def _take(self, car: str, payload: bytes) -> None:
        done, said = threading.Event(), list[str]()

        def answer(digest: str) -> None:
            said.append(digest)
            done.set()

        self.server.put(Came(car, payload, answer))
        if not done.wait(ANSWER_S):
            self._say(503, b"not kept yet; send it again")
        elif said[0]:
            self._say(200, arrived(said[0]))
        else:
            self._say(400, b"refused")

    def _say(self, code: int, body: bytes) -> None:
        self.send_response(code)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        log.debug("http", text=format % args)
