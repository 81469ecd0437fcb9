"""Composition root: a configuration becomes a running gateway.

Only this module knows every part. :class:`Gateway` does no waiting and reads no clock: frames and
time go in, events and frames come out. ``gateway run``, ``gateway replay``, ``gateway demo`` and the
tests all drive this same class.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from cantools.database.can import Message

from gateway.bus.frames import Frames
from gateway.config import Config, MonitorConfig, monitor_of
from gateway.engine.build import CheckInstance, MonitorInstance, build_engine
from gateway.engine.core import Engine
from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED, Events
from gateway.errors import InputError, InputErrors
from gateway.faults.catalogue import Catalogue, FaultDefinition, debounce_of, define
from gateway.faults.memory import DtcChange, FaultMemory
from gateway.faults.store import Store
from gateway.monitors.shape import FAILED, PASSED, Monitor, MonitorParams
from gateway.outputs.dtc_frame import DtcFrameOutput, message_of
from gateway.resources import shipped
from gateway.signals.database import Database, load_database
from gateway.signals.tables import SignalRef

#: Takes one event of the JSON contract.
Listener = Callable[[dict[str, Any]], None]

#: Databases of messages that the gateway itself sends.
OWN_DATABASES = ("dbc/gateway.dbc", "dbc/pedal.dbc")

_RESULTS = {PASSED: "passed", FAILED: "failed"}


def load_databases(config: Config, file: Path | None = None) -> list[tuple[int, Database]]:
    """Load the databases of every bus.

    Raises:
        InputErrors: every database that cannot be loaded.
    """
    loaded, wrong = [], []
    for index, bus in enumerate(config.bus):
        try:
            loaded.append((index, load_database(bus.database)))
        except InputError as error:
            wrong.append(error)
        except InputErrors as errors:
            wrong += errors.errors
    if wrong:
        raise InputErrors(wrong)
    return loaded


def _signal_ref(config: Config, name: str, bus: int) -> SignalRef:
    """Read ``Bus.Message.Signal``, or ``Message.Signal`` on a given bus."""
    parts = name.split(".")
    if len(parts) == 3:
        return SignalRef(config.bus_index(parts[0]), parts[1], parts[2])
    if len(parts) == 2:
        return SignalRef(bus, parts[0], parts[1])
    raise InputError('a signal is named "Message.Signal" or "bus.Message.Signal"', value=name)


class Gateway:
    """Engine, fault memory and outputs of one configuration.

    Args:
        config: the configuration.
        memory_path: SQLite file of the fault memory; None keeps it in this process only.
        file: where the configuration came from, for errors.

    Raises:
        InputError, InputErrors: a database, message, signal or fault that is wrong.
    """

    def __init__(
        self, config: Config, memory_path: Path | None = None, *, file: Path | None = None
    ) -> None:
        self.config = config
        try:
            self.databases = load_databases(config)
            self.engine, self.catalogue, self._frozen = _assemble(config, self.databases)
        except InputError as error:
            raise error.within(file) from error
        except InputErrors as errors:
            raise InputErrors([error.within(file) for error in errors.errors]) from errors
        self.engine.warm()
        self._index = {definition.id: k for k, definition in enumerate(self.catalogue)}
        self.store = Store(memory_path)
        self.memory = FaultMemory(self.catalogue, self.store)
        frame = config.output.dtc_frame
        self._dtc_frame = (
            None
            if frame is None
            else DtcFrameOutput(
                frame,
                shipped("dbc/gateway.dbc"),
                config.bus_index(frame.bus),
                self._fault_detection_counter,
            )
        )
        self._listeners: list[Listener] = []
        self._changes: list[DtcChange] = []
        self._uncommitted = False
        self.event_count = 0

    def _fault_detection_counter(self, fault: str) -> int:
        index = self._index.get(fault)
        return 0 if index is None else self.engine.fault_detection_counter(index)

    def listen(self, listener: Listener) -> None:
        """Add a listener; it is called with each event of the JSON contract, in order."""
        self._listeners.append(listener)

    def start(self, t_ns: int) -> None:
        """Start an operation cycle."""
        self.memory.start_cycle(t_ns)
        self.engine.reset_debounce()

    def stop(self, t_ns: int) -> None:
        """End the operation cycle and keep everything."""
        self.memory.end_cycle(t_ns)
        self.memory.commit()

    def close(self) -> None:
        """Close the fault memory."""
        self.store.close()

    def feed(self, frames: Frames) -> Frames:
        """Take a batch of frames; returns the frames to send.

        What the returned frames say is in the fault memory before they are returned.
        """
        return self._outputs(self.engine.process(frames, self._on_events))

    def advance(self, t_ns: int) -> Frames:
        """Let time pass without frames; returns the frames to send."""
        return self._outputs(self.engine.advance(t_ns, self._on_events))

    @property
    def dtc_frame_id(self) -> int:
        """Identifier of the DTC frame."""
        return int(message_of(shipped("dbc/gateway.dbc")).frame_id)

    def serve_requests(self) -> None:
        """Do what other processes asked the fault memory for (``gateway faults clear``)."""
        cleared = self.memory.serve_requests()
        self.engine.reset_debounce(self._index[name] for name in cleared if name in self._index)

    def _on_events(self, events: Events) -> None:
        self.event_count += len(events)
        for event in events:
            if event["kind"] not in (QUALIFIED_FAILED, QUALIFIED_PASSED):
                self._tell(self._monitor_event(event))
                continue
            changes = self.memory.apply(events_of(event), self._snapshot)
            self._uncommitted = self._uncommitted or bool(changes)
            told = [change for change in changes if change.concerns_fault]
            self._changes += told
            for change in told:
                self._tell(self._dtc_event(change, int(event["bus"])))
            if not told:
                self._tell(self._monitor_event(event))

    def _outputs(self, sent: Frames) -> Frames:
        """Return the frames to send: the monitors' own, then what the fault memory has to say."""
        if self._uncommitted:
            self.memory.commit()
            self._uncommitted = False
        changes, self._changes = self._changes, []
        if self._dtc_frame is None:
            return sent
        now = self.engine.now_ns
        if not self._dtc_frame.due(changes, now):
            return sent
        return np.concatenate(
            [
                sent,
                self._dtc_frame.on_changes(changes, self.memory, now),
                self._dtc_frame.on_time(now, self.memory),
            ]
        )

    def _snapshot(self, definition: FaultDefinition) -> Mapping[str, float]:
        return {name: self.engine.value(slot) for name, slot in self._frozen[definition.id].items()}

    def _tell(self, event: dict[str, Any]) -> None:
        for listener in self._listeners:
            listener(event)

    def _monitor_event(self, event: np.void) -> dict[str, Any]:
        definition = self.catalogue[int(event["fault"])]
        return {
            "event": "monitor",
            "t_ns": int(event["t_ns"]),
            "bus": self.config.bus[int(event["bus"])].name,
            "fault": definition.id,
            "result": _RESULTS.get(int(event["result"]), "not tested"),
            "fdc": int(event["fdc"]),
            "value": float(event["value"]),
            "threshold": float(event["threshold"]),
        }

    def _dtc_event(self, change: DtcChange, bus: int) -> dict[str, Any]:
        return {
            "event": "dtc",
            "t_ns": change.t_ns,
            "bus": self.config.bus[bus].name,
            "fault": change.definition.id,
            "dtc": str(change.dtc),
            "status": int(change.new_status),
            "fdc": change.fdc,
            "occurrence": change.occurrence,
            "evidence": dict(change.evidence),
        }

    def summary(self, seconds: float) -> dict[str, Any]:
        """Return the last event of the JSON contract.

        Args:
            seconds: how long the work took by the caller's clock.
        """
        counters = self.engine.counters()
        return {
            "event": "summary",
            "frames": counters["frames"],
            "decoded": counters["decoded"],
            "events": self.event_count,
            "seconds": seconds,
            "frames_per_s": counters["frames"] / seconds if seconds > 0 else 0.0,
            "counters": counters,
            "monitors": self.engine.readout(),
            "dtcs": [str(entry.dtc) for entry in self.memory.entries()],
        }


