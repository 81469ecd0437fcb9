"""The daemon: one configuration after another on the same buses and the same fault memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gateway.bus.ring import Ring
from gateway.config.load import load_config
from gateway.config.model import Config, StatusConfig
from gateway.faults.kept import KeptStore
from gateway.live.doors import Doors
from gateway.live.link import Link
from gateway.live.loop import GRACE_NS, Live, Tap, bus_event
from gateway.live.machine import Machine
from gateway.live.notify import Notifier
from gateway.live.reload import Prepared, Reloader
from gateway.live.report_socket import ReportSocket
from gateway.live.status import StatusSocket
from gateway.live.watchdog import Watchdog
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import GatewayError, InputError

log = get_logger(__name__)


#: A reload that has taken this time may take longer than a tester waits (P2, 50 ms): it gets 0x78 (wait) [s].
SOON_S = 0.0125


class Daemon:
    """Everything that ``gateway run`` runs.

    Args:
        path: of the configuration.
        bus: URI instead of the configured one.
        memory: fault memory instead of the configured one.
        tell: takes the events of the JSON contract.
        taps: take every frame besides the configured recording.
        notifier: the service manager.
        machine: clocks, buses and threads; its clock gets the configured tolerance.
        on_built: called when everything is compiled, and nothing has been opened or written yet.
        status: status socket instead of the configured one.
        asked: returns whether the process was asked to end, even while no handler of Python can run.

    Attributes:
        status: that socket, if there is one.
        gateway: that runs now.

    Raises:
        InputError, InputErrors: a wrong configuration.
        UnsupportedError: a kind of bus that this system does not have.
    """

    def __init__(
        self,
        path: Path,
        *,
        bus: str | None = None,
        memory: Path | None = None,
        tell: Callable[[dict[str, Any]], None],
        taps: Sequence[Tap] = (),
        notifier: Notifier | None = None,
        machine: Machine | None = None,
        on_built: Callable[[], None] = lambda: None,
        status: Path | None = None,
        asked: Callable[[], bool] = lambda: False,
    ) -> None:
        self._path, self._bus, self._memory = path, bus, memory
        self._listener, self._given_taps = tell, list(taps)
        self.status: StatusSocket | None = None
        self._doors = Doors()
        self._reports: ReportSocket | None = None
        self._notifier = notifier or Notifier({})
        self._watchdog = Watchdog(lambda: self.gateway.engine, lambda: self.gateway.store.path, asked=asked)
        config = self._load()
        self._machine = machine or Machine()
        self._clock = self._machine.clock
        self._clock.tolerance_ns = _tolerance_ns(config)
        self._ring: Ring | None = None
        self.reloader = Reloader(self._prepare, self._machine.begin_thread)
        parts = prepare(config, path)
        parts.engine.warm()
        on_built()
        store = KeptStore(memory or config.memory.path, connect=self._machine.connect, displacing=True)
        gateway = Gateway(config, file=path, parts=parts, store=store)
        gateway.listen(self._tell)
        if self._machine.begin_writer is not None:
            gateway.write_beside(self._machine.begin_writer(), self._machine.patience_s)
        self.gateway = gateway
        links: list[Link] = []
        try:
            self._ring = self._new_ring(config)
            for index, entry in enumerate(config.bus):
                links.append(self._new_link(entry.uri, index, entry.name))
                links[-1].start()
            self.status = self._new_status(config, status, gateway, links)
            if self.status is not None:
                self._doors.add(self.status)
            self._replace_reports(self._new_reports(config, gateway))
            gateway.start(self._clock.now())
            self._live = Live(
                gateway,
                links,
                self._tell,
                taps=self._taps(),
                clock=self._clock,
                tick_s=self._machine.tick_s,
                monotonic=self._machine.monotonic,
                settle=self._machine.settle,
                door=self._doors,
            )
        except BaseException:
            for door in (self.status, self._reports):
                if door is not None:
                    door.close()
            self._doors.close()
            for link in links:
                link.close()
            gateway.close()
            raise

    def _tell(self, event: dict[str, Any]) -> None:
        self._listener(event)
        if self.status is not None:
            self.status.tell(event)

    def _new_status(
        self, config: Config, path: Path | None, gateway: Gateway, links: Sequence[Link]
    ) -> StatusSocket | None:
        if path is None and config.status is None:
            return None
        settings = config.status or StatusConfig(socket=path or Path())
        place = path or settings.socket
        return StatusSocket(place, gateway, self._bus_states, readers=settings.readers)

    def _new_reports(self, config: Config, gateway: Gateway) -> ReportSocket | None:
        """Return the report socket of a configuration: the one that there is, if it fits."""
        before = self._reports
        if config.report is None or (before is not None and before.fits(config.report)):
            return None if config.report is None else before
        return ReportSocket(config.report, gateway)

    def _replace_reports(self, new: ReportSocket | None) -> None:
        if new is self._reports:
            return
        if self._reports is not None:
            self._doors.remove(self._reports)
            self._reports.close()
        if new is not None:
            self._doors.add(new)
        self._reports = new

    def _bus_states(self) -> list[dict[str, Any]]:
        return self._live.bus_states()

    def describe(self) -> str:
        """Return in one line what is monitored."""
        uris = ", ".join(link.uri for link in self._live.links)
        return f"{self.gateway.config.name}: monitoring {uris}"

    def run(self, stop: Callable[[], bool]) -> None:
        """Monitor until told to stop; then the operation cycle has ended and everything is kept."""
        self._notifier.ready(self.describe())
        self._watchdog.begin()
        try:
            self._live.run(stop, on_turn=self._on_turn)
        finally:
            self._notifier.stopping()
        self._live.drain()
        gateway = self.gateway
        gateway.advance(self._clock.now() - GRACE_NS)
        self._live.keep()
        gateway.stop(gateway.engine.now_ns)
        for link in self._live.links:
            t_ns = gateway.engine.wall_ns(gateway.engine.now_ns)
            self._tell(bus_event(link, "closed", t_ns))
        if self.status is not None:
            self.status.turn(self._machine.monotonic())

    def close(self) -> None:
        """Close buses, recording, status socket and fault memory."""
        self._watchdog.end()
        for door in (self.status, self._reports):
            if door is not None:
                door.close()
        self._doors.close()
        self._live.close()
        for link in self._live.links:
            link.close()
        if self._ring is not None:
            self._ring.close()
        self.gateway.close()
        self._notifier.close()

    def _load(self) -> Config:
        config = load_config(self._path)
        if self._bus is None:
            return config
        if len(config.bus) > 1:
            raise InputError("the configuration has several buses; set their URIs there", value=self._bus)
        (entry,) = config.bus
        return config.model_copy(update={"bus": (entry.model_copy(update={"uri": self._bus}),)})

    def _new_link(self, uri: str, index: int, name: str) -> Link:
        machine = self._machine
        return Link(uri, index, name, machine.open_bus, machine.clock, monotonic=machine.monotonic)

    def _new_ring(self, config: Config) -> Ring | None:
        if config.record is None:
            return None
        return Ring(config.record, {k: bus.channel for k, bus in enumerate(config.bus)})

    def _taps(self) -> list[Tap]:
        return [*self._given_taps, *([] if self._ring is None else [self._ring])]

    # Another configuration

    def _on_turn(self) -> None:
        self._notifier.alive()
        if self.reloader.begin():
            self._notifier.reloading()
        if self.gateway.writing:
            return  # a change reads the file; until the thread is done, even with a slow disk, all goes on
        found = self.reloader.take()
        if found is None:
            return
        try:
            if isinstance(found, GatewayError):
                raise found
            self._change(found)
        except GatewayError as error:
            log.error("new configuration refused", file=str(self._path), error=str(error))
            self._tell_config("refused", str(error))
        else:
            log.info("new configuration", file=str(self._path))
            self._tell_config("reloaded", "")
        self._notifier.ready(self.describe())

    def _tell_config(self, state: str, reason: str) -> None:
        self._tell(
            {
                "event": "config",
                "t_ns": self._clock.wall(),
                "file": str(self._path),
                "state": state,
                "reason": reason,
            }
        )

    def _prepare(self) -> Prepared:
        config = self._load()
        running = self.gateway.config.memory.path
        if self._memory is None and config.memory.path != running:
            raise InputError(
                f"the fault memory cannot change while the gateway runs ({running}); restart it",
                file=self._path,
                key="memory.path",
                value=str(config.memory.path),
            )
        parts = prepare(config, self._path)
        parts.engine.warm()  # the loop's thread compiles nothing
        return Prepared(config, parts)

    def _change(self, new: Prepared) -> None:
        """Go on with another configuration; one that cannot be built or opened changes nothing.

        The order matters. Opening may take long, and frames that come meanwhile are for the old gateway: all are fed
        before the new one reads the fault memory. From there to the end nothing is fed to anybody; frames wait in the
        queues of the buses.
        """
        old = self.gateway
        kept = {link.uri: link for link in self._live.links}
        links: list[Link] = []
        opened: list[Link] = []
        ring, reports = self._ring, self._reports
        channels = [bus.channel for bus in new.config.bus]
        same = [bus.channel for bus in old.config.bus] == channels
        try:
            if new.config.record != old.config.record or not same:
                ring = self._new_ring(new.config)
            for index, entry in enumerate(new.config.bus):
                link = kept.pop(entry.uri, None)
                if link is None:
                    link = self._new_link(entry.uri, index, entry.name)
                    opened.append(link)
                    link.start()
                links.append(link)
            reports = self._new_reports(new.config, old)
            self._live.drain()
            self._live.finish()
            began_s = self._machine.monotonic()
            gateway = Gateway(new.config, file=self._path, parts=new.parts, store=old.store)
            if self._machine.monotonic() - began_s >= SOON_S:
                self._live.hold()
        except GatewayError:
            old.go_on()
            for link in opened:
                link.close()
            if reports is not None and reports is not self._reports:
                reports.close()
            raise
        gateway.succeed(old)
        self.gateway = gateway
        self._clock.tolerance_ns = _tolerance_ns(new.config)
        for index, (link, entry) in enumerate(zip(links, new.config.bus, strict=True)):
            link.index, link.name = index, entry.name
        if ring is not self._ring:
            if self._ring is not None:
                self._ring.close()
            self._ring = ring
        if self.status is not None:
            self.status.replace(gateway)
        self._replace_reports(reports)
        if self._reports is not None and new.config.report is not None:
            self._reports.replace(gateway, new.config.report)
        self._live.replace(gateway, links, self._taps())
        for link in kept.values():
            link.close()


def _tolerance_ns(config: Config) -> int:
    return round(config.clock.tolerance_ms * 1e6)
