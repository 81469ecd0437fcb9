"""``gateway warmup``: make every kernel ready, so that no start compiles."""

from __future__ import annotations

import time

from gateway.cli.present import print_json
from gateway.jit import cache_directory
PARTS: dict = {}


def warmup(*, json: bool) -> int:
    """Load all kernels that the gateway's commands use, or compile those that changed; returns the exit code."""
    begun = time.monotonic()
    for make_ready in PARTS.values():
        make_ready()
    seconds = time.monotonic() - begun
    if json:
        print_json({"seconds": seconds, "cache": str(cache_directory())})
    else:
        print(f"kernels ready in {seconds:.1f} s")
    return 0
