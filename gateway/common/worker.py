"""Loaded first in the process of a worker, which is ours alone."""

from __future__ import annotations

from gateway.common.postponed import postpone


def dask_setup(_worker: object) -> None:
    """Let python-can wait for its use, as the command line does."""
    postpone()
