"""Mistakes in checks and in monitors signal and rule: each is one line that names file, key, value and what is near."""

import json

import pytest
from car import write

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_commands.check import check
from gateway_commands.validation import mistakes
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors

DBC = (
    'BO_ 256 Wheel: 8 A\n SG_ Speed : 0|16@1- (0.01,0) [-300|300] "km/h" B\n SG_ Gear : 16|8@1+ (1,0) [0|255] "" B\n'
    ' SG_ COUNTER : 24|4@1+ (1,0) [0|15] "" B\n SG_ CHECKSUM : 56|8@1+ (1,0) [0|255] "" B\n'
    'BO_ 257 Body: 8 A\n SG_ Moving : 0|16@1- (0.1,0) [0|0] "km/h" B\n SG_ Angle : 16|16@1- (0.1,0) [0|0] "deg" B\n'
    ' SG_ Real : 32|32@1- (1,0) [0|0] "" B\n'
    'VAL_ 256 Gear 0 "Park" 1 "Drive" 2 "Reverse" 15 "SNA" ;\nSIG_VALTYPE_ 257 Real : 1;\n'
)
BUS, CHECK = "bus[0]", "bus[0].check[0]"
SIGNAL, RULE = "monitor[0].signal[0]", "monitor[0].rule[0]"

