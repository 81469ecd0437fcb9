"""One answer: 60 faults asked for by every door; status, counters and times are the same at each."""

import asyncio
import json
import os
import random

import numpy as np
import pytest
from doip_rig import Peer
from doors import Doors as _Doors
from rig import Rig, Tester, dtc_text, write_config
from uds_tester import EXTRA

from gateway.bus.frames import EXTENDED
from gateway.faults.dtc import Dtc
from gateway.servers.uds.extended_data import EXTENDED_DATA
from gateway_commands.faults import list_faults
from gateway_serve.status_socket import StatusSocket

FAULTS = 60
#: Extended data records that are compared, as numbers: occurrences, cycles, counters, times.
RECORDS = {
    0x01: "occurrence",
    0x02: "aged_cycles",
    0x03: "peak_fdc",
    0x04: "failed_cycles",
    0x10: "first_ns",
    0x11: "last_ns",
}


class Doors(_Doors):
    """A gateway with 60 faults."""

    def __init__(self, folder, draw):
        self.memory = folder / "m.sqlite"
        spn = {k: f"spn = {1000 + k}\nfmi = {k % 20}\n" for k in range(FAULTS)}
        extra = EXTRA.format(uds="") + "[output.j1939]\naddress = 0x2A\n[output.doip]\n[memory]\nentries = 100\n"
        self.config = write_config(folder, FAULTS + 1, extra=extra, faults=spn)
        self.rig = Rig(self.config, self.memory)
        self.path, self.now_s, self.loop = folder / "s", 1.0, None
        self.status = StatusSocket(self.path, self.rig.gateway)
        self.rig.wait(300)
        for _ in range(3):
            for k in range(FAULTS):
                if draw.random() < 0.7:
                    self.rig.fail(k)
                if draw.random() < 0.4:
                    self.rig.heal(k)
            if draw.random() < 0.7:
                self.rig.cycle()
        for k in range(FAULTS):
            if not self.rig.status(k) & 0x08:
                self.rig.fail(k)
        self.rig.wait(100)


def by_uds(ask):
    """Return (status, records) of each DTC by 0x19 02 and 06."""
    found = {}
    listed = ask("190208")
    for k in range(3, len(listed), 4):
        number, status = listed[k : k + 3], listed[k + 3]
        one = {"status": status}
        for record, name in RECORDS.items():
            answer = ask(f"1906{number.hex()}{record:02x}")
            assert answer[:2] == b"\x59\x06"
            assert answer[5] == status
            one[name] = int.from_bytes(answer[7 : 7 + EXTENDED_DATA[record].length], "big", signed=record != 1)
        found[str(Dtc(int.from_bytes(number, "big")))] = one
    return found


def by_sovd(doors):
    """Return the same by faults and their details."""
    own, found = "/sovd/v1/components/gateway/faults", {}

    def get(path):
        status, text = doors.http("GET", path, token="")
        assert status == 200
        return json.loads(text)

    for item in get(f"{own}?status[confirmedDTC]=1")["items"]:
        detail = get(f"{own}/{item['code']}")
        assert detail["item"] == item
        extended = detail["environment_data"]["extended_data_records"]
        found[item["code"]] = {
            "status": int(item["status"]["mask"], 16),
            **{name: extended[name] for name in RECORDS.values()},
        }
    return found


def of_entries(entries):
    """Return the same of entries as the JSON contract has them."""
    return {each["dtc"]: {name: each[name] for name in ("status", *RECORDS.values())} for each in entries}


def by_dm1(rig):
    """Return (SPN, FMI, occurrences) of the active DTCs, as they are broadcast."""
    rig.sent.clear()
    rig.wait(4000)
    data, size = {}, 0
    for can_id, payload in rig.sent:
        pgn = can_id >> 8 & 0x3FFFF
        if can_id & EXTENDED and pgn & 0x3FF00 == 0xEC00 and payload[0] == 0x20:
            size, data = int.from_bytes(payload[1:3], "little"), {}
        elif size and can_id & EXTENDED and pgn & 0x3FF00 == 0xEB00:
            data[payload[0]] = payload[1:]
            if len(data) * 7 >= size:
                break
    whole = b"".join(data[k] for k in sorted(data))[2:size]
    rows = np.frombuffer(whole, np.uint8).reshape(-1, 4)
    return {(int(a | b << 8 | (c >> 5) << 16), int(c & 31), int(d & 127)) for a, b, c, d in rows.astype(int)}


@pytest.mark.evidence("Live is replay: one answer")
@pytest.mark.long
def test_sixty_faults_are_the_same_by_every_door(tmp_path, capsys):
    seed = int(os.environ.get("GATEWAY_SEED", "52"))
    print(f"seed {seed}")
    with Doors(tmp_path, random.Random(seed)) as doors:
        bus, peer, reader = Tester(doors.rig), Peer(doors), doors.reader()
        peer.activate()
        wanted = by_uds(bus.ask)
        assert len(wanted) == FAULTS
        assert len({json.dumps(each) for each in wanted.values()}) > FAULTS // 2, "they differ"
        assert by_uds(lambda request: bytes.fromhex(peer(request))) == wanted
        assert by_uds(lambda request: bytes.fromhex(reader.ask("request", tester="t", uds=request)["uds"][0])) == wanted
        assert by_sovd(doors) == wanted
        assert of_entries(page(doors)) == wanted
        capsys.readouterr()
        list_faults(doors.config, memory=doors.memory, json=True)
        assert of_entries(json.loads(capsys.readouterr().out)) == wanted
        active = {
            (1000 + k, k % 20, min(wanted[dtc_text(k)]["occurrence"], 126))
            for k in range(FAULTS)
            if wanted[dtc_text(k)]["status"] & 1
        }
        assert by_dm1(doors.rig) == active, "J1939 has those that fail now, with their occurrences"


def page(doors):
    """Return the entries as an open page gets them."""
    found = doors.loop.run_until_complete(asyncio.wait_for(doors.hub.read_memory(), 10))
    return found["entries"]
