"""Metrics for Prometheus. Names are fixed; labels are those of the catalogue and of the configured buses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.registry import Collector

from gateway.faults.explanation import HELD
from gateway_serve.memory import BITS

if TYPE_CHECKING:
    from prometheus_client.core import Metric

    from gateway_serve.hub import Hub


class Metrics(Collector):
    """Data of the hub, as Prometheus asks for them."""

    content_type = CONTENT_TYPE_LATEST

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._registry = CollectorRegistry()
        self._registry.register(self)

    def text(self) -> bytes:
        """Return all of them; the worst values since the last time start again."""
        return generate_latest(self._registry)

    def describe(self) -> list[Metric]:
        """Say nothing before the first time."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics."""
        yield GaugeMetricFamily("gateway_up", "Whether the gateway runs.", value=float(self._hub.connected))
        yield GaugeMetricFamily(
            "gateway_monitoring_on", "Whether the gateway runs and monitoring is not switched off.",
            value=float(self._hub.connected and self._hub.monitoring["on"]),
        )  # fmt: skip
        yield from self._faults()
        yield from self._buses()
        yield from self._reporters()
        yield from self._ecus()
        yield from self._security()
        yield self._exceptions()
        decoded = self._hub.counters
        for name, text in (
            ("frames", "Frames taken in."),
            ("decoded", "Frames whose signals were taken."),
            ("timeouts", "Messages that did not come in time."),
            ("crc_failed", "Frames whose protection is wrong."),
            ("events_lost", "Events that there was no room for."),
        ):
            if name in decoded:
                yield CounterMetricFamily(f"gateway_engine_{name}", text, value=float(decoded[name]))
        yield CounterMetricFamily("gateway_page_missed_ticks", "Ticks that the page missed.", value=self._hub.missed)
        yield CounterMetricFamily(
            "gateway_page_refused", "Requests that the page's server refused.", value=self._hub.refused
        )

    def _faults(self) -> Iterator[Metric]:
        hub = self._hub
        bits = GaugeMetricFamily("gateway_dtc_status", "Bits of the DTC's status byte.", labels=["fault", "dtc", "bit"])
        ratio = GaugeMetricFamily(
            "gateway_test_ratio", "Nearest to a failure since the last scrape; 1: at the limit.", labels=["fault"]
        )
        entries = GaugeMetricFamily("gateway_dtc_occurrences", "Failures since the entry.", labels=["fault", "dtc"])
        known = {entry["fault"]: entry for entry in hub.memory["entries"]}
        for k, fault in enumerate(hub.hello["faults"]):
            status = hub.memory["status"].get(fault["id"])
            if status is not None:
                for place, name in enumerate(BITS):
                    bits.add_metric([fault["id"], fault["dtc"], name], float(status >> place & 1))
            if k in hub.worst:
                ratio.add_metric([fault["id"]], hub.worst[k])
            if fault["id"] in known:
                entries.add_metric([fault["id"], fault["dtc"]], float(known[fault["id"]]["occurrence"]))
        hub.worst = {}
        yield from (bits, ratio, entries, *self._causes())
        yield GaugeMetricFamily(
            "gateway_memory_stored", "Whether the file has all that is known.", value=float(hub.memory["stored"])
        )

        yield CounterMetricFamily(
            "gateway_restarts", "Starts after a gateway that was not stopped but died.",
            value=float(hub.memory["restarts"]["count"]),
        )  # fmt: skip

    def _causes(self) -> Iterator[Metric]:
        labels = ["cause", "proven"]
        probability = GaugeMetricFamily(
            "gateway_cause_probability", "Of the likeliest cause of faults that are there now.", labels=labels
        )
        count = GaugeMetricFamily("gateway_cause_faults", "Faults that are there now, by their cause.", labels=labels)
        for case in self._hub.memory["cases"]:
            if case["failing"]:
                values = [" and ".join(case["components"]), str(case["proven"]).lower()]
                probability.add_metric(values, case["probability"])
                count.add_metric(values, float(case["failing"]))
        held = sum(entry["hold"] == HELD for entry in self._hub.memory["entries"])
        yield from (probability, count)
        yield GaugeMetricFamily("gateway_symptoms_held", "Entries that a proven cause keeps unconfirmed.", value=held)

    def _reporters(self) -> Iterator[Metric]:
        reports = CounterMetricFamily(
            "gateway_reports", "Test results of other processes by what became of them.", labels=["reporter", "outcome"]
        )
        losses = CounterMetricFamily("gateway_reporter_losses", "How often a reporter was lost.", labels=["reporter"])
        there = GaugeMetricFamily("gateway_reporter_lost", "Whether it is lost at present.", labels=["reporter"])
        for each in self._hub.reporters:
            name, counts = each["reporter"], dict(each["counts"])
            lost = counts.pop("lost", 0)
            for outcome, count in counts.items():
                reports.add_metric([name, outcome], float(count))
            if name:
                losses.add_metric([name], float(lost))
                there.add_metric([name], float(bool(each["lost"])))
        if self._hub.reporters:
            yield from (reports, losses, there)

    def _ecus(self) -> Iterator[Metric]:
        requests = CounterMetricFamily("gateway_ecu_requests", "Requests to other ECUs.", labels=["ecu"])
        ends = CounterMetricFamily(
            "gateway_ecu_outcomes", "Requests to other ECUs, and their answers, by what became of them.",
            labels=["ecu", "outcome"],
        )  # fmt: skip
        there = GaugeMetricFamily("gateway_ecu_dtc", "Whether a DTC of another ECU is there.", labels=["ecu", "dtc"])
        for state in self._hub.ecus:
            requests.add_metric([state["ecu"]], float(state["requests"]))
            for name, count in state.items():
                if name != "requests" and isinstance(count, int):
                    ends.add_metric([state["ecu"], name], float(count))
        for each in self._hub.memory["ecu_dtcs"]:
            there.add_metric([each["ecu"], each["dtc"]], float(each["there"]))
        if self._hub.ecus or self._hub.memory["ecu_dtcs"]:
            yield from (requests, ends, there)

    def _security(self) -> Iterator[Metric]:
        found = CounterMetricFamily("gateway_security_events", "Security events.", labels=["sensor", "kind"])
        for event in self._hub.security.values():
            found.add_metric([event["sensor"], event["kind"]], float(event["total"]))
        if self._hub.security:
            yield found

    def _exceptions(self) -> Metric:
        """Exceptions that walls caught: of the gateway, and of this process (``page``)."""
        labels = ["process", "wall", "door"]
        found = CounterMetricFamily("gateway_exceptions", "Exceptions that ended the work for a peer.", labels=labels)
        own = self._hub.fence
        for process, walls in (
            ("gateway", self._hub.exceptions),
            ("page", {"first": own.first, "second": own.second}),
        ):
            for wall in ("first", "second"):
                for door, count in (walls.get(wall) or {"": 0}).items():
                    found.add_metric([process, wall, door], float(count))
        return found

    def _buses(self) -> Iterator[Metric]:
        state = GaugeMetricFamily("gateway_bus_open", "Whether the bus is open.", labels=["bus"])
        load = GaugeMetricFamily("gateway_bus_load_ratio", "Share of time that the bus is busy.", labels=["bus"])
        frames = CounterMetricFamily("gateway_bus_frames", "Frames received.", labels=["bus"])
        lost = CounterMetricFamily("gateway_bus_frames_lost", "Frames lost before they were read.", labels=["bus"])
        gone = CounterMetricFamily("gateway_bus_losses", "How often the bus was lost.", labels=["bus"])
        errors = CounterMetricFamily("gateway_bus_errors", "Error frames by class.", labels=["bus", "class"])
        for bus in self._hub.buses:
            name = bus["bus"]
            state.add_metric([name], float(bus.get("state") == "open"))
            if bus["load"] is not None:
                load.add_metric([name], bus["load"])
            for family, key in ((frames, "received"), (lost, "overflow"), (gone, "losses")):
                if key in bus:
                    family.add_metric([name], float(bus[key]))
            for kind, count in bus["errors"].items():
                errors.add_metric([name, kind], float(count))
        yield from (state, load, frames, lost, gone, errors)
