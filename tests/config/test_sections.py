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

LACKING = """
import sys
from gateway.common import plugins
plugins._our_plugins = lambda: ()
from gateway.config.load import load_config
load_config(sys.argv[1])
"""


def test_the_schema_has_the_tables_of_all_packages():
    tables = schema()["$defs"]["OutputConfig"]["properties"]
    assert {*tables} == {"dtc_frame", "uds", *SECTIONS}
    assert all(tables[name]["description"] == SECTIONS[name].description for name in SECTIONS)


@pytest.mark.parametrize("table", ["obd", "j1939", "doip"])
def test_a_table_without_its_package_is_an_unknown_key(tmp_path, table):
    path = write_config(tmp_path, extra=f"[output.uds]\n[output.{table}]\n")
    load_config(path)
    ended = subprocess.run([sys.executable, "-c", LACKING, path], capture_output=True, text=True, check=False)
    assert f"output.{table}: unknown key" in ended.stderr


def test_ecus_without_the_package_that_asks_them_are_an_error_of_their_key(tmp_path):
    path = write_config(tmp_path, extra='[[ecu]]\nname = "engine"\nrequest = 0x7E0\nresponse = 0x7E8\n')
    code = LACKING + "from gateway.runtime.app import Gateway\nGateway(load_config(sys.argv[1]))\n"
    ended = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=False)
    assert "ecu: no installed package asks ECUs" in ended.stderr


def test_a_section_that_cannot_be_used_is_left_out(monkeypatch):
    monkeypatch.setattr(SECTIONS, "described", lambda: {"obd": SECTIONS["obd"], "mine": InputError("broken")})
    assert [name for name, _ in usable()] == ["obd"]


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
sys.path[:0] = sys.argv[2:]
from gateway.common import plugins
from gateway.plugin import Plugin
plugins._foreign_plugins = lambda: ({"x": Plugin(sections={"beacon": "beacon:SECTION"})}, {})
from rig import Rig
from gateway_fdi.errors import GatewayError
from gateway.config.reserved_ids import bus_instances
from gateway_commands.check import check
try:
    rig = Rig(sys.argv[1])
except GatewayError as error:
    sys.exit(str(error))
rig.fail(1)
print(*rig.wait(10)[-1], 0x6B0 in bus_instances(rig.gateway.config)[0].known)
check(Path(sys.argv[1]), schema_wanted=False, json=False)
"""


def beacon(tmp_path, extra):
    (tmp_path / "beacon.py").write_text(BEACON)
    path = write_config(tmp_path, extra=extra)
    arguments = [sys.executable, "-c", RUN, path, tmp_path, str(Path(rig.__file__).parent)]
    return subprocess.run(arguments, capture_output=True, text=True, check=False)


def test_a_table_of_a_stranger_has_its_server_its_check_and_its_identifiers(tmp_path):
    ended = beacon(tmp_path, '[output.uds]\n[output.beacon]\nsignal = "M1.Value"\n')
    assert ended.stderr == ""
    assert "1712 b'\\x01fileb' True" in ended.stdout.splitlines()
    assert "by beacon:" in ended.stdout
    assert "output.beacon: everybody" in ended.stdout


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        ('[output.uds]\n[output.beacon]\nsignal = "M1.Valu"\n', "output.beacon.signal"),
        ('[output.uds]\n[output.beacon]\nsignal = "M1.Value"\nbus = "z"\n', "output.beacon.bus"),
        ('[output.beacon]\nsignal = "M1.Value"\n', "output.beacon: this needs the table [output.uds]: why not"),
    ],
)
def test_errors_of_a_strangers_table_have_its_keys(tmp_path, extra, said):
    assert said in beacon(tmp_path, extra).stderr


@pytest.mark.parametrize(("found", "said"), [(3, "no Section, but int"), (type("Old", (Section,), {"api": 0})(), "0")])
def test_what_is_no_section_of_this_version_is_refused(monkeypatch, found, said):
    monkeypatch.setattr(plugins, "_load", lambda place: found)
    with pytest.raises(InputError, match=said):
        SECTIONS["module:NAME"]
