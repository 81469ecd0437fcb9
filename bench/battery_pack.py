"""A battery pack of n cells in series as a structural model: two tests a cell, and one of the pack.

C_k  the cell's own sensor against its model, by the current
P_k  the pack's sensor against cell k by its model and all others by their sensors
P    the pack's sensor against the sum of all cells' sensors
"""

from __future__ import annotations

from pathlib import Path

from gateway_plants.structural.study.model_text import equation


def battery_model(cells: int) -> str:
    """Return the model of a pack of so many cells as TOML."""
    numbers = range(1, cells + 1)
    lines = [
        f"# A battery pack of {cells} cells in series, written by bench/battery_pack.py.",
        f"text = \"battery pack of {cells} cells in series; each cell's voltage, the pack's and the current measured\"",
        "",
        "[unknown]",
        'I = { unit = "A", text = "current out of the pack" }',
        'V = { unit = "V", text = "voltage of the pack" }',
    ]
    for k in numbers:
        lines.append(f'z{k} = {{ unit = "1", text = "charge of cell {k}", start = 0.8 }}')
        lines.append(f'v{k} = {{ unit = "V", text = "voltage of cell {k}" }}')
    lines += ["[known]", 'y_I = { unit = "A" }', 'y_V = { unit = "V" }']
    lines += [f'y{k} = {{ unit = "V" }}' for k in numbers]
    lines += ["[fault]", 'f_I = { text = "the current\'s sensor" }', 'f_V = { text = "the pack\'s voltage sensor" }']
    for k in numbers:
        lines.append(f'f_R{k} = {{ text = "resistance of cell {k}" }}')
        lines.append(f'f_y{k} = {{ text = "sensor of cell {k}" }}')
    lines += [
        "[parameter]",
        'Q = { value = 180000.0, unit = "A s", text = "charge of a full cell" }',
        'R = { value = 0.0015, unit = "ohm" }',
        "[table.ocv]",
        'text = "voltage at rest by charge [V]"',
        "x = [0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0]",
        "y = [3.0, 3.45, 3.6, 3.68, 3.82, 4.02, 4.2]",
    ]
    for k in numbers:
        lines += equation(f"charge{k}", f"der(z{k}) = -I / Q", (f"der(z{k})", "I"))
        lines += equation(f"cell{k}", f"v{k} = ocv(z{k}) - R * (1 + f_R{k}) * I", (f"v{k}", "I"))
        lines += equation(f"sensor{k}", f"y{k} = v{k} + f_y{k}", (f"v{k}",))
    volts = [f"v{k}" for k in numbers]
    lines += equation("pack", f"V = {' + '.join(volts)}", ("V", *volts))
    lines += equation("sensor_V", "y_V = V + f_V", ("V",))
    lines += equation("sensor_I", "y_I = I + f_I", ("I",))
    lines += _residuals(cells)
    return "\n".join(lines) + "\n"


def _residuals(cells: int) -> list[str]:
    numbers = range(1, cells + 1)
    lines = []
    for k in numbers:
        lines += [
            f"[residual.C{k}]",
            f'equations = ["charge{k}", "cell{k}", "sensor{k}", "sensor_I"]',
            f'consistency = "sensor{k}"',
        ]
    for k in numbers:
        others = ", ".join(f'"sensor{j}"' for j in numbers if j != k)
        lines += [
            f"[residual.P{k}]",
            f'equations = ["charge{k}", "cell{k}", {others}, "pack", "sensor_V", "sensor_I"]',
            'consistency = "sensor_V"',
        ]
    every = ", ".join(f'"sensor{j}"' for j in numbers)
    return [*lines, "[residual.P]", f'equations = [{every}, "pack", "sensor_V"]', 'consistency = "sensor_V"']


def tests_of(cells: int) -> tuple[str, ...]:
    """Return the names of the tests that a monitor of so many cells runs."""
    numbers = range(1, cells + 1)
    return (*(f"C{k}" for k in numbers), *(f"P{k}" for k in numbers), "P")


#: What a value of each kind is in a frame: factor and unit.
_CODED = {"y_I": ("0.01", "A"), "y_V": ("0.01", "V")}
_CELL = ("0.0001", "V")


def _sensors(cells: int) -> list[list[str]]:
    """Return the known variables in each message, four in one."""
    names = ["y_I", "y_V", *(f"y{k}" for k in range(1, cells + 1))]
    return [names[k : k + 4] for k in range(0, len(names), 4)]


def _database(cells: int) -> str:
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: A"]
    for number, names in enumerate(_sensors(cells)):
        lines.append(f"BO_ {256 + number} M{number}: 8 A")
        for place, name in enumerate(names):
            factor, unit = _CODED.get(name, _CELL)
            lines.append(f' SG_ {name} : {16 * place}|16@1+ ({factor},{-300 if name == "y_I" else 0}) [0|0] "{unit}" A')
    return "\n".join(lines) + "\n"


def write_pack(folder: Path, cells: int, *, keys: str = "", seconds: float = 600.0, faults: str = "") -> Path:
    """Write all that a pack of so many cells takes: model, database, configuration, scenario; no code.

    Args:
        folder: where.
        cells: in series.
        keys: further lines of the monitor's table.
        seconds: of the scenario.
        faults: its tables of faults.

    Returns:
        the configuration; the scenario beside it is ``scenario.toml``.
    """
    messages = _sensors(cells)
    (folder / "pack.toml").write_text(battery_model(cells))
    (folder / "pack.dbc").write_text(_database(cells))
    signals = ", ".join(f'{z} = "M{k}.{z}"' for k, names in enumerate(messages) for z in names)
    config = folder / "gateway.toml"
    config.write_text(
        '[clock]\nwatched = false\n[[bus]]\nname = "b"\nuri = "virtual:pack"\ndatabase = ["pack.dbc"]\n'
        'health = { watched = false }\n[memory]\npath = "faults.sqlite"\n'
        '[[monitor]]\nname = "pack"\ntype = "structural"\nmodel = "pack.toml"\nperiod_ms = 100.0\nsample = "set"\n'
        f"settle_s = 1.0\nconfirm_s = 6.0\nsignals = {{ {signals} }}\n{keys}"
    )
    noise = ", ".join(["y_I = 0.3", "y_V = 0.004", *(f"y{k} = 0.002" for k in range(1, cells + 1))])
    lines = [
        'name = "pack"', f"duration_s = {seconds}", 'config = "gateway.toml"',
        "[[ecu]]", 'type = "structural"', 'model = "pack.toml"', "rest = true",
        "inputs = { y_I = { points = [[0, 60], [20, 60], [25, -40], [55, -40], [60, 60]], repeat_s = 60 } }",
        f"noise = {{ {noise} }}",
    ]  # fmt: skip
    for k, names in enumerate(messages):
        each = ", ".join(f'{z} = "{z}"' for z in names)
        lines += ["[[ecu.message]]", f'name = "M{k}"', "period_ms = 100", f"signals = {{ {each} }}"]
    (folder / "scenario.toml").write_text("\n".join(lines) + "\n" + faults)
    return config
