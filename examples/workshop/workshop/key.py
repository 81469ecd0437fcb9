"""The key of the workshop's security access: each byte of the seed, exclusive or with the secret's."""


def key(seed: bytes, secret: bytes, level: int) -> bytes:
    """Return the key.

    Args:
        seed: of the gateway.
        secret: as configured.
        level: of security.
    """
    return bytes(byte ^ secret[k % len(secret)] ^ level for k, byte in enumerate(seed))
