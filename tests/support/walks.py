"""Walks of strangers: an environment with the wheel alone, and pages that are followed word for word in it."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from zipfile import ZipFile

from once import once

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"^```(.*)$")
#: Words of an output that a page shows; numbers may differ.
WORD = re.compile(r"[A-Za-z_][\w.\-]{2,}")


def environment(tmp_path_factory):
    """Return the folder of the programs of an environment in which this wheel is installed, and nothing of a checkout.

    The packages that it needs are those of the environment of the tests.
    """
    home = tmp_path_factory.getbasetemp()
    home = (home.parent if "PYTEST_XDIST_WORKER" in os.environ else home) / "stranger"

    def made():
        wheels = home / "wheels"
        for command in (
            (sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(wheels)),
            (sys.executable, "-m", "venv", "--without-pip", str(home)),
        ):
            subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
        (site,) = (home / "lib").glob("python*/site-packages")
        with ZipFile(next(wheels.glob("*.whl"))) as wheel:
            wheel.extractall(site)
            (entries,) = (name for name in wheel.namelist() if name.endswith("entry_points.txt"))
            module, name = re.search(r"^gateway = ([\w.]+):(\w+)$", wheel.read(entries).decode(), re.M).groups()
        (site / "needs.pth").write_text("\n".join(each for each in sys.path if each.endswith("site-packages")))
        script = home / "bin" / "gateway"
        guarded = f'if __name__ == "__main__":\n    sys.exit({name}())\n'  # as pip does; workers import it, too
        script.write_text(f"#!{home}/bin/python\nimport sys\nfrom {module} import {name}\n{guarded}")
        script.chmod(0o755)
        return home / "bin"

    return once(tmp_path_factory, "stranger", made)


def blocks(text):
    """Yield line, language, title and text of each block of code of a page."""
    info, body, begun = None, [], 0
    for number, line in enumerate(text.splitlines(), 1):
        found = FENCE.match(line)
        if found and info is None:
            info, body, begun = found[1].strip(), [], number
        elif found:
            title = re.search(r'title="([^"]+)"', info)
            yield begun, (info.split() or [""])[0], title and title[1], "".join(f"{each}\n" for each in body)
            info = None
        elif info is not None:
            body.append(line)


@dataclass
class Walk:
    """A walk in a folder.

    Attributes:
        bin: folder of the programs.
        folder: in which it began; its environment knows no trusted code.
        renamed: text of a command -> what is run in its place, for ports and interfaces that this machine may not have.
    """

    bin: Path
    folder: Path
    renamed: dict[str, str] = field(default_factory=dict)
    ran: int = 0
    said: str = ""
    shown: int = 0

    def __post_init__(self):
        self.here = self.folder

    def environ(self):
        left = {k: v for k, v in os.environ.items() if not k.startswith(("GATEWAY_TRUST", "PYTHONPATH", "PYTEST_"))}
        mine = {"XDG_CONFIG_HOME": str(self.folder / ".config"), "PYTEST_ADDOPTS": "-p no:xdist -p no:cacheprovider"}
        return left | mine | {"PATH": f"{self.bin}:{os.environ['PATH']}", "COLUMNS": "180"}

    def run(self, text, *, fails=False):
        """Run a block of a shell, all of it; returns what it said."""
        for old, new in self.renamed.items():
            text = text.replace(old, new)
        where = self.folder / ".where"
        script = f"set -eo pipefail\ntrap 'pwd > {where}' EXIT\n{text}"
        done = subprocess.run(
            ["bash", "-c", script], cwd=self.here, env=self.environ(), capture_output=True, text=True, timeout=600,
            check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        said = done.stdout + done.stderr
        assert (done.returncode != 0) == fails, f"{text}\n{said}"
        assert "Traceback" not in done.stderr, said
        self.here = Path(where.read_text().strip())
        self.said += said
        self.ran += 1
        return said

    def follow(self, page, *, wanted=lambda text: True):
        """Follow a page: write its files, run its commands, and find in their outputs what it shows.

        Args:
            page: of the documentation.
            wanted: whether a block is of this walk.
        """
        last = ""
        for line, language, title, text in blocks(page.read_text(encoding="utf-8")):
            if title:
                (self.here / title).write_text(text)
            elif language in ("sh", "sh-fails") and wanted(text):
                last = self.run(text, fails=language == "sh-fails")
            elif not language and last:
                self.compare(text, last, f"{page.name}:{line}")

    def compare(self, shown, said, place):
        """Find each line that a page shows: its words stand in one line of the output, in this order."""
        said = [" ".join(each.replace("│", " ").split()) for each in said.splitlines()]
        for line in shown.splitlines():
            words = [re.escape(word) for word in WORD.findall(line)]
            if words:
                wanted = re.compile(r"(?<!\w)" + r".*?".join(words))
                assert any(wanted.search(each) for each in said), f"{place}: not said: {line}\n" + "\n".join(said)
                self.shown += 1


def stop(folder):
    """End the programs that a walk has begun and noted as NAME.pid."""
    for file in folder.rglob("*.pid"):
        try:
            os.kill(int(file.read_text()), 9)
        except (OSError, ValueError):
            pass
