"""Tutorials do what they say: their files are written, their commands run, one after the other, in an empty folder."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from amount import FULL

TUTORIALS = sorted((Path(__file__).parents[1] / "docs" / "tutorials").glob("*.md"))
#: A block of code: its language, the name of its file if it has one, its text.
BLOCK = re.compile(r'^```([\w-]+)(?: title="([^"]+)")?\n(.*?)^```', re.MULTILINE | re.DOTALL)


def environment(folder):
    """Return that of a person whose first program is the gateway of these tests, and who has trusted no code yet."""
    return {
        **{name: value for name, value in os.environ.items() if name != "GATEWAY_TRUST"},
        "XDG_CONFIG_HOME": str(folder / ".config"),
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTEST_ADDOPTS": "-p no:xdist",
    }


#: Those of the bench and the fleet run what other tests of CI run, too.
PAGES = [page for page in TUTORIALS if FULL or page.stem in ("car", "monitor", "plant")]


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_tutorial_does_what_it_says(page, tmp_path):
    folder, said, ran = tmp_path, "", 0
    for language, file, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if file:
            (folder / file).write_text(text)
        elif language in ("sh", "sh-fails"):
            for command in text.splitlines():
                if command.startswith("cd "):
                    folder /= command.removeprefix("cd ")
                    continue
                done = subprocess.run(
                    ["sh", "-c", command],
                    cwd=folder,
                    env=environment(tmp_path),
                    capture_output=True,
                    text=True,
                    timeout=300,
                    check=False,
                )
                said += done.stdout + done.stderr
                assert done.returncode == (language == "sh-fails"), f"{command}\n{done.stdout}{done.stderr}"
                ran += 1
    assert ran >= 3
    # What the page shows of DTCs was said, in these words.
    for shown in re.findall(r"DTC \S+ SET  \S+|^[│ ]+ben[^\n]*[PU]\w+-\w\w", page.read_text(), re.MULTILINE):
        assert " ".join(shown.split()) in " ".join(said.split())
