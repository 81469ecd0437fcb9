"""The parts of a gateway, connected: frames go in, verdicts go on, events and frames come out."""

from __future__ import annotations

from pathlib import Path

from gateway.common.calls import CALLS
from gateway.common.fence import Fence
from gateway.common.gc_pause import gc_paused
from gateway.config.model import Config
from gateway.engine.depends.derive import Dependences
from gateway.faults.memory import FaultMemory
from gateway.faults.recorder import Recorder
from gateway.faults.resilient_store import ResilientStore
from gateway.runtime.assemble import Parts, asking_of, connect_routes, identifiers_of, prepare, servers_of
from gateway.runtime.controls import Controls
from gateway.runtime.diagnosis import DIAGNOSIS, Diagnosis
from gateway.runtime.disabled_monitors import DisabledMonitors
from gateway.runtime.exception_events import ExceptionEvents
from gateway.runtime.failing_rules import FailingRules
from gateway.runtime.input_stage import InputStage
from gateway.runtime.interventions import Interventions
from gateway.runtime.monitoring_off_dtc import MonitoringOffDtc
from gateway.runtime.outbox import Outbox
from gateway.runtime.proofs import Proofs
from gateway.runtime.reports import REPORTS, Reports
from gateway.runtime.restart_dtc import RestartDtc
from gateway.runtime.security import Security
from gateway.runtime.security_events import SecurityEvents
from gateway.runtime.suspicions import Suspicions
from gateway.runtime.usage_meter import UsageMeter
from gateway.runtime.verdicts import Verdicts
from gateway.servers.access import signals_of
from gateway.servers.authority import Authority
from gateway.servers.bus_servers import BusServers
from gateway.servers.dtc_frame import DtcFrameSender
from gateway.servers.local import LocalServer
from gateway_fdi.errors import InputError