#: What is written, what the line has: key with value, text.
OF_CHECKS = (
    ('message = "Whel"', f"{CHECK}.message = 'Whel'", "did you mean Wheel?"),
    ('message = "Whel"\nprotection = "auto"', f"{CHECK}.message = 'Whel'", "did you mean Wheel?"),
    ('mesage = "Wheel"', f"{CHECK}.mesage", "did you mean message?"),
    ('message = "Wheel"\ntimeout = 5', f"{CHECK}.timeout", "did you mean timeout_ms or most?"),
    ('message = "Wheel"\ntimeout_ms = -5', f"{CHECK}.timeout_ms = -5", "a number above 0"),
    ('message = "Wheel"\nlost = "U100"', f"{CHECK}.lost = 'U100'", "U[0-3]"),
    ('message = "Wheel"\nchecksum = "toyotta"', f"{CHECK}.checksum = 'toyotta'", "did you mean toyota?"),
    ('message = "Wheel"\nchecksum = { rule = "hond" }', f"{CHECK}.checksum.rule = 'hond'", "did you mean honda"),
    ('message = "Wheel"\nchecksum = { rul = "sum" }', f"{CHECK}.checksum.rul", "did you mean rule?"),
    (
        'message = "Wheel"\nchecksum = { rule = "sum", signal = "CHEKSUM" }',
        f"{CHECK}.checksum.signal = 'CHEKSUM'",
        "did you mean CHECKSUM?",
    ),
    ('message = "Wheel"\nchecksum = "hyundai_canfd"', f"{CHECK}.checksum.signal = 'CHECKSUM'", "16 bits, its signal 8"),
    ('message = "Wheel"\ncounter = { signal = "COUNTR" }', f"{CHECK}.counter.signal = 'COUNTR'", "mean COUNTER?"),
    ('message = "Wheel"\ncounter = "COUNTER"', f"{CHECK}.counter = 'COUNTER'", "first, max_step, modulus, signal"),
    (
        'message = "Wheel"\ncounter = { signal = "COUNTER", modulus = 99 }',
        f"{CHECK}.counter.modulus = 99",
        "4 bits have 16 values",
    ),
    ('message = "Body"\ncounter = { signal = "Real" }', f"{CHECK}.counter.signal = 'Real'", "is an integer"),
    ('message = "Wheel"\ncrc = { signal = "Sped" }', f"{CHECK}.crc.signal = 'Sped'", "did you mean Speed?"),
    (
        'message = "Wheel"\ncrc = { signal = "CHECKSUM", algorithm = "crc8_sae" }',
        f"{CHECK}.crc.algorithm",
        "crc8_sae_j1850",
    ),
    (
        'message = "Wheel"\ncrc = { signal = "CHECKSUM", over = [0, 12] }',
        f"{CHECK}.crc.over = [0, 12]",
        "Wheel has 8 bytes",
    ),
    (
        'message = "Wheel"\ncrc = { signal = "CHECKSUM", data_id = { bytes = [1, 2], place = "by_counter" } }',
        f"{CHECK}.crc.data_id = {{'bytes': [1, 2]",
        "16 bytes, one for each value",
    ),
    (
        'message = "Wheel"\ncrc = { signal = "CHECKSUM", data_id = { byts = [1, 2] } }',
        f"{CHECK}.crc.data_id.byts",
        "did you mean bytes?",
    ),
    ('message = "Wheel"\ne2e = { profile = "P03" }', f"{CHECK}.e2e.profile = 'P03'", "did you mean P0"),
    ('message = "Wheel"\ne2e = { profile = "P01", data_id = 70000 }', f"{CHECK}.e2e.data_id = 70000", "16 bits"),
    ('message = "Wheel"\ne2e = { profile = "P01", windo = {} }', f"{CHECK}.e2e.windo", "did you mean window?"),
    (
        'message = "Wheel"\n[[bus.check]]\nmessage = "Wheel"',
        "bus[0].check[1].message = 'Wheel'",
        "has its checks already",
    ),
    ('message = "Wheel"\n[[bus.check]]\nmessage = "Body"', "bus[0].check[1] = 'Body'", 'codes = "own"'),
)
OF_SIGNALS = (
    ('signal = "Wheel.Sped", gradient = 1', f"{SIGNAL}.signal = 'Wheel.Sped'", "did you mean Speed?"),
    ('signal = "Whel.Speed", gradient = 1', f"{SIGNAL}.signal = 'Whel.Speed'", "did you mean Wheel?"),
    ('signal = "Speed", gradient = 1', f"{SIGNAL}.signal = 'Speed'", "did you mean Wheel.Speed?"),
    ('signal = "can1.Wheel.Speed", gradient = 1', f"{SIGNAL}.signal = 'can1.Wheel.Speed'", "did you mean can?"),
    ('signal = "Wheel.Speed", gradiant = 1', f"{SIGNAL}.gradiant", "did you mean gradient?"),
    ('signal = "Wheel.Speed", stuck = 5', f"{SIGNAL}.stuck = 5", "by, during, inside, moving"),
    ('signal = "Wheel.Speed", stuck = { second = 5 }', f"{SIGNAL}.stuck.second", "did you mean seconds?"),
    (
        'signal = "Wheel.Speed", stuck = { moving = "Body.Movin", moving_by = 1 }',
        f"{SIGNAL}.stuck.moving = 'Body.Movin'",
        "did you mean Moving?",
    ),
    ('signal = "Wheel.Gear", invalid = ["SNAA"]', f"{SIGNAL}.invalid = 'SNAA'", "did you mean SNA?"),
    ('signal = "Wheel.Gear", invalid = "autom"', f"{SIGNAL}.invalid = 'autom'", "did you mean auto?"),
    ('signal = "Wheel.Speed", undefined = true', f"{SIGNAL}.undefined = 'Wheel.Speed'", "no texts"),
    ('signal = "Body.Real", all_ones = true', f"{SIGNAL}.all_ones = 'Body.Real'", "floating-point"),
    ('signal = "Wheel.Speed", missing_ms = 3', f"{SIGNAL}.missing_ms = 3.0", "in every frame of its message"),
    ('signal = "Wheel.Speed"', f"{SIGNAL} = 'Wheel.Speed'", "nothing is asked of it"),
)
OF_RULES = (
    ('holds = "Wheel.Sped < 3"', f"{RULE}.holds = 'Wheel.Sped < 3'", "did you mean Speed?"),
    ('holds = "Wheel.Speed < 3", when = "Body.Movin > 1"', f"{RULE}.when = 'Body.Movin > 1'", "did you mean Moving?"),
    ('hold = "Wheel.Speed < 3"', f"{RULE}.hold", "did you mean holds"),
    ('holds = "abss(Wheel.Speed) < 3"', f"{RULE}.holds", "did you mean abs"),
    ('holds = "Wheel.Speed < Body.Angle"', f"{RULE}.holds", '"km/h" and "deg" do not go together'),
    ('holds = "Wheel.Speed + 3"', f"{RULE}.holds = 'Wheel.Speed + 3'", "compare it with something"),
    ('holds = "cam.Wheel.Speed < 3"', f"{RULE}.holds = 'cam.Wheel.Speed < 3'", "did you mean can?"),
)
GOOD = '[[monitor]]\nname = "w"\ntype = "signal"\nsignal = [{ signal = "Wheel.Speed", plausible = [0, 1] }]\n'
OTHERS = (
    (f"{GOOD}bus = 'cam'", "monitor[0].bus = 'cam'", "did you mean can?"),
    (f'{GOOD}signals = {{ "Wheel.Sped" = "Wheel.Gear" }}', "monitor[0].signals", "did you mean"),
    (
        f'{GOOD}signals = {{ "Wheel.Speed" = "Wheel.Gera" }}',
        "monitor[0].signals.\"Wheel.Speed\" = 'Wheel.Gera'",
        "Gear?",
    ),
    (f'{GOOD}[fault."w.Speed.hihg"]\npriority = 1', 'fault."w.Speed.hihg"', "did you mean w.Speed.high"),
    (
        f'{GOOD}[fault."w.Speed.high"]\ncaused_by = ["w.Speed.lo"]',
        "caused_by = 'w.Speed.lo'",
        "did you mean w.Speed.low?",
    ),
    ('[[monitor]]\nname = "w"\ntype = "signals"\n', "monitor[0].type = 'signals'", "did you mean signal?"),
)
MISTAKES = (
    *[(f"[[bus.check]]\n{text}\n", key, said) for text, key, said in OF_CHECKS],
    *[(f'[[monitor]]\nname = "w"\ntype = "signal"\nsignal = [{{ {text} }}]\n', *rest) for text, *rest in OF_SIGNALS],
    *[
        (f'[[monitor]]\nname = "w"\ntype = "rule"\nrule = [{{ name = "a", {text} }}]\n', *rest)
        for text, *rest in OF_RULES
    ],
    *OTHERS,
)


