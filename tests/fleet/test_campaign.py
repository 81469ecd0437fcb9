"""Campaigns: limits that a fleet's owner signs, and all that an attacker at the broker can offer instead."""

import asyncio
import base64
import json
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from judging import Fleet
from road import car_of

from gateway.config.load import load_config
from gateway.faults.fleet import LIMITS
from gateway.faults.records import Changes, Recording
from gateway.faults.resilient_store import ResilientStore
from gateway.runtime.contract import wrong
from gateway_fdi.errors import GatewayError, InputError
from gateway_fleet.live import signed_documents
from gateway_fleet.live.campaign import Campaign, is_in, next_stage
from gateway_fleet.live.member import Member
from gateway_fleet.live.shadow import Shadow
from gateway_fleet.live.statistics import _Test, columns
from gateway_fleet.live.trials import Trials

NOW = datetime(2026, 11, 29, tzinfo=UTC)
TEST = "voltage.Volts.high"
CAR = """
[[bus]]
name = "can0"
uri = "loopback:127.0.0.1:29539"
database = ["battery.dbc"]
[[monitor]]
name = "voltage"
type = "signal"
signal = [{{ signal = "BATT.Volts", plausible = [10.0, 15.0] }}]
[output.dtc_frame]
bus = "can0"
[status]
socket = "status"
[fleet]
name = "vans"
car = "c0ffee01"
model = "van"
software = "7.1"
limits = "{folder}/limits.toml"
"""


class Beside:
    """A shadow that is asked for, and does nothing."""

    def __init__(self):
        self.tables = None

    def begin(self, tables):
        self.tables = tables

    def end(self):
        self.tables = None


class Rig:
    """A car, its owner's keys, and what the car says."""

    def __init__(self, folder):
        from battery_bus import DBC

        self.folder, self.shadow, self.said, self.loads = folder, Beside(), [], 0
        (folder / "battery.dbc").write_text(DBC)
        self.config = folder / "car.toml"
        self.config.write_text(CAR.format(folder=folder))
        self.car = car_of(limits=folder / "limits.toml")
        self.keys = {name: signed_documents.Ed25519PrivateKey.generate() for name in ("root", "signer", "other")}
        (folder / "keys.signed").write_bytes(self.keyring())
        self.trials = self.begin()

    def begin(self):
        def reload():
            self.loads += 1

        return Trials(
            self.car, self.config, self.folder / "keys.signed", self.folder / "state",
            shadow=self.shadow, reload=reload, post=self.said.append,
        )  # fmt: skip

    def keyring(self, serial=1, by="root", fleet="vans", signers=("signer",)):
        public = {name: signed_documents.public_of(key) for name, key in self.keys.items()}
        told = {"fleet": fleet, "serial": serial, "root": [public["root"]], "signer": [public[n] for n in signers]}
        return signed_documents.sign("keys", signed_documents.to_toml(told), self.keys[by])

    def campaign(self, by="signer", kind="campaign", **changed):
        told = {
            "fleet": "vans", "name": "cold", "serial": 2, "until": NOW + timedelta(days=9), "share": 1.0,
            "shadow_hours": 10.0, "control_per_hour": 0.001, "limit": [{"test": TEST, "limit": 15.5}],
        }  # fmt: skip
        return signed_documents.sign(kind, signed_documents.to_toml({**told, **changed}), self.keys[by])

    def offer(self, document):
        return self.trials.offer(document, NOW)

    @property
    def states(self):
        return [event["state"] for event in self.said]

    @property
    def judges(self):
        """Upper limit by which the daemon would judge now, and the campaign that it says."""
        config = load_config(self.config)
        return config.monitor[0].signal[0]["plausible"][1], config.fleet.serial


