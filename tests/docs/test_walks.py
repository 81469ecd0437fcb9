"""Five walks of strangers from a clean wheel: README, the tutorials, an own bench, a folder of logs, testers' programs.

In CI the tutorials are walked (:mod:`tests.test_tutorials`), in the full size all five.
"""

import csv
import io
import re
import socket

import pytest
import vans
from walks import ROOT, Walk, blocks, environment, stop

pytestmark = [pytest.mark.long, pytest.mark.full("of the full size")]


@pytest.fixture
def walk(tmp_path, tmp_path_factory):
    yield Walk(environment(tmp_path_factory), tmp_path)
    stop(tmp_path)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def begin(walk, name, command):
    """Begin a program beside the walk."""
    walk.run(f"{command} > {walk.folder}/{name}.txt 2>&1 & echo $! > {walk.folder}/{name}.pid")


def wait_for(walk, command):
    walk.run(f"for k in $(seq 300); do {command} > /dev/null 2>&1 && exit 0; sleep 0.2; done; exit 1")


def test_readme(walk, tmp_path):
    """As in a checkout, on a bus of this machine in place of vcan0; lines that need hardware are not run."""
    for name in ("examples", "gateway.toml", "dbc"):
        (tmp_path / name).symlink_to(ROOT / name)
    port = free_port()
    begin(walk, "bus", f"gateway bus 127.0.0.1:{port}")
    text = (ROOT / "README.md").read_text()
    text = re.sub(r"^.*socketcan:can0.*\n", "", text, flags=re.M)
    text = text.replace("python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/gateway", "gateway")
    text = text.replace("\nscripts/test\n", "\n").replace(
        "socketcan:vcan0 &", f"loopback:127.0.0.1:{port} > run.txt 2>&1 &"
    )
    text = text.replace("&                                 # with", "& echo $! > run.pid; sleep 5  # with")
    text = text.replace("gateway faults list", "gateway faults list && cat run.txt")
    (tmp_path / "README.md").write_text(text.replace("socketcan:vcan0", f"loopback:127.0.0.1:{port}"))
    walk.follow(tmp_path / "README.md")
    assert walk.ran >= 4
    assert walk.shown >= 5
    assert (tmp_path / "car.toml").exists()


DBC = """VERSION ""
NS_ :
BS_:
BU_: Pump Tester
BO_ 100 Command: 2 Tester
 SG_ Wanted : 0|16@1+ (0.1,0) [0|500] "l/min" Pump
BO_ 101 State: 4 Pump
 SG_ Flow : 0|16@1+ (0.1,0) [0|500] "l/min" Tester
 SG_ Pressure : 16|16@1+ (0.01,0) [0|100] "bar" Tester
BO_ 102 Heat: 2 Pump
 SG_ Oil : 0|8@1+ (1,-40) [-40|150] "degC" Tester
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_ "GenMsgCycleTime" BO_ 100 20;
BA_ "GenMsgCycleTime" BO_ 101 20;
BA_ "GenMsgCycleTime" BO_ 102 100;
"""
OWN = """[[bus]]
name = "pump"
uri = "virtual:pump"
database = ["pump.dbc"]

[[bus.check]]
message = "State"
timeout_ms = 100.0

[[monitor]]
name = "limits"
type = "signal"
signal = [{ signal = "Heat.Oil", plausible = [-30, 110], failed_ms = 500, code = "P0217" }]
"""
SCENARIO = """name = "{name}"
description = "The oil of the pump."
duration_s = 10.0
config = "gateway.toml"

[[ecu]]
type = "restbus"

[ecu.signals]
"Command.Wanted" = 120
"State.Flow" = 120
"Heat.Oil" = {oil}
{expect}"""
EXPECT = '\n[[expect]]\ndtc = "P0217-85"\nafter_s = 4.0\nby_s = 8.0\n'


