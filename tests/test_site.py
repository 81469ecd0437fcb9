"""The documentation as a site: every page is in it, no link is broken, and nothing is fetched from another host."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_the_site_is_built_without_a_warning(tmp_path):
    build = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "-q",
        "-f",
        str(ROOT / "scripts/site/mkdocs.yml"),
        "-d",
        str(tmp_path),
    ]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(build, capture_output=True, text=True, env=quiet, check=False)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
    keys = (tmp_path / "reference/configuration.html").read_text()
    assert "output.doip.route" in keys
    assert "gateway fleet run" in (tmp_path / "reference/commands.html").read_text()
    fetched = re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="(https?:[^"]*)"', keys)
    assert fetched == []
    for plant in ("crank", "pedal", "steering", "linear", "truck", "structural"):
        assert (tmp_path / plant / f"{plant}.html").is_file()
