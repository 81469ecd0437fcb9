"""The packages for an index and for the Dockerfile, without a container engine: its wheel is made of what it copies."""

import importlib.util
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path
from zipfile import ZipFile

import pytest
import typer
import yaml

from gateway import __version__
from gateway.cli import app
from gateway.cli.version import version

ROOT = Path(__file__).parents[2]


def matches(pattern, path):
    """Return whether a pattern of .dockerignore matches a path, or a folder that it lies in; both from the root."""
    parts = (re.escape(part).replace(r"\*", "[^/]*") if part != "**" else "**" for part in pattern.split("/"))
    text = "/".join(parts).replace("**/", "(?:.*/)?").replace("/**", "/.*")
    return re.fullmatch(f"{text}(?:/.*)?", path) is not None


def ignored(path):
    patterns = (ROOT / ".dockerignore").read_text().split()
    assert not any(pattern.startswith(("!", "#")) for pattern in patterns)  # unknown here
    return any(matches(pattern, path) for pattern in patterns)


def copied():
    """Return the sources and the targets of the COPY lines of the stage that builds, below its work folder."""
    build = (ROOT / "Dockerfile").read_text().split("\nFROM ")[1]
    lines = re.findall(r"^COPY (.*)$", build, re.M)
    assert lines
    assert not any(line.startswith("--") for line in lines)
    return [(source, target) for line in lines for *sources, target in [line.split()] for source in sources]


def tracked():
    if not (ROOT / ".git").exists():
        pytest.skip("these tests are of a checkout")
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
    return listed.stdout.splitlines()


def built(kind, folder, to):
    """Return the package that hatchling makes of a folder."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", to]
    made = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    (package,) = to.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return package


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Return the wheel that is made of what the Dockerfile copies, without git."""
    tree = tmp_path_factory.mktemp("copied")
    for source, target in copied():
        files = [file for file in tracked() if file == source or file.startswith(f"{source}/")]
        assert files, f"COPY {source}: there is no such thing"
        for file in files:
            assert not ignored(file), f".dockerignore keeps {file} out"
            place = Path(target) / Path(file).name if file == source else Path(target) / Path(file).relative_to(source)
            (tree / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / file, tree / place)
    return built("wheel", tree, tree / "made")


@pytest.mark.evidence("Releases: image")
def test_the_wheel_is_made_of_what_is_copied(wheel):
    names = set(ZipFile(wheel).namelist())
    packages = {file.removeprefix("packages/") for file in tracked() if file.startswith(("gateway/", "packages/"))}
    assert packages <= names
    for folder in ("dbc", "scenarios", "examples"):
        assert {f"gateway/shipped/{file}" for file in tracked() if file.startswith(f"{folder}/")} <= names
    assert "gateway/shipped/gateway.toml" in names
    tops = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    assert {f"{top}/py.typed" for top in tops} <= names
    written = {name for name in names if re.fullmatch(r"gateway_plants/\w+/monitor/generated/t\d\.py", name)}
    makers = {name.split("/")[1] for name in packages if name.endswith("/residual_generators.py")}
    assert {name.split("/")[1] for name in written} == makers, "made at build"
    others = names - packages - written
    assert others == {name for name in others if name.startswith("gateway/shipped/") or ".dist-info/" in name}


@pytest.mark.evidence("Releases: same bytes")
def test_the_wheel_of_the_source_package_is_the_same_byte_for_byte(wheel, tmp_path):
    for name in tracked():
        (tmp_path / "tree" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, tmp_path / "tree" / name)
    source = built("sdist", tmp_path / "tree", tmp_path / "made")
    with tarfile.open(source) as packed:
        packed.extractall(tmp_path, filter="data")
    unpacked = tmp_path / source.name.removesuffix(".tar.gz")
    there = {str(path.relative_to(unpacked)) for path in unpacked.rglob("*") if path.is_file()}
    assert there == {*tracked(), "PKG-INFO"}
    again = built("wheel", unpacked, tmp_path / "again")
    assert again.name == wheel.name
    assert again.read_bytes() == wheel.read_bytes()


