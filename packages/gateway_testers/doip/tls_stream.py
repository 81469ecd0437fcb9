"""TLS of one connection over memory: its socket stays the door's, and no state of OpenSSL is changed behind it.

So the bytes that one turn of the loop takes are bounded in every state, whatever records are among them.
"""

from __future__ import annotations

import ssl
from contextlib import suppress


class TlsStream:
    """The server's side of one connection.

    Attributes:
        sent: bytes for the socket.
        certificate: common name of the tester's certificate, once the handshake is over; "": none, or several.
        ended: whether the other end has said that it sends no more (close_notify).
    """

    def __init__(self, context: ssl.SSLContext) -> None:
        self._in, self._out = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._in, self._out, server_side=True)
        self.sent = bytearray()
        self.certificate = ""
        self.ended = False

    def shake(self, data: bytes) -> bool:
        """Take bytes of a handshake; returns whether it is over.

        Raises:
            OSError: it failed; the alert is among what is to be sent.
        """
        self._in.write(data)
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            return False
        finally:
            self.sent += self._out.read()
        subject = (self._tls.getpeercert() or {}).get("subject", ())
        names = [value for part in subject for key, value in part if key == "commonName"]  # type: ignore[str-unpack]
        self.certificate = str(names[0]) if len(names) == 1 else ""
        return True

    def decrypted(self, data: bytes = b"") -> bytes | None:
        """Return what bytes carry; None: they are no whole record; b"": the other end has ended.

        Raises:
            OSError: they are no records of this connection; the alert is among what is to be sent.
        """
        self._in.write(data)
        found = bytearray()
        try:
            while part := self._tls.read(64 << 10):
                found += part
        except ssl.SSLWantReadError:
            return bytes(found) if found else None
        finally:
            self.sent += self._out.read()
        self.ended = True
        return bytes(found)

    def encrypt(self, data: bytes) -> None:
        """Have bytes among those to be sent."""
        self._tls.write(data)
        self.sent += self._out.read()

    def end(self) -> None:
        """Have the end (close_notify) among what is to be sent."""
        with suppress(ssl.SSLError):  # the other end's is not waited for
            self._tls.unwrap()
        self.sent += self._out.read()
