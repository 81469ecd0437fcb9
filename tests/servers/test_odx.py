"""The PDX file of a gateway: odxtools reads it, and makes a tester of it that knows nothing else."""

import io
import lzma
import math
import re
import sys
import warnings
import xml.etree.ElementTree as ET
import zipfile
from contextlib import contextmanager
from pathlib import Path

import odxtools
import odxtools.cli.main
import pytest
from doip_wire import wired
from kept import kept
from odxtools.message import Message
from odxtools.writepdxfile import write_pdx_file
from rig import Tester, write_config
from uds_tester import ANYBODY, EXTRA, hexed

from gateway.cli.present import find_config
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway.servers.uds.security import hmac_sha256
from gateway.servers.uds.services import SERVICES
from gateway_ask.answers.decode import AnswerDecoder
from gateway_ask.answers.layout import Address, read_file
from gateway_commands.export import export
from gateway_fdi.errors import InputError
from gateway_testers.odx.export import pdx_of

UDS = """security = [{ level = 1, secret = "00112233" }]
p2_ms = 40
"""
MORE = """
[access.write]
sessions = ["extended"]
security = 1
[output.obd]
vin = "1HGCM82633A004352"
pid = [{ id = 0x0D, signal = "M1.Value" }]
[[did]]
id = 0x0125
name = "real"
signal = "M1.Value"
[[monitor]]
name = "high"
type = "signal"
signal = [{ signal = "M1.Value", plausible = [0, 100], failed_ms = 20 }]
"""
FAULTS = {0: 'severity = "immediately"\nfreeze_frame = ["M2.Value", "volts"]\n'}
SECRET = bytes.fromhex("00112233")


class Made:
    """A tester that is made of a file alone; ``send`` carries bytes to the server and back."""

    def __init__(self, file, send):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            self.database = odxtools.load_pdx_file(file)
        (self.ecu,) = self.database.ecu_variants
        self.send = send
        self.services = {service.short_name: service for service in self.ecu.services}

    def ask(self, name, **values):
        """Return what is read of the answer, by the names of the file."""
        request = bytes(self.services[name].encode_request(**values))
        (message,) = self.ecu.decode_response(self.send(request), request)
        assert isinstance(message, Message)
        assert message.service.short_name == name
        return message.param_dict

    def refusal(self, name, **values):
        return self.ask(name, **values)["NRC"]


def file_of(gateway, folder):
    file = folder / "gateway.pdx"
    file.write_bytes(pdx_of(gateway))
    return file


@contextmanager
def on_can(folder, **more):
    """A gateway with DTCs, and a tester that takes the identifiers of the file, too."""
    with wired(folder, uds=UDS, more=MORE + more.pop("more", ""), **more) as net:
        file = file_of(net.rig.gateway, folder)
        made = Made(file, None)
        by = made.ecu.get_can_receive_id("UDS_on_CAN"), made.ecu.get_can_send_id("UDS_on_CAN")
        made.send = Tester(net.rig, *by).ask
        yield net, made


def in_doip(net, made):
    """Return a function that sends over TCP by the addresses of the file."""
    ecu, protocol = made.ecu, "UDS_on_DoIP"
    tester, own = ecu.get_doip_logical_tester_address(protocol), ecu.get_doip_logical_ecu_address(protocol)
    assert ecu.get_doip_logical_gateway_address(protocol) == own
    door = net.connect()
    address = tester.to_bytes(2, "big") + own.to_bytes(2, "big")
    kind = ecu.get_doip_routing_activation_type(protocol)
    activation = tester.to_bytes(2, "big") + bytes([kind, 0, 0, 0, 0])

    def packed(payload, body):
        return b"\x03\xfc" + payload.to_bytes(2, "big") + len(body).to_bytes(4, "big") + body

    assert net.exchange(door, packed(5, activation), lambda _: True)[0][1][4] == 0x10

    def send(request):
        told = net.exchange(door, packed(0x8001, address + request), lambda got: got.count(b"\x80\x01") > 0)
        return next(body[4:] for kind, body in told if kind == 0x8001)

    return send


