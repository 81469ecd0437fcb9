"""A result that tests of several workers need, computed by the first of them."""

import fcntl
import os
import pickle


def once(tmp_path_factory, name, work):
    """Return ``work()``, of this run of the tests; others wait for whoever computes it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    result = folder / f"{name}.pickle"
    with (folder / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not result.exists():
            result.write_bytes(pickle.dumps(work()))
    return pickle.loads(result.read_bytes())
