"""What each fault's test depends on, in all configurations that come with the gateway, and of strangers' monitors."""

from dataclasses import replace
from pathlib import Path

import pytest

from gateway.config.load import load_config
from gateway.engine.depends.monitors import of_monitor
from gateway.engine.depends.parts import Network, strongest
from gateway.engine.depends.residuals import residuals
from gateway.engine.depends.underlying_tests import behind
from gateway.engine.instances import MonitorInstance
from gateway.monitors.contract import Behind, Blame, Blames, Gain, LastResult, Reading, Residuals
from gateway.monitors.registry import MONITORS
from gateway.runtime.assemble import prepare
from gateway.signals.database import load_database
from gateway.signals.tables import SignalRef
from gateway_fdi.common.resources import all_shipped, shipped
from gateway_fdi.diagnosis.system import PRIORS
from gateway_fdi.errors import InputError, InputErrors, each_of

ROOT = Path(__file__).parents[2]
CONFIGS = sorted(
    [*all_shipped("configs", ".toml"), ROOT / "gateway.toml", ROOT / "examples/battery_voltage/gateway.toml"]
)
#: Not a configuration of its own.
CATALOGUES = {"diagnostics_faults.toml"}


def depends(path):
    config = load_config(path)
    parts = prepare(config, path)
    return config, parts, parts.depends


@pytest.mark.long
@pytest.mark.parametrize("path", [p for p in CONFIGS if p.name not in CATALOGUES], ids=lambda p: p.stem)
def test_every_fault_of_every_configuration_depends_on_something(path):
    config, parts, found = depends(path)
    assert list(found) == [slot.id for slot in parts.engine.faults]
    buses = {bus.name: k for k, bus in enumerate(config.buses)}
    for fault, seen in found.items():
        assert seen, fault
        names = [one.component.name for one in seen]
        assert len(set(names)) == len(names)
        for one in seen:
            assert 0.0 < one.power < 1.0
            kind, _, way = one.component.name.partition(" ")
            assert kind == one.component.kind
            assert kind in PRIORS or kind in ("gateway", "reported"), fault
            if kind in ("message", "signal"):
                bus, message, *signal = way.split(".")
                message = parts.databases[buses[bus]].message(message)
                assert set(signal) <= {each.name for each in message.signals}
            if kind == "ecu":
                bus, sender = way.split(".")
                assert sender == "unnamed" or any(sender in message.senders for message in parts.databases[buses[bus]])


def names(seen):
    return {one.component.name: one.power for one in seen}


def test_a_message_that_is_missing_blames_the_way_that_it_takes():
    _, _, found = depends(shipped("configs/signals.toml"))
    told = names(found["chassis.Vehicle.timeout"])
    assert set(told) == {"message chassis.Vehicle", "ecu chassis.Body"}, "while others are heard the bus is well"
    assert told["ecu chassis.Body"] > told["message chassis.Vehicle"] > 0.0  # if that is at fault
    silent = names(found["chassis.bus_silent"])
    assert set(silent) == {"bus chassis"}
    assert "bus chassis" not in names(found["relations.front"])  # what arrives and is wrong was wrong before


def test_a_rule_blames_each_of_its_signals_and_itself():
    _, _, found = depends(shipped("configs/signals.toml"))
    told = names(found["relations.front"])
    signals = {f"signal chassis.{name}" for name in ("WheelSpeeds.FL", "WheelSpeeds.FR", "Vehicle.Speed")}
    assert {name for name in told if name.startswith("signal")} == signals
    assert "model relations.front" in told


def test_isolation_says_whom_a_fault_blames():
    _, _, found = depends(shipped("configs/linear_aircraft.toml"))
    sensor = found["aircraft.sensor_roll"]
    assert sensor[0].component.name == "signal flight.Aircraft_Sensors.Roll"
    assert not any("Yaw" in one.component.name for one in sensor)
    actuator = found["aircraft.actuator_rudder"]
    assert actuator[0].component.name == "actuator flight.Aircraft_Command.Rudder"
    _, _, found = depends(shipped("configs/tanks.toml"))
    assert names(found["tanks.f_1"])["signal tanks.Sensors.Level1"] == pytest.approx(0.9)
    (pump, power), *others = names(found["tanks.f_p"]).items()
    assert pump == "plant tanks.f_p"  # not its command
    assert power == 2.0 * max(share for _, share in others), "two others may fire together what it does"


def test_faults_of_one_channel_share_what_they_see_of_it():
    _, _, found = depends(shipped("configs/pedal_three.toml"))
    own = [seen[0] for fault, seen in found.items() if fault.startswith("brake.channel_2_")]
    assert {one.component.name for one in own} == {"signal chassis.PED_Brake3.Ch2"}
    assert sum(one.power for one in own) == pytest.approx(0.9)


