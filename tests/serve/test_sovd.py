"""SOVD beside the other doors: the same memory, rules and trace; locks, roles, modes, events, failures."""

import json
from urllib.parse import quote

import pytest
from asking_rig import Car, Ecu
from doors import TOKEN, Doors
from jsonschema_rs import validate
from rig import dtc_text, write_config
from test_access import LEVEL, SECRET
from test_local import ROUTED

from gateway.servers.uds.security import hmac_sha256
from gateway_serve.memory import BITS
from gateway_serve.sovd.faults import instant
from gateway_serve.status_socket import StatusSocket

OWN = "/sovd/v1/components/gateway"


class Client:
    """A client of SOVD; each answer is held against the document."""

    def __init__(self, doors, token=TOKEN):
        self.doors, self.token = doors, token
        self.document = json.loads(doors.http("GET", "/sovd/v1/docs")[1])

    def __call__(self, method, path, body=None):
        """Return status and answer."""
        status, text = self.doors.http(method, path if path.startswith("/") else f"{OWN}/{path}", body, self.token)
        found = json.loads(text) if text else None
        if status >= 400:
            schema = {"$ref": "#/components/schemas/GenericError", "components": self.document["components"]}
            validate(schema, found)
        return status, found

    def good(self, method, path, body=None):
        status, found = self(method, path, body)
        assert status < 300, (status, found)
        return found

    def lock(self, seconds=30, path="locks"):
        return self.good("POST", path, {"lock_expiration": seconds})["id"]


@pytest.fixture
def doors(tmp_path):
    with Doors(tmp_path) as made:
        made.drive(0.0)
        yield made


@pytest.mark.evidence("ISO 17978-3: entities")
def test_entities_are_buses_ecus_and_monitors(doors):
    client = Client(doors, "")
    assert client.good("GET", "/sovd/version-info")["sovd_info"][0]["base_uri"] == "/sovd/v1"
    assert [each["id"] for each in client.good("GET", "/sovd/v1/components")["items"]] == ["gateway", "A"]
    assert [each["id"] for each in client.good("GET", "/sovd/v1/areas")["items"]] == ["b"]
    assert [each["id"] for each in client.good("GET", "/sovd/v1/areas/b/contains")["items"]] == ["A"]
    apps = [each["id"] for each in client.good("GET", "/sovd/v1/apps")["items"]]
    assert {"b.M0", "b.M1", "b.M2"} <= set(apps)
    assert client.good("GET", "/sovd/v1/components/A")["belongs-to"] == "/sovd/v1/areas/b"
    for place in client.good("GET", OWN).values():  # every address of the entity is one
        if place.startswith("/"):
            assert client("GET", place)[0] == 200, place


@pytest.mark.evidence("ISO 17978-3: faults")
def test_faults_have_status_environment_and_evidence_and_are_filtered(doors):
    client = Client(doors, "")
    doors.rig.fail(0)
    doors.rig.heal(0)
    doors.rig.fail(2)
    code = dtc_text(2)
    first, second = client.good("GET", "faults")["items"]
    assert (first["code"], first["symptom"], first["status"]["aggregatedStatus"]) == (code, "b.M2.length", "active")
    byte = int(doors.rig.status(2))
    assert {name: first["status"][name] for name in BITS} == {name: str(byte >> k & 1) for k, name in enumerate(BITS)}
    assert (first["status"]["mask"], second["status"]["aggregatedStatus"]) == (f"0x{byte:02X}", "passive")
    for asked, found in (
        ("status[testFailed]=1", [code]), ("status[testFailed]=false", [dtc_text(0)]), ("scope=other", []),
        ("status[testFailed]=1&status[confirmedDTC]=1", [code, dtc_text(0)]), ("severity=1", []),
        ("scope=primary", [code, dtc_text(0)]),
        ("status[aggregatedStatus]=passive", [dtc_text(0)]),
    ):  # fmt: skip
        assert [each["code"] for each in client.good("GET", f"faults?{asked}")["items"]] == found, asked
    for wrong in (
        "severity=9",
        "status[nothing]=1",
        "status=1",
        "status[testFailed]=2",
        "colour=red",
        "scope=a&scope=b",
    ):
        assert client("GET", f"faults?{wrong}")[0] == 400, wrong
    detail = client.good("GET", f"faults/{code}")
    entry = doors.gateway.memory.entries()[-1]
    assert detail["environment_data"]["extended_data_records"]["last_ns"] == entry.record.last_ns
    assert detail["environment_data"]["snapshots"][0]["record"] == 1
    assert detail["x-gateway"]["evidence"] == dict(entry.record.evidence)
    bare = client.good("GET", f"faults/{code}?include-snapshot-data=false&include-extended-data=false")
    assert bare["environment_data"] == {}
    for path in ("/sovd/v1/areas/b", "/sovd/v1/apps/b.M2", "/sovd/v1/components/A"):
        assert code in [each["code"] for each in client.good("GET", f"{path}/faults")["items"]]
    assert [each["code"] for each in client.good("GET", "/sovd/v1/apps/b.M0/faults")["items"]] == [dtc_text(0)]
    assert client("GET", "faults/P0000-00")[0] == 404
    for path in ("faults", f"faults/{code}", "data", "data/M0.Value"):
        described = client.good("GET", f"{path}?include-schema=true")
        validate(described.pop("schema"), described)


