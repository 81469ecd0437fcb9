"""Active front steering: angle sensors, current sensors, inverter (paper 001).

`monitor` takes the samples, with the constants and the state of `records`. `electrics` makes the residuals of the
motor's side, `kinematics` those of the gear's, each message at its own time. `symptoms` turns residuals into symptoms,
with what `jumps`, `trend` and `onset` keep of the last of them; `decision` looks symptoms up in the table of
signatures. `road_wheel` checks the overall ratio beside all this.
"""

from gateway_plants.steering.monitor.monitor import MONITOR

__all__ = ["MONITOR"]
