"""Attempts to unlock a session, by key (0x27) or certificate (0x29): wrong ones, and the delay after too many.

ISO 14229-1 has both for 0x27 (Annex I; 0x36 and 0x37 in Annex A.1), and leaves to a server's security strategy how many
and how long. 0x29 goes by the same rule here, with the same two codes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

from gateway.servers.uds.nrc import NegativeError, Nrc, refuse_unless

#: Keeps how many wrong attempts there were, by name, durable on return; returns that number.
Keep = Callable[[str, int], None]
Kept = Callable[[str], int]


class Attempts:
    """Attempts of all testers at one lock.

    They are counted in the fault memory's file, before they are looked at: neither a restart nor a power cut makes them
    forgotten. Restarting the gateway during a delay restarts the delay. After a delay there is one attempt.

    Args:
        name: of the lock, in the file.
        allowed: wrong ones before the delay.
        delay_s: the delay [s].
        start_delay_s: delay after each start [s].
    """

    def __init__(self, name: str, allowed: int, delay_s: float, start_delay_s: float = 0.0) -> None:
        self._name, self._allowed = name, allowed
        self._delay_s, self._start_delay_s = delay_s, start_delay_s
        self._left = allowed
        self._locked_until_ns = 0
        self._started = False
        self._looked_ns: int | None = None
        self._keep: Keep = lambda name, wrong: None

    def keep_in(self, kept: Kept, keep: Keep) -> None:
        """Count where it outlasts this process."""
        self._keep = keep
        self._left = self._allowed - min(max(kept(self._name), 0), self._allowed)

    def start(self, t_ns: int) -> None:
        """Begin the delay of a start, with the first request: before it no time is known."""
        if not self._started:
            self._started = True
            self._lock_out(t_ns, self._start_delay_s if self._left else self._delay_s)

    def check(self, t_ns: int) -> None:
        """Refuse an attempt during a delay.

        Raises:
            NegativeError: the delay is not over.
        """
        refuse_unless(t_ns >= self._locked_until_ns, Nrc.REQUIRED_TIME_DELAY_NOT_EXPIRED)

    def look(self, t_ns: int) -> None:
        """Refuse a look that takes milliseconds, where another tester had one in this turn of the loop.

        Args:
            t_ns: now; the same for all requests of a turn.

        Raises:
            NegativeError: the tester is to ask again.
        """
        refuse_unless(t_ns != self._looked_ns, Nrc.BUSY)
        self._looked_ns = t_ns

    def begin(self, t_ns: int) -> None:
        """Count an attempt, before it is looked at.

        Raises:
            NegativeError: the delay is not over; or those that are allowed were begun, and none ended well.
        """
        self.check(t_ns)
        if not self._left:
            self.fail(t_ns, Nrc.EXCEEDED_NUMBER_OF_ATTEMPTS)
        self._left -= 1
        self._keep(self._name, self._allowed - self._left)

    def fail(self, t_ns: int, nrc: Nrc) -> NoReturn:
        """End an attempt that was wrong.

        Raises:
            NegativeError: always; with ``nrc`` if there may be another one before the delay.
        """
        if self._left:
            raise NegativeError(nrc)
        self._lock_out(t_ns, self._delay_s)
        raise NegativeError(Nrc.EXCEEDED_NUMBER_OF_ATTEMPTS)

    def forgive(self) -> None:
        """End an attempt that was right."""
        self._left = self._allowed
        self._keep(self._name, 0)

    def _lock_out(self, t_ns: int, seconds: float) -> None:
        """Begin a delay. The file says as long as nobody was right that all attempts are spent."""
        self._locked_until_ns = max(self._locked_until_ns, t_ns + round(seconds * 1e9))
        self._left = max(self._left, 1)