@pytest.mark.evidence("ISO 17978-3: locks")
def test_what_intervenes_needs_a_token_and_a_lock_that_nobody_can_steal(doors):
    doors.rig.fail(0)
    nobody, client, anna = Client(doors, ""), Client(doors), Client(doors, "anna")
    code = dtc_text(0)
    for who, status in ((nobody, 401), (Client(doors, "wrong"), 401), (client, 403), (anna, 403)):
        assert who("DELETE", "faults")[0] == status
        assert who("PUT", "modes/dtcsetting", {"value": "off"})[0] == status
        assert who("POST", "operations/restart-cycle/executions", {})[0] == status
        assert who("PUT", "status/restart")[0] == status
    assert doors.http("POST", "/api/clear", {"force": True}, "anna")[0] == 401, "the page's rights are not hers"
    lock = client.lock()
    assert nobody.good("GET", "locks")["items"] == [{"id": lock, "owned": False}]
    assert client.good("GET", f"locks/{lock}")["owned"]
    assert [anna("POST", "locks", {"lock_expiration": 5})[0], anna("DELETE", f"locks/{lock}")[0]] == [409, 403]
    assert [anna("PUT", f"locks/{lock}", {"lock_expiration": 5})[0], anna("DELETE", "faults")[0]] == [403, 403]
    assert nobody("DELETE", f"locks/{lock}")[0] == 401
    assert int(doors.rig.status(0)) & 1
    assert client("DELETE", f"faults/{code}")[0] == 204
    assert client.good("GET", "faults") == {"items": []}
    assert client("DELETE", "faults")[0] == 204
    assert client("PUT", f"locks/{lock}", {"lock_expiration": 60})[0] == 204
    assert client("DELETE", f"locks/{lock}")[0] == 204
    anna.lock()
    assert client("DELETE", "faults")[0] == 403
    noted = [(each.action, each.outcome, each.bus[:18]) for each in doors.gateway.memory.interventions()]
    assert noted == [("clear", 0, "local sovd.control")], "twice, and nothing else was tried"


@pytest.mark.evidence("ISO 17978-3: locks end")
def test_a_lock_keeps_the_session_and_its_end_switches_on_again(doors):
    client = Client(doors)
    lock = client.lock(3600)
    assert client.good("PUT", "modes/dtcsetting", {"value": "off"})["value"] == "off"
    assert client.good("GET", "modes/session")["value"] == "extended"
    assert client.good("GET", "modes/dtcsetting")["value"] == "off"
    assert not doors.gateway.controls.results
    assert client("DELETE", f"locks/{lock}")[0] == 204
    assert doors.gateway.controls.results
    assert client.good("GET", "modes/session")["value"] == "default"
    client.lock()
    assert client("PUT", "modes/session", {"value": "sleeping"})[0] == 409
    assert client.good("PUT", "modes/session", {"value": "extended"})["value"] == "extended"
    doors.turn(6.0)  # nobody says tester present: the session is over, and is begun again
    assert client.good("GET", "modes/session")["value"] == "default"
    doors.drive(0.0)
    assert client.good("PUT", "modes/dtcsetting", {"value": "off"})["value"] == "off"


