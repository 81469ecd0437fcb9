"""The documentation as a site: every page is in it, no link is broken, and nothing is fetched from another host."""

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from surface import MODULES

ROOT = Path(__file__).parents[2]


@pytest.mark.full("8 s")
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
    parameters = (tmp_path / "reference/monitors.html").read_text()
    assert all(f">{one}<" in parameters for one in ("crank_sync", "pi_bank.output", "structural"))
    python = (tmp_path / "reference/python.html").read_text()
    names = {f"{module}.{name}" for module in MODULES for name in importlib.import_module(module).__all__}
    assert names <= set(re.findall(r'id="([\w.]+)"', python))
    assert "var __index = {" in (tmp_path / "search/search_index.js").read_text()[:20]
    fetched = re.compile(r'<(?:script|link|img)[^>]*(?:src|href)="(?:https?:)?//[^"]*"')
    assert [page.name for page in tmp_path.rglob("*.html") if fetched.search(page.read_text())] == []
    for plant in ("crank", "pedal", "steering", "linear", "truck", "structural"):
        assert (tmp_path / plant / f"{plant}.html").is_file()
