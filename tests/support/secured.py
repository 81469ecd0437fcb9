"""Frames that SecOC secures, made by cantools' layout and cryptography's CMAC: neither is ours."""

from types import SimpleNamespace

from cantools.autosar.secoc import apply_authenticator
from cantools.database.can.formats.arxml.secoc_properties import AutosarSecOCProperties
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC

KEY = bytes(range(16))


def write_key(folder, key=KEY, name="key", mode=0o600):
    """Write a key's file; returns its name."""
    (folder / name).write_text(key.hex() + "\n")
    (folder / name).chmod(mode)
    return name


def tag(key, data):
    """Return the CMAC of data."""
    made = CMAC(AES(key))
    made.update(data)
    return made.finalize()


def secured(payload, value, *, data_id=0x12, length=8, bits=64, truncated=8, mac=24, key=KEY):
    """Return a secured payload.

    Args:
        payload: its authentic part.
        value: whole freshness value.
        data_id: of the message.
        length: of the secured payload [byte].
        bits: of the whole freshness value.
        truncated: bits of it that are sent.
        mac: bits of the MAC that are sent.
        key: of AES-128.
    """
    properties = AutosarSecOCProperties("CMAC", "counter", len(payload), data_id, mac, bits, truncated)
    message = SimpleNamespace(name="M", autosar=SimpleNamespace(secoc=properties))
    room = bytes(payload).ljust(length, b"\0")
    return bytes(apply_authenticator(room, message, lambda _, data, __: tag(key, data), value))