def test_a_sender_that_stands_for_nobody_is_no_ecu():
    """Most messages of opendbc's databases have the sender XXX: that they share it means nothing."""
    network = Network(["can0"], {0: load_database([ROOT / "examples/car/toyota_rav4.dbc"])})
    assert network.senders(0, "SPEED") == []
    assert network.senders(0, "no such message") == []


def test_the_sender_of_a_j1939_message_is_who_has_its_address(tmp_path):
    frame = 'BO_ {} {}: 8 Vector__XXX\n SG_ X : 0|8@1+ (1,0) [0|255] "" Vector__XXX\n'
    kind = 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    ids = {"EEC1": 0x8CF00417, "CCVS": 0x98FEF1FE}
    text = "".join(frame.format(can_id, name) for name, can_id in ids.items()) + kind
    (tmp_path / "a.dbc").write_text(text + "".join(f'BA_ "VFrameFormat" BO_ {each} 3;\n' for each in ids.values()))
    network = Network(["can0"], {0: load_database([tmp_path / "a.dbc"])})
    assert [one.name for one in network.senders(0, "EEC1")] == ["ecu can0.0x17"]
    assert network.senders(0, "CCVS") == [], "0xFE is the address of who has none"


# By configuration -----------------------------------------------------------------------------------------------------


def configured_by(more, tmp_path):
    text = shipped("configs/signals.toml").read_text()
    path = tmp_path / "signals.toml"
    path.write_text(text + more)
    return depends(path)[2]


def test_a_signal_that_stands_blames_its_message_as_a_frozen_one_repeats_it(tmp_path):
    found = names(configured_by("", tmp_path)["wheels.RL.stuck"])
    assert found["frozen chassis.WheelSpeeds"] == pytest.approx(0.99), "what repeats its payload never moves"
    assert found["message chassis.WheelSpeeds"] < 0.01, "it may fail in many other ways"
    assert not {"frozen chassis.Vehicle"} & set(found), "it only carries the speed that moves"


def test_a_relation_sees_a_message_freeze_only_beside_another_message(tmp_path):
    """Signals of one frozen message go on to fit each other: that clears nothing of it."""
    found = configured_by("", tmp_path)
    own = {one.component.name: one.component for one in found["relations.speed"]}
    frozen = {"frozen chassis.WheelSpeeds", "frozen chassis.Vehicle"}
    assert frozen <= set(own)
    assert {own[name].told for name in frozen} == {"message chassis.WheelSpeeds", "message chassis.Vehicle"}
    assert not any(name.startswith("frozen") for name in names(found["relations.front"]))


def test_a_protection_that_is_watched_as_a_signal_is_wrong_as_its_message_is():
    network = Network(["a"], {}, [SignalRef(0, "M", "Counter")])
    assert network.signal(SignalRef(0, "M", "Counter")).name == "message a.M"
    assert network.signal(SignalRef(0, "M", "Speed")).name == "signal a.M.Speed"


def test_a_supply_is_seen_by_what_sees_what_it_feeds(tmp_path):
    supply = """
[[diagnosis.supply]]
name = "sensors_5V"
feeds = ["WheelSpeeds.FL", "WheelSpeeds.FR"]

[[diagnosis.supply]]
name = "G101"
kind = "ground"
feeds = ["Brakes", "Body"]
"""
    before, found = depends(shipped("configs/signals.toml"))[2], configured_by(supply, tmp_path)
    of = "supply sensors_5V"
    assert {fault for fault, seen in found.items() if of in names(seen)} == {
        fault for fault, seen in before.items() if "signal chassis.WheelSpeeds.FL" in names(seen) or "FR" in fault
    }
    told = names(found["chassis.Vehicle.timeout"])
    assert told["ground G101"] == pytest.approx(0.9 * told["ecu chassis.Body"])
    assert "ground G101" in names(found["chassis.WheelSpeeds.timeout"])


def test_priors_are_those_of_the_configuration(tmp_path):
    found = configured_by('\n[diagnosis]\npriors = { signal = 0.01, "ecu chassis.Body" = 0.2 }\n', tmp_path)
    priors = {one.component.name: one.component.prior for seen in found.values() for one in seen}
    assert priors["signal chassis.Vehicle.Speed"] == 0.01
    assert priors["ecu chassis.Body"] == 0.2
    assert priors["ecu chassis.Brakes"] is None


