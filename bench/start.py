"""How long a start takes and how much it weighs, beside the commands of python-can and cantools, in one run.

CPU seconds (user and system), wall time and largest resident memory of one process each; the least of several runs,
with bytecode and kernels there. The peers run as one installs them, without asammdf and matplotlib, which they load
where they find them; ours runs with what is installed here. Then a start on an empty cache of kernels, what an import
of each spends its time on, and what is to be installed. Nothing here imports the gateway: a child's memory begins with
its parent's.

    python bench/start.py [--runs 5] [--no-cold] [--no-wheel] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import defaultdict
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
GATEWAY = [sys.executable, "-c", "from gateway.cli import main; main()"]
_ALONE = "import runpy, sys; sys.modules['asammdf'] = sys.modules['matplotlib'] = None; "
PEER = [
    *(sys.executable, "-c"),
    _ALONE + "del sys.argv[0]; runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)",
]
#: Lines of the demo that tell how far it is: by (name, pattern).
MARKS = (("first line", re.compile(r".")), ("first frame", re.compile(r"^ +\d+\.\d+ s ")))
TICK_S = 1 / os.sysconf("SC_CLK_TCK")
MB = 1e6

#: Name -> (command, name of the peer that it is compared with).
COMMANDS = {
    "python -m can.logger --help": ([*PEER, "can.logger", "--help"], ""),
    "cantools --help": ([*PEER, "cantools", "--help"], ""),
    "cantools dump crank.dbc": ([*PEER, "cantools", "dump", "dbc/crank/crank.dbc"], ""),
    "gateway --help": ([*GATEWAY, "--help"], "cantools --help"),
    "gateway check": ([*GATEWAY, "check", "gateway.toml"], "cantools dump crank.dbc"),
    "gateway doctor": ([*GATEWAY, "doctor", "gateway.toml"], "python -m can.logger --help"),
    "gateway faults list": (
        [*GATEWAY, "faults", "list", "--memory", "{folder}/faults.sqlite"],
        "python -m can.logger --help",
    ),
    "gateway run, for 0 s": (
        [
            *(*GATEWAY, "run", "gateway.toml", "--bus", "loopback:127.0.0.1:1"),
            *("--duration", "0", "--memory", "{folder}/faults.sqlite"),
        ],
        "python -m can.logger --help",
    ),
}
IMPORTS = {
    "gateway check": [*GATEWAY, "check", "gateway.toml"],
    "import can": [sys.executable, "-c", _ALONE + "import can"],
    "import cantools": [sys.executable, "-c", _ALONE + "import cantools"],
}


def environment(**more):
    """The environment of a command: bytecode is kept, as in an installed package."""
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    path = os.pathsep.join(part for part in (str(ROOT), str(ROOT / "packages"), kept.get("PYTHONPATH", "")) if part)
    return {**kept, "PYTHONPATH": path, **more}


def spent_s(pid):
    """CPU time of a running process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) * TICK_S


def start(command, marks=(), **more):
    """Run a command to its end; returns CPU and wall time [s], memory [MB], and when each mark was printed."""
    begun = time.perf_counter()
    child = subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment(**more),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    reached, waiting, said = {}, list(marks), []
    for line in child.stdout:
        said.append(line)
        while waiting and waiting[0][1].search(line):
            at = {"cpu_s": spent_s(child.pid), "wall_s": time.perf_counter() - begun}
            reached[waiting.pop(0)[0]] = at
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode or waiting:
        raise SystemExit(f"{' '.join(command)} ended with {child.returncode}:\n{''.join(said)}")
    return {
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "wall_s": time.perf_counter() - begun,
        "rss_mb": usage.ru_maxrss * 1024 / MB,
        **reached,
    }


def warm(runs):
    """Each command in turn, so that a busy moment meets all of them; a row for each."""
    found = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        commands = {
            name: [part.format(folder=folder) if "{folder}" in part else part for part in command]
            for name, (command, _) in COMMANDS.items()
        }
        # The first run of all makes the fault memory, and the kernels and bytecode that are not there.
        start(commands["gateway run, for 0 s"])
        for command in commands.values():
            start(command)
        for _ in range(runs):
            for name, command in commands.items():
                found[name].append(start(command))
    rows = []
    for name, results in found.items():
        best = {key: min(result[key] for result in results) for key in results[0]}
        rows.append({"name": name, "against": COMMANDS[name][1], **best})
    cpu = {row["name"]: row["cpu_s"] for row in rows}
    for row in rows:
        row["ratio"] = row["cpu_s"] / cpu[row["against"]] if row["against"] else None
    return rows


def cold():
    """The demo on an empty cache of kernels, then again; and what the cache holds."""
    with tempfile.TemporaryDirectory() as cache:
        demo = [*GATEWAY, "demo", "--speed", "0"]
        first, second = (start(demo, MARKS, GATEWAY_CACHE_DIR=cache) for _ in range(2))
        files = [file for file in Path(cache).rglob("*") if file.is_file()]
        size = sum(file.stat().st_size for file in files) / MB
    return {"cold": first, "again": second, "cache_mb": size, "cache_files": len(files)}


