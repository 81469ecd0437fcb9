"""What a start does not wait for."""

import subprocess
import sys


def loaded(modules, work="gateway.app"):
    code = f"import {work}, sys; print([m for m in {modules!r} if m in sys.modules])"
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()


def test_a_start_does_not_load_what_only_a_design_needs():
    assert loaded(("scipy.stats", "scipy.optimize", "scipy.signal", "sympy")) == "[]"


def test_a_start_does_not_load_what_one_format_of_logs_needs():
    """python-can loads asammdf, and by it pandas and SymPy: a second."""
    assert loaded(("asammdf", "pandas", "sympy"), "gateway.app, gateway.cli.replay") == "[]"


def test_an_mf4_log_is_read_and_written_by_a_process_that_has_not_loaded_it(tmp_path):
    code = f"""
import sys
from pathlib import Path
import numpy as np
from gateway.bus.frames import empty
from gateway.bus.logs import LogWriter, read_log
frames = empty(3)
frames["t_ns"], frames["can_id"], frames["length"] = [10**9, 2 * 10**9, 3 * 10**9], [1, 2, 3], 2
path = Path({str(tmp_path)!r}) / "a.mf4"
assert "asammdf" not in sys.modules
writer = LogWriter(path)
writer.write(frames)
writer.close()
again = np.concatenate(list(read_log(path)))
print(again["can_id"].tolist(), "asammdf" in sys.modules)
"""
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[1, 2, 3] True"