def values_of(net):
    """Feed values, and let faults of two kinds come."""
    rig = net.rig
    for k, volts in ((0, 5.0), (1, 4.5), (2, 7.5)):
        rig.value(k, volts)
    rig.fail(0)
    for _ in range(60):
        rig.value(1, 200.0)
    return rig


def read_all(made, rig):
    """Read each identifier, and compare it with the gateway's own value."""
    ids, count = rig.gateway.identifiers, 0
    for name in [name for name in made.services if name.startswith("Read_")]:
        got, count = made.ask(name), count + 1
        did = ids.table.get(got["Identifier"])
        if did is None or did.signal is None:
            continue
        expected = rig.gateway.controls.value(did.signal)
        assert got[did.name] == pytest.approx(expected) or (math.isnan(expected) and math.isnan(got[did.name]))
    return count


@pytest.mark.evidence("Releases: ODX")
def test_a_tester_made_of_the_file_alone_reads_every_identifier_by_can_and_by_doip(tmp_path):
    with on_can(tmp_path, messages=3) as (net, made):
        rig = values_of(net)
        count = read_all(made, rig)
        assert count > 20
        assert made.ask("Read_volts")["volts"] == 5.0
        assert made.ask("Read_real")["real"] == 200.0
        assert made.ask("Read_pid_0D")["pid_0D"] == {"VSS": 200.0}
        assert made.ask("Read_vin")["vin"] == "1HGCM82633A004352"
        assert made.ask("Read_active_session")["active_session"] == "Default"
        made.send = in_doip(net, made)
        assert read_all(made, rig) == count


def test_dtcs_snapshots_and_extended_data_have_our_names(tmp_path):
    faults = FAULTS[0].replace("[", '["M0.Value", ', 1)
    with on_can(tmp_path, more=f'[fault."high.Value.high"]\n{faults}') as (net, made):
        rig = values_of(net)
        memory = rig.gateway.memory
        (entry,) = [each for each in memory.entries() if each.fault == "high.Value.high"]
        got = made.ask("reportDTCSnapshotRecordByDTCNumber", DTC=int(entry.dtc.value), RecordNumber=0xFF)
        assert got["DTC"].display_trouble_code == str(entry.dtc)
        assert "high.Value.high" in str(got["DTC"].text)
        assert got["Status"]["TEST_FAILED"] == 1
        first = {case: data[case] for case, data in (one["identifier"] for one in got["records"][0]["data"])}
        assert first == pytest.approx({"volts": 5.0, "M2_Value": 7.5})
        assert [one["RecordNumber"] for one in got["records"]] == [f.number for f in entry.freeze_frames]

        got = made.ask("reportDTCExtDataRecordByDTCNumber", DTC=int(entry.dtc.value), RecordNumber=0xFF)
        records = dict(one["record"] for one in got["records"])
        assert records["occurrence"] == {"occurrence": entry.record.occurrence}
        first_s = sum(records["first_ns"].values())
        assert first_s == pytest.approx(entry.record.first_ns / 1e9, abs=1e-6)
        evidence = records["evidence"]["evidence"]
        assert list(evidence.values()) == [math.nan if v is None else v for v in entry.record.evidence.values()]
        assert list(entry.record.evidence) in [
            [p.long_name or p.short_name for p in each.parameters]
            for each in made.ecu.diag_data_dictionary_spec.env_datas
            if int(entry.dtc.value) in each.dtc_values
        ]
        inputs = records["inputs"]["inputs"]
        assert inputs == {name.replace(".", "_"): v for name, v in entry.record.inputs.items()}
        (units,) = [
            d
            for d in made.ecu.diag_data_dictionary_spec.env_datas
            if [p.short_name for p in d.parameters] == list(inputs)
        ]
        assert [param.dop.unit.display_name for param in units.parameters] == ["V"] * len(inputs)


