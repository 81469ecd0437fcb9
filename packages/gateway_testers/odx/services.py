"""The services of the UDS server as this configuration has them, each with its request and its answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gateway.faults.dtc import ALL_DTCS
from gateway.faults.settings import ConditionSettings
from gateway.servers.uds.context import ANY_SESSION, Context, Service
from gateway.servers.uds.services import SERVICES
from gateway.servers.uds.services.x11_ecu_reset import HARD, KEY_OFF_ON, SOFT
from gateway.servers.uds.services.x31_routine_control import COMPACT, RESTART_CYCLE, RESULTS, START
from gateway_testers.odx.data import SESSION_NAMES, Data, Served
from gateway_testers.odx.dictionary import Param, const, value
from gateway_testers.odx.layer import Layer, Needed
from gateway_testers.odx.reports import Reports, SubFunction
from gateway_testers.odx.xml import short

_SESSION, _SECURITY, _LOCKED = "Session", "SecurityAccess", "Locked"


def charts(c: Context) -> dict[str, list[str]]:
    """Return the states that services need: of sessions and of security."""
    levels = {_SECURITY: [_LOCKED, *map(_level, c.security.levels)]} if c.security.levels else {}
    return {_SESSION: list(SESSION_NAMES.values()), **levels}


def _level(level: int) -> str:
    return f"Level_{level}"


def add_services(layer: Layer, served: Served) -> None:
    """Add all services that the configuration offers."""
    made = _Services(layer, served)
    for service in SERVICES.values():
        if service.offered(served.context):
            made.add_all(service)


class _Services:
    """Adds services to a layer."""

    def __init__(self, layer: Layer, served: Served) -> None:
        self._layer, self._dictionary, self._c = layer, layer.dictionary, served.context
        self._data = Data(layer.dictionary, served)
        self._reports = Reports(layer.dictionary, served, self._data)

    def add_all(self, service: Service) -> None:
        """Add a service: each of its sub-functions, identifiers or routines."""
        special = {
            0x14: self._clear,
            0x19: self._report,
            0x22: self._read,
            0x2E: self._write,
            0x31: self._routines,
        }.get(service.sid, self._sub_functions)
        special(service)

    def _sub_functions(self, service: Service) -> None:
        known = self._layouts(service.sid)
        assert service.sub_functions is not None
        for number in sorted(service.sub_functions(self._c)):
            layout = known.get(number, SubFunction(f"{service.name}_{number:02X}"))
            self._add(service, layout, sub=number, leads=self._leads(service.sid, number))

    def _add(
        self,
        service: Service,
        layout: SubFunction,
        *,
        sub: int | None = None,
        leads: Sequence[tuple[str, str]] = (),
        semantic: str = "",
        long: str = "",
    ) -> None:
        own = [] if sub is None else [const("SubFunction", sub, semantic="SUBFUNCTION")]
        self._layer.service(
            short(layout.name),
            service.sid,
            [*own, *layout.request],
            [*own, *layout.response],
            self._needed(service, sub, leads),
            semantic=semantic or service.name.upper(),
            long=long,
        )

    def _needed(self, service: Service, sub: int | None, leads: Sequence[tuple[str, str]]) -> Needed:
        undoing = sub is not None and service.undoes(bytes([service.sid, sub]))
        need = self._c.authority.need(service.action, undoing=undoing)
        allowed = set(service.sessions) & need.sessions
        if sub is not None and service.sub_functions is not None:
            allowed &= set(service.sub_functions(self._c).get(sub, ANY_SESSION))
        states = {} if allowed == ANY_SESSION else {_SESSION: [SESSION_NAMES[each] for each in sorted(allowed)]}
        if need.security:
            states[_SECURITY] = [_level(need.security)]
        says = [f"needs the role {' or '.join(sorted(need.roles))} (0x29)"] if need.roles else []
        says += ["only while " + " and ".join(map(_range, need.when))] if need.when else []
        return Needed(states, leads, "; ".join(says))

    def _leads(self, sid: int, number: int) -> list[tuple[str, str]]:
        """Return the states that a sub-function leads to."""
        locked = [(_SECURITY, _LOCKED)] if self._c.security.levels else []
        if sid == 0x10:
            return [(_SESSION, SESSION_NAMES[number]), *locked]
        if sid == 0x11:
            return [(_SESSION, next(iter(SESSION_NAMES.values()))), *locked]
        return [(_SECURITY, _level(number // 2))] if sid == 0x27 and number % 2 == 0 else []

    def _layouts(self, sid: int) -> Mapping[int, SubFunction]:
        """Return the sub-functions of a service."""
        made = {0x10: self._sessions, 0x27: self._security, 0x28: self._communication, 0x29: self._authentication}
        if sid in made:
            return made[sid]()
        if sid == 0x86:
            return self._events()
        names = {
            0x11: {HARD: "hardReset", KEY_OFF_ON: "keyOffOnReset", SOFT: "softReset"},
            0x3E: {0x00: "TesterPresent"},
            0x85: {0x01: "DTCSettingOn", 0x02: "DTCSettingOff"},
        }
        return {number: SubFunction(name) for number, name in names.get(sid, {}).items()}

    def _sessions(self) -> dict[int, SubFunction]:
        number = self._dictionary.number
        p2 = [value("P2_max", number("H", unit="ms")), value("P2_star_max", number("H", scale=10.0, unit="ms"))]
        return {k: SubFunction(f"{name}Session", [], p2) for k, name in SESSION_NAMES.items()}

    def _security(self) -> dict[int, SubFunction]:
        made, key = {}, value("key", self._dictionary.data(None))
        for entry in self._c.params.security:
            seed, name = value("seed", self._dictionary.data(entry.seed_length)), _level(entry.level)
            made[2 * entry.level - 1] = SubFunction(f"RequestSeed_{name}", [], [seed])
            made[2 * entry.level] = SubFunction(f"SendKey_{name}", [key], [])
        return made

    def _communication(self) -> dict[int, SubFunction]:
        kinds = {1: "normal messages", 2: "network management", 3: "both"}
        kind = value("CommunicationType", self._dictionary.number("B", texts=kinds))
        names = ("enableRxAndTx", "enableRxAndDisableTx", "disableRxAndEnableTx", "disableRxAndTx")
        return {k: SubFunction(name, [kind]) for k, name in enumerate(names)}

    def _authentication(self) -> dict[int, SubFunction]:
        part, result = self._dictionary.data(None, length_bits=16), value("Result", self._dictionary.number("B"))

        def parts(*names: str) -> list[Param]:
            return [value(name, part) for name in names]

        shown = [const("Configuration", 0), *parts("certificate", "challenge")]
        return {
            0x00: SubFunction("deAuthenticate", [], [result]),
            0x01: SubFunction("verifyCertificateUnidirectional", shown, [result, *parts("challenge", "publicKey")]),
            0x03: SubFunction("proofOfOwnership", parts("proof", "publicKey"), [result, *parts("sessionKey")]),
            0x08: SubFunction("authenticationConfiguration", [], [result]),
        }

    def _events(self) -> dict[int, SubFunction]:
        byte, more = self._dictionary.number("B"), self._dictionary.data(None)
        window, events = value("EventWindow", byte), value("Events", byte)
        asked = [window, value("StatusMask", byte), value("ServiceToRespondTo", more)]
        names = {0x00: "stopResponseOnEvent", 0x05: "startResponseOnEvent", 0x06: "clearResponseOnEvent"}
        return {
            **{k: SubFunction(name, [window], [events, window]) for k, name in names.items()},
            0x01: SubFunction("onDTCStatusChange", asked, [events, *asked]),
            0x04: SubFunction("reportActivatedEvents", [window], [events, value("activated", more)]),
        }

    def _clear(self, service: Service) -> None:
        group = value("GroupOfDTC", self._dictionary.number("I", bits=24), default=ALL_DTCS)
        self._add(service, SubFunction(service.name, [group]))

    def _report(self, service: Service) -> None:
        for number, report in self._reports.all():
            self._add(service, report, sub=number)
        for report in self._reports.by_record():
            self._add(service, report, sub=0x16)

    def _read(self, service: Service) -> None:
        for number, found in self._data.identifiers().items():
            which = const("Identifier", number, 2, "ID")
            layout = SubFunction(f"Read_{found.name}", [which], [which, *found.params])
            self._add(service, layout, semantic="CURRENTDATA", long=found.signal)

    def _write(self, service: Service) -> None:
        for number, did in sorted(self._c.identifiers.table.items()):
            if did.writable:
                which = const("Identifier", number, 2, "ID")
                layout = SubFunction(f"Write_{did.name}", [which, *self._data.of_did(did)], [which])
                self._add(service, layout, semantic="STOREDDATA")

    def _routines(self, service: Service) -> None:
        for routine, name in ((RESTART_CYCLE, "RestartCycle"), (COMPACT, "CompactMemory")):
            which, done = const("Routine", routine, 2, "ID"), value("result", self._dictionary.number("B"))
            for number, verb in ((START, "Start"), (RESULTS, "Results")):
                self._add(
                    service, SubFunction(f"{verb}_{name}", [which], [which, done]), sub=number, semantic="ROUTINE"
                )


def _range(condition: ConditionSettings) -> str:
    low, high = ("" if end is None else f"{end:g}" for end in (condition.min, condition.max))
    return f"{low}{' <= ' * bool(low)}{condition.signal}{' <= ' * bool(high)}{high}"
