"""Functions of this interface that packages above the core do: scenarios, and learning.

They come by the plug-ins' door ``calls``, as commands do; here are their signatures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.common.calls import call_of
from gateway_api.paths import Pathish, path_of, paths_of
from gateway_api.progress import Progress
from gateway_api.run import Run
from gateway_api.setup import Setup, open
from gateway_api.words import spoken


def simulate(
    scenario: Pathish,
    *,
    seed: int | None = None,
    series: bool = False,
    signals: Sequence[str] = (),
    record: Pathish | None = None,
    progress: Progress = False,
) -> Run:
    """Play a scenario's virtual ECUs and faults to a gateway, in simulated time (docs/vecu.md).

    Args:
        scenario: its file, or the name of a shipped one.
        seed: instead of the scenario's.
        series: whether values of monitors over time are kept.
        signals: names of signals that are kept with them.
        record: log that the frames are written to, by its suffix.
        progress: True: a bar; or a function that is called with the share done.

    Raises:
        GatewayError: no installed package plays scenarios.
        InputError, InputErrors: the scenario or its configuration is wrong.
    """
    with spoken():
        run: Run = call_of("simulate")(
            path_of(scenario, "scenario"),
            seed=seed,
            series=series,
            signals=signals,
            record=None if record is None else path_of(record, "record"),
            progress=progress,
        )
    return run


@dataclass(frozen=True)
class Learned:
    """A configuration that was learned from healthy logs.

    Attributes:
        file: of it; its evidence is beside it, in Markdown.
        facts: what was learned, as ``gateway learn --json`` has it.
    """

    file: Path
    facts: Mapping[str, Any]

    def open(self) -> Setup:
        """Open it."""
        return open(self.file)


def learn(
    databases: Sequence[Pathish],
    logs: Sequence[Pathish],
    out: Pathish,
    *,
    overwrite: bool = False,
    update: bool = False,
    hold_out: float = 0.3,
    maps: Sequence[str] = (),
    seed: int = 1,
    progress: Progress = False,
) -> Learned:
    """Learn a configuration from databases and logs of healthy drives, and write it (docs/learn.md).

    Args:
        databases: DBC, KCD, SYM or ARXML; none: the layouts of frames are looked for in the logs.
        logs: healthy ones.
        out: file of the configuration.
        overwrite: a file that is there is overwritten.
        update: the logs are added to it.
        hold_out: share of each log, at its end, on which what was learned is proven.
        maps: channels of the logs taken as buses, ``"channel=bus"`` each.
        seed: of the faults that are tried.
        progress: True: a bar; or a function that is called with the share done of each step.

    Raises:
        GatewayError: no installed package learns.
        InputError, InputErrors: a file is not there, is damaged, or is in the way.
    """
    with spoken():
        file, facts = call_of("learn")(
            paths_of(databases, "databases"),
            paths_of(logs, "logs"),
            path_of(out, "out"),
            overwrite=overwrite,
            update=update,
            hold_out=hold_out,
            maps=maps,
            seed=seed,
            progress=progress,
        )
    return Learned(file, facts)
