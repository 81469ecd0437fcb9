"""The page of ``gateway demo --serve``: a gateway on a scenario's clock, shown as a daemon is."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from gateway.bus.frames import Frames
from gateway.cli.present import say
from gateway.common.extras import need
from gateway.runtime.app import Gateway
from gateway_bench.vecu.player import Player, TruthReader
from gateway_bench.vecu.words import injected
from gateway_fdi.errors import GatewayError
from gateway_serve.cli.page_process import PageProcess
from gateway_serve.status_socket import StatusSocket

#: How long the page is waited for before the scenario begins, and how long it has to draw then [s].
PATIENCE_S, LOOK_S = 20.0, 2.0


class DemoPage:
    """Shows a demo on a page, and keeps it until told to stop.

    Args:
        port: of the page.
        stop: tells when to end.
        open_page: whether a browser is to open it.

    Attributes:
        memory: fault memory of the demo; it is gone afterwards.
    """

    def __init__(self, port: int, stop: Callable[[], bool], *, open_page: bool) -> None:
        need("serve", "pages", key="--serve")
        self._port, self._open, self.stop = port, open_page, stop
        self._folder = Path(tempfile.mkdtemp(prefix="gateway-demo-"))
        self.memory = self._folder / "faults.sqlite"
        self._socket: StatusSocket | None = None
        self._page: PageProcess | None = None

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the page, and remove the demo's files."""
        self.end()
        shutil.rmtree(self._folder, ignore_errors=True)

    def begin(self, gateway: Gateway, player: Player) -> None:
        """Open the page, and wait until it is there.

        Raises:
            GatewayError: it has ended, and has said why.
        """
        gateway.engine.warm()  # kernels are compiled before anybody looks
        self._truth, self._scenario = TruthReader(player), player.scenario
        self._socket = StatusSocket(self._folder / "status", gateway, lambda: _states(gateway))
        gateway.listen(self._socket.report)
        self._page = PageProcess(self._folder / "status", self._port, open_page=self._open)
        limit = time.monotonic() + PATIENCE_S
        while not self.stop() and time.monotonic() < limit:
            if self._socket.listening():
                limit = min(limit, time.monotonic() + LOOK_S)
            self._turn()
            if self._page.ended:
                raise GatewayError("the page did not begin (see above): name another port, as --port 0")

    def _turn(self) -> None:
        if self._socket is not None:
            self._socket.turn(time.monotonic())
        time.sleep(0.01)

    def on_frames(self, frames: Frames) -> None:
        """Count frames, and tell what was injected before the gateway can have seen it."""
        if self._socket is None or not len(frames):
            return
        self._socket.on_frames(frames)
        for fact in self._truth.until(int(frames["t_ns"][-1])):
            self._socket.report({"event": "injected", "t_ns": fact.t_ns, "text": injected(fact, self._scenario)})

    def on_step(self, _: int) -> None:
        """Serve the page."""
        if self._socket is not None:
            self._socket.turn(time.monotonic())

    def stay(self, ended: str) -> None:
        """Serve the page until told to stop.

        Args:
            ended: words of the page about the scenario, which is over.
        """
        if self._socket is not None:
            self._socket.end(ended)
        say("the scenario is over; the page stays until Ctrl-C")
        while not self.stop() and self._page is not None and not self._page.ended:
            self._turn()

    def end(self) -> None:
        """End the page."""
        if self._page is not None:
            self._page.close()
            self._page = None
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _states(gateway: Gateway) -> list[dict[str, object]]:
    return [{"bus": bus.name, "uri": "in this process", "state": "open"} for bus in gateway.config.bus]