def test_a_bench_with_a_database_of_its_own(walk, tmp_path):
    files = {
        "pump.dbc": DBC,
        "gateway.toml": OWN,
        "cool.toml": SCENARIO.format(name="cool", oil="60", expect=""),
        "hot.toml": SCENARIO.format(name="hot", oil="[[0, 60], [4, 60], [6, 130]]", expect=EXPECT),
        "wrong/missed.toml": SCENARIO.format(name="missed", oil="60", expect=EXPECT).replace('"gate', '"../gate'),
        "pytest.ini": "[pytest]\ngateway_scenarios = .\ngateway_config = gateway.toml\npythonpath = .\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert "5 faults" in walk.run("gateway check gateway.toml | head -1") or walk.said
    assert "2 passed" in walk.run("python -m pytest hot.toml cool.toml --junitxml=junit.xml")
    said = walk.run("python -m pytest wrong -o gateway_scenarios=wrong", fails=True)
    assert "1 failed" in said
    assert "P0217-85 not set" in said
    assert "limits.Oil.high" in walk.run("gateway demo hot.toml --speed 0")


#: Formats of logs, of which one asks for an extra.
FORMATS = ("log", "asc", "blf", "trc", "csv", "parquet", "log.gz", "log.xz")


def test_a_folder_of_24_logs_in_8_formats(walk, tmp_path):
    (tmp_path / "van.dbc").write_text(vans.DBC)
    faults = {(3, 1): "coolant", (5, 0): "wheel", (7, 1): "battery", (9, 1): "dead"}
    for k in range(3):
        vans.write(tmp_path / f"healthy/{k}.log", vans.drive(900 + k, 180.0))
    for k in range(24):
        car, day = divmod(k, 2)
        suffix = FORMATS[k % len(FORMATS)]
        frames = vans.drive(k, 90.0, faults.get((car, day), ""), vans.BEGIN_S + 86400 * day + 600 * car)
        path = vans.write(tmp_path / f"logs/van{car:02d}/day{day}.{suffix.partition('.')[0]}", frames)
        if "." in suffix:
            walk.run(f"{'gzip' if suffix.endswith('gz') else 'xz'} {path}")
    other = vans.drive(77, 10.0)
    other["can_id"] += 0x400
    vans.write(tmp_path / "logs/van11/other.log", other)
    walk.run("gateway learn van.dbc healthy/*.log -o car.toml")
    said = walk.run("gateway fleet run 'logs/**' -c car.toml -o verdicts --workers 0")
    assert "25 logs, 0 judged before; now: 1 foreign, 24 whole" in said
    assert "3 of 12 cars with faults, 1 unusual without a fault, 1 logs not judged whole" in said
    walk.run("gateway fleet report verdicts --html fleet.html --csv fleet.csv")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "fleet.csv").read_text())))
    assert {(row["car"], row["kind"]) for row in rows} == {
        ("van03", "cause"), ("van07", "cause"), ("van09", "cause"), ("van05", "unusual"), ("van11", "log"),
    }  # fmt: skip
    assert all(row["since"].startswith("2025-10-") for row in rows if row["kind"] != "log")
    page = (tmp_path / "fleet.html").read_text()
    assert "http" not in page, "the page needs nothing from elsewhere"
    assert "off the relation by [km/h], highest of each car" in page
    assert "0 judged" not in walk.run("gateway fleet run 'logs/**' -c car.toml -o verdicts --workers 0")


def test_testers_programs(walk, tmp_path):
    """The blocks of docs/diagnostics.md, doip.md and sovd.md, as they are but for their ports."""
    bus, doip, page = free_port(), free_port(), free_port()
    config = (ROOT / "gateway.toml").read_text().replace("29536", str(bus))
    (tmp_path / "gateway.toml").write_text(f"{config}\n[output.doip]\nport = {doip}\n")
    begin(walk, "bus", f"gateway bus 127.0.0.1:{bus}")
    begin(walk, "run", f"gateway run gateway.toml --serve --port {page}")
    wait_for(walk, f"curl -sf http://127.0.0.1:{page}/sovd/v1/components/gateway/faults")
    walk.run(f"gateway simulate crank_missed_tooth --bus loopback:127.0.0.1:{bus}")
    assert "P0336-39" in walk.run("gateway faults list")
    base = f"http://127.0.0.1:{page}/sovd/v1/components/gateway"
    sovd = (ROOT / "docs/sovd.md").read_text()
    (asked,) = (text for _, language, _, text in blocks(sovd) if language == "sh" and "curl" in text)
    lines = [line for line in asked.splitlines() if line.startswith('curl "')]
    assert len(lines) >= 3
    said = [walk.run(f"G={base}\n{line.replace('curl', 'curl -sf')}") for line in lines]
    assert "P0336-39" in said[0]
    assert '"P0336-39"' in said[1]
    for name, port in (("diagnostics", bus), ("doip", doip)):
        text = (ROOT / f"docs/{name}.md").read_text()
        (program,) = (text for _, language, _, text in blocks(text) if language == "python")
        program = program.replace("29536", str(port)).replace(
            "0x1000, client", f"0x1000, tcp_port={port}, udp_port={port}, client"
        )
        if name == "diagnostics":  # it clears what the other one reads
            program = program.replace("    client.clear_dtc()\n", "")
        (tmp_path / f"{name}.py").write_text(program)
        assert re.search(r"^033639 \d+$", walk.run(f"python {name}.py"), re.M)
    assert "22F190" in walk.run("gateway request 22F190 || true")