@pytest.fixture
def rig(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Rig(tmp_path)


def test_limits_judge_in_shadow_then_report_and_the_car_goes_back_by_itself(rig):
    assert rig.judges == (15.0, 0)
    assert rig.offer(rig.campaign()) == ""
    assert rig.shadow.tables["monitor"][0]["signal"][0]["plausible"] == [10.0, 15.5]
    assert rig.judges == (15.0, 0), "it reports by its own"
    rig.trials.drove(9.9, causes=1, shadow_causes=2, now=NOW)
    rig.trials = rig.begin()  # killed, and begun again
    assert rig.shadow.tables is not None
    rig.trials.drove(0.2, 0, 0, now=NOW)
    assert rig.states == ["shadow", "waits", "active"]
    assert rig.shadow.tables is None
    assert rig.judges == (15.5, 2)
    assert rig.loads == 1
    rig.trials.drove(100.0, 1, 0, now=NOW)
    assert rig.states[-1] == "active", "one cause in 100 h is chance"
    rig.trials = rig.begin()
    rig.trials.drove(1.0, 4, 0, now=NOW)
    assert rig.states[-1] == "back"
    assert "more causes" in rig.said[-1]["reason"]
    assert rig.judges == (15.0, 0)
    assert rig.loads == 2
    assert "not newer" in rig.offer(rig.campaign()), "and does not take it again"


def test_what_is_worse_in_shadow_reports_never(rig):
    rig.offer(rig.campaign())
    rig.trials.drove(10.0, 1, 20, now=NOW)
    assert rig.states == ["shadow", "back"]
    assert rig.judges == (15.0, 0)
    assert rig.loads == 0


def test_a_later_stage_needs_no_other_shadow_and_the_end_ends_it(rig):
    rig.offer(rig.campaign(share=1e-9))
    rig.trials.drove(10.0, 0, 0, now=NOW)
    assert rig.states == ["shadow", "waits"]
    rig.offer(rig.campaign(serial=3, share=1.0))
    assert rig.states[-1] == "active"
    assert rig.judges == (15.5, 3)
    rig.offer(rig.campaign(serial=4, withdrawn=True))
    assert rig.said[-1]["reason"] == "withdrawn by the fleet"
    assert rig.judges == (15.0, 0)
    rig.offer(rig.campaign(serial=5, name="next"))
    rig.trials.drove(10.0, 0, 0, now=NOW)
    assert rig.judges == (15.5, 5)
    rig.trials.drove(0.1, 0, 0, now=NOW + timedelta(days=10))
    assert rig.said[-1]["reason"] == "it is over"
    assert rig.judges == (15.0, 0)


@pytest.mark.parametrize(
    ("document", "reason"),
    [
        (lambda r: r.campaign(by="other"), "key that is not believed"),
        (lambda r: r.campaign(by="root"), "key that is not believed"),
        (lambda r: r.campaign().replace(b"15.5", b"99.0"), "not that of this document"),
        (lambda r: r.campaign().replace(b'"cold"', b'"warm"'), "not that of this document"),
        (lambda r: r.campaign(kind="keys").replace(b"#signed keys", b"#signed campaign"), "not that of this document"),
        (lambda r: r.campaign(fleet="others"), "another fleet"),
        (lambda r: r.campaign(model="truck"), "not for this car"),
        (lambda r: r.campaign(software="6.*"), "not for this car"),
        (lambda r: r.campaign(until=NOW - timedelta(seconds=1)), "over"),
        (lambda r: r.campaign(until=datetime(2027, 1, 1)), "until"),
        (lambda r: r.campaign(serial=0), "serial"),
        (lambda r: r.campaign(limit=[{"test": TEST, "limit": 1e9}]), "no more than 4 times"),
        (lambda r: r.campaign(limit=[{"test": TEST, "limit": 9.0}]), "no more than 4 times"),
        (lambda r: r.campaign(limit=[{"test": TEST, "limit": float("nan")}]), "limit"),
        (lambda r: r.campaign(limit=[{"test": "access.unlock.high", "limit": 1.0}]), "no test of a signal"),
        (lambda r: r.campaign(limit=[{"test": "voltage.Volts.invalid", "limit": 1.0}]), "no test of a signal"),
        (lambda r: r.campaign(limit=[{"test": TEST, "limit": 15.5, "type": "evil:RUN"}]), "unknown key"),
        (lambda r: r.campaign(access={"local_unlocked": True}), "unknown key"),
        (lambda r: r.campaign(monitor=[{"name": "x", "type": "evil:RUN"}]), "unknown key"),
        (lambda r: r.campaign(output={"dtc_frame": {"bus": "can0"}}), "unknown key"),
        (lambda r: b"", "no signed document"),
        (lambda r: b"#signed campaign \xff", "no signed document"),
        (lambda r: b"x" * (signed_documents.MOST_BYTES + 1), "more than"),
        (lambda r: r.keyring(serial=1), "not newer"),
        (lambda r: r.keyring(serial=2, by="signer"), "key that is not believed"),
        (lambda r: r.keyring(serial=2, by="other"), "key that is not believed"),
        (lambda r: r.keyring(serial=2, fleet="others"), "another fleet"),
    ],
)
def test_what_an_attacker_offers_changes_nothing(rig, document, reason):
    """Neither code, nor frames, nor access, nor another fleet's, nor what is over or was changed on the way."""
    assert reason in rig.offer(document(rig))
    assert rig.shadow.tables is None
    assert rig.judges == (15.0, 0)
    assert rig.offer(rig.campaign(serial=9)) == "", "a right one comes through still"


def test_replay_and_rollback_are_refused_also_after_a_restart(rig):
    old, new = rig.campaign(serial=2), rig.campaign(serial=7, limit=[{"test": TEST, "limit": 15.2}])
    assert rig.offer(old) == ""
    assert rig.offer(new) == ""
    for _ in range(2):
        assert "not newer than campaign 7" in rig.offer(old)
        assert "not newer than campaign 7" in rig.offer(new)
        rig.trials = rig.begin()
    (rig.folder / "state").write_text("{torn")
    with pytest.raises(GatewayError, match="no state of campaigns"):
        rig.begin()  # and not as if nothing had been seen


def test_keys_are_changed_and_revoked(rig):
    assert rig.offer(rig.keyring(serial=2, signers=("other",))) == ""
    assert "not believed" in rig.offer(rig.campaign())
    assert rig.offer(rig.campaign(by="other")) == ""
    rig.trials = rig.begin()
    assert "not believed" in rig.offer(rig.campaign(serial=3)), "also after a restart"
    assert "not newer" in rig.offer(rig.keyring(serial=1))
    assert rig.offer(rig.keyring(serial=3, signers=())) == "", "all revoked"
    assert "not believed" in rig.offer(rig.campaign(by="other", serial=3))
    (rig.folder / "keys.signed").write_bytes(rig.keyring(fleet="others"))
    with pytest.raises(GatewayError, match="keys of fleet others"):
        rig.begin()


def test_limits_that_do_not_fit_any_more_leave_the_car_with_its_own(rig, capsys):
    """A car is never without diagnosis because of a campaign."""
    (rig.folder / "limits.toml").write_text("serial = 3\nlimit = [{ test = 'gone.X.high', limit = 1.0 }]\n")
    assert rig.judges == (15.0, 0)
    assert "limits of a campaign are not taken" in capsys.readouterr().out
    (rig.folder / "limits.toml").write_text("serial = [")
    assert rig.judges == (15.0, 0)


def test_a_shadow_neither_sends_nor_asks_nor_listens_for_testers(rig):
    rig.offer(rig.campaign())
    made = Shadow(rig.config, rig.folder)._changed(rig.shadow.tables)
    assert made["bus"][0]["listen_only"] is True
    assert not made.keys() & {"output", "status", "report", "record", "ecu"}
    assert made["memory"]["path"] != load_config(rig.config).memory.path
    assert "limits" not in made["fleet"]
    assert made["fleet"]["serial"] == 2


def test_a_bad_campaign_is_withdrawn_at_one_percent_and_a_good_one_goes_on():
    base = {"fleet": "vans", "name": "cold", "serial": 5, "until": NOW, "share": 0.01}
    campaign = Campaign(**base)
    stage, why = next_stage(campaign, [(0, 20, 10_000.0), (5, 6, 100.0)], 100.0)
    assert stage.withdrawn
    assert (stage.serial, stage.first) == (6, 5)
    assert "6 causes in 100.0 h" in why
    stage, _ = next_stage(campaign, [(0, 20, 10_000.0), (5, 1, 100.0)], 100.0)
    assert (stage.withdrawn, stage.share, stage.serial) == (False, 0.1, 6)
    assert stage.control_per_hour == pytest.approx(0.002)
    assert next_stage(campaign, [(0, 20, 10_000.0), (5, 0, 99.0)], 100.0)[0] is None
    later, _ = next_stage(stage, [(0, 20, 10_000.0), (5, 1, 100.0), (6, 2, 900.0)], 100.0)
    assert later.share == 1.0
    cars = [f"{k:024x}" for k in range(20_000)]
    small, large = ({car for car in cars if is_in(share, "vans", "cold", car)} for share in (0.01, 0.1))
    assert small < large
    assert len(small) == pytest.approx(200, abs=60)
    assert {car for car in cars if is_in(0.01, "vans", "warm", car)} != small


def test_a_campaign_says_whose_statistics_and_recordings_are_told(rig):
    """Recordings in parts, each once, and none beyond the bytes."""
    rig.offer(rig.campaign(tests=["voltage.*"], recordings=["*.Volts.high"], bytes=50_000))
    config = load_config(rig.config)
    member = Member(config, rig.config, Path("status"), None)
    member._trials = rig.trials

    def recorded(t_ns, fault, size):
        with closing(ResilientStore(config.memory.path)) as store:
            found = Recording(fault, t_ns, 7, 1, bytes(size))
            store.save(Changes(recordings=[found], kept_recordings=9))
        events = member._recordings(rig.trials)
        assert [wrong(event) for event in events] == [""] * len(events)
        return [(event["t_ns"], event["fault"], len(base64.b64decode(event["log"]))) for event in events]

    assert recorded(1, TEST, 10_000) == [(1, TEST, 10_000)]
    assert recorded(2, "voltage.Volts.low", 10) == []
    assert recorded(3, TEST, 40_001) == [], "beyond the bytes"
    assert recorded(4, TEST, 40_000) == [(4, TEST, 30_000), (4, TEST, 10_000)]
    assert rig.trials.state.bytes == 50_000
    tests = columns({name: (_Test(sign=1), [1.0] * 20) for name in ("other.X.high", TEST)})
    head = {
        "event": "statistics",
        "t_ns": 5,
        "begin_ns": 1,
        "part": 0,
        "condition": "",
        "block_s": 60.0,
        "seconds": 60.0,
    }
    member.drive.give_back([head | {"tests": tests}])
    asyncio.run(member._report())
    with closing(ResilientStore(config.memory.path)) as store:
        (row,) = store.outgoing()
    assert json.loads(row.body)["tests"] == columns({TEST: (_Test(sign=1), [1.0] * 20)})


@pytest.mark.long
def test_cars_that_judge_take_a_good_campaign_on_and_a_bad_one_back_at_one_percent(tmp_path):
    """Limits that are too tight, as cold days show, which the shadow had not: twice by the fleet, once by the car."""
    fleet = Fleet(tmp_path)
    good = fleet.campaign(15.5)
    fleet.join(good, 2, 2)
    fleet.offer(good)
    for highest in (13.0, 14.5):
        fleet.drive(highest)
    assert [car.trials.state.state for car in fleet.cars] == ["active"] * 2 + ["waits"] * 2
    assert [load_config(car.file).fleet.serial for car in fleet.cars] == [10, 10, 0, 0]
    stage, why = fleet.next(good, 2.0)
    assert (stage.withdrawn, stage.share) == (False, 0.1)
    assert why == "10%: 0 causes in 2.0 h, by their own limits 0 in 6.0 h"
    bad = fleet.campaign(13.5)
    inside = fleet.join(bad, 2, 2)
    fleet.offer(bad)
    fleet.drive(13.0)
    assert [car.trials.state.state for car in inside] == ["active"] * 2
    for _ in range(4):
        fleet.drive(14.5)
    stage, why = fleet.next(bad, 100.0)
    assert stage.withdrawn, why
    assert "8 causes in 8.0 h, by their own limits 0" in why
    fleet.offer(stage)
    assert [(car.trials.state.state, load_config(car.file).fleet.serial) for car in inside] == [("back", 0)] * 2
    bad = fleet.campaign(13.5, control_per_hour=1e-4)
    fleet.offer(bad)
    inside = fleet.join(bad, 1, 0)
    fleet.offer(bad)
    for highest in (13.0, 14.5):
        fleet.drive(highest)
    assert inside[0].trials.state.state == "back", "by itself, before the fleet knows"


def test_the_memory_says_which_limits_judged(tmp_path):
    from fault_examples import catalogue, event, frame

    from gateway.faults import service
    from gateway.faults.memory import FaultMemory

    path = tmp_path / "faults.sqlite"
    for serial, fault in ((7, 0), (0, 1)):
        store = ResilientStore(path)
        memory = FaultMemory(catalogue((1, 1)), store, fleet=car_of(serial=serial))
        memory.start_cycle(serial)
        memory.apply(event(fault, True, 10), frame({}))
        memory.commit()
        store.close()
    assert {entry["fault"]: entry["limits"] for entry in service.list_entries(path)} == {"m.f0": 7, "m.f1": 0}
    assert LIMITS
    assert json.dumps(service.list_entries(path))
    with pytest.raises(InputError):
        signed_documents.private_of(path)
