"""Pictures of the docs are of this code: what a figure shows is drawn again, words of a drawing are the code's."""

import re
from collections import Counter
from functools import cache

import matplotlib.pyplot as plt
import pytest
from amount import FULL
from pictures import (
    COMMANDS,
    DOCS,
    ELSEWHERE,
    RUNS,
    SCENARIOS,
    STUDIES,
    contents,
    different,
    of_command,
    of_scenario,
    of_study,
)
from typer import Context
from typer.main import get_command
from uses import PACKAGES

from gateway.cli import app
from gateway_commands.configuration_schema import schema
from gateway_replay.drawing import save

ROOT = DOCS.parent
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
PICTURES = {str(path.relative_to(DOCS)) for kind in ("png", "svg", "gif") for path in DOCS.rglob(f"*.{kind}")}
OF_STUDIES = {f"{name}/{picture}.png" for name, (_, pictures) in STUDIES.items() for picture in pictures}
OF_COMMANDS = {picture for pictures in (COMMANDS | RUNS).values() for picture in pictures}
FIGURES = {*SCENARIOS, *OF_STUDIES, *OF_COMMANDS}
DRAWINGS = sorted(PICTURES - FIGURES - ELSEWHERE)
LONGER = pytest.mark.full("3 and 7 s")
AGAIN = "python tests/support/pictures.py makes it again"


def held(picture, made):
    """Hold a picture of the docs against the one that was made now."""
    assert not (found := different(contents(DOCS / picture), contents(made))), f"docs/{picture}: {found}\n{AGAIN}"


def test_each_picture_is_on_a_page_and_none_is_missing():
    shown = Counter()
    for page in PAGES:
        for link in re.findall(r"\]\(([^)\s]+\.(?:png|svg|gif))\)|src=\"([^\"]+\.(?:png|svg|gif))\"", page.read_text()):
            path = (page.parent / "".join(link)).resolve()
            assert path.is_file(), f"{page}: {link}"
            shown[str(path.relative_to(DOCS))] += 1
    assert set(shown) == PICTURES
    assert PICTURES >= FIGURES | ELSEWHERE
    assert len(DRAWINGS) < len(PICTURES) / 2


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=LONGER) if name in ("truck", "linear") else name for name in STUDIES]
)
def test_figures_of_a_study(name, tmp_path):
    for picture, made in of_study(name, tmp_path).items():
        held(picture, made)


@pytest.mark.full("5 s a picture")
@pytest.mark.parametrize("picture", SCENARIOS)
def test_figures_of_a_scenario(picture, tmp_path):
    held(picture, of_scenario(picture, tmp_path))


@pytest.mark.long
@pytest.mark.parametrize("command", [*COMMANDS, *RUNS] if FULL else ["structure truck --plot FOLDER/truck.png"])
def test_figures_of_a_command(command, tmp_path):
    for picture, made in of_command(command, (COMMANDS | RUNS)[command], tmp_path).items():
        held(picture, made)


@pytest.mark.parametrize("name", ["a.png", "a.PNG", "a.svg", "a.pdf", "a.jpg", "a.eps"])
def test_a_figure_is_written_in_any_format(name, tmp_path):
    figure, axes = plt.subplots()
    axes.plot([0.0, 1.0], [2.0, 3.0])
    assert save(figure, tmp_path / name).stat().st_size > 1000
    if name in ("a.png", "a.svg"):
        assert contents(tmp_path / name)[0]["lines"] == [[2, 0.0, 0.5, 1.0, 2.0, 2.5, 3.0]]


def test_a_picture_of_other_code_is_noticed():
    shown = contents(DOCS / "crank/fig3-no-fault.png")
    assert not different(shown, shown)
    for change in (
        lambda axes: axes["words"].append("x"),
        lambda axes: axes["lines"].pop(),
        lambda axes: axes["lines"][0].__setitem__(5, axes["lines"][0][5] * 1.2 + 1.0),
    ):
        other = [{**axes, "words": [*axes["words"]], "lines": [[*line] for line in axes["lines"]]} for axes in shown]
        change(other[0])
        assert different(shown, other)


@pytest.mark.parametrize("picture", DRAWINGS)
def test_a_drawing_has_the_words_of_the_code(picture):
    """Tables of a configuration, keys, options and commands of a drawing exist."""
    texts = re.findall(r"<text[^>]*>(.*?)</text>", drawing(picture), re.DOTALL)
    text = "\n".join(re.sub("<[^>]+>", "", each) for each in texts).replace("&#x27;", "'")
    tables = set(schema()["properties"]) | {"expect"}
    for table in re.findall(r"\[{1,2}([a-z_]+)[^\]]*\]", text):
        assert table in tables, table
    for name in re.findall(r"--([a-z-]+)|\b([a-z]+(?:_[a-z]+)+)\b", text):
        assert re.search(rf"\b{re.escape(''.join(name))}\b", source()), name
    group = get_command(app)
    for command in re.findall(r"(?:^|: )gateway ([a-z]+)", text, re.MULTILINE):
        assert group.get_command(Context(group), command) is not None, command


def test_the_drawing_of_packages_has_each():
    packages = {path.name for path in (ROOT / "packages").iterdir() if (path / "__init__.py").exists()} | {"gateway"}
    drawn = set(re.findall(r">(gateway(?:_[a-z]+)?)<", drawing("images/street.svg")))
    assert packages <= drawn == {*PACKAGES}


def drawing(picture):
    """Return the text of a drawing."""
    return (DOCS / picture).read_text(encoding="utf-8")


@cache
def source():
    """Return all code of the product as one text."""
    paths = [path for folder in ("gateway", "packages") for path in (ROOT / folder).rglob("*.[pch]*")]
    return "\n".join(path.read_text(encoding="utf-8") for path in paths if path.suffix in (".py", ".h"))
