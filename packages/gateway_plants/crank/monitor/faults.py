"""What the crankshaft monitor reports: each cause its own fault and DTC."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

from gateway.monitors.contract import Blame, Debounce, Fault, Out
from gateway_fdi.jit import Record, f8, f8s, labels, means

(
    MISSED,
    ADDED,
    SYNC_LOST,
    PULSES_LOST,
    DOUBLED,
    NO_GAP,
    RUNOUT,
    REVERSED,
    CAM_CORRELATION,
    CAM_SILENT,
    RELOCATED,
    DAMAGED,
    UNWATCHED,
    NOISE,
    TWO_PLACES,
    WRONG_WHEEL,
) = range(16)
#: Those before concern the crankshaft sensor alone.
CRANK_FAULTS = CAM_CORRELATION

#: Residuals kept as the shape of a fault.
RESIDUALS = 5


class Shape(Record):
    """Evidence of missed and added pulses.

    The residual has five values in order of time, up to the decision.
    """

    count: f8 = means("count")
    tooth: f8 = means("tooth")
    speed: f8 = means(unit="rpm")
    residual: Annotated[f8s, RESIDUALS] = means(unit="pitch")


class SyncLost(Record):
    """Evidence of a lost place."""

    teeth: f8 = means("teeth")
    index: f8 = means("index")
    speed: f8 = means(unit="rpm")
    cost: f8 = means(unit="nat")


class Doubled(Record):
    """Evidence of doubled edges."""

    share: f8 = means("share of teeth")
    teeth: f8 = means("teeth")
    speed: f8 = means(unit="rpm")


class NoGap(Record):
    """Evidence of a gap that never comes."""

    teeth: f8 = means("teeth")
    polarity: f8 = means("1: the pulses are those of the wheel with the sensor's polarity reversed")
    widest: f8 = means("largest interval / its neighbours")
    speed: f8 = means(unit="rpm")


class Runout(Record):
    """Evidence of runout."""

    amplitude: f8 = means("amplitude")
    tooth: f8 = means("tooth")
    speed: f8 = means(unit="rpm")


class Reversed(Record):
    """Evidence of an engine that has turned back."""

    tooth: f8 = means("tooth")
    pulses: f8 = means("pulses until the gap")


class CamCorrelation(Record):
    """Evidence of a cam that does not fit the crank."""

    angle: f8 = means("crank angle", "deg")
    off: f8 = means(unit="deg")
    level: f8 = means("level")


class CamSilent(Record):
    """Evidence of a silent cam sensor."""

    revolutions: f8 = means("revolutions")


class Relocated(Record):
    """Evidence of a place on the wheel that was found wrong."""

    shift: f8 = means("teeth from the wrong place to the right one")
    tooth: f8 = means("right one")
    speed: f8 = means(unit="rpm")


class Damaged(Record):
    """Evidence of a tooth that is not where it belongs."""

    tooth: f8 = means("tooth; -1: it is not told which")
    off: f8 = means("later than the others say; 1 and more: so many are missing", "pitch")
    speed: f8 = means(unit="rpm")


class Unwatched(Record):
    """Evidence of too many lost frames."""

    share: f8 = means("share of pulses that no frame brought")
    teeth: f8 = means("teeth")


class Noise(Record):
    """Evidence of a burst of pulses that no tooth made."""

    count: f8 = means("pulses in the burst")
    tooth: f8 = means("tooth before the burst")
    speed: f8 = means(unit="rpm")


class TwoPlaces(Record):
    """Evidence of a wheel that has two equal gaps: by one place the one tooth is missing, by the other the other."""

    tooth: f8 = means("tooth missing, if the place is right")
    other: f8 = means("tooth missing, if the other place is")
    speed: f8 = means(unit="rpm")
    here: f8 = means("cam edges that fit the place alone")
    there: f8 = means("cam edges that fit the other place alone")


class WrongWheel(Record):
    """Evidence of pulses that are of another wheel than the configured one."""

    teeth: f8 = means("pitches of a turn that is seen")
    pulses: f8 = means("pulses of that turn")
    gap: f8 = means("largest pitch of that turn", "pitch")


class Evidence(Record, overlay=True):
    """Evidence of a fault: one of these."""

    pulses: Shape = means("pulses missed or added")
    sync_lost: SyncLost = means("a lost place")
    doubled: Doubled = means("doubled edges")
    no_gap: NoGap = means("a gap that never comes")
    runout: Runout = means("runout")
    reversed: Reversed = means("an engine that has turned back")
    cam_correlation: CamCorrelation = means("a cam that does not fit the crank")
    cam_silent: CamSilent = means("a silent cam sensor")
    relocated: Relocated = means("a place that was wrong")
    damaged: Damaged = means("a tooth that is not where it belongs")
    unwatched: Unwatched = means("too many lost frames")
    noise: Noise = means("a burst of pulses")
    two_places: TwoPlaces = means("two equal gaps")
    wrong_wheel: WrongWheel = means("another wheel")


#: What the parts of the monitor report into.
Reports: TypeAlias = Out[Evidence, Any]

_ONCE = Debounce(failed_after=1, passed_after=10)
#: What the tests of single pulses compare.
_PLACE = "pulse away from its place [pitch]"

FAULTS = (
    Fault("missed_pulse", "P0336-39", "pulses of the crankshaft sensor missed", labels(Shape), _ONCE, tested=_PLACE),
    Fault(
        "added_pulse",
        "P0336-3A",
        "pulses of the crankshaft sensor that no tooth made",
        labels(Shape),
        _ONCE,
        tested=_PLACE,
    ),
    Fault(
        "sync_lost",
        "P0336-61",
        "teeth arrive, but their place on the wheel was lost",
        labels(SyncLost),
        Debounce(failed_after=1, passed_after=3),
    ),
    Fault(
        "pulses_lost",
        "P0339-1F",
        "three pulses or more of the crankshaft sensor missed in a row: intermittent circuit",
        labels(Shape),
        _ONCE,
        tested=_PLACE,
    ),
    Fault(
        "doubled_edges",
        "P0335-3A",
        "the sensor gives more than one pulse for a tooth",
        labels(Doubled),
        Debounce(failed_after=1, passed_after=3),
        tested="share of teeth with more than one pulse",
    ),
    Fault(
        "no_gap",
        "P0335-64",
        "teeth arrive, but the wheel's gap never comes: wrong edge, polarity or wheel",
        labels(NoGap),
        Debounce(failed_after=1, passed_after=1),
        tested="largest interval / its neighbours",
    ),
    Fault(
        "runout",
        "P0336-38",
        "the pitch varies once a revolution: wheel off centre, or bent",
        labels(Runout),
        Debounce(failed_after=3, passed_after=10),
        tested="amplitude of the pitch",
    ),
    Fault(
        "reversed",
        "P1335-00",
        "the engine turned back: synchronisation is given up",
        labels(Reversed),
        Debounce(failed_after=1, passed_after=3),
    ),
    Fault(
        "cam_correlation",
        "P0016-76",
        "an edge of the cam sensor does not fit the crank",
        labels(CamCorrelation),
        Debounce(failed_after=3, passed_after=10),
        tested="edge away from its place [deg]",
    ),
    Fault(
        "cam_silent",
        "P0340-31",
        "the crank turns, but no edge of the cam sensor comes",
        labels(CamSilent),
        Debounce(failed_after=1, passed_after=3),
        tested="revolutions without an edge",
    ),
    Fault(
        "relocated",
        "P0335-62",
        "the place on the wheel was wrong: the gap came elsewhere turn by turn, and the index was put right",
        labels(Relocated),
        _ONCE,
        tested="teeth from the wrong place to the right one",
    ),
    Fault(
        "damaged_tooth",
        "P0336-07",
        "a tooth is far from its place, or missing in each turn: bent, chipped, broken off, or of another wheel",
        labels(Damaged),
        _ONCE,
        tested="tooth away from its place [pitch]",
    ),
    Fault(
        "frames_lost",
        "U1335-87",
        "so many tooth frames are lost on the bus that nothing can be told about the sensor",
        labels(Unwatched),
        Debounce(failed_after=1, passed_after=3),
        tested="share of pulses that no frame brought",
    ),
    Fault(
        "noise",
        "P0335-2F",
        "a burst of pulses within one tooth: ignition noise, ringing or a loose contact",
        labels(Noise),
        _ONCE,
        tested="pulses in the burst",
    ),
    Fault(
        "two_places",
        "P0336-64",
        "a tooth is missing in each turn, and the wheel fits at two places: which tooth it is cannot be told",
        labels(TwoPlaces),
        _ONCE,
        tested="turns in a row that fit at two places",
    ),
    Fault(
        "wrong_wheel",
        "P0335-56",
        "the pulses are of another wheel than the configured one: change `wheel`, or the wheel is damaged like it",
        labels(WrongWheel),
        Debounce(failed_after=1, passed_after=1),
        tested="turns in a row that showed another wheel",
    ),
)

_SENSOR, _CAM = Blame("crankshaft sensor", "sensor"), Blame("cam sensor", "sensor")
_WHEEL, _CONFIGURED = Blame("wheel", "plant"), Blame("wheel configured", "model")

#: What each fault blames. Lost frames are not named: their sender and all before it may be at fault.
BLAMES = {
    **{fault.name: (_SENSOR,) for fault in FAULTS[:CRANK_FAULTS] if fault.name != "reversed"},
    # A broken tooth fails these, too, in the turns before it is known; sensors that drop a pulse are far more frequent.
    **dict.fromkeys(("missed_pulse", "added_pulse"), (_SENSOR, _WHEEL._replace(share=0.01))),
    # What nothing explains, or shows no gap, may be the wheel as well.
    "sync_lost": (_SENSOR, _WHEEL),
    "no_gap": (_SENSOR, _WHEEL, _CONFIGURED),
    "reversed": (Blame("engine", "plant"),),
    "runout": (_WHEEL,),
    # A place that is not proven judges no edge of the cam.
    "cam_correlation": (_CAM, Blame("timing", "plant"), _SENSOR._replace(share=0.01)),
    "cam_silent": (_CAM,),
    "relocated": (_SENSOR,),
    "damaged_tooth": (_WHEEL,),
    "noise": (_SENSOR,),
    "two_places": (_WHEEL,),
    "wrong_wheel": (_WHEEL, _CONFIGURED, _SENSOR._replace(share=0.2)),
}
