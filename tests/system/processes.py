"""Commands of the gateway as processes."""

import re
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import warm

GATEWAY = [sys.executable, "-c", "from gateway.cli import main; main()"]
#: The same for a test that kills it many times: it waits for nothing after that.
TIRELESS = [
    sys.executable,
    "-c",
    "from gateway.faults import restarts; restarts.LONGEST_S = 0.0; from gateway.cli import main; main()",
]


def gateway(*arguments, cwd, timeout=1200, **options):
    return warm.run(
        [*GATEWAY, *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
        **options,
    )


@contextmanager
def process(*arguments, cwd, ready, program=GATEWAY):
    """Start a command, wait for a line on stderr, end it with SIGTERM."""
    started = warm.Popen(
        [*program, *map(str, arguments)],
        cwd=cwd,
        stdout=(Path(cwd) / f"{arguments[0]}.out").open("a"),
        stderr=subprocess.PIPE,
        text=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    )
    try:
        line = ""
        while ready not in line:
            line = started.stderr.readline()
            assert line, f"{arguments} ended with {started.wait(60)}"
        started.said = line
        started.log = []
        drain = threading.Thread(target=started.log.extend, args=(started.stderr,), daemon=True)
        drain.start()
        yield started
    finally:
        if started.poll() is None:
            started.terminate()
        started.code = started.wait(300)
        if hasattr(started, "log"):
            drain.join(60)


@contextmanager
def bus(cwd, *, program=GATEWAY):
    with process("bus", "127.0.0.1:0", cwd=cwd, ready="serving", program=program) as started:
        yield re.search(r"loopback:\S+", started.said)[0]
