"""Gear of an active front steering (Reinelt, Lundquist, Johansson 2005, (1)), as one writes it with filterpy.

Motor, steering wheel and pinion fit: pinion = wheel / i_D + motor / i_M. A filter of one state follows what is left,
which is zero in health. The wheel's angle is some milliseconds old, so nothing is judged while it turns fast.
"""

from filterpy.kalman import KalmanFilter

from gateway.monitors.contract import Debounce, Signal
from gateway.monitors.plain import Result, monitor


@monitor(
    signals=[
        Signal("AFS_Angle.Delta_M", unit="deg"),  # does not step it
        Signal("AFS_Angle.Delta_G", unit="deg"),
        "SAS_Angle.Delta_S [deg]",
        "SAS_Angle.Delta_S_dot [deg/s]",
    ],
    fault={"angles": "C1A20-62"},
    debounce=Debounce(failed_after=5, passed_after=20),
    tested="difference of the angles [deg]",
)
class Gear:
    """Motor, steering wheel and pinion angle do not fit."""

    def __init__(
        self, motor_ratio: float = 20.0, wheel_ratio: float = 1.0, limit: float = 0.5, slow: float = 40.0
    ) -> None:
        self.kf = KalmanFilter(1, 1)
        self.kf.H[:], self.kf.Q[:], self.kf.R[:] = 1.0, 1e-3, 0.1**2
        self.motor_ratio, self.wheel_ratio, self.limit, self.slow = motor_ratio, wheel_ratio, limit, slow

    def update(self, motor: float, pinion: float, wheel: float, rate: float) -> Result | None:
        """Take the angles [deg] and the wheel's rate [deg/s]."""
        self.kf.predict()
        if abs(rate) > self.slow:
            return None
        self.kf.update(pinion - motor / self.motor_ratio - (wheel + 0.005 * rate) / self.wheel_ratio)
        off = abs(float(self.kf.x[0, 0]))
        return Result(off > self.limit, off, self.limit)
