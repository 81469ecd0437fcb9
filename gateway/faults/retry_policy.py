"""When a fault memory that could not be written is tried again."""

from __future__ import annotations

#: First and longest wait before another attempt [ns of the gateway's clock].
FIRST_NS, LONGEST_NS = 100_000_000, 10_000_000_000


class RetryPolicy:
    """The time between the first write that failed and the next one that succeeds.

    It reads no clock: times are those of the engine, and come with the calls.

    Attributes:
        reason: why the last attempt failed, "" if it did not.
        since_ns: when the first one failed [ns].
        failures: attempts that failed, of all outages.
        awaited: whether somebody tells of it before others see what is not written.
        told: whether that was done.
    """

    def __init__(self) -> None:
        self.reason = ""
        self.since_ns = 0
        self.failures = 0
        self.awaited = self.told = False
        self._tried_ns = 0
        self._wait_ns = 0

    def failed(self, t_ns: int, reason: str) -> None:
        """Note an attempt that failed; each wait is twice the last one."""
        if not self.reason:
            self.since_ns, self._wait_ns = t_ns, FIRST_NS
        else:
            self._wait_ns = min(2 * self._wait_ns, LONGEST_NS)
        self.reason = reason
        self.failures += 1
        self._tried_ns = t_ns

    def ended(self) -> None:
        """Note that all is written."""
        self.reason, self.told = "", False

    @property
    def is_open(self) -> bool:
        """Whether others see what is not written."""
        return bool(self.reason) and (self.told or not self.awaited)

    def is_due(self, t_ns: int) -> bool:
        """Return whether to try again; always so while there is no outage."""
        return not self.reason or not 0 <= t_ns - self._tried_ns < self._wait_ns
