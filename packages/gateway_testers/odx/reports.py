"""Reports of 0x19: requests and answers of its sub-functions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from gateway.faults.explanation import HOLDS, ROLES
from gateway.faults.status import Status
from gateway.servers.uds.extended_data import EXTENDED_DATA
from gateway.servers.uds.intervention_memory import NUMBERS, SELECTION, dtc_of
from gateway_testers.odx.data import Data, Served
from gateway_testers.odx.dictionary import Dictionary, Param, const, value

#: Values of evidence beside those that a monitor names.
_ALWAYS = ("value", "threshold")


class SubFunction(NamedTuple):
    """A sub-function: its name, and what follows it in request and answer."""

    name: str
    request: Sequence[Param] = ()
    response: Sequence[Param] = ()


class Reports:
    """The reports of a gateway's fault memory, in a dictionary."""

    def __init__(self, dictionary: Dictionary, served: Served, data: Data) -> None:
        self._dictionary, self._served, self._data = dictionary, served, data
        self._catalogue = list(served.context.memory.catalogue)
        self._dtc = dictionary.dtcs(
            "DTC", [(each.dtc.value, str(each.dtc), f"{each.id}: {each.description}") for each in self._catalogue]
        )
        flag = dictionary.number("B", bits=1)
        bits = [value(bit.name or "", flag, bit=(0, k)) for k, bit in enumerate(Status)]
        self._status = dictionary.structure("Status", bits, size=1)
        self._of_dtc = [value("DTC", self._dtc), value("Status", self._status)]
        self._extended = self._extended_data()

    def all(self) -> Iterator[tuple[int, SubFunction]]:
        """Yield number and report of each."""
        yield from self._lists().items()
        yield from self._records().items()
        yield from self._user_memory().items()

    def _byte(self, name: str) -> Param:
        return value(name, self._dictionary.number("B"))

    def _lists(self) -> dict[int, SubFunction]:
        """Return the reports of numbers and lists of DTCs."""
        dictionary, byte = self._dictionary, self._byte
        mask, severity = byte("StatusMask"), byte("SeverityMask")
        group, readiness = byte("FunctionalGroup"), byte("ReadinessGroup")
        shown, kind = value("AvailabilityMask", self._status), byte("DTCFormat")
        count = [shown, kind, value("DTCCount", dictionary.number("H"))]
        severe = [byte("Severity"), byte("FunctionalUnit"), *self._of_dtc]
        listed = value("DTCs", dictionary.rest("DTCs", self._of_dtc))
        with_unit = value("DTCs", dictionary.rest("DTCs_with_severity", severe))
        graded = value("DTCs", dictionary.rest("DTCs_graded", [byte("Severity"), *self._of_dtc]))
        counters = dictionary.rest("DetectionCounters", [value("DTC", self._dtc), byte("FaultDetectionCounter")])
        wwh = [mask, severity]
        return {
            0x01: SubFunction("reportNumberOfDTCByStatusMask", [mask], count),
            0x02: SubFunction("reportDTCByStatusMask", [mask], [shown, listed]),
            0x07: SubFunction("reportNumberOfDTCBySeverityMaskRecord", [severity, mask], count),
            0x08: SubFunction("reportDTCBySeverityMaskRecord", [severity, mask], [shown, with_unit]),
            0x09: SubFunction("reportSeverityInformationOfDTC", [value("DTC", self._dtc)], [shown, *severe]),
            0x0A: SubFunction("reportSupportedDTC", [], [shown, listed]),
            0x0B: SubFunction("reportFirstTestFailedDTC", [], [shown, listed]),
            0x0C: SubFunction("reportFirstConfirmedDTC", [], [shown, listed]),
            0x0D: SubFunction("reportMostRecentTestFailedDTC", [], [shown, listed]),
            0x0E: SubFunction("reportMostRecentConfirmedDTC", [], [shown, listed]),
            0x14: SubFunction("reportDTCFaultDetectionCounter", [], [value("DTCs", counters)]),
            0x15: SubFunction("reportDTCWithPermanentStatus", [], [shown, listed]),
            0x1A: SubFunction(
                "reportDTCExtendedDataRecordIdentification",
                [byte("RecordNumber")],
                [shown, byte("RecordNumber"), listed],
            ),
            0x42: SubFunction("reportWWHOBDDTCByMaskRecord", [group, *wwh], [group, shown, severity, kind, graded]),
            0x55: SubFunction("reportWWHOBDDTCWithPermanentStatus", [group], [group, shown, kind, listed]),
            0x56: SubFunction(
                "reportDTCInformationByDTCReadinessGroupIdentifier",
                [group, readiness],
                [group, shown, kind, readiness, listed],
            ),
        }

    def _records(self) -> dict[int, SubFunction]:
        """Return the reports of snapshots and extended data."""
        dictionary, record, asked = self._dictionary, self._byte("RecordNumber"), value("DTC", self._dtc)
        snapshot = self._snapshot()
        snapshots = dictionary.rest("Snapshots", [record, *snapshot])
        stored = dictionary.rest("StoredData", [record, *self._of_dtc, *snapshot])
        numbered = dictionary.rest("SnapshotNumbers", [asked, record])
        cases = {
            n: (EXTENDED_DATA[n].name, dictionary.structure(EXTENDED_DATA[n].name, p))
            for n, p in self._extended.items()
        }
        records = dictionary.rest("ExtendedData", [value("record", dictionary.choice("ExtendedRecord", "B", cases))])
        return {
            0x03: SubFunction("reportDTCSnapshotIdentification", [], [value("records", numbered)]),
            0x04: SubFunction(
                "reportDTCSnapshotRecordByDTCNumber", [asked, record], [*self._of_dtc, value("records", snapshots)]
            ),
            0x05: SubFunction("reportDTCStoredDataByRecordNumber", [record], [value("records", stored)]),
            0x06: SubFunction(
                "reportDTCExtDataRecordByDTCNumber", [asked, record], [*self._of_dtc, value("records", records)]
            ),
        }

    def by_record(self) -> Iterator[SubFunction]:
        """Yield 0x16 of each record: its answer alone does not say how the record looks."""
        for number, params in self._extended.items():
            name, which = EXTENDED_DATA[number].name, const("RecordNumber", number)
            found = value("DTCs", self._dictionary.rest(f"{name}_of_DTCs", [*self._of_dtc, *params]))
            yield SubFunction(f"reportDTCExtDataRecordByRecordNumber_{name}", [which], [which, found])

    def _snapshot(self) -> list[Param]:
        """Return the content of a snapshot: identifiers with their data; without signals there is none."""
        cases = {
            number: (did.name, self._dictionary.structure(did.name, self._data.of_did(did)))
            for number, did in sorted(self._served.context.identifiers.table.items())
            if did.signal is not None
        }
        if not cases:
            return []
        which = value("identifier", self._dictionary.choice("Identified", "H", cases))
        return [value("data", self._dictionary.counted("Snapshot", [which]))]

    def _extended_data(self) -> dict[int, Sequence[Param]]:
        """Return the data of each extended data record, by its number."""
        dictionary, data = self._dictionary, self._data
        evidence = {each.dtc.value: data.numbers((*_ALWAYS, *each.evidence)) for each in self._catalogue}
        inputs = {each.dtc.value: data.numbers(self._served.inputs[each.id], signals=True) for each in self._catalogue}
        part = dictionary.counted("Components", [value("name", dictionary.data(None, text=True, length_bits=8))])
        of_cause = [value("probability", dictionary.number("H", scale=1e-4)), value("components", part)]
        varying = {
            "evidence": [value("evidence", dictionary.by_dtc("evidence", evidence))],
            "inputs": [value("inputs", dictionary.by_dtc("inputs", inputs))],
            "cause": [
                value("role", dictionary.number("B", texts=dict(enumerate(ROLES)))),
                value("confirmation", dictionary.number("B", texts=dict(enumerate(("as usual", *HOLDS[1:]))))),
                value("lead", dictionary.number("I", bits=24)),
                value("causes", dictionary.counted("Causes", of_cause)),
            ],
        }
        return {n: varying.get(kind.name) or data.coded(kind.name, kind.code) for n, kind in EXTENDED_DATA.items()}

    def _user_memory(self) -> dict[int, SubFunction]:
        """Return the reports of what testers did."""
        dictionary, data, trace = self._dictionary, self._data, self._served.context.trace_did
        if trace is None:
            return {}
        record, shown = self._byte("RecordNumber"), value("AvailabilityMask", self._status)
        known = {dtc_of(action): action for action in ("", *NUMBERS)}
        dtc = dictionary.dtcs(
            "Intervention", [(d.value, str(d), action or "other") for d, action in sorted(known.items())]
        )
        memory, of_dtc = const("Memory", SELECTION), [value("DTC", dtc), value("Status", self._status)]
        listed = value("DTCs", dictionary.rest("Interventions", of_dtc))
        each = dictionary.counted("InterventionRecord", [const("Identifier", trace, 2), *data.intervention()])
        records = value("records", dictionary.rest("InterventionRecords", [record, value("data", each)]))
        counted = {n: EXTENDED_DATA[n] for n in (0x01, 0x10, 0x11)}
        cases = {n: (k.name, dictionary.structure(k.name, data.coded(k.name, k.code))) for n, k in counted.items()}
        choice = value("record", dictionary.choice("InterventionValue", "B", cases))
        extended = value("records", dictionary.rest("InterventionData", [choice]))
        asked, told = [value("DTC", dtc), record, memory], [memory, *of_dtc]
        return {
            0x17: SubFunction(
                "reportUserDefMemoryDTCByStatusMask", [self._byte("StatusMask"), memory], [memory, shown, listed]
            ),
            0x18: SubFunction("reportUserDefMemoryDTCSnapshotRecordByDTCNumber", asked, [*told, records]),
            0x19: SubFunction("reportUserDefMemoryDTCExtDataRecordByDTCNumber", asked, [*told, extended]),
        }