def _frozen_refs(
    config: Config, fault: str, names: tuple[str, ...], databases: Mapping[int, Database]
) -> dict[str, SignalRef]:
    """Find the signals of a fault's freeze frame; errors name the key."""
    found = {}
    for k, name in enumerate(names):
        try:
            ref = _signal_ref(config, name, 0)
            databases[ref.bus].signal(ref.message, ref.signal)
        except InputError as error:
            raise InputError(
                error.message, key=f'fault."{fault}".freeze_frame[{k}]', value=name
            ) from error
        found[name] = ref
    return found


def _emission(
    entry: MonitorConfig, monitor: Monitor, params: MonitorParams, database: Database
) -> Message:
    """Find the message that a monitor sends: in its bus's database, else among the gateway's own.

    Raises:
        InputError: the monitor has nothing to send, or its message is nowhere.
    """
    key = f'monitor "{entry.name}".send'
    emission = monitor.emission_of(params)
    if emission is None:
        raise InputError(f"a {monitor.type} monitor has no message to send", key=key, value="true")
    name = entry.send if isinstance(entry.send, str) else emission.message
    for known in (database, *(load_database([shipped(file)]) for file in OWN_DATABASES)):
        if any(message.name == name for message in known):
            found = known.message(name)
            missing = set(emission.signals) - {signal.name for signal in found.signals}
            if missing:
                lacking = ", ".join(sorted(missing))
                raise InputError(f"this message has no {lacking}", key=key, value=name)
            return found
    raise InputError("no database has this message", key=key, value=name)


