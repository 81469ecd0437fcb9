"""Copies of the checkout, whole or without the folders of a plant or a package."""

import shutil
import subprocess

from uses import PLANTS, ROOT


def places(name):
    """Return the folders of a package, or of a plant."""
    if name not in PLANTS:
        return [f"packages/{name}"]
    return [f"packages/gateway_plants/{name}", *(f"{top}/{name}" for top in ("dbc", "scenarios", "tests", "docs"))]


def copied(tree, without=()):
    """Copy the files that git knows, but those in some folders; git knows those of the copy, as tests ask it.

    Bytecode comes with its source: to compile all of them takes longer than many a test.
    """
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    for name in names:
        if not any(name.startswith(f"{folder}/") for folder in without) and (ROOT / name).exists():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)
            for kept in (ROOT / name).parent.glob(f"__pycache__/{(ROOT / name).stem}.*.pyc"):
                (tree / name).parent.joinpath("__pycache__").mkdir(exist_ok=True)
                shutil.copy2(kept, (tree / name).parent / "__pycache__" / kept.name)
    for command in (["git", "init", "--quiet"], ["git", "add", "--all"]):
        subprocess.run(command, cwd=tree, check=True)
