"""Times in integer nanoseconds."""

from __future__ import annotations

#: A time that never comes [ns]: the greatest of 64 bits, signed.
NEVER = (1 << 63) - 1