@pytest.mark.parametrize(("text", "key", "said"), MISTAKES)
def test_a_mistake_is_one_line(tmp_path, text, key, said):
    path = write(tmp_path, DBC, text)
    path.write_text(path.read_text().replace('name = "b"', 'name = "can"'))
    with pytest.raises((InputError, InputErrors)) as told:
        Gateway(load_config(path), file=path)
    (line,) = str(told.value).splitlines()
    file, _, rest = line.partition(": ")
    assert file == str(path)
    assert rest.startswith((key, 'fault."w.Speed.high".caused_by'))
    assert key in rest
    assert said in rest
    assert [str(error) for error in mistakes(path)] == [line]


def test_with_many_faults_only_near_names_are_told(tmp_path):
    many = "".join(f' SG_ S{k} : {k}|1@1+ (1,0) [0|0] "" B\n' for k in range(60))
    limits = ", ".join(f'{{ signal = "Many.S{k}", plausible = [0, 0.5] }}' for k in range(60))
    text = f'[[monitor]]\nname = "w"\ntype = "signal"\nsignal = [{limits}]\n[fault."w.S33.hihg"]\npriority = 1\n'
    path = write(tmp_path, f"BO_ 256 Many: 8 A\n{many}", text)
    with pytest.raises(InputErrors, match=r"known: 124; did you mean w\.S33\.high") as told:
        Gateway(load_config(path), file=path)
    assert len(str(told.value)) < 300


#: Of each stage: keys, what tables say of each other, names of the database, what monitors want, faults.
ALL_STAGES = """
[[bus.check]]
message = "Wheel"
timeout = 5
[[bus.check]]
message = "Boddy"
lost = "U0101"
invalid = "U0402"
[[monitor]]
name = "s"
type = "signal"
signal = [{ signal = "Wheel.Sped", plausible = [0, 1] }, { signal = "Whel.Speed", plausible = [0, 1] }]
[[monitor]]
name = "w"
type = "signal"
bus = "cam"
signal = [{ signal = "Wheel.Speed", gradient = 1 }]
[[monitor]]
name = "r"
type = "rule"
rule = [{ name = "a", holds = "Wheel.Speed < Body.Angle" }]
[[monitor]]
name = "good"
type = "signal"
signal = [{ signal = "Wheel.Speed", plausible = [0, 1] }]
[fault."w.Speed.steep"]
priority = 1
[fault."good.Speed.hihg"]
priority = 1
[fault."good.Speed.high"]
caused_by = ["good.Speed.lo"]
[fault."good.Speed.low"]
freeze_frame = ["Wheel.Ger", "w:value"]
[memory]
entries = 0
[cycle.drive]
begins = { signal = "Wheel.Geer", min = 1 }
ends = { signal = "Wheel.Gear", max = 0 }
"""


