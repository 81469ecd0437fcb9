"""A folder on a disk that can be filled up, and freed again."""

import os
import resource
import subprocess
from contextlib import contextmanager, suppress


class TmpfsDisk:
    """A small tmpfs: what does not fit is ENOSPC, as on a real one."""

    def __init__(self, folder):
        self._ballast = folder / "ballast"

    def fill(self, _process):
        with suppress(OSError), self._ballast.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(1024))

    def free(self, _process):
        self._ballast.unlink(missing_ok=True)


class LimitedDisk:
    """Where nothing can be mounted: the process may write nothing more into files (EFBIG)."""

    def fill(self, process):
        _, hard = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (0, hard))

    def free(self, process):
        if process.poll() is None:
            _, hard = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (hard, hard))


@contextmanager
def small_disk(folder, size="1m"):
    """Make a small disk at a folder; gives what fills and frees it."""
    folder.mkdir()
    mounted = (
        os.geteuid() == 0
        and not subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)],
            capture_output=True,
            check=False,
        ).returncode
    )
    try:
        yield TmpfsDisk(folder) if mounted else LimitedDisk()
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)
