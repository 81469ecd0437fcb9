"""gallia's virtual ECU, with behaviour of chance: it is asked, and surveyed."""

import asyncio
import importlib

import numpy as np
import pytest
from asking_rig import BUS, MS, Car, Ecu, settled, write
from gallia.services.uds import server as gallia

from gateway.bus.frames import joined
from gateway.faults.vehicle import TOLD
from gateway_ask.survey import Survey

cli = importlib.import_module("gateway_ask.cli.survey")

#: What it can be asked for; the rest of it is of chance.
SERVICES = [0x10, 0x19, 0x22, 0x3E]
NAMES = {
    0xF187: "part number",
    0xF188: "software number",
    0xF18C: "serial number",
    0xF191: "hardware number",
    0xF197: "system name",
}


class Virtual:
    """gallia's server behind a transport of ours; `answers`: what it said, by request."""

    def __init__(self, seed):
        print("seed", seed)
        kinds = [gallia.UDSIsoServices(service) for service in SERVICES]
        chance = gallia.RandomUDSServer.RandomnessParameters(
            mandatory_services=kinds, optional_services=[], p_identifier=0.3, p_sub_function=0.9
        )
        server = gallia.RandomUDSServer(seed, chance)
        asyncio.run(server.setup())
        self.said = {}
        self._transport = gallia.UDSServerTransport(server, None)
        self.ecu = Ecu(0x7E2, 0x7EA, lambda request: [(5, self.answer(request))])

    def answer(self, request):
        found, _ = asyncio.run(self._transport.handle_request(request))
        self.said[bytes(request)] = found
        return found

    @property
    def dtcs(self):
        """DTCs with their status, of its answer to 19 02."""
        record = self.said[b"\x19\x02\xaf"][3:]
        kinds = ("P", "C", "B", "U")
        found = {}
        for at in range(0, len(record), 4):
            text = record[at : at + 3].hex().upper()
            found[f"{kinds[int(text[0], 16) >> 2]}{int(text[0], 16) & 3}{text[1:4]}-{text[4:]}"] = record[at + 3]
        return found


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 3])
def test_a_survey_tells_what_it_says(seed):
    virtual, made, heard = Virtual(seed), Survey(200.0, physical=range(0x7E0, 0x7E8)), []
    for k in range(60_000):
        t_ns = 2 * MS * (k + 1)
        frames = joined([*heard, virtual.ecu.step(t_ns)])
        frames["t_ns"] = t_ns
        sent = made.poll(t_ns, frames)
        sent["t_ns"] = t_ns
        heard = [virtual.ecu.take(sent)] if len(sent) else []
        if made.done:
            break
    assert made.done
    (told,) = cli._facts(made.found)["ecus"]
    assert (told["request"], told["response"]) == (0x7E2, 0x7EA)
    assert {name for name, there in told["services"].items() if there} == {"19", "22"}
    assert {each["dtc"]: each["status"] for each in told["dtcs"]} == virtual.dtcs
    good = {key[1:]: data for key, data in virtual.said.items() if data[0] == 0x62}
    for did, name in NAMES.items():
        assert (name in told["parts"]) == (did.to_bytes(2, "big") in good), name


@pytest.mark.long
@pytest.mark.parametrize("seed", [2])
def test_it_is_asked(seed, tmp_path):
    dids = np.random.default_rng(seed).integers(0, 1 << 16, 20).tolist()
    reads = ", ".join(f"{{ did = 0x{did:04X}, every_ms = 1000 }}" for did in dids)
    text = f'[[ecu]]\nname = "g"\nrequest = 0x7E2\nresponse = 0x7EA\nread = [{reads}]\ndtcs = {{ every_s = 10 }}\n'
    virtual = Virtual(seed)
    made = Car(write(tmp_path, BUS + "[bus.ask]\nrequests_per_s = 50\n" + text), [virtual.ecu])
    made.run(15_000)
    state = made.state()
    refused = [did for did in dids if virtual.said[b"\x22" + did.to_bytes(2, "big")][0] == 0x7F]
    assert 0 < len(refused) < len(dids)
    assert {name for name in state["not_asked"] if name.startswith("22")} == {f"22{did:04X}" for did in refused}
    assert settled(state)
    assert (state["absent"], state["answers_cut"]) == (0, 0)
    came = {event["dtc"] for event in made.events if event["event"] == "ecu_dtc" and event["state"] == "came"}
    assert came == {dtc for dtc, status in virtual.dtcs.items() if status & TOLD}
    made.close()
