"""Processes of the gateway that begin as copies of one that has imported it (:mod:`nest`): a start is cheap.

A start imports a thousand modules: a second of processor time, four in the test kernel. A copy is a process all the
same: it has a number, files and signals of its own, and nobody's work in it, for what is copied has only imported.
``python -c`` with the environment of these tests is copied, also with a width of the terminal; what asks for more is
started anew.
"""

import atexit
import json
import os
import select
import socket
import struct
import subprocess
import sys
from functools import cache
from pathlib import Path

#: What the commands of live buses import.
IMPORTED = (
    "gateway.cli.run",
    "gateway_commands.check",
    "gateway_commands.doctor",
    "gateway_checks.rule",
    "gateway_checks.signal",
    "gateway_fdi.jit.machine",
    "structlog",
)


def _told(environment):
    return {k: v for k, v in environment.items() if k != "PYTEST_CURRENT_TEST"}


#: Of these tests, before one of them has changed it for itself.
ENVIRONMENT = _told(os.environ)
#: Variables that a copy can still be given.
LATE = {"COLUMNS"} - {*ENVIRONMENT}


class _Nest:
    """The process that is copied; it ends with this one."""

    def __init__(self):
        self._line, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        code = Path(__file__).with_name("nest.py").read_text()
        with theirs:
            words = [sys.executable, "-c", code, str(theirs.fileno()), *IMPORTED]
            self._process = subprocess.Popen(
                words,
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=ENVIRONMENT,
            )
        atexit.register(self.end)

    def end(self):
        """End it; its processor time, and that of its copies, is this one's."""
        self._line.close()
        self._process.wait(60)

    def copy(self, order, files):
        """Have a copy made; returns its number."""
        socket.send_fds(self._line, [json.dumps(order).encode()], files)
        return struct.unpack("=q", self._line.recv(8))[0]


@cache
def _nest():
    return _Nest()


class Popen(subprocess.Popen):
    """As ``subprocess.Popen``."""

    _end = None  # pipe in which a copy's end is told

    def _execute_child(self, args, executable, before, closed, passed, cwd, env, *more):
        _, _, shell, *pipes = more[:9]
        _, _, _, _, _, apart, *_ = more[9:]
        code = list(args[1:3])[:1] == ["-c"] and args[0] == sys.executable and sys.platform == "linux"
        environment = _told(os.environ if env is None else env)
        differs = {k: v for k, v in environment.items() if k not in LATE} != ENVIRONMENT
        if not code or before or passed or shell or apart or differs:
            super()._execute_child(args, executable, before, closed, passed, cwd, env, *more)
            return
        order = {
            "code": args[2],
            "arguments": [os.fspath(each) for each in args[3:]],
            "cwd": os.path.abspath(cwd or "."),  # noqa: PTH100 - of bytes, too
            "environment": environment,
        }
        ours = [pipes[0], pipes[3], pipes[5]]
        files = [place if file == -1 else file for place, file in enumerate(ours)]
        self._end, tell = os.pipe()
        try:
            self.pid = _nest().copy(order, [*files, tell])
        finally:
            os.close(tell)
            self._close_pipe_fds(*pipes)
        self._child_created = True

    def _heard(self, timeout):
        """Wait for the copy's end; returns whether it was told."""
        if self.returncode is None and select.select([self._end], [], [], timeout)[0]:
            status = os.read(self._end, 4)
            os.close(self._end)
            self._handle_exitstatus(struct.unpack("=i", status)[0] if status else 9)  # with the nest itself
        return self.returncode is not None

    def _internal_poll(self, *given, **more):
        if self._end is None:
            return super()._internal_poll(*given, **more)
        self._heard(0)
        return self.returncode

    def _wait(self, timeout):
        if self._end is None:
            return super()._wait(timeout)
        if not self._heard(timeout):
            raise subprocess.TimeoutExpired(self.args, timeout)
        return self.returncode


def run(arguments, *, capture_output=False, timeout=None, check=False, **options):
    """As ``subprocess.run``, without input."""
    if capture_output:
        options |= {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with Popen(arguments, **options) as started:
        try:
            said = started.communicate(timeout=timeout)
        except BaseException:
            started.kill()
            raise
    done = subprocess.CompletedProcess(arguments, started.returncode, *said)
    if check:
        done.check_returncode()
    return done