def imports(runs):
    """What each spends on the modules of which package [ms], and how many modules."""
    found = {}
    for name, command in IMPORTS.items():
        least = defaultdict(lambda: float("inf"))
        for _ in range(runs):
            ended = subprocess.run(
                command,
                cwd=ROOT,
                env=environment(PYTHONPROFILEIMPORTTIME="1"),
                capture_output=True,
                text=True,
                check=True,
            )
            for line in ended.stderr.splitlines():
                if match := re.match(r"import time: +(\d+) \| +\d+ \| +(\S+)", line):
                    least[match[2]] = min(least[match[2]], int(match[1]) / 1000)
        packages = defaultdict(float)
        for module, ms in least.items():
            packages[module.partition(".")[0]] += ms
        parts = sorted(packages.items(), key=lambda part: -part[1])[:8]
        found[name] = {"modules": len(least), "ms": sum(least.values()), "packages": dict(parts)}
    return found


def closure(requirements):
    """Every distribution that these requirements bring into this environment, and those that are missing."""
    there, missing, waiting = {}, set(), [(Requirement(text), "") for text in requirements]
    seen = set()
    while waiting:
        requirement, extra = waiting.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        name = canonicalize_name(requirement.name)
        for asked in ("", *requirement.extras):
            if (name, asked) in seen:
                continue
            seen.add((name, asked))
            try:
                there[name] = distribution(name)
            except PackageNotFoundError:
                missing.add(name)
                continue
            waiting += [(Requirement(text), asked) for text in there[name].requires or ()]
    return there, missing


def weigh(requirements):
    """Size of what these requirements install [MB], and how many distributions that are."""
    there, missing = closure(requirements)
    size = sum(
        Path(path).stat().st_size
        for one in there.values()
        for path in map(one.locate_file, one.files or ())
        if Path(path).is_file()
    )
    return {"distributions": len(there), "mb": size / MB, "missing": sorted(missing)}


def environments():
    """What an installation weighs: ours, with each extra, and the peers'."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    base, extras = project["dependencies"], project["optional-dependencies"]
    found = {"python-can": weigh(["python-can"]), "cantools": weigh(["cantools"])}
    found["ecu-gateway"] = weigh(base)
    for extra, more in extras.items():
        if extra != "all":
            found[f"ecu-gateway[{extra}]"] = weigh([*base, *more])
    whole = [one for extra, more in extras.items() if extra != "all" for one in more]
    found["ecu-gateway[all]"] = weigh([*base, *whole])
    return found


def wheel_mb():
    """Size of the wheel [MB]."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "pip",
            "wheel",
            "--quiet",
            "--no-deps",
            "--wheel-dir",
            folder,
            ".",
        ]
        subprocess.run(command, cwd=ROOT, check=True)
        (wheel,) = Path(folder).glob("*.whl")
        return wheel.stat().st_size / MB


def show(found):
    print(f"{'warm start':30s} {'CPU s':>7s} {'wall s':>7s} {'RSS MB':>7s}")
    for row in found["warm"]:
        beside = f"  {row['ratio']:5.1f} x {row['against']}" if row["against"] else ""
        print(f"{row['name']:30s} {row['cpu_s']:7.2f} {row['wall_s']:7.2f} {row['rss_mb']:7.0f}{beside}")
    if "demo" in found:
        demo = found["demo"]
        for name, which in (("cold", "an empty cache"), ("again", "the next time")):
            row = demo[name]
            marks = "".join(f", {mark} {row[mark]['cpu_s']:.1f}" for mark, _ in MARKS)
            print(
                f"gateway demo, {which}: {row['cpu_s']:.1f} s of CPU{marks}; wall {row['wall_s']:.1f} s,"
                f" {row['rss_mb']:.0f} MB"
            )
        print(f"cache of kernels: {demo['cache_mb']:.1f} MB in {demo['cache_files']} files")
    for name, row in found["imports"].items():
        parts = ", ".join(f"{package} {ms:.0f}" for package, ms in row["packages"].items())
        print(f"{name}: {row['modules']} modules, {row['ms']:.0f} ms: {parts}")
    if "wheel_mb" in found:
        print(f"wheel: {found['wheel_mb']:.2f} MB")
    for name, row in found["environments"].items():
        lacking = f" (not here: {', '.join(row['missing'])})" if row["missing"] else ""
        print(f"{name}: {row['distributions']} distributions, {row['mb']:.0f} MB{lacking}")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5, help="of each command")
    parser.add_argument("--no-cold", action="store_true", help="no start on an empty cache")
    parser.add_argument("--no-wheel", action="store_true", help="build no wheel")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = {"warm": warm(options.runs)}
    if not options.no_cold:
        found["demo"] = cold()
    found["imports"] = imports(min(options.runs, 3))
    if not options.no_wheel:
        found["wheel_mb"] = wheel_mb()
    found["environments"] = environments()
    if options.json:
        print(json.dumps(found))
    else:
        show(found)


if __name__ == "__main__":
    main()
