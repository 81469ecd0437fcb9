"""Monitors whose step did not return, in a small file beside the fault memory: they stay off at the next start.

A watchdog writes it just before it ends the process. A monitor is known by its name and by the digest of its kernel:
another version of it is given a new chance, and its entry goes.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


def file_beside(memory: Path) -> Path:
    """Return the file's path."""
    return memory.with_name(memory.name + ".hung.json")


@dataclass
class HungMonitors:
    """Contents of the file.

    Attributes:
        path: of the file.
        monitors: name -> its entry: ``digest`` of its kernel, ``reason``.
    """

    path: Path
    monitors: dict[str, dict[str, Any]] = field(default_factory=dict)

    def reason(self, name: str, digest: str) -> str | None:
        """Return why a monitor is to stay off; None: it is not."""
        entry = self.monitors.get(name)
        if entry is None or entry.get("digest") != digest:
            return None
        return f"{entry.get('reason', '')}; {self.path} keeps it off until its kernel changes, or this file is deleted"

    def add(self, name: str, digest: str, reason: str) -> None:
        """Note a monitor, on the disk when this returns.

        Raises:
            OSError: the file cannot be written.
        """
        self.monitors[name] = {"digest": digest, "reason": reason}
        new = self.path.with_name(self.path.name + ".new")
        with new.open("w") as file:
            json.dump({"monitors": self.monitors}, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        new.replace(self.path)


def hung_beside(memory: Path) -> HungMonitors:
    """Return what the file beside a fault memory says; one that is not there, or cannot be read, says nothing."""
    found = HungMonitors(file_beside(memory))
    try:
        entries = json.loads(found.path.read_text()).get("monitors", {})
        found.monitors = {str(name): dict(entry) for name, entry in entries.items()}
    except (OSError, ValueError, AttributeError, TypeError, RecursionError):
        found.monitors = {}
    return found
