"""How much of a long random test is run: all of it by hand (GATEWAY_TESTS=full), a fifth of it each time."""

import os

FULL = os.environ.get("GATEWAY_TESTS") == "full"


def amount(whole: int, part: int | None = None) -> int:
    """Return how many cases to try, of so many; ``part`` of them in a short run, a fifth if not given."""
    if FULL:
        return whole
    return whole // 5 if part is None else part