@pytest.mark.evidence("ISO 17978-3: modes")
def test_a_security_level_is_unlocked_by_seed_and_key(tmp_path):
    with Doors(tmp_path, uds=LEVEL) as doors:
        doors.drive(0.0)
        client = Client(doors)
        client.lock()
        status, error = client("DELETE", "faults")
        assert (status, error["parameters"]) == (403, {"service": 0x14, "nrc": 0x33})
        seed = client.good("PUT", "modes/security", {"value": "level_1_request_seed"})["seed"]["Request_Seed"]
        key = hmac_sha256(bytes.fromhex(seed[2:]), bytes.fromhex(SECRET), 1)
        asked = {"value": "level_1", "Key": {"Send_Key": "0x" + bytes(8).hex()}}
        assert client("PUT", "modes/security", asked)[0] == 403
        assert client("PUT", "modes/security", {"value": "level_1"})[0] == 409
        seed = client.good("PUT", "modes/security", {"value": "level_1_request_seed"})["seed"]["Request_Seed"]
        key = hmac_sha256(bytes.fromhex(seed[2:]), bytes.fromhex(SECRET), 1)
        client.good("PUT", "modes/security", {"value": "level_1", "Key": {"Send_Key": key.hex()}})
        assert client.good("GET", "modes/security")["value"] == "level_1"
        assert Client(doors, "").good("GET", "modes/security")["value"] == "locked"
        assert client("DELETE", "faults")[0] == 204


@pytest.mark.evidence("ISO 17978-3: faults delete")
def test_conditions_are_those_of_access(doors):
    """The vehicle moves: nothing is done, and it is said why."""
    doors.drive(50.0)
    client = Client(doors)
    client.lock()
    for method, path, body in (
        ("DELETE", "faults", None), ("PUT", "modes/dtcsetting", {"value": "off"}), ("PUT", "status/restart", None),
        ("POST", "operations/compact/executions", {}), ("PUT", "configurations/did-0124", {"data": {"raw": "0a0b"}}),
    ):  # fmt: skip
        status, error = client(method, path, body)
        assert (status, error["parameters"]["nrc"], error["error_code"]) == (409, 0x22, "precondition-not-fulfilled")


