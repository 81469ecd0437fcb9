"""How often changes are written: the first ones at once, those of a storm in groups."""

from __future__ import annotations

#: Number of writes that are allowed at once, after a quiet time; then one in each interval [ns].
#: A fault that comes and goes fifty times a second is written, and told, at each change.
BURST, INTERVAL_NS = 32, 8_000_000
#: Number of faults in a write that doubles the time until the next one: larger writes take longer.
FAULTS = 8


class WriteThrottle:
    """Leave to write. It reads no clock: times come with the calls, of the engine's clock.

    Args:
        burst: writes allowed at once after a quiet time.
        interval_ns: after these, one write in each [ns].
    """

    def __init__(self, burst: int = BURST, interval_ns: int = INTERVAL_NS) -> None:
        self._interval_ns = interval_ns
        self._most_ns = burst * interval_ns
        self._credit_ns = self._most_ns
        self._last_ns: int | None = None

    @property
    def calm(self) -> bool:
        """Whether there has been little to write lately."""
        return 2 * self._credit_ns >= self._most_ns

    def allows(self, t_ns: int, faults: int = 0) -> bool:
        """Return whether to write now; a yes is used up, and more of it the more there is to write.

        Args:
            t_ns: now [ns].
            faults: whose records are to be written.
        """
        passed = 0 if self._last_ns is None else max(t_ns - self._last_ns, 0)
        self._last_ns = t_ns
        self._credit_ns = min(self._credit_ns + passed, self._most_ns)
        if self._credit_ns < self._interval_ns:
            return False
        self._credit_ns -= self._interval_ns * (FAULTS + faults) // FAULTS
        return True
