"""Each kind of fault of a rest bus is seen by the DTC that is meant for it, and by no other."""

import pytest

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.message_faults import KINDS
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.errors import GatewayError

SEED = 7
DBC = """VERSION ""
BU_: A B
BO_ 256 Drive: 8 A
 SG_ Counter : 0|4@1+ (1,0) [0|15] "" B
 SG_ Swing : 8|12@1- (0.1,0) [-200|200] "" B
 SG_ Calm : 20|12@1- (0.1,0) [-200|200] "" B
 SG_ Level : 32|8@1+ (1,0) [0|200] "" B
 SG_ One : 40|16@1- (0.1,0) [-3000|3000] "" B
 SG_ Crc : 56|8@1+ (1,0) [0|255] "" B
BO_ 257 Other: 8 B
 SG_ Counter : 0|4@1+ (1,0) [0|15] "" A
 SG_ Two : 8|16@1- (0.1,0) [-3000|3000] "" A
 SG_ Mode : 24|8@1+ (1,0) [0|10] "" A
 SG_ Crc : 56|8@1+ (1,0) [0|255] "" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
VAL_ 257 Mode 0 "Off" 1 "On" 255 "SNA";
"""
PROTECTION = 'counter = { signal = "Counter" }\ncrc = { signal = "Crc", data_id = 0x1234 }\n'
CONFIG = f"""
[clock]
watched = false
[[bus]]
name = "can"
uri = "virtual:x"
database = ["car.dbc"]
health = {{ watched = false }}
[[bus.check]]
message = "Drive"
timeout_ms = 100
lost = "U0110"
invalid = "U0410"
{PROTECTION}
[[bus.check]]
message = "Other"
timeout_ms = 300
lost = "U0111"
invalid = "U0411"
{PROTECTION}
[[monitor]]
name = "limits"
type = "signal"
signal = [
    {{ signal = "Drive.Swing", stuck = {{ seconds = 0.5 }}, code = "C1000" }},
    {{ signal = "Drive.Calm", noise = {{ deviation = 2.0 }}, code = "C1001" }},
    {{ signal = "Drive.Level", plausible = [10, 200], code = "C1002" }},
    {{ signal = "Other.Mode", code = "C1004" }},
]
[[monitor]]
name = "relations"
type = "rule"
rule = [
    {{ name = "same", holds = "abs(Drive.One - Other.Two) < 12", failed_ms = 100, passed_ms = 200, code = "C1003" }},
]
[fault."can.Drive.counter"]                # one frame in two is right where each comes twice
debounce = {{ failed_after = 1 }}
"""
SCENARIO = f"""
name = "faults"
duration_s = 5.0
seed = {SEED}
config = "gateway.toml"
[[ecu]]
type = "restbus"
jitter_ms = 0.2
[[ecu.message]]
name = "Drive"
{PROTECTION}
[[ecu.message]]
name = "Other"
{PROTECTION}
[ecu.signals]
"Drive.Swing" = {{ sine = {{ amplitude = 100, period_s = 3 }} }}
"Drive.Calm" = {{ sine = {{ amplitude = 50, period_s = 4 }}, noise = 0.2 }}
"Drive.Level" = 100
"Drive.One" = {{ sine = {{ mean = 100, amplitude = 50, period_s = 5 }} }}
"Other.Two" = {{ expression = "Drive.One", noise = 0.1 }}
"""
SWING, CALM, LEVEL, ONE = ({"signal": f"Drive.{name}"} for name in ("Swing", "Calm", "Level", "One"))
DRIVE, OTHER = {"message": "Drive"}, {"message": "Other"}
#: Kind, its keys -> the DTC; until when [s] (None: the end); by when it is set after its begin [s].
TABLE = [
    ("stuck", SWING, "C1000-2A", 3.5, 1.1),
    ("noise", CALM | {"size": 10}, "C1001-2F", 3.0, 0.8),
    ("out_of_range", LEVEL, "C1002-85", 3.0, 0.7),
    ("value", LEVEL | {"size": 220}, "C1002-85", 3.0, 0.7),
    ("value", LEVEL | {"size": 2}, "C1002-84", 3.0, 0.7),
    ("gain", LEVEL | {"size": 0.05}, "C1002-84", 3.0, 0.7),
    ("offset", ONE | {"size": 20}, "C1003-64", 3.0, 0.2),
    ("gain", ONE | {"size": 1.2}, "C1003-64", 3.0, 0.6),
    ("drift", ONE | {"size": 30}, "C1003-64", 3.0, 0.8),
    ("stuck", ONE, "C1003-64", 3.5, 0.8),
    ("counter", DRIVE, "U0410-82", 3.0, 0.2),
    ("counter", OTHER | {"size": 5}, "U0411-82", 3.0, 0.2),
    ("checksum", DRIVE, "U0410-83", 3.0, 0.2),
    ("checksum", OTHER, "U0411-83", 3.0, 0.2),
    ("lost", OTHER, "U0111-87", 3.0, 0.35),
    ("lost", OTHER | {"probability": 0.6}, "U0411-82", 3.0, 0.9),
    ("late", DRIVE | {"delay_ms": 150}, "U0110-87", None, 0.15),
    ("doubled", DRIVE, "U0410-82", 3.0, 0.2),
    ("short", OTHER, "U0411-81", 3.0, 0.2),
    ("sna", {"signal": "Other.Mode"}, "C1004-86", 3.0, 0.7),
    ("babbling", DRIVE, "U0111-87", 3.0, 0.35),  # it takes the bus from what has a lower priority; itself it is whole
    ("bus_off", {}, "U0110-87 U0111-87", 3.0, 0.35),  # all of its messages
]


