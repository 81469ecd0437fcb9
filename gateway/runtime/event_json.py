"""The JSON contract: events for people and programs, one dictionary each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gateway.bus.frames import ID_MASK
from gateway.engine.checks.bus_health import ACTIVITIES
from gateway.engine.checks.kinds import KINDS
from gateway.engine.events import Event
from gateway.faults.catalogue import Catalogue
from gateway.faults.entries import DtcChange
from gateway.faults.interventions import Intervention
from gateway.faults.service import intervention_as_dict
from gateway.faults.summary import Summary
from gateway.monitors.contract import FAILED, PASSED
from gateway.signals.tables import DecodePlan
from gateway_fdi.common.log import get_logger

_RESULTS = {PASSED: "passed", FAILED: "failed"}
_log = get_logger(__name__)


def monitor_events(events: Sequence[Event], catalogue: Catalogue, buses: Mapping[int, str]) -> list[dict[str, Any]]:
    """Tell verdicts that changed no DTC, or values that are watched.

    Args:
        events: of the engine.
        catalogue: the faults.
        buses: names of the buses, "": the gateway itself.
    """
    return [
        {
            "event": "monitor",
            "t_ns": event.t_ns,
            "bus": buses[event.bus],
            "fault": catalogue[event.fault].id,
            "result": _RESULTS.get(event.result, "not tested"),
            "fdc": event.fdc,
            "value": event.value,
            "threshold": event.threshold,
        }
        for event in events
    ]


def short_event(event: Event, plan: DecodePlan, bus: str) -> dict[str, Any]:
    """Tell that the frames of a message are shorter than its database says, for the first time."""
    signals = plan.beyond(event.fault, int(event.value))
    of = {"bus": bus, "message": plan.message_names[event.fault][1]}
    length, database = int(event.value), int(event.threshold)
    text = "frames are shorter than the database says: what is not in them is not tested"
    _log.warning(text, **of, length=length, database=database, signals=", ".join(signals) or "none that is used")
    told = {"length": length, "database": database, "signals": signals}
    return {"event": "short_frames", "t_ns": event.t_ns, **of, **told}


def other_event(event: Event, plan: DecodePlan, bus: str) -> dict[str, Any]:
    """Tell that a message never was as its check says since it came: its ECU has another software, or is another."""
    told: dict[str, Any] = {"bus": bus, "message": plan.message_names[event.fault][1]}
    told |= {"what": KINDS[event.result].fault.name, "now": round(event.value, 1), "learned": event.threshold}
    _log.warning("another software of its ECU, or another ECU: it never was as its check says", **told)
    return {"event": "other_software", "t_ns": event.t_ns, **told}


def source_event(event: Event, plan: DecodePlan, bus: str) -> dict[str, Any]:
    """Tell that a further source address sends a J1939 message, or that it is silent."""
    name, address = plan.message_names[event.fault][1], int(event.value)
    can_id = int(plan.messages["can_id"][event.fault]) & ID_MASK & ~0xFF | address
    told = {"bus": bus, "message": name, "source": address, "silent_ms": event.threshold or None}
    if event.threshold:
        _log.warning("a source address is silent", **told)
    else:
        text = "another source address sends this message, too: its values are tested where its exact name is used"
        _log.info(text, bus=bus, message=name, source=address, exact=f"{name}_0x{can_id:X}")
    return {"event": "source", "t_ns": event.t_ns, **told}


def activity_event(event: Event, bus: str) -> dict[str, Any]:
    """Log that a bus does something else as a whole: it sleeps, wakes, runs or falls asleep; return what tells it."""
    now, before = ACTIVITIES[int(event.value)], ACTIVITIES[int(event.threshold)]
    _log.info(f"bus is {now}", bus=bus, before=before)
    return {"event": "activity", "t_ns": event.t_ns, "bus": bus, "activity": now, "before": before}


def lossy_event(event: Event, bus: str) -> dict[str, Any]:
    """Log that frames of a bus get lost before they come here, or no more; return the event that tells it."""
    lossy = event.value > event.threshold
    text = "frames of this bus get lost before they come here" if lossy else "frames of this bus get lost no more"
    _log.warning(text, bus=bus, share=round(event.value, 3))
    return {"event": "lossy", "t_ns": event.t_ns, "bus": bus, "lossy": lossy, "share": round(event.value, 3)}


def dtc_event(change: DtcChange, bus: str) -> dict[str, Any]:
    """Tell a status byte that changed."""
    return {
        "event": "dtc",
        "t_ns": change.t_ns,
        "bus": bus,
        "fault": change.definition.id,
        "dtc": str(change.dtc),
        "status": int(change.new_status),
        "fdc": change.fdc,
        "occurrence": change.occurrence,
        "evidence": dict(change.evidence),
    }


def cycle_event(t_ns: int, bus: str, name: str, state: str, number: int) -> dict[str, Any]:
    """Tell that an operation cycle "began", "ended", or "goes on" after the death of a process."""
    return {
        "event": "cycle",
        "t_ns": t_ns,
        "bus": bus,
        "cycle": name,
        "state": state,
        "number": number,
    }


def clear_event(t_ns: int, faults: Sequence[str]) -> dict[str, Any]:
    """Tell which entries were cleared."""
    return {"event": "clear", "t_ns": t_ns, "faults": list(faults)}


def intervention_event(intervention: Intervention) -> dict[str, Any]:
    """Log what a tester did, or was refused, and return the event of the JSON contract that tells it."""
    told = intervention_as_dict(intervention)
    shown = ("protocol", "bus", "address", "action", "outcome")
    _log.warning("a tester intervened", **{name: told[name] for name in shown})
    return {"event": "intervention", **told}


def clock_event(t_ns: int, step_s: float) -> dict[str, Any]:
    """Log that the wall clock was set, and return the event of the JSON contract that tells it.

    Args:
        t_ns: when, by the clock as it was set [ns].
        step_s: by how much, forward positive [s].
    """
    _log.warning("wall clock was set", step_s=step_s)
    return {"event": "clock", "t_ns": t_ns, "step_s": step_s}


def summary_event(
    seconds: float,
    events: int,
    counters: dict[str, int],
    *,
    buses: dict[str, dict[str, int]],
    monitors: Any,
    dtcs: list[str],
    found: Summary,
) -> dict[str, Any]:
    """Tell at the end what was done.

    Args:
        seconds: how long it took.
        events: of the engine.
        counters: by name.
        buses: name -> errors that the controller reported, how often.
        monitors: own words of each.
        dtcs: in the fault memory.
        found: verdict, causes of them, and what was not judged.
    """
    return {
        "event": "summary",
        "frames": counters["frames"],
        "decoded": counters["decoded"],
        "events": events,
        "seconds": seconds,
        "frames_per_s": counters["frames"] / seconds if seconds > 0 else 0.0,
        "counters": counters,
        "buses": buses,
        "monitors": monitors,
        "dtcs": dtcs,
        **found.as_dict(),
    }