def test_every_report_is_decoded(tmp_path):
    with on_can(tmp_path, more=ANYBODY) as (net, made):
        rig = values_of(net)
        dtc, usual = int(hexed(0), 16), {"StatusMask": 0xFF, "SeverityMask": 0xFF, "RecordNumber": 0xFF}
        usual |= {"FunctionalGroup": 0xFF, "ReadinessGroup": 1, "DTC": dtc}
        for name in [
            name for name in made.services if name.startswith("report") and not re.search("UserDef|Events", name)
        ]:
            asked = {p.short_name for p in made.services[name].request.parameters if p.parameter_type == "VALUE"}
            record = {"RecordNumber": 1} if "Identification" in name else {}
            got = made.ask(name, **{k: v for k, v in (usual | record).items() if k in asked})
            assert "NRC" not in got, name
        listed = made.ask("reportDTCByStatusMask", StatusMask=0x01)["DTCs"]
        assert {one["DTC"].trouble_code for one in listed} == {each.dtc for each in rig.gateway.memory.supported(0x01)}
        made.ask("ExtendedSession")
        made.ask("ClearDiagnosticInformation")
        (cleared,) = made.ask("reportUserDefMemoryDTCByStatusMask", StatusMask=0xFF)["DTCs"]
        assert str(cleared["DTC"].text) == "clear"
        got = made.ask(
            "reportUserDefMemoryDTCSnapshotRecordByDTCNumber", DTC=cleared["DTC"].trouble_code, RecordNumber=0xFF
        )
        (record,) = got["records"][0]["data"]
        assert (record["protocol"], record["session"], record["service"]) == ("uds", 3, 0x14)
        assert record["request"] == bytes.fromhex("14ffffff000000")


def test_what_needs_a_session_or_a_key_says_so(tmp_path):
    """The states of each service are those in which the server answers; refusals are read, too."""
    with on_can(tmp_path) as (_, made):
        for name, service in made.services.items():
            needs = {ref.state.short_name for ref in service.pre_condition_state_refs}
            prefix = bytes(service.request.coded_const_prefix())
            answer = made.send(prefix.ljust(SERVICES[prefix[0]].shortest, b"\0"))
            session = answer[0] == 0x7F and answer[2] in (0x7E, 0x7F)
            assert session == ("Extended" in needs), name
            made.ask("DefaultSession")
        assert made.refusal("Write_setting", setting=b"\x05\x06") == "service not supported in session"
        made.ask("ExtendedSession")
        assert made.refusal("Write_setting", setting=b"\x05\x06") == "security access denied"
        seed = made.ask("RequestSeed_Level_1")["seed"]
        made.ask("SendKey_Level_1", key=hmac_sha256(bytes(seed), SECRET, 1))
        assert made.ask("Write_setting", setting=b"\x05\x06")["Identifier"] == 0x0124
        assert made.ask("Read_setting")["setting"] == b"\x05\x06"
        assert made.ask("Start_RestartCycle")["result"] == 0
        assert {ref.state.short_name for ref in made.services["Write_setting"].pre_condition_state_refs} == {
            "Extended",
            "Level_1",
        }


def test_every_sub_function_that_is_served_is_in_the_file(tmp_path):
    with on_can(tmp_path) as (net, made):
        found = {bytes(s.request.coded_const_prefix())[:2] for s in made.services.values()}
        context = net.rig.gateway.servers.all[0].uds.context
        for service in SERVICES.values():
            if service.offered(context) and service.sub_functions is not None and service.sid != 0x31:
                assert {bytes([service.sid, k]) for k in service.sub_functions(context)} <= found
        assert {prefix[0] for prefix in found} == {s.sid for s in SERVICES.values() if s.offered(context)}


def stripped(element):
    """Return an element as (tag, attributes, text, children), without what only spaces say."""
    attributes = {k: v for k, v in element.attrib.items() if "noNamespace" not in k}
    return element.tag, attributes, (element.text or "").strip(), [stripped(child) for child in element]


def written(path, folder):
    """Return the file of a configuration."""
    file = folder / f"{path.stem}.pdx"
    assert export(path, out=None, pdx=file) == 0
    return file


