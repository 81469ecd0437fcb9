"""Texts that stay as they are kept: what differs is seen line by line, and is meant or not."""

import os


def kept(file, data):
    """Return the bytes of a file that is kept; GATEWAY_KEEP=1 writes it, where a change is meant."""
    if os.environ.get("GATEWAY_KEEP"):
        file.write_bytes(data)
    return file.read_bytes()
