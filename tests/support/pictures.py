"""Pictures of the docs: what makes each of them, and what is in it.

    python tests/support/pictures.py [PICTURE ...]      make them again, all or these

Pictures of figures hold what is drawn (:func:`gateway_replay.drawing.contents`). So a test makes them again and
compares words and numbers: the code has not changed since. Drawings are by hand; their words are held against the code.
"""

import json
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path
from xml.etree import ElementTree

DOCS = Path(__file__).resolve().parents[2] / "docs"
GATEWAY = (sys.executable, "-c", "from gateway.cli import main; main()")

#: Picture of a scenario's monitor: the scenario, its configuration, what is drawn.
SCENARIOS = {
    "structural/faults.png": (
        "motor_faults",
        "motor",
        [f"motor.T over J of {test}" for test in ("e1", "e1_2", "e5", "e5_2")],
    ),
    "pedal/faults.png": (
        "pedal_faults",
        "pedal",
        ["brake.channel_1_low", "brake.channel_1_stuck", "brake.channel_1_erratic", "brake.drift", "brake.value"],
    ),
    "linear/faults.png": (
        "linear_belt_faults",
        "linear_belt",
        [f"belt.{part}" for part in ("actuator_voltage", "sensor_motor_speed", "sensor_load_speed", "sensor_current")],
    ),
    "truck/battery-short.png": (
        "truck_battery_short",
        "truck",
        ["powertrain.residual of T2", *(f"powertrain.T over J of T{k}" for k in (2, 6, 7))],
    ),
    "images/signals.png": (
        "signals_faults",
        "signals",
        ["body.Pressure", "wheels.FL.high", "wheels.FR.gradient", "wheels.RL.stuck", "wheels.RR.noise"],
    ),
}
#: Folder of a study's page -> its module that draws, with what, and the pictures that need no table of runs.
STUDIES = {
    "crank": ((2026,), ("fig2-fault-signals", "fig3-no-fault", "fig4-one-pulse-missed", "fig5-one-pulse-added")),
    "truck": ((30000,), ("fig5", "fig6", "fig7", "fig8", "fig9", "observer")),
    "pedal": (([], 100000), ("fig9-impulses", "fig10-permanent")),
    "steering": (([], 100000), ("fig5", "fig7")),
    "linear": (([],), ("fig3_to_7", "fig8_to_11")),
}
#: Pictures of tables of runs, which last many minutes.
RUNS = {
    "evaluate pedal --seeds 300 --plot FOLDER": [
        f"pedal/fig{name}.png" for name in ("11-rate", "12-value", "13-rate-predictive", "14-value-predictive")
    ],
    "evaluate steering --plot FOLDER": ["steering/detection.png"],
    "evaluate linear --hours 0 --plot FOLDER": ["linear/holdout.png"],
    "evaluate arena --plant buck --plant quad --method structural --method fixed --method kalman --method pca"
    " --method forest --seed 300000 --runs 5 --healthy 39 --train 8 --plot FOLDER/arena_roc.svg": [
        "images/arena_roc.svg"
    ],
}
#: Pictures of a command.
COMMANDS = {
    "evaluate cause --figures FOLDER": [
        f"images/cause-{name}.svg" for name in ("speed", "silent", "ecu", "supply", "plant")
    ],
    "structure truck --plot FOLDER/truck.png": ["structure/truck.png"],
}
#: Pictures that are held against the code where they come from, by other tests.
ELSEWHERE = {"images/page.png", "images/tutorial-car.png", "images/tutorial-plant.png"}


def contents(path):
    """Return what a picture of a figure says that it shows; None: it says nothing."""
    if path.suffix == ".svg":
        found = re.search(r"<dc:description>(.*?)</dc:description>", path.read_text(), re.DOTALL)
        return json.loads(ElementTree.fromstring(f"<a>{found[1]}</a>").text) if found else None
    data, at = path.read_bytes(), 8
    while at < len(data):
        (size,), kind = struct.unpack(">I", data[at : at + 4]), data[at + 4 : at + 8]
        name, _, text = data[at + 8 : at + 8 + size].partition(b"\0")
        if name == b"Description":
            if kind == b"iTXt":
                text = text[2:].split(b"\0", 2)[2]
            return json.loads(zlib.decompress(text[1:]) if kind == b"zTXt" else text)
        at += size + 12
    return None


def different(shown, drawn):
    """Return where two figures differ, "" if they are alike: words are equal, numbers are by a twentieth."""
    if shown is None:
        return "it does not say what it shows"
    if len(shown) != len(drawn):
        return f"{len(shown)} axes, now {len(drawn)}"
    for k, (old, new) in enumerate(zip(shown, drawn, strict=True)):
        if old["words"] != new["words"]:
            return f"axes {k}: {old}, now {new}"
        for name in ("lines", "boxes"):
            if len(old[name]) != len(new[name]):
                return f"axes {k}: {len(old[name])} {name}, now {len(new[name])}"
            for one, other in zip(old[name], new[name], strict=True):
                scale = max((abs(v) for v in one[-3:] if v is not None), default=0.0)
                for a, b in zip(one, other, strict=True):
                    if (a is None) != (b is None) or (a is not None and abs(a - b) > 0.05 * max(abs(a), scale) + 1e-9):
                        return f"axes {k}: {one}, now {other}"
    return ""


def of_scenario(picture, folder):
    """Make the picture of a scenario's monitor; returns the file."""
    scenario, config, only = SCENARIOS[picture]
    made = folder / Path(picture).name
    chosen = [word for name in only for word in ("--only", name)]
    for words in (
        ("simulate", scenario, "--bus", "inside", "--record", f"{scenario}.log"),
        ("replay", f"{scenario}.log", "-c", f"configs/{config}.toml", "--signals", f"{scenario}.parquet"),
        ("plot", f"{scenario}.parquet", *chosen, "-o", made.name),
    ):
        run(folder, *words)
    return made


def of_study(name, folder):
    """Draw a study's figures; returns the files by picture."""
    from importlib import import_module

    arguments, pictures = STUDIES[name]
    import_module(f"gateway_plants.{name}.study.figures").draw(folder, *arguments)
    return {f"{name}/{picture}.png": folder / f"{picture}.png" for picture in pictures}


def of_command(command, pictures, folder):
    """Have a command draw; returns the files by picture."""
    run(folder, *command.replace("FOLDER", str(folder)).split())
    return {picture: folder / Path(picture).name for picture in pictures}


def run(folder, *words):
    """Run a command of the gateway; one that fails is told with what it said."""
    ended = subprocess.run([*GATEWAY, *words], cwd=folder, capture_output=True, text=True, check=False)
    assert ended.returncode in (0, 1), f"gateway {' '.join(words)}\n{ended.stdout}{ended.stderr}"


def main(wanted):
    """Make pictures again."""
    makers = [(picture, lambda f, p=picture: {p: of_scenario(p, f)}) for picture in SCENARIOS]
    makers += [(name, lambda f, n=name: of_study(n, f)) for name in STUDIES]
    makers += [(c, lambda f, c=c, p=p: of_command(c, p, f)) for c, p in (COMMANDS | RUNS).items()]
    for what, make in makers:
        if not wanted or what in wanted:
            with tempfile.TemporaryDirectory() as folder:
                for picture, file in make(Path(folder)).items():
                    shutil.copy(file, DOCS / picture)
                    print(DOCS / picture, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
