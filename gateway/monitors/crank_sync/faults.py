"""What the crankshaft monitor reports: each cause its own fault and DTC."""

from gateway.monitors.shape import Debounce, Fault

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
) = range(10)
#: Those before concern the crankshaft sensor alone.
CRANK_FAULTS = CAM_CORRELATION

#: Evidence of missed and added pulses: how many, the first tooth concerned, the speed, and the shape of the
#: residual, five values in order of time. paper: from the first exceedance on; adaptive: up to the decision.
SHAPE = (
    "count",
    "tooth",
    "speed [rpm]",
    *(f"residual {k} [pitch]" for k in range(1, 6)),
)

_ONCE = Debounce(failed_after=1, passed_after=10)

FAULTS = (
    Fault("missed_pulse", "P0336-29", "pulses of the crankshaft sensor missed", SHAPE, _ONCE),
    Fault(
        "added_pulse",
        "P0336-2F",
        "pulses of the crankshaft sensor that no tooth made",
        SHAPE,
        _ONCE,
    ),
    Fault(
        "sync_lost",
        "P0335-31",
        "teeth arrive, but their place on the wheel was lost",
        ("teeth", "index", "speed [rpm]", "cost [nat]"),
        Debounce(failed_after=1, passed_after=3),
    ),
    Fault(
        "pulses_lost",
        "P0339-1F",
        "three pulses or more of the crankshaft sensor missed in a row: intermittent circuit",
        SHAPE,
        _ONCE,
    ),
    Fault(
        "doubled_edges",
        "P0335-3A",
        "the sensor gives more than one pulse for a tooth",
        ("share of teeth", "teeth", "speed [rpm]"),
        Debounce(failed_after=1, passed_after=3),
    ),
    Fault(
        "no_gap",
        "P0335-64",
        "teeth arrive, but the wheel's gap never comes: wrong edge, polarity or wheel",
        ("teeth", "largest interval / its neighbours", "speed [rpm]"),
        Debounce(failed_after=1, passed_after=1),
    ),
    Fault(
        "runout",
        "P0336-38",
        "the pitch varies once a revolution: wheel off centre, or bent",
        ("amplitude", "tooth", "speed [rpm]"),
        Debounce(failed_after=3, passed_after=10),
    ),
    Fault(
        "reversed",
        "P1335-00",
        "the engine turned back: synchronisation is given up",
        ("tooth", "pulses until the gap"),
        Debounce(failed_after=1, passed_after=3),
    ),
    Fault(
        "cam_correlation",
        "P0016-76",
        "an edge of the cam sensor does not fit the crank",
        ("crank angle [deg]", "off [deg]", "level"),
        Debounce(failed_after=3, passed_after=10),
    ),
    Fault(
        "cam_silent",
        "P0340-31",
        "the crank turns, but no edge of the cam sensor comes",
        ("revolutions",),
        Debounce(failed_after=1, passed_after=3),
    ),
)