class Composition:
    """Engine, fault memory, servers and clients of one configuration, and the links between them.

    Args:
        config: the configuration.
        memory_path: SQLite file of the fault memory; None keeps it in this process only.
        file: where the configuration came from, for errors.
        parts: of this configuration, when they are there already (see :func:`prepare`).
        store: an open fault memory to go on with, instead of ``memory_path``.
        lasting: whether batches are not written to after they were fed, as those of a log: they can be kept as they
            are.
        fence: counts exceptions that come from outside; None: one of its own.

    Raises:
        InputError, InputErrors: a database, message, signal or fault that is wrong.
    """

    @gc_paused()
    def __init__(
        self,
        config: Config,
        memory_path: str | Path | None = None,
        *,
        file: Path | None = None,
        parts: Parts | None = None,
        store: ResilientStore | None = None,
        lasting: bool = False,
        fence: Fence | None = None,
    ) -> None:
        self.config = config
        self.fence = fence or Fence()
        self.parts: Parts = prepare(config, file) if parts is None else parts
        self.engine, self.catalogue = self.parts.engine, self.parts.catalogue
        self.store = ResilientStore(None if memory_path is None else Path(memory_path)) if store is None else store
        self._closed = False
        recording = config.memory.recording
        names = tuple(bus.name for bus in config.bus)
        self._recorder = None if recording is None else Recorder(recording, names, lasting=lasting)
        self.memory = FaultMemory(
            self.catalogue,
            self.store,
            size=config.memory.entries,
            recordings=1 if recording is None else recording.most_per_fault,
            statistics=self.engine.fold_statistics,
            usage=config.usage,
            ahead=config.memory.tell == "first",
            fleet=config.fleet,
        )
        self.controls = Controls(
            self.engine,
            self.memory,
            self.store,
            self._recorder,
            self.parts.slots,
            round(config.access.stale_ms * 1e6),
            live=self.parts.live,
        )
        local = config.access.local_unlocked
        self.authority = Authority(config.needs, self.controls, local_unlocked=local)
        self._standing = MonitoringOffDtc(self.engine, self.controls, told=self.store.path is None)
        self._meter = UsageMeter(config.usage, self.memory, self.controls, round(config.access.stale_ms * 1e6))
        self.identifiers = identifiers_of(config, self.parts, self.memory, self.controls)
        self.asking = asking_of(config, self.parts, self.controls, self._may_ask, self.fence)
        servers = servers_of(config, self.parts, self.memory, self.authority, self.identifiers)
        told = self.asking.memory_server(config, self.memory, self.engine)
        servers += [] if told is None else [told]
        self.servers = BusServers(servers, len(config.buses), lambda: self.controls.send, self.fence)
        self.local = next(each for each in servers if isinstance(each, LocalServer))
        self._dtc_frames = next((each for each in servers if isinstance(each, DtcFrameSender)), None)
        connect_routes(self.servers, self.asking)
        self._heard = self.servers.heard.also(self.asking.heard)
        self._connect()

    def _may_ask(self, bus: int) -> bool:
        """Return whether other ECUs of a bus may be asked now: it is neither dead nor asleep, and we may send."""
        awake = self.config.power.awake
        return (
            self.controls.send
            and self.engine.bus_lives(bus)
            and (not awake or any(self.controls.met_so_far(condition) for condition in awake))
        )

    def _connect(self) -> None:
        """Make the links between the parts: frames in, verdicts, events and frames out."""
        self._off = DisabledMonitors(self.engine)
        self._restarted = RestartDtc(self.engine, self.memory, self.store.path)
        first, send = self.config.memory.tell == "first", self.servers.on_changes
        own = (self._off.report, self._restarted.report)
        self._outbox = Outbox(self.memory, self.store, self.engine, own, send, first=first)
        self._upkeep = self._outbox.upkeep
        names = [bus.name for bus in self.config.buses]
        self._doubts = FailingRules(self.engine, self.parts.checks, self.parts.databases, names, self._outbox.report)
        self._proofs = Proofs(self.engine, self.memory)
        self.security = Security(self._outbox.report)
        checks = {check.name for check in self.parts.checks}
        self._strangers = SecurityEvents(self.engine, names, checks, self.security)
        self._suspicions = Suspicions(self.engine, self.security.note)
        parts = self.parts
        known = Dependences(dict(parts.depends), dict(parts.residuals), parts.behind)
        self._diagnosis = self._new_diagnosis(known)
        self._verdicts = Verdicts(
            self.config,
            self.parts,
            self.memory,
            self.controls,
            self._recorder,
            self._outbox,
            self._off,
            self._doubts,
            self._diagnosis,
            self._strangers,
        )
        self._diagnosis.connect(self._verdicts.note_changes)
        self.asking.connect(self._outbox.note, self._verdicts.take)
        judged = [self.parts.slots[name] for name in signals_of(self.config.needs)]
        self._reception = InputStage(self.engine, self.controls, self._meter, judged, self._verdicts.take)
        self._interventions = Interventions(
            self.engine,
            self.memory,
            self._outbox,
            self._verdicts,
            self.controls,
            self.authority,
            self._standing,
            (self._off, self._restarted),
        )
        self.controls.connect(self._interventions)
        self._caught = ExceptionEvents(self.fence, self.engine, self.security, self._verdicts.take, self.memory.status)
        self.reports = self._new_reports()

    def _new_diagnosis(self, known: Dependences) -> Diagnosis:
        """Return what finds causes, by the package that does.

        Raises:
            InputError: symptoms are to be held, and no package finds causes.
        """
        hold = self.config.memory.symptoms == "hold"
        if DIAGNOSIS in CALLS:
            made: Diagnosis = CALLS[DIAGNOSIS](
                self.engine, self.memory, known, self.parts.checks, hold=hold, note=self._outbox.note
            )
            return made
        if hold:
            raise InputError("no installed package finds causes", key="memory.symptoms", value="hold")
        return Diagnosis()

    def _new_reports(self) -> Reports:
        """Return what takes test results of other processes, by the package that does.

        Raises:
            InputError: no package does, and there are reporters.
        """
        params = self.config.report
        if params is None:
            return Reports()
        if REPORTS not in CALLS:
            raise InputError("no installed package takes reports", key="report")
        made: Reports = CALLS[REPORTS](params, self.engine, self.controls, self._verdicts.take, self._outbox.report)
        return made