def events_of(event: np.void) -> Events:
    """Return one event as an array of one."""
    return np.asarray([event], dtype=event.dtype)


def _assemble(
    config: Config, databases: list[tuple[int, Database]]
) -> tuple[Engine, Catalogue, dict[str, dict[str, int]]]:
    """Build the engine, the catalogue in the engine's order, and each fault's frozen slots."""
    monitors = []
    for entry in config.monitor:
        monitor, params = monitor_of(entry)
        bus = config.bus_index(entry.bus)
        monitors.append(
            MonitorInstance(
                entry.name,
                monitor,
                params,
                bus,
                entry.priority,
                entry.signals,
                _emission(entry, monitor, params, dict(databases)[bus]) if entry.send else None,
            )
        )
    checks = [
        CheckInstance(check, index, f"{bus.name}.{check.message}")
        for index, bus in enumerate(config.bus)
        for check in bus.check
    ]
    frozen = {
        fault: _frozen_refs(config, fault, override.freeze_frame, dict(databases))
        for fault, override in config.fault.items()
    }
    engine = build_engine(
        databases,
        monitors,
        checks,
        debounce=lambda name, fault: debounce_of(fault, config.fault.get(name)),
        extra={ref for names in frozen.values() for ref in names.values()},
        pgn=[index for index, bus in enumerate(config.bus) if bus.match == "pgn"],
    )
    known = {slot.id for slot in engine.faults}
    unknown = [fault for fault in config.fault if fault not in known]
    if unknown:
        raise InputErrors(
            [
                InputError(
                    f"no monitor reports this fault; known: {', '.join(sorted(known))}",
                    key=f'fault."{fault}"',
                )
                for fault in unknown
            ]
        )
    catalogue = Catalogue(
        define(slot.id, slot.fault, config.fault.get(slot.id)) for slot in engine.faults
    )
    slots = {
        slot.id: {name: engine.plan.slot(*ref) for name, ref in frozen.get(slot.id, {}).items()}
        for slot in engine.faults
    }
    return engine, catalogue, slots