@pytest.mark.evidence("ISO 17978-3: data")
def test_data_are_read_and_configurations_written(doors):
    client = Client(doors)
    doors.drive(1.5)
    items = {each["id"]: each for each in client.good("GET", "data")["items"]}
    assert items["M1.Value"]["unit"] == "V"
    assert client.good("GET", "data/M1.Value")["data"] == {"value": 1.5, "unit": "V"}
    for key in items:
        assert client("GET", f"data/{quote(key)}")[0] == 200
    assert client("GET", "data/did-0999")[0] == 404
    doors.drive(0.0)
    (key, *_) = [each["id"] for each in client.good("GET", "configurations")["items"]]
    before = client.good("GET", f"configurations/{key}")["data"]["raw"]
    new = bytes(len(before) // 2).hex()
    assert client("PUT", f"configurations/{key}", {"data": {"raw": new}})[0] == 403
    client.lock()
    assert client("PUT", f"configurations/{key}", {"data": {"raw": new}})[0] == 204
    assert client.good("GET", f"configurations/{key}")["data"]["raw"] == new
    assert client("PUT", f"configurations/{key}", {"data": {"raw": new + "00"}})[0] == 409
    assert client("PUT", f"configurations/{key}", {"data": {}})[0] == 400
    assert client("PUT", "configurations/did-F186", {"data": {"raw": "01"}})[0] == 404


@pytest.mark.evidence("ISO 17978-3: operations")
def test_operations_logs_and_status(doors):
    client = Client(doors)
    client.lock()
    assert client.good("POST", "operations/restart-cycle/executions", {})["status"] == "completed"
    assert doors.gateway.memory.cycle_number() == 2
    assert client.good("PUT", "status/restart")["status"] == "ready"
    assert doors.gateway.memory.cycle_number() == 3
    assert client.good("POST", "operations/compact/executions", {})["parameters"] == {"result": "00"}
    assert client("POST", "operations/explode/executions", {})[0] == 404
    assert client("GET", "/sovd/v1/components/A/status")[0] == 404
    doors.turn()  # it is written with the next batch
    told = [each["x-gateway"]["action"] for each in client.good("GET", "logs/entries")["items"]]
    assert told == ["routine", "reset", "routine"]


@pytest.mark.evidence("ISO 17978-3: errors")
def test_every_failure_is_a_generic_error(doors, caught):
    client = Client(doors)
    assert client("GET", "/sovd/v1/nothing")[0] == 404
    assert client("GET", "/sovd/v1/components/gate%0Away".replace("%0A", "\n"))[0] == 404
    assert client("PATCH", "faults")[0] == 405
    assert client("POST", "faults", {})[0] == 405
    assert client("POST", "locks", {"lock_expiration": 0})[0] == 400
    assert client("POST", "locks", [])[0] == 400
    assert client("POST", "locks", {"lock_expiration": 5, "colour": 1})[0] == 400
    assert client("POST", "locks", {"text": "x" * 20_000})[0] == 413
    assert client("GET", "faults?" + "x" * 10_000)[0] == 414
    doors.hub.hello = dict(doors.hub.hello, faults=None)
    assert client("GET", "faults")[0] == 500


class Behind(Doors):
    """A gateway with an ECU behind it."""

    def __init__(self, folder, answer, more=""):
        config = write_config(folder, extra=ROUTED + more)
        self.rig = self.car = Car(config, [Ecu(0x7E1, 0x7E9, answer)], memory=folder / "m.sqlite")
        self.path, self.now_s, self.loop = folder / "s", 1.0, None
        self.status = StatusSocket(self.path, self.gateway)
        self.car.run(200)

    async def _until(self, done):
        def step():
            self.car.run(1)
            return done()

        await super()._until(step)


def ecu(request):
    """Its DTC, its name; it echoes what changes something."""
    answers = {"1902ff": "5902ff" + "c10000" + "2f", "22f190": "62f190" + b"VIN".hex(), "22f186": "62f18601"}
    return [(1, bytes.fromhex(answers.get(request.hex(), f"{request[0] + 0x40:02x}" + request[1:2].hex())))]


@pytest.mark.evidence("ISO 17978-3: components")
@pytest.mark.parametrize("rule", ["", '[access]\nroute = { sessions = ["default", "extended"] }\n'])
def test_an_ecu_is_a_component_and_the_firewall_holds(tmp_path, rule):
    with Behind(tmp_path, ecu, rule) as doors:
        client = Client(doors)
        brakes = "/sovd/v1/components/brakes"
        assert set(client.good("GET", brakes)) >= {"faults", "data", "modes", "locks"}
        assert client.good("GET", f"{brakes}/data/did-F190")["data"]["value"] == "VIN"
        assert client.good("GET", f"{brakes}/modes/session")["value"] == "default"
        assert client("DELETE", f"{brakes}/faults")[0] == 403
        heard = len(doors.car.ecus[0].heard)
        for path in ("data/did-F190", "modes/session"):
            assert Client(doors, "")("GET", f"{brakes}/{path}")[0] == 403
        assert len(doors.car.ecus[0].heard) == heard, "who only reads the page makes no frames"
        lock = client.lock(path=f"{brakes}/locks")
        status, error = client("DELETE", f"{brakes}/faults")
        assert status == (204 if rule else 403), error
        assert client("DELETE", f"{brakes}/locks/{lock}")[0] == 204
        heard = [request.hex() for request in doors.car.ecus[0].heard]
        asked = [each for each in heard if each[:2] not in ("22", "19")]
        assert asked == (["1003", "14ffffff", "1001"] if rule else [])


@pytest.mark.evidence("ISO 17978-3: times")
def test_times_are_those_of_the_wall_clock_to_the_microsecond():
    shown = instant(1_700_000_000_123_456_789)
    assert shown is not None
    assert shown.isoformat() == "2023-11-14T22:13:20.123456+00:00"
    assert instant(None) is None
