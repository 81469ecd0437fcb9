"""``gateway faults export``: the catalogue for testers and other programs."""

from __future__ import annotations

from pathlib import Path

from gateway.cli.present import find_config
from gateway.common.calls import call_of
from gateway.common.jsonlines import line
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.errors import InputError


def export(config_path: Path | None, *, out: Path | None, pdx: Path | None) -> int:
    """Write the catalogue as JSON, or what testers can ask as PDX; returns the exit code.

    Raises:
        InputError: the configuration is wrong or has no UDS server; a file cannot be written.
    """
    path = find_config(config_path)
    gateway = Gateway(load_config(path), None, file=path)
    try:
        files = {} if pdx is None else {pdx: call_of("pdx_of")(gateway)}
        if out is not None or pdx is None:
            text = line(gateway.describe(), indent=2) + "\n"
            if out is None:
                print(text, end="")
            else:
                files[out] = text.encode()
    except InputError as error:
        raise error.within(path) from error
    finally:
        gateway.close()
    for file, content in files.items():
        try:
            file.write_bytes(content)
        except OSError as error:
            raise InputError(error.strerror or str(error), file=file) from error
    return 0
