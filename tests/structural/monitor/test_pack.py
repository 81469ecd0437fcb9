"""A pack of 64 cells as one monitor: calibrated, quiet when healthy, its faults named as its analysis says."""

import pytest
from amount import FULL, amount
from structural_config import named

from bench import battery_pack as battery
from gateway.bus.logs import open_writer
from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway_bench.scenario_session import opened
from gateway_calibration.cusum import learn
from gateway_calibration.file import write
from gateway_calibration.logs import Reading
from gateway_fdi.jit import COMPILED

pytestmark = [pytest.mark.long, pytest.mark.skipif(not (COMPILED and FULL), reason="a minute of algebra")]
CELLS = 64
#: The tests of one cell each, as the shipped pack of four has them: those that `auto` finds are half as many, and that
#: of all cells' models together does not see one cell's resistance beside 64 cells' noise.
KEYS = f"sizes = false\ntests = [{', '.join(repr(name) for name in battery.tests_of(CELLS))}]\n"
FAULT = '[[fault]]\nkind = "value"\nname = "{name}"\nfrom_s = 60\nsize = {size}\n'


def frames(folder, seconds, seed, faults=""):
    config = battery.write_pack(folder, CELLS, keys=KEYS, seconds=seconds, faults=faults)
    return config, opened(folder / "scenario.toml", seed)[2].frames


def test_64_cells(tmp_path):
    config, drive = frames(tmp_path, 600.0, 1001)
    log = tmp_path / "healthy.log"
    writer = open_writer(log)
    writer.write(drive)
    writer.close()
    tables = learn(load_config(config), [log], Reading(config)).tables
    write(config, tables, "healthy log")
    learned = config.read_text()
    monitor, params = monitor_of(load_config(config).monitor[0])
    notes = monitor.notes(params)
    assert sum(line.startswith("test ") for line in notes) == len(params.nu) == 2 * CELLS + 1
    assert sum(line.startswith("fault ") for line in notes) == 2 * CELLS + 2
    assert not any("cannot fire" in line for line in monitor.warnings(params))

    def again(seconds, seed, faults=""):
        _, found = frames(tmp_path, seconds, seed, faults)
        config.write_text(learned)
        return named(config, found)

    assert again(600.0, 2) == []
    for name, size, told in (
        ("f_y1", 0.05, "f_y1"), ("f_y63", -0.05, "f_y63"), ("f_R7", 1.0, "f_I_or_f_R7"), ("f_R64", 1.0, "f_I_or_f_R64"),
        ("f_I", 15.0, "f_I"), ("f_V", 0.3, "f_V"),
    ):  # fmt: skip
        for seed in range(3, 3 + amount(5, 1)):
            found = again(180.0, seed, FAULT.format(name=name, size=size))
            assert found[:1] == [told], (name, seed, found)
