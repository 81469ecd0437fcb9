"""bench/live.py over the SocketCAN of a test kernel (user-mode Linux), where this machine has none.

It has one core, which sender and receiver share, and a call of the system takes some ten times as long as elsewhere:
only figures of the same kernel compare. A PYTHONPATH with another version of the gateway measures that one.

    python bench/in_kernel.py [options of bench/live.py]
"""

from __future__ import annotations

import os
import shlex
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
DEFAULT = ["--only", "process", "python-can", "--rates", "1000", "--seconds", "10", "--rest", "0.001"]


def main() -> None:
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    from user_mode import boot, build_ptrace_xsave  # noqa: PLC0415 - of the tests

    options = shlex.join([*(sys.argv[1:] or DEFAULT), "--interface", "vcan0"])
    environment = {k: v for k, v in os.environ.items() if k == "PYTHONPATH"}
    with tempfile.TemporaryDirectory() as name:
        said = boot(
            [f"python {ROOT / 'bench' / 'live.py'} {options}"], Path(name), build_ptrace_xsave(Path(name)), environment
        )
        output = Path(name) / "lane0" / "output"
        print(output.read_text() if output.exists() else said)


if __name__ == "__main__":
    main()
