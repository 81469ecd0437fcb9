"""What a steering can have, by the component that is at fault."""

from __future__ import annotations

from gateway.monitors.contract import Blame, Debounce, Fault
from gateway_fdi.jit import Record, f8, labels, means

#: Faults by their place. The motor's angle sensor, in the ways it can fail; then the others.
(
    OFFSET,
    DRIFT,
    STUCK,
    SCALE,
    NOISE,
    INTERMITTENT,
    IMPLAUSIBLE,
    WHEEL,
    PINION,
    ANGLES,
    CURRENT,
    VOLTAGE,
    ELECTRIC,
    PAIRING,
    RATIO,
) = range(15)


class Evidence(Record):
    """Evidence of each fault: the symptoms."""

    increment: f8 = means("increment residual", "rad")
    angle: f8 = means("angle of the EMF", "rad")
    parity: f8 = means("parity", "deg")
    balance: f8 = means("balance")
    wheel: f8 = means("steering wheel against its rate", "deg")
    nis: f8 = means("normalised innovation squared")
    speed: f8 = means("speed, estimated", "rad/s")
    repeated: f8 = means("repeated", "frames")


_FOUND = Debounce(failed_after=1, passed_after=200)
_SEEN = Debounce(failed_after=5, passed_after=200)

#: Name, DTC, description, debounce. Chassis codes from C1A00 on are the manufacturer's; failure types of SAE J2012-DA.
_ROWS = (
    ("motor_angle_offset", "C1A01-28", "motor angle sensor: jumped, and stays off", _FOUND),
    ("motor_angle_drift", "C1A01-02", "motor angle sensor: moves away slowly", _FOUND),
    ("motor_angle_stuck", "C1A01-2A", "motor angle sensor: repeats its reading", _FOUND),
    ("motor_angle_scale", "C1A01-91", "motor angle sensor: its error grows with the angle", _FOUND),
    ("motor_angle_noise", "C1A01-2F", "motor angle sensor: noisy", _FOUND),
    ("motor_angle_intermittent", "C1A01-1F", "motor angle sensor: jumps to and fro", _FOUND),
    (
        "motor_angle_implausible",
        "C1A01-64",
        "motor angle sensor: contradicts gear and EMF, nobody knows how yet",
        _FOUND,
    ),
    ("wheel_angle", "C1A02-64", "steering wheel angle contradicts its rate and the gear", _FOUND),
    ("pinion_angle", "C1A03-64", "pinion angle contradicts motor and steering wheel", _FOUND),
    (
        "angles",
        "C1A04-62",
        "motor, steering wheel and pinion angle do not fit; which one is wrong is not known (yet)",
        _FOUND,
    ),
    ("current", "C1A05-64", "a current sensor contradicts voltages and motion", _FOUND),
    ("voltage", "C1A06-64", "inverter or voltage contradicts currents and motion", _FOUND),
    (
        "electric",
        "C1A07-62",
        "currents, voltages and motion do not fit; which is wrong is not known",
        _FOUND,
    ),
    ("pairing", "C1A08-82", "current and voltage frames do not belong together", _SEEN),
    ("ratio", "C1A09-64", "road wheel angle does not follow the ratio asked for", _SEEN),
)

#: What is tested where that is not a symptom's strength.
_TESTED = {"pairing": "counters apart [frames]", "ratio": "off what the ratio asks for"}

FAULTS = tuple(
    Fault(name, dtc, text, labels(Evidence), debounce, tested=_TESTED.get(name, "strength of the symptom"))
    for name, dtc, text, debounce in _ROWS
)

MOTOR_PART = Blame("motor angle", "sensor")  # it comes in two messages
WHEEL_PART, PINION_PART = Blame("SAS_Angle.Delta_S"), Blame("AFS_Angle.Delta_G")
ANGLE_PARTS = (MOTOR_PART, WHEEL_PART, PINION_PART)
_CURRENTS = (Blame("AFS_MotCur.I_U"), Blame("AFS_MotCur.I_V"))
_VOLTAGES = (Blame("AFS_MotVol.U_sd_mean"), Blame("AFS_MotVol.U_sq_mean"), Blame("inverter", "actuator"))
ELECTRIC_PARTS = (*_CURRENTS, *_VOLTAGES)


#: How likely one angle is taken for another one, because something else is wrong, too; a current or voltage for the
#: motor's; and the motor's for the pinion's, which has its name only where the EMF agrees with the motor's.
_SECOND, _UPSET, _CONSISTENT = 0.01, 0.005, 0.002


def _vague(*parts: Blame, share: float = _SECOND) -> tuple[Blame, ...]:
    """Return parts that the fault of another one blames a little: the table has one at a time, there may be two."""
    return tuple(one._replace(share=share) for one in parts)


_MOTOR_BLAMES = (MOTOR_PART, *_vague(WHEEL_PART, PINION_PART), *_vague(*ELECTRIC_PARTS, share=_UPSET))


#: What each fault blames: the component that the signature table names, or those that it cannot tell apart.
BLAMES = {
    **{fault.name: _MOTOR_BLAMES for fault in FAULTS[: IMPLAUSIBLE + 1]},
    "wheel_angle": (WHEEL_PART, *_vague(MOTOR_PART, PINION_PART)),
    "pinion_angle": (PINION_PART, *_vague(WHEEL_PART), *_vague(MOTOR_PART, share=_CONSISTENT)),
    "angles": tuple(one._replace(share=0.3) for one in ANGLE_PARTS),
    "current": _CURRENTS,
    "voltage": _VOLTAGES,
    "electric": tuple(one._replace(share=0.3) for one in ELECTRIC_PARTS),
    "pairing": (Blame("AFS_MotCur.MC_cur"), Blame("AFS_MotVol.MC_vol")),
    # An angle that is wrong is steered by.
    "ratio": (
        Blame("steering", "actuator"),
        *(one._replace(share=0.3) for one in ANGLE_PARTS),
        Blame("ESC_Speed.v_X", share=0.5),
    ),
}
