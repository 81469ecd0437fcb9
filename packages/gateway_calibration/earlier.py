"""A configuration that is to be calibrated, read without what an earlier calibration found for other tests."""

from __future__ import annotations

import re
from pathlib import Path

from gateway.config.load import load_config
from gateway.config.model import Config
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputErrors

log = get_logger(__name__)

#: Keys of a monitor that a calibration writes.
_WRITTEN = ("nu", "thresholds", "digests")
_FOUND_BEFORE = re.compile(rf"monitor\[(\d+)\]\.(?:{'|'.join(_WRITTEN)})\..*")


def load_afresh(path: Path, *, told: bool = False) -> Config:
    """Read a configuration that is to be calibrated; values for tests that are no longer there do not count.

    Args:
        path: of the configuration.
        told: a line in the log for each key that is left out.

    Raises:
        InputError, InputErrors: anything else is wrong.
    """
    try:
        return load_config(path)
    except InputErrors as errors:
        places = [_FOUND_BEFORE.fullmatch(error.key or "") for error in errors.errors]
        if not all(places):
            raise
        for error in errors.errors if told else ():
            log.warning("found for another test, and left out", key=error.key, value=error.value)
        stale = {int(found[1]) for found in places if found}
        return load_config(path, [(k, key) for k in stale for key in _WRITTEN])