def run(folder, fault="", config=CONFIG, scenario=SCENARIO):
    """Return the events of DTCs that a gateway tells of the scenario, and what was injected."""
    (folder / "car.dbc").write_text(DBC)
    (folder / "gateway.toml").write_text(config)
    file = folder / "scenario.toml"
    file.write_text(scenario + fault)
    scenario = load_scenario(file)
    config = load_config(scenario.config)
    player = player_of(scenario, config)
    gateway, events = Gateway(config), []
    gateway.listen(events.append)
    gateway.start(0)
    for until, frames in player.batches():
        gateway.feed(frames)
        gateway.advance(until)
    gateway.stop(until)
    return [event for event in events if event["event"] == "dtc"], player.truth


def toml(kind, keys, from_s, to_s):
    times = {name: t for name, t in (("from_s", from_s), ("to_s", to_s)) if t is not None}
    values = {"kind": kind} | times | keys
    shown = (f'{name} = "{v}"' if isinstance(v, str) else f"{name} = {v}" for name, v in values.items())
    return "\n[[fault]]\n" + "\n".join(shown) + "\n"


def test_healthy_nothing_is_said(tmp_path):
    assert run(tmp_path) == ([], [])


def test_what_the_configuration_checks_is_sent_so(tmp_path):
    """No name tells the data id; the scenario need not repeat it. What it says goes before all the same."""
    tables = [f'[[ecu.message]]\nname = "{name}"\n{PROTECTION}\n' for name in ("Drive", "Other")]
    silent = SCENARIO
    for table in tables:
        assert table.strip() in silent
        silent = silent.replace(table.strip(), "")
    assert run(tmp_path, scenario=silent) == ([], [])
    events, _ = run(tmp_path, toml("checksum", DRIVE, 2.0, 3.0), scenario=silent)
    assert {event["dtc"] for event in events if event["status"] & 1} == {"U0410-83"}
    other = silent.replace("[ecu.signals]", tables[0].replace("0x1234", "0x1235") + "[ecu.signals]")
    events, _ = run(tmp_path, scenario=other)
    assert {event["dtc"] for event in events if event["status"] & 1} == {"U0410-56"}, "another rule than the check's"


@pytest.mark.parametrize(("kind", "keys", "dtc", "to_s", "within_s"), TABLE)
def test_each_is_seen_by_its_dtc_alone(kind, keys, dtc, to_s, within_s, tmp_path):
    events, truth = run(tmp_path, toml(kind, keys, 2.0, to_s))
    failed = [event for event in events if event["status"] & 1]
    assert {event["dtc"] for event in failed} == set(dtc.split())
    assert 2.0 <= failed[0]["t_ns"] / 1e9 <= 2.0 + within_s
    assert [fact.kind for fact in truth] == [kind]
    assert truth[0].t_ns == pytest.approx(2e9, abs=200e6 if "probability" in keys else 25e6)
    if to_s is not None:  # what is over heals
        assert not events[-1]["status"] & 1