@pytest.mark.parametrize(
    ("text", "key", "said"),
    [
        ('[[diagnosis.supply]]\nname = "a"\nfeeds = ["Brake"]', "diagnosis.supply[0].feeds[0]", "did you mean Brakes"),
        ("[diagnosis]\npriors = { signl = 0.1 }", "diagnosis.priors.signl", "did you mean signal"),
        ("[diagnosis]\npriors = { signal = 0.7 }", "diagnosis", "at most 0.5"),
        ('[[diagnosis.supply]]\nname = "a"\nfeeds = ["Body", "Body"]', "diagnosis.supply[0]", "names Body twice"),
    ],
)
def test_a_slip_of_a_configuration_is_named_with_its_key(tmp_path, text, key, said):
    with pytest.raises((InputError, InputErrors)) as error:
        configured_by(f"\n{text}\n", tmp_path)
    (one,) = each_of(error.value)
    assert one.key == key
    assert said in str(one)


# A monitor of a stranger ---------------------------------------------------------------------------------------------


@pytest.fixture
def stranger(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "examples/battery_voltage"))
    return MONITORS.get("battery_voltage:MONITOR")


@pytest.fixture
def network():
    database = load_database([ROOT / "examples/battery_voltage/battery.dbc"])
    return Network(["a", "b"], {0: database, 1: database})


def of(monitor, network, **more):
    return of_monitor(MonitorInstance("battery", monitor, monitor.params(), **more), network)


def test_a_strangers_monitor_gets_it_from_its_connections(stranger, network):
    for seen in of(stranger, network).values():
        told = names(seen)
        assert set(told) == {"signal a.BATT.Voltage", "message a.BATT", "ecu a.ECU", "model battery"}
        assert told["signal a.BATT.Voltage"] <= 0.3  # nobody knows what it sees: a pass clears little
    elsewhere = of(stranger, network, signals={"BATT.Voltage": "b.BATT.Voltage"})
    assert all("signal b.BATT.Voltage" in names(seen) for seen in elsewhere.values())


def test_a_monitor_may_refine_it(stranger, network):
    fault = stranger.faults(stranger.params())[0].name
    knows = Blames(lambda p: {fault: [Blame(p.signal), Blame("alternator", "actuator", 0.5)]})
    found = of(replace(stranger, capabilities=(knows,)), network)
    assert names(found[fault])["actuator battery.alternator"] == pytest.approx(0.45)
    assert names(found[fault])["signal a.BATT.Voltage"] == pytest.approx(0.9)
    other = next(seen for name, seen in found.items() if name != fault)
    assert "model battery" in names(other)  # by its connections, as before


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"loww": [Blame("BATT.Voltage")]}, "no such fault; did you mean low"),
        ({"low": [Blame("BATT.Volage")]}, "no such signal is connected.*did you mean BATT.Voltage"),
        ({"low": [Blame("BATT.Voltage", share=0.0)]}, "a share above 0, at most 1.1"),
        ({"low": "BATT.Voltage"}, "a tuple of Blame"),
        (["low"], "names of faults and what they blame, not list"),
    ],
)
def test_a_slip_of_its_author_is_named_with_the_file(stranger, network, given, text):
    with pytest.raises(InputError, match=text) as error:
        of(replace(stranger, capabilities=(Blames(lambda _: given),)), network)
    assert error.value.file is not None
    assert error.value.file.endswith("battery_voltage.py")


def test_it_may_tell_its_residuals_and_the_tests_behind_its_faults(stranger, network):
    fault = stranger.faults(stranger.params())[0].name
    gains = (Gain("BATT.Voltage", 2.0), Gain("alternator", -1.0, "actuator"))
    knows = (
        Residuals(lambda p: {fault: lambda result: Reading(result.value - result.limit, 0.1, gains)}),
        Behind(lambda p: {"T1": [Blame(p.signal)]}, lambda p, state: [3.0], {"T1": 0.02}),
    )
    made = MonitorInstance("battery", replace(stranger, capabilities=knows), stranger.params())
    sized = residuals([made], network)[f"battery.{fault}"](LastResult([0.0] * 8, 11.0, 9.0, None))
    assert sized.residual == 2.0
    assert sized.gains == {"signal a.BATT.Voltage": 2.0, "actuator battery.alternator": -1.0}
    (tests,) = behind([made], network)
    assert list(tests.seen) == ["battery//T1"]
    assert tests.false_alarms == {"battery//T1": 0.02}
    assert tests.faults == tuple(f"battery.{one.name}" for one in stranger.faults(stranger.params()))
    wrong = replace(stranger, capabilities=(Residuals(lambda _: {"loww": None}),))
    with pytest.raises(InputError, match="no such fault; did you mean low"):
        residuals([MonitorInstance("battery", wrong, stranger.params())], network)


def test_a_component_is_there_once_as_it_is_seen_best(network):
    ref = SignalRef(0, "BATT", "Voltage")
    seen = strongest([*network.behind(ref, 0.2), *network.behind(ref, 0.5)])
    assert [round(one.power, 6) for one in seen] == [0.5, 0.01, 0.01]
