"""Report test results of your own process to a gateway of this machine (AUTOSAR Dem_SetEventStatus).

    from gateway.report import Reporter

    with Reporter("report.sock") as reporter:
        reporter.failed("battery.hot", temperature=81.5)
        reporter.passed("battery.hot")

Nothing of the gateway but this is loaded, and nothing beside the standard library. docs/report.md has the protocol.
"""

from __future__ import annotations

import json
import os
import socket
import time
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from gateway.report.words import MOST_BYTES, REFUSALS

__all__ = ["Answer", "Reporter", "header"]

#: Why a report is not accepted, by this side: no gateway was reached; it has left, and its answer is not there yet.
UNDELIVERED, UNANSWERED = "undelivered", "unanswered"


class Answer(NamedTuple):
    """Outcome of a report; it is true if the gateway has taken it.

    ``refused`` is a word of docs/report.md, "undelivered" if the gateway was not reached, "unanswered" if its answer
    did not come in time; ``why`` is for people.
    """

    accepted: bool
    refused: str = ""
    why: str = ""

    def __bool__(self) -> bool:
        return self.accepted


class Reporter:
    """A connection to a gateway, which is made when it is needed, and again when the gateway has started again.

    No call takes longer than ``patience_s``. Not thread-safe: a reporter for each thread.

    Args:
        path: of the gateway's socket, ``[report] socket`` of its configuration.
        patience_s: longest time that a call may take [s].
        retry_s: after a try that reached no gateway, time for which calls fail at once [s].

    Attributes:
        accepted: reports that the gateway has taken.
        refused: word of the protocol -> reports that were refused so.
        undelivered: reports that reached no gateway.
        unanswered: reports that have left, and whose answers have not come yet; one that comes later is counted then.
            Those of a gateway that has ended stay here.
    """

    def __init__(self, path: str | Path, *, patience_s: float = 0.1, retry_s: float = 0.1) -> None:
        self._path, self._patience_s, self._retry_s = os.fspath(path), patience_s, retry_s
        self._socket: socket.socket | None = None
        self._not_before = 0.0
        self._reason = ""
        self._number = 0
        self._open: set[int] = set()  # reports on this connection without an answer
        self.accepted = self.undelivered = self.unanswered = 0
        self.refused: dict[str, int] = {}

    def __enter__(self) -> Reporter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None:
            self.goodbye()
        else:  # a process that fails says no goodbye: its faults are not tested
            self._drop("")

    def passed(self, fault: str, /, **data: float) -> Answer:
        """Report that a test has passed, without debounce.

        Args:
            fault: its id, ``reporter.fault``.
            data: numbers by the names that the configuration gives the fault.
        """
        return self.report(fault, "passed", **data)

    def failed(self, fault: str, /, **data: float) -> Answer:
        """Report that a test has failed, without debounce; arguments as for :meth:`passed`."""
        return self.report(fault, "failed", **data)

    def prepassed(self, fault: str, /, **data: float) -> Answer:
        """Report one passed result, which the gateway debounces; arguments as for :meth:`passed`."""
        return self.report(fault, "prepassed", **data)

    def prefailed(self, fault: str, /, **data: float) -> Answer:
        """Report one failed result, which the gateway debounces; arguments as for :meth:`passed`."""
        return self.report(fault, "prefailed", **data)

    def not_tested(self, fault: str) -> Answer:
        """Report that the test cannot run at present."""
        return self.report(fault, "not_tested")

    def report(self, fault: str, result: str, /, **data: float) -> Answer:
        """Report a result, one of ``gateway.report.words.RESULTS``.

        Args:
            fault: its id, ``reporter.fault``.
            result: word of the protocol.
            data: numbers by the names that the configuration gives the fault.
        """
        asked: dict[str, Any] = {"fault": fault, "result": result}
        if data:
            asked["data"] = {name: float(value) for name, value in data.items()}
        answer = self._ask(asked)
        self._count(answer)
        return answer

    def goodbye(self) -> Answer:
        """End the connection, and leave the faults as they are; the next report makes it again."""
        answer = self._ask({"goodbye": True}) if self._socket is not None else Answer(True)
        self._drop("")
        return answer

    def _count(self, answer: Answer) -> None:
        if answer.accepted:
            self.accepted += 1
        elif answer.refused == UNDELIVERED:
            self.undelivered += 1
        elif answer.refused == UNANSWERED:
            self.unanswered += 1
        else:
            self.refused[answer.refused] = self.refused.get(answer.refused, 0) + 1

    def _ask(self, asked: dict[str, Any]) -> Answer:
        until_s = time.monotonic() + self._patience_s
        self._number += 1
        packet = json.dumps({**asked, "id": self._number}).encode()
        if len(packet) > MOST_BYTES:
            return Answer(False, "malformed", f"longer than {MOST_BYTES} bytes")
        for _ in range(2):  # a connection to a gateway that has ended since is noticed when it is used
            connection = self._socket or self._connect(until_s)
            if connection is None:
                break
            try:
                _wait(connection, until_s)
                connection.send(packet)
            except TimeoutError:
                self._reason = "the gateway takes no reports at present"
                break
            except OSError as error:  # nothing of it has left; a process that is refused gets the reason
                told = self._last_word(connection)
                self._drop(error.strerror or str(error))
                if told is not None:
                    return told
                continue
            return self._answer(connection, until_s)
        return Answer(False, UNDELIVERED, self._reason)

    def _answer(self, connection: socket.socket, until_s: float) -> Answer:
        while True:
            try:
                _wait(connection, until_s)
                told = _read_answer(connection)
            except TimeoutError:
                self._open.add(self._number)
                return Answer(False, UNANSWERED, "no answer in time")
            if told is None:
                self._drop("the gateway has ended")
                return Answer(False, UNANSWERED, self._reason)
            number, answer = told
            if number in (self._number, None):
                return answer
            if number in self._open:  # of a report before
                self._open.remove(number)
                self.unanswered -= 1
                self._count(answer)

    def _last_word(self, connection: socket.socket) -> Answer | None:
        connection.setblocking(False)
        try:
            told = _read_answer(connection)
        except OSError:
            return None
        return None if told is None or told[0] is not None else told[1]

    def _connect(self, until_s: float) -> socket.socket | None:
        now = time.monotonic()
        if now < self._not_before:
            return None
        try:
            made = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        except OSError as error:
            self._reason = error.strerror or str(error)
            return None
        try:
            _wait(made, until_s)
            made.connect(self._path)
        except OSError as error:
            made.close()
            self._not_before = now + self._retry_s
            self._reason = f"no gateway listens at {self._path}: {error.strerror or error}"
            return None
        self._socket = made
        return made

    def _drop(self, reason: str) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket, self._reason = None, reason
        self._open.clear()


def _wait(connection: socket.socket, until_s: float) -> None:
    left = until_s - time.monotonic()
    if left <= 0:
        raise TimeoutError("no time is left")
    connection.settimeout(left)


def _read_answer(connection: socket.socket) -> tuple[int | None, Answer] | None:
    """Return the number of a report and the answer; None: the connection has ended.

    Raises:
        OSError: nothing has come in time.
    """
    try:
        heard = connection.recv(MOST_BYTES)
    except ConnectionResetError:  # it has ended with a report unread; its earlier answers are still there
        heard = connection.recv(MOST_BYTES)
    try:
        told = json.loads(heard)
    except ValueError:
        return None
    if not isinstance(told, dict):
        return None
    if told.get("ok"):
        return told.get("id"), Answer(True)
    refused = str(told.get("refused", ""))
    return told.get("id"), Answer(False, refused, str(told.get("why") or REFUSALS.get(refused, "")))


def header() -> Path:
    """Return the path of the header for C, ``gateway_report.h``."""
    return Path(__file__).parent / "gateway_report.h"
