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
        (BUS + "xyz = 1\n", "bus[0].xyz: unknown key; the keys here are ask, bitrate, check, codes, data_bitrate,"),
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


DEEP = [
    ("a = " + "[" * 100_000 + "]" * 100_000, ":6: a: nested deeper than 64"),
    ("b = [\n" + "{a=[" * 3000 + "1" + "]}" * 3000 + "\n]", ":7: b: nested deeper than 64"),
    (".".join("k" * 100_000) + " = 1", ":6: k: nested deeper than 64"),
    ("[ t ." + ".".join("k" * 100_000) + "]", ":6: t: nested deeper than 64"),
    ("c = " + "[" * 80 + "]" * 80, "car.toml: bus: nested deeper than 64"),
    ("c = 'a[[[[{{{'\nd = " + "9" * 5000, ":7: not a good value"),
]


@pytest.mark.parametrize(("text", "said"), DEEP, ids=["arrays", "tables", "key", "header", "just", "digits"])
def test_toml_that_means_harm_is_one_line(gateway, tmp_path, text, said):
    path = tmp_path / "car.toml"
    path.write_text(BUS + "\n\n" + text + "\n")
    end = gateway("check", path)
    assert (end.code, end.err.count("\n")) == (2, 1)
    assert str(path) in end.err
    assert said in end.err


MESSAGE = 'BU_: A\n\nBO_ 256 M: {length} A\n SG_ S : {place}@1+ ({scaling}) [0|0] "" A\n'


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"scaling": "0,0"}, "car.dbc: M.S.factor = 0.0: a factor is a number other than 0"),
        ({"scaling": "1e999,0"}, "car.dbc: M.S.factor = inf: a factor"),
        ({"scaling": "9" * 400 + ",0"}, "car.dbc: M.S.factor = inf: a factor"),
        ({"scaling": "1,-1e999"}, "car.dbc: M.S.offset = -inf: an offset"),
        ({"length": "99999999999"}, "car.dbc:3: M = 99999999999: a message has at most 65536 bytes"),
        ({"length": "9" * 5000}, "car.dbc:3: M = '9999"),
        ({"place": "0|99999999"}, "car.dbc:4: S = 99999999: a signal lies within 524288 bits"),
        ({"place": "99999999|8"}, "car.dbc:4: S = 99999999: a signal lies"),
    ],
)
def test_a_database_that_means_harm_is_one_line(gateway, tmp_path, wrong, said):
    text = MESSAGE.format(**{"length": 8, "place": "0|16", "scaling": "1,0", **wrong})
    (tmp_path / "car.dbc").write_text(text)
    (tmp_path / "car.toml").write_text(BUS + 'database = ["car.dbc"]\n')
    end = gateway("check", "car.toml")
    assert (end.code, end.err.count("\n")) == (2, 1)
    assert said in end.err


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".kcd", '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document/><Bus name="b">\n'
         '<Message id="0x1" name="M" length="9999999999"/></Bus></NetworkDefinition>'),
        (".sym", 'FormatVersion=6.0\n{SENDRECEIVE}\n[M]\nID=001h\nLen=9999999999\nVar=V unsigned 0,8\n'),
    ],
)  # fmt: skip
def test_absurd_lengths_of_other_databases_are_refused(gateway, tmp_path, suffix, text):
    (tmp_path / f"car{suffix}").write_text(text)
    (tmp_path / "car.toml").write_text(BUS + f'database = ["car{suffix}"]\n')
    end = gateway("check", "car.toml")
    assert (end.code, end.err.count("\n")) == (2, 1)
    assert "9999999999: a message has at most 65536 bytes" in end.err


def test_a_wrong_environment_is_named(gateway, tmp_path, monkeypatch):
    (tmp_path / "c.toml").write_text(BUS)
    monkeypatch.setenv("GATEWAY_MEMORY", "f.sqlite")
    ended = gateway("check", "c.toml")
    assert ended.code == 2
    assert 'the environment: error parsing value for field "memory"' in ended.err
    monkeypatch.delenv("GATEWAY_MEMORY")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("GATEWAY_MEMORY__PAHT", "GATEWAY_MEMORY__PAHT: unknown key; did you mean path?"),
        ("GATEWAY_MEMORY__ENTRIES", "GATEWAY_MEMORY__ENTRIES = 'x': a whole number"),
        (
            "GATEWAY_MEMRY__PATH",
            "GATEWAY_MEMRY__PATH: no table of the configuration is called memry; did you mean MEMORY?",
        ),
    ],
)
def test_a_slip_in_the_environment_is_no_error_of_the_file(gateway, tmp_path, monkeypatch, name, said):
    (tmp_path / "c.toml").write_text(BUS)
    monkeypatch.setenv(name, "x")
    ended = gateway("check", "c.toml")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert ended.err.startswith(f"error: the environment: {said}")


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
         " scenario, and the gateway comes with "),
        ('"linear"', '"linar"', "ecu[0].type = 'linar': there are crank, fmu, linear, pedal,"
         " responder, restbus, steering, structural, table, truck, turbo; did you mean linear?"),
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
