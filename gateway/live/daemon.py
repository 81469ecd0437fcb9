"""The daemon: one configuration after another on the same buses and the same fault memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gateway.bus.ring import Ring
from gateway.common.calls import CALLS
from gateway.common.fence import Fence
from gateway.config.load import load_config
from gateway.config.model import Config, StatusConfig
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.restarts import WELL_S, Restart
from gateway.live.clock import Clock
from gateway.live.link import Link, bus_event
from gateway.live.listeners import STATUS_SOCKET, Listeners, StatusDoor, TableDoor
from gateway.live.loop import GRACE_NS, Live, Tap
from gateway.live.machine import Machine
from gateway.live.notify import Notifier
from gateway.live.reload import Prepared, Reloader
from gateway.live.watchdog import Watchdog
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway.runtime.reports import REPORT_SOCKET
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import GatewayError, InputError

log = get_logger(__name__)


#: A reload that has taken this time may take longer than a tester waits (P2, 50 ms): it gets 0x78 (wait) [s].
SOON_S = 0.0125
#: While it waits after restarts: how often it looks whether it is to end, and what the rest of a start may take [s].
LEAVING_S, START_S = 0.05, 60.0


class Daemon:
    """Everything that ``gateway run`` runs.

    Args:
        path: of the configuration.
        bus: URI instead of the configured one.
        memory: fault memory instead of the configured one.
        report: takes the events of the JSON contract.
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
        report: Callable[[dict[str, Any]], None],
        taps: Sequence[Tap] = (),
        notifier: Notifier | None = None,
        machine: Machine | None = None,
        on_built: Callable[[], None] = lambda: None,
        status: Path | None = None,
        asked: Callable[[], bool] = lambda: False,
    ) -> None:
        self._path, self._bus, self._memory = path, bus, memory
        self._listener, self._given_taps = report, list(taps)
        self.status: StatusDoor | None = None
        self._fence = Fence()
        self._doors = Listeners(self._fence)
        self._asked: dict[str, TableDoor] = {}
        self._notifier = notifier or Notifier({})
        self._leaving = asked
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
        store = ResilientStore(memory or config.memory.path, connect=self._machine.connect, displacing=True)
        gateway = Gateway(config, file=path, parts=parts, store=store, fence=self._fence)
        gateway.listen(self._report)
        if self._machine.begin_writer is not None:
            gateway.write_beside(self._machine.begin_writer(), self._machine.patience_s)
        self.gateway = gateway
        links: list[Link] = []
        try:
            self._wait_after(gateway.note_restart(self._clock.wall(), self._machine.boot()))
            self._ring = self._new_ring(config)
            for index, entry in enumerate(config.bus):
                links.append(self._new_link(entry.uri, index, entry.name))
                links[-1].start()
            self.status = self._new_status(config, status, gateway, links)
            if self.status is not None:
                self._doors.add(self.status)
            self._replace_doors(self._new_doors(config, gateway))
            gateway.start(self._clock.now())
            self._live = Live(
                gateway,
                links,
                self._report,
                taps=self._taps(),
                clock=self._clock,
                tick_s=self._machine.tick_s,
                monotonic=self._machine.monotonic,
                settle=self._machine.settle,
                door=self._doors,
                fence=self._fence,
            )
        except BaseException:
            self._close_doors()
            self._doors.close()
            for link in links:
                link.close()
            gateway.close()
            raise

    def _wait_after(self, restart: Restart | None) -> None:
        """Open nothing for a while if the gateway has died again and again; being asked to end ends it."""
        machine = self._machine
        self._well_s = machine.monotonic() + WELL_S
        if restart is None or not restart.wait_s:
            return
        text = f"{restart.in_a_row} restarts in a row without a stop: buses are opened in {restart.wait_s:.0f} s"
        log.warning(text, reason=restart.reason)
        self._notifier.waiting(text, restart.wait_s + START_S)
        end_s = machine.monotonic() + restart.wait_s
        while (left_s := end_s - machine.monotonic()) > 0 and not self._leaving():
            machine.sleep(min(left_s, LEAVING_S))
        self._well_s = machine.monotonic() + WELL_S

    def _report(self, event: dict[str, Any]) -> None:
        self._listener(event)
        if self.status is not None:
            self.status.report(event)

    def _new_status(
        self, config: Config, path: Path | None, gateway: Gateway, links: Sequence[Link]
    ) -> StatusDoor | None:
        if path is None and config.status is None:
            return None
        settings = config.status or StatusConfig(socket=path or Path())
        place = path or settings.socket
        made: StatusDoor = _of_package(STATUS_SOCKET, "status")(
            place, gateway, self._bus_states, readers=settings.readers
        )
        return made

    def _new_doors(self, config: Config, gateway: Gateway) -> dict[str, TableDoor]:
        """Return the doors that tables of a configuration ask for: those that there are, where they fit."""
        made: dict[str, TableDoor] = {}
        try:
            for name, (params, make) in _makers(config).items():
                before = self._asked.get(name)
                door = before if before is not None and before.fits(params) else make(params, gateway, self._clock)
                if door is not None:
                    made[name] = door
        except BaseException:
            self._close_new(made)
            raise
        return made

    def _close_new(self, made: dict[str, TableDoor]) -> None:
        for name, door in made.items():
            if door is not self._asked.get(name):
                door.close()

    def _replace_doors(self, new: dict[str, TableDoor]) -> None:
        for name, door in self._asked.items():
            if door is not new.get(name):
                self._doors.remove(door)
                door.close()
        for name, door in new.items():
            if door is not self._asked.get(name):
                self._doors.add(door)
        self._asked = new

    def _close_doors(self) -> None:
        for door in (self.status, *self._asked.values()):
            if door is not None:
                door.close()

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
            self._report(bus_event(link, "closed", t_ns))
        if self.status is not None:
            self.status.turn(self._machine.monotonic(), wanted=True)

    def close(self) -> None:
        """Close buses, recording, status socket and fault memory."""
        self._watchdog.end()
        self._close_doors()
        self._doors.close()
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
        return Link(
            uri, index, name, machine.open_bus, machine.clock, monotonic=machine.monotonic,
            before_close=self.gateway.store.settle_journal, wall=self._fence.wall("bus"),
        )  # fmt: skip

    def _new_ring(self, config: Config) -> Ring | None:
        if config.record is None:
            return None
        return Ring(config.record, {k: bus.channel for k, bus in enumerate(config.bus)})

    def _taps(self) -> list[Tap]:
        return [*self._given_taps, *([] if self._ring is None else [self._ring])]

    # Another configuration

    def _on_turn(self) -> None:
        self._notifier.alive()
        if self._machine.monotonic() >= self._well_s:
            self._well_s += WELL_S
            self.gateway.memory.restarts.went_well()
        if self.reloader.begin():
            self._notifier.reloading()
        if not self.reloader.ready:
            return
        # Frames go on; what they change waits, also in a storm and with a slow disk: a change reads the file.
        self.gateway.pause()
        if self.gateway.writing:
            return
        try:
            self._change(self.reloader.take())
        except GatewayError as error:
            self.gateway.go_on()
            log.error("new configuration refused", file=str(self._path), error=str(error))
            self._report_config("refused", str(error))
        else:
            log.info("new configuration", file=str(self._path))
            self._report_config("reloaded", "")
        self._notifier.ready(self.describe())

    def _report_config(self, state: str, reason: str) -> None:
        self._report(
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
        before the new one reads the fault memory, and the last write has ended, too. From there to the end nothing is
        fed to anybody; frames wait in the queues of the buses.
        """
        old = self.gateway
        kept = {link.uri: link for link in self._live.links}
        links: list[Link] = []
        opened: list[Link] = []
        ring, doors = self._ring, self._asked
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
            doors = self._new_doors(new.config, old)
            self._live.drain()
            self._live.finish()
            began_s = self._machine.monotonic()
            gateway = Gateway(new.config, file=self._path, parts=new.parts, store=old.store, fence=self._fence)
            if self._machine.monotonic() - began_s >= SOON_S:
                self._live.hold()
        except GatewayError:
            for link in opened:
                link.close()
            self._close_new(doors)
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
        self._replace_doors(doors)
        for name, (params, _) in _makers(new.config).items():
            if name in self._asked:
                self._asked[name].replace(gateway, params)
        self._live.replace(gateway, links, self._taps())
        for link in kept.values():
            link.close()


def _makers(config: Config) -> dict[str, tuple[Any, Callable[[Any, Gateway, Clock], TableDoor | None]]]:
    """Return the tables that can ask for a door, each with the function that makes it."""
    made: dict[str, tuple[Any, Callable[[Any, Gateway, Clock], TableDoor | None]]] = {
        name: (params, one.door) for name, (one, params) in config.output.sections.items()
    }
    if config.report is not None:
        make = _of_package(REPORT_SOCKET, "report")
        made["report"] = config.report, lambda params, gateway, _: make(params, gateway)
    return made


def _of_package(name: str, table: str) -> Callable[..., Any]:
    """Return a call of another package that a table needs.

    Raises:
        InputError: no package brings it.
    """
    if name not in CALLS:
        raise InputError("no installed package has this socket", key=table)
    return CALLS[name]


def _tolerance_ns(config: Config) -> int:
    return round(config.clock.tolerance_ms * 1e6)
