"""The page of a daemon beside it: ``gateway serve`` in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

from gateway.common.extras import need
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)


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
