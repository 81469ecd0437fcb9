"""FMUs for tests, built by pythonfmu (FMI 2) and pythonfmu3 (FMI 3)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCRIPT = """
{imports}


class {name}({base}):
    def __init__(self, **more):
        super().__init__(**more)
        self.time = 0.0
        {start}
        {variables}

    def do_step(self, t, dt):
        {body}
        return True
"""
#: FMI -> program that builds it; its imports, base class, type of a real number; whether it wants a variable time.
KINDS = {
    "2": ("pythonfmu", "from pythonfmu import Fmi2Causality as C, Fmi2Slave, Fmi2Variability as V, Real", "Fmi2Slave"),
    "3": (
        "pythonfmu3",
        "from pythonfmu3 import Fmi3Causality as C, Fmi3Slave, Fmi3Variability as V, Float64 as Real",
        "Fmi3Slave",
    ),
}
PLANT = {
    "name": "Motor",
    "inputs": ("u",),
    "outputs": ("i", "w"),
    "parameters": {"k": 10.0},
    "body": """
        n = 20
        h = dt / n
        for _ in range(n):   # midpoint rule
            i, w = self.i, self.w
            a, b = i + h / 2 * (-10 * i - 5 * w + self.k * self.u), w + h / 2 * (8 * i - w)
            self.i, self.w = i + h * (-10 * a - 5 * b + self.k * self.u), w + h * (8 * a - b)""",
}
CONTROLLER = {
    "name": "Controller",
    "inputs": ("w",),
    "outputs": ("u",),
    "parameters": {"gain": 1.5},
    "body": """
        wanted = 3.0 if int((t + dt) / 1.5) % 2 else 1.0
        self.u = max(-20.0, min(20.0, self.gain * (wanted - self.w) + 0.7 * wanted))""",
}


def build(folder: Path, model: dict, fmi: str) -> Path:
    """Return a model as an FMU of FMI 2 or 3, built in a folder."""
    program, imports, base = KINDS[fmi]
    kinds = [(name, "C.input", "V.continuous") for name in model["inputs"]]
    kinds += [(name, "C.output", "V.continuous") for name in model["outputs"]]
    kinds += [(name, "C.parameter", "V.tunable") for name in model["parameters"]]
    if fmi == "3":
        kinds.insert(0, ("time", "C.independent", "V.continuous"))
    values = dict.fromkeys((*model["inputs"], *model["outputs"]), 0.0) | model["parameters"]
    script = folder / f"{model['name'].lower()}{fmi}.py"
    script.write_text(
        SCRIPT.format(
            imports=imports,
            base=base,
            name=model["name"],
            start="\n        ".join(f"self.{name} = {value}" for name, value in values.items()),
            variables="\n        ".join(
                f'self.register_variable(Real("{name}", causality={c}, variability={v}))' for name, c, v in kinds
            ),
            body=model["body"].strip(),
        )
    )
    made = folder / f"built-{script.stem}"
    made.mkdir()
    command = [str(Path(sys.executable).parent / program), "build", "-f", str(script), "-d", str(made)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    [found] = made.glob("*.fmu")
    return found
