"""``gateway structure``: which residual generators a model has, and which faults they isolate."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from gateway.cli.present import find_shipped, print_json, wide_console
from gateway.common.extras import need
from gateway_bench.cli.study import headed
from gateway_fdi.errors import InputError
from gateway_fdi.structure.analysis import Analysis, Test, analyse, as_dict
from gateway_fdi.structure.candidates import ALGEBRAIC, CAUSALITIES
from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.isolability import Isolability
from gateway_fdi.structure.model import Model
from gateway_fdi.structure.sensors import place_sensors

#: Sets listed in text.
MOST_LISTED = 200

_NUMBERED = re.compile(r"(.*?)(\d+)")
_FORMATS = (".svg", ".png", ".pdf")


def _head(console: Console, analysis: Analysis) -> None:
    model, parts = analysis.model, analysis.parts
    console.print(f"[bold]{model.name}[/]" + (f": {escape(model.text)}" if model.text else ""))
    console.print(
        f"{len(model.equations)} equations, {len(model.variables)} unknowns ({len(model.states)} states),"
        f" {len(model.knowns)} known variables, {len(model.faults)} faults"
    )
    console.print(
        f"overdetermined: {len(parts.over.equations)} equations for {len(parts.over.variables)} unknowns,"
        f" redundancy {parts.redundancy}; just determined: {_names(b.equations for b in parts.just)};"
        f" underdetermined: {_names([parts.under.equations])}"
    )
    shown = ", ".join(f"{count} of {size}" for size, count in analysis.sizes.items())
    console.print(f"{len(analysis.msos)} MSO sets ({shown or 'none'}), {len(analysis.candidates)} candidates")
    if analysis.left_out:
        console.print(f"[yellow]{analysis.left_out}[/] (--limit)", soft_wrap=True)


def _names(blocks: Iterable[Sequence[str]]) -> str:
    return " ".join(_runs([name for block in blocks for name in block])) or "none"


def _runs(names: Sequence[str]) -> list[str]:
    """Return names with runs of three and more numbered ones as e1-e3."""
    found: list[list[str]] = []
    for name in names:
        if found and _follows(found[-1][-1], name):
            found[-1].append(name)
        else:
            found.append([name])
    return [part for run in found for part in ([f"{run[0]}-{run[-1]}"] if len(run) > 2 else run)]


def _follows(before: str, name: str) -> bool:
    stem, number = _NUMBERED.fullmatch(before), _NUMBERED.fullmatch(name)
    return bool(stem and number and stem[1] == number[1] and int(stem[2]) + 1 == int(number[2]))


def _counts(analysis: Analysis) -> Table:
    title = "MSO sets and residual generators; (in brackets: the original algorithm)"
    table = headed(title, ["", "causality"], ["MSO sets", "generators"])
    counts = analysis.candidates.table
    for algebraic in ALGEBRAIC:
        for causality in CAUSALITIES:
            ours, original = (counts[a][algebraic][causality] for a in ("modified", "original"))
            cells = [f"{a} ({b})" if ours != original else str(a) for a, b in zip(ours, original, strict=True)]
            table.add_row(algebraic, causality, *cells, end_section=causality == CAUSALITIES[-1])
    return table


def _sets(analysis: Analysis) -> Table:
    title = "MSO sets: unique/realizable generators for each class of causality"
    table = headed(title, [], ["set", "size", *CAUSALITIES])
    table.add_column("faults")
    table.add_column("equations", overflow="fold")
    counts = {c: [analysis.counts(c, a) for a in ALGEBRAIC] for c in CAUSALITIES}
    for k, row in enumerate(analysis.msos[:MOST_LISTED]):
        faults = [f for f, there in zip(analysis.model.faults, analysis.signature[k], strict=True) if there]
        numbers = [f"{counts[c][0][k]}/{counts[c][1][k]}" for c in CAUSALITIES]
        equations = " ".join(_runs(analysis.structure.names(row)))
        table.add_row(str(k + 1), str(int(row.sum())), *numbers, " ".join(faults), equations)
    if len(analysis.msos) > MOST_LISTED:
        table.caption = f"and {len(analysis.msos) - MOST_LISTED} more: --json has all"
    return table


def _isolability(analysis: Analysis) -> Table:
    table = headed("Faults: others that explain each too, with unique generators", ["fault", "at best", *CAUSALITIES])
    columns = [analysis.best, *(analysis.isolability(c) for c in CAUSALITIES)]
    for k, fault in enumerate(analysis.model.faults):
        table.add_row(fault, *(_explained(one, k) for one in columns))
    return table


def _explained(found: Isolability, k: int) -> str:
    if not found.detectable[k]:
        return "[red]not detectable[/]"
    others = [f for j, f in enumerate(found.faults) if found.confused[k, j] and j != k]
    return f"[yellow]{' '.join(others)}[/]" if others else "[green]isolated[/]"


def _tests(title: str, faults: Sequence[str], rows: Mapping[str, Sequence[str]], tests: Mapping[str, Test]) -> Table:
    table = Table(title=title)
    table.add_column("test")
    for fault in faults:
        table.add_column(fault, justify="center")
    if tests:
        for name in ("size", "checks", "causality", "solutions"):
            table.add_column(name, justify="right" if name == "size" else "left")
    for name, there in rows.items():
        more = []
        if name in tests:
            test = tests[name]
            more = [str(len(test.equations)), test.consistency, test.causality, test.status]
        table.add_row(name, *("x" if f in there else "" for f in faults), *more)
    return table


def _text(console: Console, analysis: Analysis) -> None:
    faults = analysis.model.faults
    _head(console, analysis)
    console.print(_counts(analysis))
    console.print(_sets(analysis))
    if not faults:
        return
    console.print(_isolability(analysis))
    fewest = {
        f"set {k + 1}": [f for f, there in zip(faults, analysis.signature[k], strict=True) if there]
        for k in analysis.fewest
    }
    console.print(_tests("Fewest sets that tell as much", faults, fewest, {}))
    if analysis.tests:
        named = {name: test.faults for name, test in analysis.tests.items()}
        console.print(_tests("Residual generators of the model", faults, named, analysis.tests))


def _residual(console: Console, analysis: Analysis, name: str, *, json: bool) -> None:
    from gateway_fdi.structure.generator.code import write  # noqa: PLC0415 - algebra is slow to load
    from gateway_fdi.structure.generator.realisation import realise  # noqa: PLC0415
    from gateway_fdi.structure.generator.solver import NotSolvableError  # noqa: PLC0415

    choice = analysis.choice(name)
    test = analysis.test(choice)
    refused, source = "", None
    try:
        try:
            realised = realise(analysis.model, choice.equations, choice.consistency)
        except NotSolvableError as error:
            refused = str(error)
            realised = realise(analysis.model, choice.equations, choice.consistency, differentiate=True)
        source = write(name, realised).source
    except NotSolvableError as error:
        refused = str(error)
    if json:
        print_json({"residual": name, **asdict(test), "source": source, "refused": refused or None})
        return
    console.print(
        f"[bold]{name}[/]: {test.consistency} checked, {len(test.equations)} equations, {test.causality},"
        f" {test.status}; sensitive to {', '.join(test.faults) or 'no fault'}"
    )
    console.print(escape(test.sequence))
    if refused:
        shown = "; the code below takes the slope of a low-pass filter instead" if source else ""
        console.print(f"[yellow]refused: {escape(refused)}{shown}[/]", soft_wrap=True)
    if source is not None:
        console.print(source, markup=False, highlight=False, soft_wrap=True)


def _exportable(export: str | None, output: str | None, residual: str | None) -> None:
    """Refuse options that do not go together.

    Raises:
        InputError: which.
    """
    if export is not None and export != "c":
        raise InputError("there is c", key="--export", value=export)
    if export is not None and residual is None:
        raise InputError("of a residual generator: --residual NAME, or SET:EQUATION", key="--export", value=export)
    if output is not None and export is None:
        raise InputError("goes with --export", key="--output", value=output)


def _export(analysis: Analysis, name: str, output: str | None) -> None:
    """Write a residual generator as C.

    Raises:
        InputError: it has no code, or the file cannot be written.
    """
    from gateway_fdi.structure.generator.c_code import c_source  # noqa: PLC0415 - algebra is slow to load
    from gateway_fdi.structure.generator.loading import residual_generator  # noqa: PLC0415
    from gateway_fdi.structure.generator.solver import NotSolvableError  # noqa: PLC0415

    choice = analysis.choice(name)
    own = name if name in analysis.model.residuals else f"{analysis.model.name}_{choice.consistency}"
    try:
        text = c_source(residual_generator(analysis.model, choice.equations, choice.consistency, name=name), own)
    except (NotSolvableError, ValueError) as error:
        raise InputError(str(error), key="--residual", value=name) from error
    if output is None:
        print(text, end="")
        return
    try:
        Path(output).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", key="--output", value=output) from error


def _places(console: Console, model: Model, wanted: str, *, json: bool) -> None:
    names = None if wanted == "all" else [name.strip() for name in wanted.split(",")]
    try:
        answers = {
            "detect": place_sensors(model, names, isolate=False),
            "isolate": place_sensors(model, names),
        }
    except ValueError as error:
        raise InputError(str(error), key="--sensors", value=wanted) from error
    if json:
        print_json({"model": model.name, "sensors": answers})
        return
    for what, sets in answers.items():
        console.print(f"[bold]to {what} faults[/], as far as these sensors can, added to the model's own:")
        for one in sets:
            console.print(f"  {', '.join(one) or 'none: the model has enough'}")


def structure(
    name: Path,
    *,
    json: bool,
    plot: Path | None,
    limit: int,
    residual: str | None,
    export: str | None = None,
    output: str | None = None,
    sensors: str | None,
) -> int:
    """Analyse a structural model; returns the exit code."""
    _exportable(export, output, residual)
    if plot is not None and plot.suffix not in _FORMATS:
        raise InputError(f"a picture is {', '.join(_FORMATS)}", key="--plot", value=str(plot))
    if residual is not None:
        need("structure", "residual generators", key="--residual")
    model = load_model(find_shipped(name, "models", "model"))
    console = wide_console()
    if sensors is not None:
        _places(console, model, sensors, json=json)
        return 0
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    stderr = Console(stderr=True)
    with Progress(*columns, console=stderr, transient=True, disable=not stderr.is_terminal) as bar:
        task = bar.add_task("MSO sets", total=1.0)
        analysis = analyse(
            model,
            limit=limit,
            progress=lambda what, share: bar.update(task, description=what, completed=share),
        )
    if plot is not None:
        from gateway_plants.structural.analysis.figures import draw  # noqa: PLC0415 - slow to load

        draw(plot, analysis)
    if residual is not None and export is not None:
        _export(analysis, residual, output)
    elif residual is not None:
        _residual(console, analysis, residual, json=json)
    elif json:
        print_json(as_dict(analysis) | ({"files": [str(plot)]} if plot else {}))
    else:
        _text(console, analysis)
        if plot is not None:
            console.print(f"drawn: {plot}")
    return 0
