"""A battery pack of n cells as one structural monitor: choice of the tests, compilation, and a sample each.

    python bench/pack.py [CELLS ...]

Of the tests that `auto` finds, and of those of one cell each that the model names. Seconds of CPU: the choice with its
code; a cold start with that and the compilation; a start that finds both. A sample is a frame of every message of the
pack, decoded, and all tests stepped.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

_CACHE = tempfile.mkdtemp()
os.environ["GATEWAY_CACHE_DIR"] = _CACHE

from battery_pack import tests_of, write_pack  # noqa: E402 - with a cache of its own

from gateway.config.load import load_config  # noqa: E402
from gateway.runtime.app import Gateway  # noqa: E402
from gateway_bench.scenario_session import opened  # noqa: E402
from gateway_fdi.structure.file import load_own_model  # noqa: E402
from gateway_plants.structural.monitor import monitor as structural  # noqa: E402
from gateway_plants.structural.monitor.choice import choose  # noqa: E402
from gateway_plants.structural.monitor.params import Params  # noqa: E402

SECONDS = 120.0


def main() -> None:
    print("cells equations        tests  choice     cold start   warm load   us a sample   ns a test")
    wanted = [int(a) for a in sys.argv[1:]] or [4, 16, 64]
    for cells, named in [(4, False), *((cells, named) for cells in wanted for named in (False, True))]:
        folder = Path(tempfile.mkdtemp())
        tests = tests_of(cells) if named else "auto"
        keys = f"tests = {list(tests)}\n" if named else ""
        path = write_pack(folder, cells, keys=f"sizes = false\n{keys}", seconds=SECONDS)
        model = load_own_model(folder / "pack.toml", key="model")
        clock = time.process_time
        begun = clock()
        plan = choose(model, Params(model=folder / "pack.toml", period_ms=100.0, sizes=False, tests=tests))
        chosen = clock() - begun
        frames = opened(folder / "scenario.toml", 1)[2].frames
        begun = clock()
        gateway = Gateway(load_config(path), None, file=path)
        gateway.start(int(frames[0]["t_ns"]))
        gateway.feed(frames[:100])
        loaded = clock() - begun
        begun = clock()
        gateway.feed(frames[100:])
        ran = clock() - begun
        gateway.close()
        begun = clock()
        structural._MONITORS.clear()
        warm = Gateway(load_config(path), None, file=path)
        again = clock() - begun
        warm.close()
        messages = (cells + 5) // 4
        each = ran / ((len(frames) - 100) / messages)
        which = f"{len(plan.tests):6} {'named' if named else 'auto':5}"
        times = f"{chosen:7.2f} {loaded:10.1f} {again:12.2f} {1e6 * each:13.1f} {1e9 * each / len(plan.tests):10.0f}"
        print(f"{cells:5} {len(model.equations):9} {which} {times}", flush=True)


if __name__ == "__main__":
    main()
