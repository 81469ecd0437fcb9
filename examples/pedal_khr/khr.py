"""Kalman hybrid redundancy of a brake pedal (Kim, Lee, Lee 2008, section III), as one writes it with filterpy.

A filter of one state forecasts by how much the pedal moves in a sample, FT. A reading is believed whose distance from
the last output is at most (1 + beta) FT; if none is, both are if they differ by no more than FT. With a least FT, and
without the lower bound of the interval: as printed, noise stops it for good.
"""

from filterpy.kalman import KalmanFilter

from gateway.monitors.contract import Debounce
from gateway.monitors.plain import monitor

CHANNELS = ("channel_1", "channel_2")


@monitor(
    signals=["PED_Brake.Ch1 [V]", "PED_Brake.Ch2 [V]"],
    fault=dict(zip(CHANNELS, ("C1B50-64", "C1B51-64"), strict=True)),
    debounce=Debounce(failed_after=20, passed_after=20),
)
class Khr:
    """A channel is not believed."""

    def __init__(self, beta: float = 0.5, floor: float = 0.02) -> None:
        self.kf = KalmanFilter(1, 1)
        self.kf.H[:], self.kf.R[:] = 1.0, 0.5
        self.beta, self.floor, self.output, self.before = beta, floor, None, None

    def update(self, first: float, second: float) -> dict[str, bool]:
        """Take a sample of both channels [V]."""
        travel = [(first - 0.5) / 4.0, (4.5 - second) / 4.0]
        if self.output is None:
            self.output = self.before = sum(travel) / 2.0
        self.kf.predict()
        ft = max(float(self.kf.x[0, 0]), self.floor)
        believed = [abs(one - self.output) <= (1.0 + self.beta) * ft for one in travel]
        if not any(believed) and abs(travel[0] - travel[1]) <= ft:
            believed = [True, True]
        if any(believed):
            output = sum(one for one, good in zip(travel, believed, strict=True) if good) / sum(believed)
        else:
            output = self.output + ft * ((self.output > self.before) - (self.output < self.before))
        self.before, self.output = self.output, min(max(output, 0.0), 1.0)
        self.kf.update(abs(self.output - self.before))
        return {name: not good for name, good in zip(CHANNELS, believed, strict=True)}
