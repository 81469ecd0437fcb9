"""Parameters of an FMU in a loop on the bus."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from gateway_bench.vecu.loop_params import LoopParams


class FmuParams(LoopParams):
    """An FMU; its inputs, outputs and parameters have the names of its variables."""

    type: Literal["fmu"]
    name: str = "fmu"
    file: Path = Field(description="relative to the scenario")

    @property
    def summary(self) -> str:
        """Its kind, for people."""
        return f"FMU {self.file.name}"
