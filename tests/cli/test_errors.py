"""Mistakes of users: one line that names file, key, value, and the nearest right name."""

import pytest
from command import command

BUS = '[[bus]]\nname = "b"\nuri = "virtual:b"\n'


@pytest.fixture
def gateway(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: command(capsys, monkeypatch, *arguments)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BUS.replace("virtual:b", "vcan0"), "bus[0].uri = 'vcan0': a bus is named as socketcan:"),
        (BUS.replace("virtual:b", "soketcan:x"), "did you mean socketcan"),
        (BUS.replace("virtual:b", "socketcan:"), "bus[0].uri = 'socketcan:': the channel is missing"),
        (BUS.replace("virtual:b", "socketcan:x?rcvbuf=-1"), "rcvbuf is a number of bytes"),
        (BUS.replace("virtual:b", "socketcan:x?fdd=true"), "socketcan takes fd=true"),
        (BUS.replace("virtual:b", "loopback:10.0.0.1:5"), "stays on this machine"),
        (BUS.replace("virtual:b", "loopback:127.0.0.1:99999"), "a port is a number"),
        (BUS + "[bus.check]\nmessage = 'A'\n", "bus[0].check: a list of tables: write [[bus.check]]"),
        (BUS.replace("[[bus]]", "[bus]"), "bus: a list of tables: write [[bus]]"),
        (BUS + "[[memory]]\n", "memory: one table: write [memory]"),
        (BUS + "databse = []\n", "bus[0].databse: unknown key; did you mean database or data_bitrate?"),
        (BUS + "xyz = 1\n", "bus[0].xyz: unknown key; the keys here are bitrate, check, codes, data_bitrate,"),
        (BUS + 'match = "pgm"\n', "did you mean pgn?"),
        ('[[bus]]\nuri = "virtual:b"\n', "bus[0].name: this key is missing: how other parts refer"),
        (
            BUS + '[[monitor]]\nname = "m"\ntype = "redundant_pare"\n',
            "monitor[0].type = 'redundant_pare': the types are crank_sync, ",
        ),
        (
            BUS + '[[monitor]]\nname = "m"\ntype = "redundant_pare"\n',
            "did you mean redundant_pair",
        ),
        (
            BUS + '[[monitor]]\nname = "m"\ntype = "linear_observer"\nsample_ms = 10.0\n',
            "monitor[0].input: this key is missing: the plant's commands, one a column of b; one at"
            " least, its actuators are what is watched; write a table [[monitor.input]] for each",
        ),
        (BUS + '[[bus.check]]\nmessage = "M"\n', "no message 'M' in a database: this bus has none"),
    ],
)  # fmt: skip
def test_check_refuses_with_a_line_that_helps(gateway, tmp_path, text, said):
    (tmp_path / "c.toml").write_text(text)
    for arguments in (("check",), ("run", "--duration", "0")):
        ended = gateway(arguments[0], "c.toml", *arguments[1:])
        assert ended.code == 2
        assert "error: c.toml: " in ended.err
        assert said in ended.err


def test_a_wrong_environment_is_named(gateway, tmp_path, monkeypatch):
    (tmp_path / "c.toml").write_text(BUS)
    monkeypatch.setenv("GATEWAY_MEMORY", "f.sqlite")
    ended = gateway("check", "c.toml")
    assert ended.code == 2
    assert 'the environment: error parsing value for field "memory"' in ended.err


def test_a_library_that_is_not_there_is_not_waited_for(gateway, tmp_path):
    (tmp_path / "c.toml").write_text(BUS.replace("virtual:b", "neovi:1"))
    ended = gateway("run", "c.toml", "--memory", "f.sqlite", "--duration", "5")
    assert ended.code == 2
    assert "neovi:1" in ended.err


SCENARIO = """
name = "own"
duration_s = 1.0
config = "c.toml"
[[ecu]]
type = "linear"
sensors = "MySensors"
commands = "MyCommand"
sample_ms = 10.0
a = [[-1.0]]
b = [[1.0]]
c = [[1.0]]
"""
DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 256 MyCommand: 8 A
 SG_ Torque : 0|16@1- (0.01,0) [-100|100] "Nm" B
BO_ 2566844673 MySensors: 8 A
 SG_ Speed : 0|16@1- (0.01,0) [-100|100] "rpm" B
 SG_ FrameCnt : 16|2@1+ (1,0) [0|3] "" B
BO_ 259 Wide: 8 A
 SG_ Speed : 0|16@1- (0.01,0) [-100|100] "rpm" B
 SG_ Crc : 20|16@1+ (1,0) [0|0] "" B
