"""TLS of the DoIP server (ISO 13400-2:2019, 10): 1.2 and 1.3."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gateway_fdi.errors import InputError
from gateway_testers.doip.params import TlsParams

if TYPE_CHECKING:
    from ssl import SSLContext


def tls_context(params: TlsParams) -> SSLContext:
    """Return the context of the TLS port.

    A tester's certificate is asked for, not demanded: a tester without one is refused by its source address, where that
    needs one.

    Raises:
        InputError: a certificate or a key that cannot be read, or do not belong together.
    """
    import ssl  # noqa: PLC0415 - slow to load, and most have none

    made = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    made.minimum_version = ssl.TLSVersion.TLSv1_2
    key, file = "key", params.key
    try:
        file.read_bytes()
        key, file = "certificate", params.certificate
        file.read_bytes()
        made.load_cert_chain(file, params.key, lambda: "")  # one with a password is refused, nobody is asked for it
        if params.client_ca is not None:
            key, file = "client_ca", params.client_ca
            made.load_verify_locations(file)
            made.verify_mode = ssl.CERT_OPTIONAL
    except OSError as error:  # ssl's errors, too
        tls = isinstance(error, ssl.SSLError)
        text = f"no certificate, or not of this key ({error.args[-1]})" if tls else error.strerror or str(error)
        raise InputError(text, key=f"output.doip.tls.{key}", value=str(file)) from error
    return made
