"""A fleet whose cars judge: each drive is replayed by the car's gateway with the limits that it has, and told."""

import json
from contextlib import closing
from datetime import UTC, datetime, timedelta

import numpy as np
from battery_bus import DBC

import gateway_api as api
from gateway.config.load import load_config
from gateway.faults.catalogue import Catalogue
from gateway.faults.memory import FaultMemory
from gateway.faults.records import Changes
from gateway.faults.resilient_store import ResilientStore
from gateway.runtime.contract import STATISTICS
from gateway_fleet.live import signed_documents
from gateway_fleet.live.answers import Answers
from gateway_fleet.live.batch import packed
from gateway_fleet.live.campaign import Campaign, is_in, next_stage
from gateway_fleet.live.causes import CauseCount
from gateway_fleet.live.collect import Came, Collector
from gateway_fleet.live.trials import SHADOW, Trials

CONFIG = """
[[bus]]
name = "can0"
uri = "loopback:127.0.0.1:29539"
database = ["{folder}/battery.dbc"]
[[monitor]]
name = "voltage"
type = "signal"
signal = [{{ signal = "BATT.Volts", plausible = [10.0, 15.0] }}]
[fleet]
name = "vans"
car = "{car}"
limits = "{folder}/{car}.limits.toml"
"""
#: Seconds of a drive, which stand for an hour; when the first one begins.
DRIVE_S, BEGIN_S = 4.0, 1_790_000_000.0


class Car:
    """One car: a gateway for its drives, and one in shadow; its part in campaigns."""

    def __init__(self, fleet, name):
        self.folder, self.name, self.events = fleet.folder, name, []
        self.file, self.memory = fleet.folder / f"{name}.toml", fleet.folder / f"{name}.sqlite"
        self.file.write_text(CONFIG.format(folder=fleet.folder, car=name))
        self.tables = None
        params = load_config(self.file).fleet
        self.trials = Trials(
            params, self.file, fleet.folder / "keys", fleet.folder / f"{name}.state",
            shadow=self, reload=lambda: None, post=self.events.append,
        )  # fmt: skip

    def begin(self, tables):
        """Begin a shadow: each drive is judged a second time."""
        self.tables = tables

    def end(self):
        """End it."""
        self.tables = None

    def drive(self, number, highest):
        """Drive an hour in which the voltage goes up to its highest and back [V]; returns a batch of what is told."""
        setup = api.open(self.file)
        t_s = np.arange(0.0, DRIVE_S, 0.01)
        values = {"BATT": {"Volts": np.where((t_s > 1.0) & (t_s < 2.0), highest, 12.0)}}
        frames = setup.frames(BEGIN_S + 3600.0 * number + t_s, values)
        state = self.trials.state.state
        causes, shadow = self.judged(setup, frames, self.memory), 0
        if state == SHADOW:
            other = self.memory.with_suffix(".shadow")
            shadow = self.judged(api.open(self.tables), frames, other)
            other.unlink()
        self.trials.drove(1.0, causes, shadow, datetime.now(UTC))
        begin_ns = round((BEGIN_S + 3600.0 * number) * 1e9)
        self.events.append({
            "event": "statistics", "t_ns": begin_ns + 4 * 10**9, "begin_ns": begin_ns, "part": 0, "condition": "",
            "block_s": 60.0, "seconds": 3600.0, "tests": {name: [] for name in STATISTICS},
        })  # fmt: skip
        car = setup.config.fleet
        with closing(ResilientStore(self.memory)) as store:
            memory = FaultMemory(Catalogue(()), store, fleet=car)
            while self.events:
                memory.fleet.post(self.events.pop(0))
            assert memory.commit(final=True)
            payload, numbers = packed(car, store.outgoing(), store.tally())
            store.save(Changes(arrived=numbers, outgoing_bytes=car.bytes))
        return payload

    def judged(self, setup, frames, memory):
        """Have frames judged; returns how many causes were told."""
        count = CauseCount()
        with closing(ResilientStore(memory)) as store:
            before = store.tally().last
        setup.replay(frames, memory=memory)
        with closing(ResilientStore(memory)) as store:
            for row in store.outgoing(before):
                count.take(json.loads(row.body))
        return count.told


class Fleet:
    """Cars, their collector, and the owner, who signs."""

    def __init__(self, folder):
        self.folder, self.owner, self.serial, self.hour = folder, signed_documents.Ed25519PrivateKey.generate(), 0, 0
        (folder / "battery.dbc").write_text(DBC)
        public = signed_documents.public_of(self.owner)
        keys = {"fleet": "vans", "serial": 1, "root": [public], "signer": [public]}
        (folder / "keys").write_bytes(signed_documents.sign("keys", signed_documents.to_toml(keys), self.owner))
        self.collector, self.cars = Collector(folder / "out", "vans", 1e9), []

    def campaign(self, limit, **changed):
        """A campaign whose voltage may go up to a limit, at 1 %, after an hour in shadow."""
        self.serial += 10
        return Campaign.model_validate({
            "fleet": "vans", "name": f"c{self.serial}", "serial": self.serial, "shadow_hours": 1.0,
            "until": datetime.now(UTC) + timedelta(days=9), "limit": [{"test": "voltage.Volts.high", "limit": limit}],
            "control_per_hour": 1.0, **changed,
        })  # fmt: skip

    def join(self, campaign, inside, others):
        """Have so many cars of the campaign's share take part, and so many others; those of the share are returned."""
        names = [f"car{k:05d}" for k in range(1000)]
        chosen = [name for name in names if is_in(campaign.share, "vans", campaign.name, name)][:inside]
        rest = [name for name in names if name not in chosen and not is_in(0.1, "vans", campaign.name, name)][:others]
        self.cars = [Car(self, name) for name in chosen + rest]
        return self.cars[: len(chosen)]

    def offer(self, campaign):
        """Sign a campaign, and have all cars hear of it."""
        document = signed_documents.sign("campaign", signed_documents.to_toml(campaign.model_dump()), self.owner)
        assert [car.trials.offer(document) for car in self.cars] == [""] * len(self.cars)

    def drive(self, highest):
        """Have all cars drive an hour, up to this voltage [V]."""
        self.hour += 1
        for car in self.cars:
            self.collector.put(Came(car.name, car.drive(self.hour, highest), lambda digest: None))
        self.collector.run(lambda: True)

    def next(self, campaign, least_hours):
        """Return what the tables say of a campaign: its next stage, and why."""
        return next_stage(campaign, Answers(self.folder / "out").by_limits(), least_hours)
