"""``gateway serve``: the page of a daemon, in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from gateway.cli.present import find_config, say
from gateway.common.extras import need
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.host import process
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)


def socket_of(config: Config, memory: Path | None = None, given: Path | None = None) -> Path:
    """Return the status socket of a configuration: the given one, its own, or one beside its fault memory."""
    if given is not None:
        return given
    if config.status is not None:
        return config.status.socket
    file = memory or config.memory.path
    return file.with_name(file.name + ".status")


def serve(
    config_path: Path | None,
    *,
    status: Path | None,
    host: str,
    port: int,
    names: Sequence[str],
    read_token_file: Path | None,
    control_token_file: Path | None,
    certificate: Path | None,
    key: Path | None,
    open_page: bool,
    parent: int | None,
) -> int:
    """Serve until a signal comes; returns the exit code. Arguments as the command has them."""
    need("serve", "pages")
    from gateway.serve.server import ServeSettings, kept_address, open_socket, rights_of, url_of, url_with_token  # noqa: PLC0415 - of an extra
    from gateway.serve.server import serve as work  # noqa: PLC0415

    place = status or socket_of(load_config(find_config(config_path)))
    settings = ServeSettings(
        place, host, port, tuple(names), read_token_file, control_token_file, certificate, key, parent
    )
    if parent is not None:
        give_way()
    rights = rights_of(settings)
    with ExitStack() as stack:
        listener = stack.enter_context(open_socket(settings))
        url = url_of(settings, rights, listener.getsockname()[1])
        own = url_with_token(settings, rights, url)
        if own is None or sys.stderr.isatty():
            say(f"page: {own or url}")
        else:  # a journal or a log, which others may read
            say(f"page: {url} (with the control token: {stack.enter_context(kept_address(settings, own))})")
        if open_page:
            import webbrowser  # noqa: PLC0415 - few want it

            webbrowser.open(own or url)
        work(settings, rights, listener)
    return 0


def give_way() -> None:
    """Have this process give way to a gateway beside it, which has no time to lose.

    With SCHED_IDLE a gateway that something comes for takes its processor at once. With SCHED_BATCH, or by its nice
    value alone, the page would keep it until its slice is over (Linux 6.6 and later protect slices): up to 4 ms.
    """
    try:
        process.give_way()
    except OSError as error:
        log.info("the page runs without SCHED_IDLE", reason=error.strerror)


class PageProcess:
    """``gateway serve`` beside a gateway: it ends with it, and its failure changes nothing else.

    Args:
        status: the gateway's status socket.
        port: of the page; 0: any that is free.
        open_page: whether a browser is to open it.
    """

    def __init__(self, status: Path, port: int, *, open_page: bool = False) -> None:
        need("serve", "pages", key="--serve")
        program = "from gateway.cli import main; main()"
        # -P: a folder "gateway" where it is started is not this package.
        command = [sys.executable, "-P", "-c", program, "serve", "--status", str(status), "--port", str(port)]
        command += ["--parent", str(os.getpid()), *(["--open"] if open_page else [])]
        self._ending = False
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL)  # noqa: S603 - our own command
        threading.Thread(target=self._watch, name="page", daemon=True).start()

    @property
    def ended(self) -> bool:
        """Whether the page is there no more."""
        return self._process.poll() is not None

    def _watch(self) -> None:
        code = self._process.wait()
        if not self._ending:
            log.warning("the page has ended; monitoring goes on", exit_code=code)

    def close(self) -> None:
        """End the page."""
        self._ending = True
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
