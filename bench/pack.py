"""A battery pack of n cells as one structural monitor: choice of the tests, compilation, and a sample each.

    python bench/pack.py [CELLS ...]

Seconds of CPU; a sample is a frame of every message of the pack, decoded, and all tests stepped. The first column with
times is what a cold start adds, "warm" the same with the choice found in the cache.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

_CACHE = tempfile.mkdtemp()
os.environ["GATEWAY_CACHE_DIR"] = _CACHE

from gateway_studies.structure.battery import write_pack  # noqa: E402 - with a cache of its own

from gateway.cli.simulate import _open  # noqa: E402
from gateway.config.load import load_config  # noqa: E402
from gateway.fdi.structure.file import load_own_model  # noqa: E402
from gateway.monitors.structural import monitor as structural  # noqa: E402
from gateway.monitors.structural.choice import choose  # noqa: E402
from gateway.monitors.structural.params import Params  # noqa: E402
from gateway.runtime.app import Gateway  # noqa: E402

SECONDS = 120.0


def main() -> None:
    print("cells equations tests  choice     cold start   warm load   us a sample   ns a test")
    for cells in [int(a) for a in sys.argv[1:]] or [4, 4, 16, 64]:
        folder = Path(tempfile.mkdtemp())
        path = write_pack(folder, cells, keys="sizes = false\n", seconds=SECONDS)
        model = load_own_model(folder / "pack.toml", key="model")
        clock = time.process_time
        begun = clock()
        plan = choose(model, Params(model=folder / "pack.toml", period_ms=100.0, sizes=False))
        chosen = clock() - begun
        frames = _open(folder / "scenario.toml", 1)[2].frames
        begun = clock()
        gateway = Gateway(load_config(path), None, file=path)
        gateway.start(int(frames[0]["t_ns"]))
        gateway.feed(frames[:100])
        loaded = clock() - begun
        structural._MONITORS.clear()
        begun = clock()
        gateway.feed(frames[100:])
        ran = clock() - begun
        gateway.close()
        begun = clock()
        warm = Gateway(load_config(path), None, file=path)
        again = clock() - begun
        warm.close()
        messages = (cells + 5) // 4
        each = ran / ((len(frames) - 100) / messages)
        print(
            f"{cells:5} {len(model.equations):9} {len(plan.tests):5} {chosen:7.2f} {loaded:10.1f} {again:12.2f}"
            f" {1e6 * each:13.1f} {1e9 * each / len(plan.tests):10.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
