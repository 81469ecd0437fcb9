"""How much of the tests is run: GATEWAY_TESTS=small, nothing, or full.

``small``: for every edit, and where all kernels run once more as plain Python or with bounds checks. Tests marked
``long`` and ``system`` are left out (tests/conftest.py), loops over random cases are short. Kernels as plain Python are
hundreds of times slower: with them it is always small.
Nothing: what CI runs; studies are sampled. ``full``: every case of every study, by hand.
"""

import os

from gateway_fdi.jit import COMPILED

SIZES = ("small", "", "full")
SIZE = os.environ.get("GATEWAY_TESTS", "")
if SIZE not in SIZES:
    raise SystemExit(f"GATEWAY_TESTS = {SIZE!r}: small, full, or not set")
SMALL = SIZE == "small" or not COMPILED
FULL = SIZE == "full" and not SMALL


def amount(whole, part=None, small=None):
    """Return how many cases to try, or how long something lasts.

    Args:
        whole: with GATEWAY_TESTS=full.
        part: in CI; a fifth of the whole if not given.
        small: with GATEWAY_TESTS=small; as in CI if not given.
    """
    if FULL:
        return whole
    if part is None:
        part = whole // 5
    return small if SMALL and small is not None else part


def examples(count):
    """Return how many examples hypothesis is to try."""
    return min(count, 15) if SMALL else count
