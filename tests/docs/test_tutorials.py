"""Tutorials do what they say, from a clean wheel: files are written, commands run, outputs compared."""

import os
import re
import shutil
from pathlib import Path

import pytest
from amount import FULL
from debian import program
from pictures import contents, different
from walks import Walk, environment, stop

TUTORIALS = sorted((Path(__file__).parents[2] / "docs" / "tutorials").glob("*.md"))
#: Those of the car, the bench and the fleet run what other tests of CI run, too.
PAGES = [page for page in TUTORIALS if FULL or page.stem in ("monitor", "road")]


@pytest.fixture
def walk(tmp_path, tmp_path_factory):
    yield Walk(environment(tmp_path_factory), tmp_path)
    stop(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_tutorial_does_what_it_says(page, walk):
    text = page.read_text(encoding="utf-8")
    if "mosquitto" in text:
        program("mosquitto")
    walk.follow(page)
    assert walk.ran >= 3
    # What the page shows of DTCs was said, in these words.
    for shown in re.findall(r"DTC \S+ SET  \S+|^[│ ]+ben[^\n]*[PU]\w+-\w\w", text, re.MULTILINE):
        assert " ".join(shown.split()) in " ".join(walk.said.split())
    # Its picture is the one that its command draws.
    for drawn, shown in zip(
        re.findall(r"(?:-o|--plot) (\S+\.png)", text), re.findall(r"\]\((\S+tutorial\S+\.png)\)", text), strict=False
    ):
        if "GATEWAY_PICTURES" in os.environ:
            shutil.copy(walk.here / drawn, page.parent / shown)
        assert not different(contents(page.parent / shown), contents(walk.here / drawn)), f"GATEWAY_PICTURES=1: {shown}"