@pytest.mark.evidence("Nothing is silent: mistakes")
def test_the_mistakes_of_all_stages_are_told_at_once_in_the_order_of_the_file(tmp_path, capsys):
    path = write(tmp_path, DBC, ALL_STAGES)
    wanted = [
        "bus[0].check[0].timeout",
        "bus[0].check[1].message = 'Boddy'",
        "monitor[0].signal[0].signal = 'Wheel.Sped'",
        "monitor[0].signal[1].signal = 'Whel.Speed'",
        "monitor[1].bus = 'cam'",
        "monitor[2].rule[0].holds = 'Wheel.Speed < Body.Angle'",
        'fault."good.Speed.hihg"',
        "fault.\"good.Speed.high\".caused_by = 'good.Speed.lo'",
        "fault.\"good.Speed.low\".freeze_frame[0] = 'Wheel.Ger'",
        "memory.entries = 0",
        "cycle.drive.begins.signal = 'Wheel.Geer'",
    ]
    with pytest.raises(InputErrors) as told:
        check(path, schema_wanted=False, json=False)
    lines = [line.removeprefix(f"{path}: ") for line in str(told.value).splitlines()]
    assert [line[: len(key)] for line, key in zip(lines, wanted, strict=True)] == wanted
    assert check(path, schema_wanted=False, json=True) == 2
    errors = json.loads(capsys.readouterr().out)["errors"]
    assert [error["key"] for error in errors] == [key.partition(" = ")[0] for key in wanted]
    assert {error["file"] for error in errors} == {str(path)}


def test_of_many_wrong_monitors_each_is_told(tmp_path):
    tables = [
        f'[[monitor]]\nname = "m{k}"\ntype = "signal"\nsignal = [{{ {t} }}]' for k, (t, *_) in enumerate(OF_SIGNALS)
    ]
    tables += [
        f'[[monitor]]\nname = "r{k}"\ntype = "rule"\nrule = [{{ name = "a", {t} }}]'
        for k, (t, *_) in enumerate(OF_RULES)
    ]
    path = write(tmp_path, DBC, "\n".join(tables))
    path.write_text(path.read_text().replace('name = "b"', 'name = "can"'))
    said = [str(error) for error in mistakes(path)]
    for k, (line, (_, key, text)) in enumerate(zip(said, OF_SIGNALS + OF_RULES, strict=True)):
        assert key.replace("monitor[0]", f"monitor[{k}]") in line
        assert text in line


