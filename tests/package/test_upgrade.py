"""Strangers' packages work with this version as a wheel, and with a later one after an upgrade of the environment."""

import json
import re
import shutil
import subprocess
import sys

import pytest
from amount import FULL
from checkout import copied

from gateway import __version__
from gateway_fdi.common.resources import shipped

LATER = "99.1.0"
#: With a stranger's key function.
UDS = 'request = 0x7E0\nresponse = 0x7E8\nsecurity = [{ level = 3, secret = "aa", key = "workshop" }]'


def done(*command, cwd):
    ended = subprocess.run([*map(str, command)], cwd=cwd, capture_output=True, text=True, timeout=600, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.fixture
def wheels(tmp_path):
    """Return the wheels of this version and of a later one, and the folder with those of the strangers."""
    tree, made = tmp_path / "tree", tmp_path / "wheels"
    copied(tree, ("tests", "docs", "bench"))
    build = (sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", made)
    for example in ("motor_load", "workshop"):
        done(*build, cwd=tree / "examples" / example)
    done(*build, cwd=tree)
    init = tree / "gateway" / "__init__.py"
    init.write_text(re.sub(r'__version__ = ".*"', f'__version__ = "{LATER}"', init.read_text()))
    done(*build, cwd=tree)
    (now,), (later,) = (made.glob(f"ecu_gateway-{version}-*") for version in (__version__, LATER))
    shutil.rmtree(tree)
    return now, later, made


@pytest.fixture
def environment(tmp_path):
    """Return an environment with nothing in it, a function that installs, and one that runs the gateway there."""
    home = tmp_path / "environment"
    done(sys.executable, "-m", "venv", "--without-pip", home, cwd=tmp_path)
    (site,) = (home / "lib").glob("python*/site-packages")
    needs = [name for name in sys.path if name.endswith("site-packages")]

    def install(*files):
        pip = (sys.executable, "-m", "pip", "--python", home / "bin" / "python", "install", "-q", "--no-compile")
        done(*pip, "--no-deps", "--no-index", "--upgrade", *files, cwd=tmp_path)

    def gateway(*arguments, cwd=tmp_path):
        """With what the gateway needs, which pip is not to see."""
        (site / "needs.pth").write_text("\n".join(needs))
        try:
            return done(home / "bin" / "gateway", *arguments, cwd=cwd)
        finally:
            (site / "needs.pth").unlink()

    return install, gateway


def placed(tmp_path):
    """Return the folders of a plant that is installed, and of a monitor that lies beside its configuration."""
    for name in ("motor_load", "battery_voltage"):
        (tmp_path / name).mkdir()
        for file in (shipped("examples") / name).iterdir():
            if file.suffix in (".toml", ".dbc") or (name == "battery_voltage" and file.suffix == ".py"):
                text = file.read_text().replace('"motor_load:MONITOR"', '"motor_load"')
                (tmp_path / name / file.name).write_text(text.replace('"motor_ecu:ECU"', '"motor"'))
    with (tmp_path / "battery_voltage" / "gateway.toml").open("a") as file:
        file.write(f"\n[output.uds]\n{UDS}\n")
    return tmp_path / "motor_load", tmp_path / "battery_voltage"


@pytest.mark.evidence("Releases: upgrade")
@pytest.mark.long
def test_strangers_packages_survive_an_upgrade(wheels, environment, tmp_path):
    """In the full size their scenarios run with each version."""
    now, later, made = wheels
    install, gateway = environment
    install(now, *made.glob("motor*"), *made.glob("*workshop*"))
    plant, monitor = placed(tmp_path)
    log = tmp_path / "a.bench"
    log.write_text("1500 can0 1A0 0011\n2500 can1 1A0 2233\n3500 can0 1A1 44\n")
    for version in (__version__, LATER):
        if version == LATER:
            install(later)
        assert gateway("--version").split() == ["gateway", version]
        assert gateway("workshop", log) == "1A0  2\n1A1  1\n"  # a command, by a reader
        brought = json.loads(gateway("doctor", "--json"))["plugins"]
        assert {door: list(names) for door, names in brought.items() if names} == {
            "monitor": ["motor_load"], "ecu": ["motor"], "command": ["workshop"], "reader": [".bench"],
            "protection": ["workshop"], "key": ["workshop"], "server": ["workshop"],
        }  # fmt: skip
        for folder in (plant, monitor):
            gateway("check", "gateway.toml", cwd=folder)
        for folder, scenario in ((plant, "jam.toml"), (monitor, "drained.toml")) if FULL else ():
            assert "NOT as expected" not in gateway("demo", scenario, "--speed", "0", cwd=folder)