@pytest.mark.parametrize(("kind", "keys", "dtc", "to_s", "within_s"), TABLE)
def test_each_by_a_condition_is_seen_by_its_dtc_alone(kind, keys, dtc, to_s, within_s, tmp_path):
    begins_s = 1.5  # until 3 s: 100 sin(2 pi t / 3), as it is without the fault
    when, from_s = "Drive.Swing < 0", None
    if kind == "late":  # at its end late frames and others cross each other
        when, from_s = "Drive.Level > 50", begins_s
    events, truth = run(tmp_path, toml(kind, keys | {"when": when}, from_s, None))
    failed = [event for event in events if event["status"] & 1]
    assert {event["dtc"] for event in failed} == set(dtc.split())
    assert begins_s - 0.05 <= failed[0]["t_ns"] / 1e9 <= begins_s + 0.05 + within_s
    assert {fact.kind for fact in truth} == {kind}
    assert truth[0].t_ns == pytest.approx(begins_s * 1e9, abs=200e6 if "probability" in keys else 50e6)


def test_the_table_has_every_kind():
    kinds = KINDS
    assert {row[0] for row in TABLE} == set(kinds)


def test_the_gateways_own_controller_is_bus_off(tmp_path):
    """Told by the bus itself: the messages that do not come then have a cause, and are nobody's fault."""
    watched = CONFIG.replace("health = { watched = false }", "")
    events, truth = run(tmp_path, toml("bus_off", {}, 2.0, 3.0).replace("[[fault]]", "[[wire]]"), watched)
    assert {event["dtc"] for event in events if event["status"] & 1} == {"U0001-88"}
    assert [fact.kind for fact in truth] == ["bus_off"]
    assert not events[-1]["status"] & 1


CONDITIONS = [  # when, from_s -> when it begins [s]
    ("Drive.Swing > 50", None, 0.25),  # 100 sin(2 pi t / 3)
    ("Drive.Swing > 50 and Other.Two > 140", None, 0.7378),  # 100 + 50 sin(2 pi t / 5)
    ("Drive.Swing < -50", 2.0, 2.0),  # from 1.75 s to 2.75 s
]


@pytest.mark.parametrize(("when", "from_s", "begins_s"), CONDITIONS)
def test_by_a_condition_on_signals(when, from_s, begins_s, tmp_path):
    keys = DRIVE | {"when": when} | ({} if from_s is None else {"from_s": from_s})
    events, truth = run(tmp_path, toml("checksum", keys, None, 4.0))
    assert {event["dtc"] for event in events if event["status"] & 1} == {"U0410-83"}
    assert truth[0].t_ns / 1e9 == pytest.approx(begins_s, abs=0.02)
    assert not events[-1]["status"] & 1, "it is over"


def test_a_condition_of_what_is_not_there_is_refused(tmp_path):
    with pytest.raises(GatewayError, match=r"fault\[0\]\.when.*did you mean Swing"):
        run(tmp_path, toml("checksum", DRIVE | {"when": "Drive.Swin > 3"}, 1.0, None))
    with pytest.raises(GatewayError, match=r"fault\[0\]\.when.*compares"):
        run(tmp_path, toml("checksum", DRIVE | {"when": "Drive.Swing + 3"}, 1.0, None))


def test_several_at_once_are_each_seen(tmp_path):
    text = toml("stuck", SWING, 2.0, 3.5) + toml("checksum", OTHER, 1.0, 1.5) + toml("out_of_range", LEVEL, 3.0, 4.0)
    events, truth = run(tmp_path, text)
    assert {event["dtc"] for event in events if event["status"] & 1} == {"C1000-2A", "U0411-83", "C1002-85"}
    assert [fact.kind for fact in truth] == ["checksum", "stuck", "out_of_range"]


def test_a_fault_that_never_comes_is_told_in_no_truth(tmp_path):
    assert run(tmp_path, toml("stuck", SWING, 9.0, None)) == ([], [])


def test_a_kind_that_is_none_is_refused(tmp_path):
    with pytest.raises(GatewayError, match=r"fault\[0\]\.kind = 'stuk'.*did you mean stuck"):
        run(tmp_path, toml("stuk", SWING, 1.0, None))
