"""A cooling fan and its controller: two plain classes that scenarios step; they import nothing of the gateway."""


class Fan:
    """A fan that cools what the engine heats.

    Args:
        coolant: temperature at the start [degC].
        speed: at the start [rpm].
    """

    def __init__(self, coolant: float = 85.0, speed: float = 1600.0) -> None:
        self.coolant, self.speed, self.t = coolant, speed, 0.0

    def step(self, t: float, inputs: dict[str, float]) -> dict[str, float]:
        """Return what the sensors say at a time [s], and go on with a duty [%] and an engine's load [%]."""
        dt, self.t = t - self.t, t
        said = {"speed": self.speed, "coolant": self.coolant}
        self.speed += (40.0 * inputs["duty"] - self.speed) * dt / 0.5
        self.coolant += (0.08 * inputs["load"] - 0.0016 * self.speed) * dt
        return said


class Controller:
    """Asks for as much air as the coolant is above its aim.

    Args:
        aim: temperature [degC].
    """

    def __init__(self, aim: float = 80.0) -> None:
        self.aim = aim

    def step(self, t: float, inputs: dict[str, float]) -> dict[str, float]:
        """Return the duty [%] at a time [s]."""
        return {"duty": min(max(8.0 * (inputs["coolant"] - self.aim), 0.0), 100.0)}