@pytest.mark.evidence("Releases: version")
def test_the_version_is_that_of_the_tag_and_tells_the_commit(tmp_path):
    """Of a folder without git, of commits without tags, with the right one, a changed file, and a wrong tag."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    file = tmp_path / "gateway" / "__init__.py"
    file.parent.mkdir()
    file.write_text('__version__ = "1.2.3"\n')

    def git(*words):
        who = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "init.defaultBranch=main")
        command = ["git", *who, *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.strip()

    assert (hooks.version_of(tmp_path), hooks.commit_of(tmp_path)) == ("1.2.3", "")
    git("init")
    assert hooks.version_of(tmp_path) == "1.2.3", "nothing is committed"
    git("add", ".")
    git("commit", "-m", "one")
    commit = git("rev-parse", "--short=12", "HEAD")
    assert (hooks.version_of(tmp_path), hooks.commit_of(tmp_path)) == (f"1.2.3.dev0+g{commit}", commit)
    data = {"force_include": {}}
    hook = hooks.Commit(str(tmp_path), {}, None, None, str(tmp_path), "wheel")
    hook.initialize("standard", data)
    ((kept, place),) = data["force_include"].items()
    assert (Path(kept).read_text(), place) == (f"{commit}\n", "gateway/shipped/COMMIT")
    git("tag", "v1.2.3")
    assert hooks.version_of(tmp_path) == "1.2.3"
    file.write_text('__version__ = "1.2.4"\n')
    with pytest.raises(ValueError, match=r"tag v1\.2\.3.*1\.2\.4"):
        hooks.version_of(tmp_path)
    git("tag", "-d", "v1.2.3")
    assert hooks.version_of(tmp_path) == f"1.2.4.dev0+g{commit}.dirty"


def test_a_checkout_says_its_commit():
    ask = ["git", "rev-parse", "--short=12", "HEAD"]
    head = subprocess.run(ask, cwd=ROOT, capture_output=True, text=True, check=False)
    if head.returncode or not (ROOT / ".git").exists():
        pytest.skip("no commit here")
    assert re.fullmatch(rf"{re.escape(__version__)} \({head.stdout.strip()}(-dirty)?\)", version())


@pytest.mark.parametrize(
    "path",
    [
        "gateway/bus/__pycache__/frames.cpython-311.pyc",
        "examples/car/faults.sqlite",
        "examples/car/faults.sqlite-wal",
        "examples/bench/left/too_early/can.log",
        "examples/bench/.pytest_cache/v/cache/nodeids",
        "faults.sqlite",
        ".venv/bin/python",
        ".git/HEAD",
    ],
)
def test_what_work_leaves_behind_is_not_in_the_image(path):
    assert ignored(path)


def test_what_compose_starts_is_there():
    """Each command is one that the gateway has; files, folders and ports of the parts fit each other and the image."""
    folder = ROOT / "deploy"
    compose = yaml.safe_load((folder / "compose.yml").read_text())
    services, image = compose["services"], (ROOT / "Dockerfile").read_text()
    assert (folder / services["gateway"]["build"]["context"] / "Dockerfile").samefile(ROOT / "Dockerfile")
    for name in services["gateway"]["build"]["args"]:
        assert f"\nARG {name}=" in image
    (state,) = re.findall(r"^VOLUME (.*)$", image, re.M)
    assert 'ENTRYPOINT ["gateway"]' in image
    used = set()
    for name in ("gateway", "page"):
        command, *words = services[name]["command"]
        asked = typer.main.get_command(app).get_command(None, command).make_context(command, list(words)).params
        assert Path(asked["status"]).parent == Path(state)
        assert services[name]["volumes"] == [f"state:{state}"]
        used |= {asked["status"]}
        if name == "page":
            assert f":{asked['port']}/metrics'" in services[name]["healthcheck"]["test"][-1]
            targets = yaml.safe_load((folder / "prometheus/prometheus.yml").read_text())["scrape_configs"]
            assert targets[0]["static_configs"][0]["targets"] == [f"{asked['host']}:{asked['port']}"]
    assert len(used) == 1, "the page looks where the gateway is"
    mounts = dict(each.split(":")[1::-1] for each in services["prometheus"]["volumes"])
    flags = dict(word.split("=") for word in services["prometheus"]["command"])
    file = Path(flags["--config.file"])
    assert (folder / mounts[str(file.parent)] / file.name).is_file()
    named = {source for source in (*mounts.values(), "state") if not source.startswith(".")}
    assert named == set(compose["volumes"])
    assert flags["--storage.tsdb.path"] in mounts
    assert {each.get("network_mode") for each in services.values()} == {"host"}
