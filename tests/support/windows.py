"""Takes from this Python what Windows' lacks, and runs the gateway: python tests/support/windows.py check car.toml.

It shows that nothing of it is needed; it does not show that Windows does the rest. Other packages, and the standard
library, keep what they have taken before.
"""

import asyncio
import ctypes
import importlib
import os
import select
import selectors
import shutil
import signal
import socket
import stat
import struct
import subprocess  # noqa: F401 - keeps what it needs of os
import sys
import time
import types
from pathlib import Path

#: Packages that know both systems, and would look for Windows' own modules.
KEEP = [
    "asyncio",
    "multiprocessing.context",
    "multiprocessing.shared_memory",
    "concurrent.futures.process",
    "tempfile",
    "selectors",
    "llvmlite.binding",
    "can",
    "can.interfaces.virtual",
    "cantools",
    "typer",
    "rich.console",
    "structlog",
    "sqlite3",
    "pydantic",
    "pydantic_settings",
    "platformdirs",
    "urllib.request",
    "uvicorn",
]
#: Those that take seconds to load, and that no command at a bus needs.
KEEP_AT_REST = ["numba", "scipy.signal", "filterpy.kalman", "matplotlib.pyplot", "pytest", "sympy"]
AT_A_BUS = ["bus", "run", "simulate", "faults", "request", "serve", "watch"]
MODULES = ["fcntl", "grp", "pwd", "resource", "termios", "tty", "pty", "syslog"]
LACKING = {
    os: """
        getuid geteuid getgid getegid getgroups eventfd eventfd_read eventfd_write EFD_NONBLOCK EFD_CLOEXEC
        sched_getaffinity sched_setscheduler sched_param SCHED_RR SCHED_IDLE SCHED_FIFO O_CLOEXEC O_NOFOLLOW
        O_NONBLOCK O_DIRECTORY O_DSYNC pwrite pread fchmod fchown chown fork fdatasync posix_fadvise
        posix_fallocate getloadavg uname statvfs sysconf nice setsid mkfifo killpg wait4 memfd_create writev
        preadv pwritev sendfile getpriority setpriority initgroups
    """,
    socket: """
        AF_UNIX AF_CAN PF_CAN CAN_RAW CMSG_LEN CMSG_SPACE SO_PEERCRED SOCK_CLOEXEC SOCK_NONBLOCK MSG_DONTWAIT
        SO_REUSEPORT MSG_NOSIGNAL AF_PACKET AF_NETLINK SCM_RIGHTS
    """,
    signal: """
        SIGHUP SIGUSR1 SIGUSR2 SIGALRM SIGPIPE SIGCHLD SIGQUIT SIGKILL setitimer pthread_sigmask sigwait
    """,
    select: "poll epoll",
    time: "clock_gettime clock_gettime_ns CLOCK_REALTIME CLOCK_MONOTONIC CLOCK_BOOTTIME CLOCK_MONOTONIC_RAW",
    asyncio: "open_unix_connection start_unix_server",
}
#: Whether it is to be shown here; on Windows, and on macOS, the gateway runs as it is.
HERE = sys.platform == "linux"
#: What Ctrl-Break of a console sends to a process.
BREAK = getattr(signal, "CTRL_BREAK_EVENT", None) or (signal.SIGUSR2 if HERE else signal.SIGTERM)
UNIX_SELECT, UNIX_STATVFS = select.select, getattr(os, "statvfs", None)


def _locking():
    """Return Windows' locks of byte ranges: of a descriptor, and never shared."""
    import fcntl

    def locking(descriptor, mode, count):
        start = os.lseek(descriptor, 0, os.SEEK_CUR)
        writes = fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_RDWR
        kind = fcntl.F_UNLCK if not mode else fcntl.F_WRLCK if writes else fcntl.F_RDLCK
        try:
            fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, struct.pack("@hhqqi0q", kind, 0, start, count, 0))
        except BlockingIOError as error:
            raise PermissionError(13, "Permission denied") from error

    return types.SimpleNamespace(locking=locking, LK_UNLCK=0, LK_NBLCK=2)


def _pair():
    """Return two sockets that are connected, as Windows' Python makes them."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        one = socket.create_connection(server.getsockname())
        return one, server.accept()[0]


def _selecting(_, reads, writes, __, timeout=None):
    """Windows' select: of sockets alone, and never of none."""
    if not reads and not writes:
        raise OSError(10022, "An invalid argument was supplied")
    numbers = [each if isinstance(each, int) else each.fileno() for each in (*reads, *writes)]
    if not all(stat.S_ISSOCK(os.fstat(number).st_mode) for number in numbers):
        raise OSError(10038, "An operation was attempted on something that is not a socket")
    return UNIX_SELECT(reads, writes, [], timeout)


def _disk_usage(path):
    """Windows' own function of it, which shutil has there."""
    found = UNIX_STATVFS(path)
    return types.SimpleNamespace(free=found.f_bavail * found.f_frsize)


def _no_handlers(*_):
    raise NotImplementedError


def become_windows(keep=(*KEEP, *KEEP_AT_REST)):
    """Take away what is lacking, for all modules that are loaded from now on."""
    if not HERE:
        return
    for name in keep:
        try:
            importlib.import_module(name)
        except ImportError:
            continue
    sys.modules["msvcrt"] = _locking()
    for name in MODULES:
        sys.modules[name] = None
    for module, names in LACKING.items():
        for name in names.split():
            vars(module).pop(name, None)
    shutil.disk_usage, shutil._USE_CP_SENDFILE = _disk_usage, False
    os.O_BINARY, os.O_NOINHERIT, socket.socketpair = 0, 0, _pair
    signal.SIGBREAK = BREAK.value
    selectors.DefaultSelector = selectors.SelectSelector
    selectors.SelectSelector._select = _selecting
    select.select = lambda reads, writes, errors, timeout=None: _selecting(None, reads, writes, errors, timeout)
    asyncio.unix_events._UnixSelectorEventLoop.add_signal_handler = _no_handlers

    def no_library_of_the_process(name, *more, **further):
        if name is None:
            raise TypeError("bad argument type for built-in operation")
        return library("libm.so.6" if name == "ucrtbase" else name, *more, **further)

    library, ctypes.CDLL = ctypes.CDLL, no_library_of_the_process


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).parents[2])
    become_windows(KEEP if sys.argv[1] in AT_A_BUS else (*KEEP, *KEEP_AT_REST))
    from gateway.cli import main

    sys.argv[0] = "gateway"
    main()
