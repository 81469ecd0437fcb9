"""Many logs: their signals as tables (``gateway decode``), their verdicts (``gateway fleet``).

``corpus`` finds logs and says of which device they are; ``kinds`` and ``lake`` make tables of signals from frames;
``task`` judges one recording, ``verdicts`` keeps what came out, ``run`` has many of them done, ``diff`` compares two
runs; ``healthy`` has thresholds learned from many; ``pool`` is Dask, for both.
"""