def test_odxtools_writes_the_same_elements_in_the_same_order(tmp_path):
    """The schema of ODX is not free; odxtools writes in its order."""
    odd = {0: 'description = "a\\u0001 <&> \\u00fc"\n'}
    plain = write_config(tmp_path, extra="[output.uds]\nfd = true\nfunctional = 0x18DB33F1\n", faults=odd)
    for path in (plain, find_config(Path("configs/diagnostics.toml"))):
        file, again = written(path, tmp_path), tmp_path / "again.pdx"
        assert written(path, tmp_path).read_bytes() == file.read_bytes()
        write_pdx_file(str(again), odxtools.load_pdx_file(file))
        with zipfile.ZipFile(file) as ours, zipfile.ZipFile(again) as theirs:
            assert set(ours.namelist()) == set(theirs.namelist())
            assert {info.date_time[0] for info in ours.infolist()} == {1980}, "no time of today"
            for name in set(ours.namelist()) - {"index.xml"}:
                assert stripped(ET.fromstring(ours.read(name))) == stripped(ET.fromstring(theirs.read(name))), name


def test_every_element_of_the_file_is_that_of_before(tmp_path):
    """A DTC's datum, a length, a time, a bit that changes in the file is seen here, and is meant or not."""
    extra = (
        EXTRA.format(uds=UDS + "functional = 0x7DF\n")
        + MORE
        + "[output.doip]\ntester = [{ address = 0xE00 }, { address = 0xE80 }]\n"
    )
    path = write_config(tmp_path, 3, extra=extra, faults=FAULTS)
    gateway = Gateway(load_config(path), file=path)
    with zipfile.ZipFile(io.BytesIO(pdx_of(gateway))) as files:
        now = "\n".join(f"{name}\n{files.read(name).decode()}" for name in files.namelist())
    gateway.close()
    before = lzma.decompress(kept(Path(__file__).with_name("gateway.pdx.txt.xz"), lzma.compress(now.encode())))
    assert now.splitlines() == before.decode().splitlines()


def test_the_commands_of_odxtools_take_the_file(tmp_path, monkeypatch, capsys):
    one, other = tmp_path / "one", tmp_path / "other"
    for folder in (one, other):
        folder.mkdir()
        write_config(folder, extra=EXTRA.format(uds=UDS) + MORE * (folder is other))
    files = [written(folder / "rig.toml", folder) for folder in (one, other)]
    for arguments, said in (
        (["list", files[0], "-a"], ["Read_volts", "Write_setting"]),
        (["decode", files[0], "-D", "-d", "22 01 23"], ["Read_volts"]),
        (["compare", files[0], "-db", files[1]], ["Read_real"]),
    ):
        monkeypatch.setattr(sys, "argv", ["odxtools", *map(str, arguments)])
        odxtools.cli.main.start_cli()
        told = capsys.readouterr().out
        assert all(word in told for word in said), told


def test_our_own_import_reads_the_same_layouts(tmp_path):
    with on_can(tmp_path) as (net, made):
        rig, found = values_of(net), read_file(tmp_path / "gateway.pdx")
        layouts = {layout.identifier: layout for layout in found.layouts}
        for number, did in rig.gateway.identifiers.table.items():
            if did.signal is None:
                assert number not in layouts
                continue
            layout = layouts[number]
            assert layout.address == Address(0x7E0, 0x7E8)
            (signal,) = layout.message.signals
            assert (signal.name, signal.unit) == (did.name, "V")
            assert (float(signal.scale), float(signal.offset)) == (did.scale, did.offset)
            answer = made.send(bytes([0x22]) + number.to_bytes(2, "big"))
            decoded = AnswerDecoder(layout).decode([answer[3:]])
            assert decoded.values[0][0] == pytest.approx(rig.gateway.controls.value(did.signal), nan_ok=True)


def test_without_a_server_there_is_no_file(tmp_path):
    config = tmp_path / "none.toml"
    config.write_text('[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = ["rig.dbc"]\n')
    (tmp_path / "rig.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A B\nBO_ 256 M0: 8 A\n SG_ V : 0|16@1+ (1,0) [0|9] "V" B\n'
    )
    with pytest.raises(InputError, match=r"output\.uds"):
        export(config, out=None, pdx=tmp_path / "no.pdx")
    assert not (tmp_path / "no.pdx").exists()