WATCHING = 'type = "signal"\nsignal = [{ signal = "Wheel.Speed", plausible = [0, 1] }]\n'
MISSPELT = WATCHING.replace("Speed", "Sped")
#: One mistake, and what is wrong only because of it.
CONSEQUENCES = {
    "monitor": (
        f'[[monitor]]\nname = "w"\npriorit = 1\n{WATCHING}plausibel = 1\n[fault."w.Speed.high"]\npriority = 1\n'
        f'[[monitor]]\nname = "v"\n{WATCHING}[fault."v.Speed.high"]\ncaused_by = ["w.Speed.low"]\n',
        ["monitor[0].priorit", "monitor[0].plausibel"],
    ),
    "monitor without a name": (
        f'[[monitor]]\n{WATCHING}[fault."w.Speed.high"]\npriority = 1\n',
        ["monitor[0].name"],
    ),
    "live value": (
        f'[[monitor]]\nname = "w"\n{WATCHING}bus = "x"\n[[did]]\nid = 0x1234\nname = "d"\nsignal = "w:value"\n',
        ["monitor[0].bus"],
    ),
    "check": (
        '[[bus.check]]\nmessage = "Whel"\ntimeout_ms = 5\n[fault."b.Wheel.timeout"]\npriority = 1\n',
        ["bus[0].check[0].message"],
    ),
    "codes": (
        '[[bus.check]]\nmessage = "Wheel"\ntimeout_ms = 5\n[[bus.check]]\nmessage = "Body"\ntimeout_ms = 5\n'
        '[fault."b.Body.timeout"]\ndtc = "U0155-87"\npriorit = 1\n[fault."b.Body.length"]\ndtc = "U0156-82"\n',
        ['fault."b.Body.timeout".priorit'],
    ),
    "cycle": (
        f'[[monitor]]\nname = "w"\n{WATCHING}[fault."w.Speed.high"]\ncycle = "drive"\n'
        '[cycle.drive]\nbegin = { signal = "Wheel.Gear", min = 1 }\nends = { signal = "Wheel.Gear", max = 0 }\n',
        ["cycle.drive.begin"],
    ),
    "identifier": (
        f'[[monitor]]\nname = "w"\n{WATCHING}[fault."w.Speed.high"]\nfreeze_frame = ["gear"]\n'
        '[[did]]\nid = 0x1234\nname = "gear"\nsignal = "Wheel.Gear"\nlenght = 1\n',
        ["did[0].lenght"],
    ),
    "levels": (
        '[output.uds]\nrequst = 1\nsecurity = [{ level = 1, secret = "00112233445566778899AABBCCDDEEFF" }]\n'
        "[access.clear]\nsecurity = 1\n",
        ["output.uds.requst"],
    ),
    "misspelt table": (
        f'[[monitr]]\nname = "w"\n{WATCHING}[fault."w.Speed.high"]\npriority = 1\n',
        ["monitr"],
    ),
}


@pytest.mark.parametrize("case", CONSEQUENCES)
def test_what_follows_from_a_mistake_is_not_told(tmp_path, case):
    text, keys = CONSEQUENCES[case]
    said = [error.key for error in mistakes(write(tmp_path, DBC, text))]
    assert said == keys


def test_a_bus_whose_database_is_missing_hides_only_what_is_on_it(tmp_path):
    path = write(
        tmp_path,
        DBC,
        '[[bus]]\nname = "c"\nuri = "virtual:y"\ndatabase = ["none.dbc"]\n[[bus.check]]\nmessage = "Wheel"\n'
        f'[[monitor]]\nname = "w"\nbus = "c"\n{WATCHING}[[monitor]]\nname = "v"\nbus = "b"\n{MISSPELT}'
        f'[[monitor]]\nname = "u"\nbus = "b"\n{WATCHING}signals = {{ "Wheel.Speed" = "c.Wheel.Speed" }}\n'
        f'[[monitor]]\nname = "t"\nbus = "b"\n{WATCHING}'
        '[fault."c.bus_off"]\npriority = 1\n[fault."c.Wheel.length"]\npriority = 1\n'
        '[fault."t.Speed.high"]\nfreeze_frame = ["Other.Signal", "b.Wheel.Ger"]\n[output.dtc_frame]\nbus = "c"\n',
    )
    said = [(error.file, error.key) for error in mistakes(path)]
    assert said == [
        (str(path), "bus[1].database"),
        (str(path), "monitor[1].signal[0].signal"),
        (str(path), 'fault."t.Speed.high".freeze_frame[1]'),
    ]


def test_a_key_of_a_bus_that_nothing_depends_on_hides_nothing(tmp_path):
    path = write(tmp_path, DBC, f'[[monitor]]\nname = "w"\n{MISSPELT}', more="bitrate = 5\n")
    path.write_text(path.read_text().replace("virtual:x", "vcan0"))
    assert [error.key for error in mistakes(path)] == ["bus[0].uri", "bus[0].bitrate", "monitor[0].signal[0].signal"]


def test_a_file_that_cannot_be_read_is_one_mistake(tmp_path):
    (tmp_path / "c.toml").write_text("bus = [\n")
    assert [(error.line, error.key) for error in mistakes(tmp_path / "c.toml")] == [(1, "bus")]
    assert [error.file for error in mistakes(tmp_path / "none.toml")] == [str(tmp_path / "none.toml")]


def test_a_configuration_that_is_right_has_none(tmp_path):
    assert mistakes(shipped("gateway.toml")) == []
