"""Tables of outputs that packages bring: their keys, their errors, their servers; without the package, no such key."""

import subprocess
import sys
from pathlib import Path

import pytest
import rig
from rig import write_config

from gateway.common import plugins
from gateway.config.load import load_config
from gateway.servers.section import SECTIONS, Section, usable
from gateway_commands.configuration_schema import schema
from gateway_fdi.errors import InputError

REPORT = """[report]
socket = "{folder}/report.sock"
[[report.reporter]]
name = "battery"
[[report.reporter.fault]]
name = "hot"
dtc = "P0A1F-98"
description = "too hot"
"""
LACKING = """
import sys
from gateway.common import plugins
plugins._our_plugins = lambda: ()
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.errors import GatewayError
for path in sys.argv[1:]:
    try:
        Gateway(load_config(path))
    except GatewayError as error:
        print(error)
"""


def test_the_schema_has_the_tables_of_all_packages():
    tables = schema()["$defs"]["OutputConfig"]["properties"]
    assert {*tables} == {"dtc_frame", "uds", *SECTIONS}
    assert all(tables[name]["description"] == SECTIONS[name].description for name in SECTIONS)


def test_what_needs_a_package_that_is_not_there_is_an_error_of_its_key(tmp_path):
    asking = '[[ecu]]\nname = "engine"\nrequest = 0x7E0\nresponse = 0x7E8\n'
    hold, report = '[memory]\nsymptoms = "hold"\n', REPORT.format(folder=tmp_path)
    extras = [*(f"[output.uds]\n[output.{table}]\n" for table in ("obd", "j1939", "doip")), asking, hold, report]
    paths = []
    for k, extra in enumerate(extras):
        (tmp_path / str(k)).mkdir()
        paths.append(write_config(tmp_path / str(k), extra=extra))
        load_config(paths[-1])
    ended = subprocess.run([sys.executable, "-c", LACKING, *paths], capture_output=True, text=True, check=False)
    said = ended.stdout.splitlines()
    assert len(said) == len(extras), ended.stderr
    wanted = [f"output.{table}: unknown key" for table in ("obd", "j1939", "doip")]
    wanted += ["ecu: no installed package asks ECUs", "memory.symptoms = 'hold': no installed package finds causes"]
    wanted += ["report: no installed package takes reports"]
    for line, text in zip(said, wanted, strict=True):
        assert text in line


def test_a_section_that_cannot_be_used_is_left_out(monkeypatch):
    monkeypatch.setattr(SECTIONS, "described", lambda: {"obd": SECTIONS["obd"], "mine": InputError("broken")})
    assert [*usable()] == ["obd"]


BEACON = """
from gateway.bus.frames import Frames, single
from gateway.servers.bus_server import BusServer
from gateway.servers.section import Section
from gateway_fdi.common.tomlfile import StrictModel

class Params(StrictModel):
    bus: str | None = None
    signal: str
    identifier: int = 0x6B0

class Beacon(BusServer):
    next_ns = 0

    def __init__(self, params, around):
        self.params, self.around = params, around

    def on_time(self, t_ns):
        count = bytes([len(self.around.memory.entries())]) + self.around.opened + self.around.bus_name.encode()
        return single(t_ns, self.params.identifier, count, bus=self.around.bus)

class BeaconTable(Section):
    params, title, description, needs = Params, "beacon", "tells how many DTCs there are", {"uds": "why not"}
    opened = lambda self, params: b"file"
    signals = lambda self, params: [(params.signal, "signal")]
    identifiers = lambda self, params: [params.identifier]
    server = lambda self, params, around: Beacon(params, around)
    reach = lambda self, params, need: ["everybody"]
    ways_around = lambda self, params: ["output.beacon: everybody"]

SECTION = BeaconTable()
"""
RUN = """
import sys
from pathlib import Path
sys.path[:0] = sys.argv[1:3]
from gateway.common import plugins
from gateway.plugin import Plugin
plugins._foreign_plugins = lambda: ({"x": Plugin(sections={"beacon": "beacon:SECTION"})}, {})
from rig import Rig
from gateway_fdi.errors import GatewayError
from gateway.config.reserved_ids import bus_instances
from gateway_commands.check import check
for path in sys.argv[3:]:
    try:
        rig = Rig(path)
    except GatewayError as error:
        print("error:", error)
        continue
    rig.fail(1)
    print(*rig.wait(10)[-1], 0x6B0 in bus_instances(rig.gateway.config)[0].known)
    check(Path(path), schema_wanted=False, json=False)
"""


def test_a_table_of_a_stranger_has_its_server_its_check_its_identifiers_and_its_errors(tmp_path):
    (tmp_path / "beacon.py").write_text(BEACON)
    tables = [
        '[output.uds]\n[output.beacon]\nsignal = "M1.Value"\n',
        '[output.uds]\n[output.beacon]\nsignal = "M1.Valu"\n',
        '[output.uds]\n[output.beacon]\nsignal = "M1.Value"\nbus = "z"\n',
        '[output.beacon]\nsignal = "M1.Value"\n',
    ]
    paths = []
    for k, extra in enumerate(tables):
        (tmp_path / str(k)).mkdir()
        paths.append(write_config(tmp_path / str(k), extra=extra))
    arguments = [sys.executable, "-c", RUN, tmp_path, str(Path(rig.__file__).parent), *paths]
    ended = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert ended.stderr == ""
    said = ended.stdout.splitlines()
    assert "1712 b'\\x01fileb' True" in said
    assert "by beacon:" in said
    assert any("output.beacon: everybody" in line for line in said)
    errors = [line for line in said if line.startswith("error:")]
    keys = ("output.beacon.signal", "output.beacon.bus", "output.beacon: this needs the table [output.uds]: why not")
    for line, key in zip(errors, keys, strict=True):
        assert key in line


@pytest.mark.parametrize(("found", "said"), [(3, "no Section, but int"), (type("Old", (Section,), {"api": 0})(), "0")])
def test_what_is_no_section_of_this_version_is_refused(monkeypatch, found, said):
    monkeypatch.setattr(plugins, "_load", lambda place: found)
    with pytest.raises(InputError, match=said):
        SECTIONS["module:NAME"]