BO_ 260 Muxed: 8 A
 SG_ m M : 0|8@1+ (1,0) [0|0] "" B
 SG_ Speed m0 : 8|16@1- (0.01,0) [-100|100] "rpm" B
BO_ 300 ACC: 8 A
 SG_ Speed : 0|16@1- (0.01,0) [-100|100] "rpm" B
"""


@pytest.fixture
def simulate(gateway, tmp_path):
    folder = tmp_path / "proj"
    folder.mkdir()
    (folder / "own.dbc").write_text(DBC)
    (folder / "c.toml").write_text(
        BUS + 'database = ["own.dbc"]\n[[bus.check]]\nmessage = "MyCommand"\n[output.dtc_frame]\n'
        'bus = "b"\ncycle_ms = 1000.0\n'
    )

    def run(text=SCENARIO, *more):
        (folder / "s.toml").write_text(text)
        return gateway("simulate", "proj/s.toml", "--bus", "inside", *more)

    return run


def test_an_ecu_sends_messages_without_crc_and_counter(simulate, tmp_path):
    """From another folder than the scenario's, with the database of its bus, and with one of its own."""
    for database in ("", 'database = "own.dbc"\n'):
        text = SCENARIO.replace('type = "linear"\n', f'type = "linear"\n{database}')
        ended = simulate(text, "--record", "r.log", "--json")
        assert ended.code == 0, ended.err
        log = (tmp_path / "r.log").read_text()
        assert log.count(" 100#") == 100
        counters = [int(line.partition("#")[2][4:6], 16) for line in log.splitlines() if "#" in line
                    and " 18FEF101#" in line]  # fmt: skip
        assert counters == [k % 4 for k in range(100)], "29 bits, and as far as its signal counts"
        assert ended.event("summary")["decoded"] == 100


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("MySensors", "MySensor", "ecu[0].sensors = 'MySensor': no message 'MySensor' in proj/own.dbc; did"
         " you mean MySensors?"),
        ("MySensors", "Wide", "ecu[0].sensors = 'Wide': its signal Crc is no CRC of 8 bits"),
        ("MySensors", "Muxed", "ecu[0].sensors = 'Muxed': a multiplexed message cannot carry a plant"),
        ('"linear"\n', '"linear"\ndatabase = "own.dbx"\n', "ecu[0].database = 'own.dbx': no such file beside the"
         " scenario, and the gateway comes with dbc/"),
        ('"linear"', '"linar"', "ecu[0].type = 'linar': there are crank, fmu, linear, pedal,"
         " responder, restbus, steering, structural, table, truck; did you mean linear?"),
        ("c = [[1.0]]", 'c = [[1.0]]\n[[wire]]\nkind = "lost"\nmessage = "MyComand"\n',
         "wire[0].message = 'MyComand': a message of the configuration, an identifier in hex (0x700), or *;"
         " did you mean MyCommand?"),
        ("c = [[1.0]]", 'c = [[1.0]]\n[[fault]]\nkind = "output_ofset"\n',
         "fault[0].kind = 'output_ofset': there are "),
    ],
)  # fmt: skip
def test_wrong_scenarios(simulate, old, new, said):
    ended = simulate(SCENARIO.replace(old, new))
    assert ended.code == 2
    assert f"proj/s.toml: {said}" in ended.err
    assert len(ended.err.splitlines()) <= 2


@pytest.mark.parametrize(
    ("message", "left"),
    [("MyCommand", (0, 100)), ("0x100", (0, 100)), ("100", (0, 100)), ("18FEF101", (100, 0)),
     ("MySensors", (100, 0)), ("*", (0, 0)), ("0x7FF", (100, 100))],
)  # fmt: skip
def test_a_wire_fault_takes_a_name_or_an_identifier(simulate, tmp_path, message, left):
    simulate(SCENARIO + f'[[wire]]\nkind = "lost"\nmessage = "{message}"\n', "--record", "r.log")
    log = (tmp_path / "r.log").read_text()
    assert (log.count(" 100#"), log.count(" 18FEF101#")) == left


def test_a_name_goes_before_an_identifier_that_is_spelt_like_it(simulate, tmp_path):
    text = SCENARIO.replace("MyCommand", "ACC") + '[[wire]]\nkind = "lost"\nmessage = "ACC"\n'
    assert simulate(text, "--record", "r.log").code == 0
    assert " 12C#" not in (tmp_path / "r.log").read_text()
