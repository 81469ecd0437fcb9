"""OBD as a car answers it: classic (SAE J1979), on UDS (SAE J1979-2), both, wrongly, late, in part; no storm."""

import numpy as np
from amount import amount
from asking_rig import BUS, Car, Ecu, Server, settled, write
from rig import Rig, Tester, dtc_text, write_config

from gateway.bus.frames import EXTENDED, payload
from gateway.config.load import load_config
from gateway.faults.vehicle import PERMANENT
from gateway.runtime.app import Gateway
from gateway_ask.answers.layout import j1979
from gateway_ask.clients.dtcs import read_dtcs
from gateway_commands.faults import list_faults
from gateway_replay.replay import replay

ONE = """
[[ecu]]
name = "engine"
request = 0x7E0
response = 0x7E8
read = [{ pid = 0x05, every_ms = 200 }, { pid = 0x0C, every_ms = 200 }]
dtcs = { every_s = 1 }
[[monitor]]
name = "hot"
type = "signal"
bus = "answers:obd"
signal = [
    { signal = "A_0105.ECT", plausible = [-40, 125], code = "P0217" },
    { signal = "A_010C.RPM", plausible = [0, 8000], code = "P0219" },
]
[clock]
watched = false
"""
#: Values, DTCs (stored, pending, permanent) as both protocols say them.
ON_UDS = {
    "22F400": "62F400 08100001",
    "22F405": "62F405 D2",
    "22F40C": "62F40C 1AF8",
    "194233AFFF": "594233FFFF04 02 013300 2F",
    "195533": "595533FF04 013300 2F",
    "19040133 00FF": "5904 013300 2F 01 01 F405 D2",
    "19060133 00FF": "5906 013300 2F 01 03",
}
CLASSIC = {
    "0100": "410008100001",
    "0105": "4105D2",
    "010C": "410C1AF8",
    "03": "43010133",
    "07": "47010133",
    "0A": "4A010133",
}


def speaks(*tables, ms=2, late=()):
    """Return an ECU that answers these requests, and refuses others; those of `late` after two announcements."""
    known = {bytes.fromhex(asked): bytes.fromhex(said) for table in tables for asked, said in table.items()}
    services = {asked[0] for asked in known}

    def answer(request):
        found = known.get(request)
        if found is None:
            return [(ms, bytes([0x7F, request[0], 0x31 if request[0] in services else 0x11]))]
        if request.hex().upper() in late:
            return [(ms, bytes([0x7F, request[0], 0x78])), (900, bytes([0x7F, request[0], 0x78])), (2000, found)]
        return [(ms, found)]

    return answer


def car(folder, answer, toml=ONE, more=()):
    return Car(write(folder, BUS + toml), [Ecu(0x7E0, 0x7E8, answer), *more])


def requests(found):
    return [data.hex().upper() for *_, data in found.requests]


def dtcs(found):
    return [(e["dtc"], e["state"]) for e in found.events if e["event"] == "ecu_dtc"]


def test_a_car_of_2027_is_asked_by_obd_on_uds(tmp_path, capsys):
    memory = tmp_path / "memory.sqlite"
    found = Car(write(tmp_path, BUS + ONE), [Ecu(0x7E0, 0x7E8, speaks(ON_UDS))], memory).run(4000)
    assert found.state()["speaks"] == "obd_on_uds"
    assert capsys.readouterr().out.count("an ECU answers OBD") == 1
    assert (found.value("answers:obd.A_0105.ECT"), found.value("answers:obd.A_010C.RPM")) == (170, 1726)
    assert dtcs(found)[0] == ("P0133-00", "came")
    (dtc,) = found.gateway.memory.vehicle.all()
    assert dtc.status == 0x12F
    assert dtc.snapshots == {"1904": "0101F405D2", "1906": "0103", "1942": "02"}
    assert found.requests[0][1] == 0x7DF
    assert requests(found).count("22F400") == 1
    assert requests(found).count("1904013300FF") == 1
    assert found.state()["not_asked"] == {}
    assert settled(found.state())
    found.gateway.stop(found.now)
    found.close()
    assert list_faults(None, memory=memory, json=False, ecu="engine") == 0
    assert "record 1: ECT 170 degC" in capsys.readouterr().out


def test_a_classic_car_is_asked_as_before_and_by_uds_for_dtcs_where_it_can(tmp_path):
    found = car(tmp_path, speaks(CLASSIC)).run(3000)
    assert found.state()["speaks"] == "obd"
    assert requests(found)[:2] == ["22F400", "0100"]
    assert [requests(found).count(each) for each in ("22F400", "0100", "1902AF")] == [1, 1, 1]
    assert dtcs(found) == [("P0133", "came"), ("P0133", "changed"), ("P0133", "changed")]
    assert (found.value("answers:obd.A_0105.ECT"), found.value("answers:obd.A_010C.RPM")) == (170, 1726)
    by_uds = car(tmp_path, speaks(CLASSIC, {"1902AF": "5902FF 013300 2F"})).run(3000)
    assert dtcs(by_uds) == [("P0133-00", "came")]
    assert not {"03", "07", "0A"} & set(requests(by_uds))


def test_values_faults_and_their_replay_are_the_same_by_either_protocol(tmp_path):
    verdicts, causes = [], []
    for tables in (ON_UDS, CLASSIC):
        found = car(tmp_path, speaks(tables)).run(4000)
        live = [e for e in found.events if e["event"] == "dtc"]
        assert [e["dtc"] for e in live] == ["P0217-85"]
        found.gateway.stop(found.now)
        replayed, again = Gateway(load_config(tmp_path / "ask.toml"), file=tmp_path / "ask.toml"), []
        replayed.listen(again.append)
        replay(replayed, np.array_split(found.recording(), 7))
        kinds = ("dtc", "ecu_dtc", "diagnosis")
        assert [e for e in again if e["event"] in kinds] == [e for e in found.events if e["event"] in kinds]
        verdicts.append([(e["dtc"], e["fault"]) for e in live])
        groups = [e["groups"] for e in found.events if e["event"] == "diagnosis" and e["groups"]]
        causes.append(groups[-1])
    assert verdicts[0] == verdicts[1]
    assert causes[0] == causes[1]
    assert causes[0][0]


SERVER = """
[output.uds]
[output.obd]
vin = "1HGCM82633A004352"
pid = [
    { id = 0x0C, signal = "M0.Value" }, { id = 0x05, signal = "M1.Value" }, { id = 0x0D, signal = "M2.Value" },
    { id = 0xA6, signal = "M2.Value", length = 4, scale = 0.1, offset = 0.0 },
]
"""


def test_our_own_server_says_the_same_by_either_protocol(tmp_path):
    """Values, MIL, readiness; DTCs by mask, of the emission system, permanent, and by readiness group."""
    emission = 'emission_related = true\nindicator = true\nreadiness = "egr"\n'
    rig = Rig(write_config(tmp_path, 3, extra=SERVER, faults={0: emission}))
    for k, value in enumerate((812.5, 90, 50)):
        rig.value(k, value)
    rig.fail(0)
    rig.fail(1)  # of the chassis: no DTC of OBD
    names = ("A_0101.MIL", "A_0101.DTC_CNT", "A_0101.EGR_RDY", "A_0105.ECT", "A_010C.RPM", "A_010D.VSS", "A_01A6.ODO")
    wanted = ", ".join(f'{{ signal = "{each}", plausible = [-1e9, 1e9] }}' for each in names)
    dtcs_of = {}
    for protocol in ("auto", "obd_on_uds", "obd"):
        read = ", ".join(f"{{ pid = {pid}, every_ms = 500 }}" for pid in (0x01, 0x05, 0x0C, 0x0D, 0xA6))
        toml = f"[[ecu]]\nname = 'e'\nrequest = 0x7E0\nresponse = 0x7E8\nprotocol = '{protocol}'\nread = [{read}]\n"
        toml += f"dtcs = {{ every_s = 1, protocol = '{protocol}' }}\n"
        monitor = f'[[monitor]]\nname = "m"\ntype = "signal"\nbus = "answers:obd"\nsignal = [{wanted}]\n'
        made = Car(write(tmp_path, BUS + toml + monitor + "[clock]\nwatched = false\n"), [Server(rig)])
        made.now = rig.now
        made.run(3000)
        rig.now = made.now
        dtcs_of[protocol] = [(each.dtc, each.status) for each in made.gateway.memory.vehicle.all()]
        assert [made.value(f"answers:obd.{each}") for each in names] == [1, 1, 0, 90, 812.5, 50, 50]
        assert (made.state()["refused"], made.state()["absent"]) == (0, 0)
    assert dtcs_of["auto"] == dtcs_of["obd_on_uds"] == [("P1000-11", 0x1AF)]
    assert dtcs_of["obd"] == [("P1000", 0x10C)]
    tester = Tester(rig)
    reports = [bytes.fromhex(each) for each in ("1902AF", "194233AFFF", "195533", "1956330B")]
    lists = [read_dtcs("e", tester.ask(each), each).found for each in reports]
    assert lists[0].pop(dtc_text(1)) == 0x2F
    assert lists == [{"P1000-11": 0xAF}, {"P1000-11": 0xAF}, {"P1000-11": PERMANENT}, {"P1000-11": 0xAF}]
    rig.close()


def test_a_car_that_behaves_by_chance_is_asked_in_no_storm_and_told_of_once(tmp_path, capsys):
    """Each request has an answer of its own kind, and now and then another: wrong, late, refused, doubled, none."""
    known = {bytes.fromhex(asked): bytes.fromhex(said) for asked, said in (ON_UDS | CLASSIC).items()}
    codes = (0x11, 0x12, 0x31, 0x22, 0x21, 0x78, 0x10, 0x33, 0x7E)
    for seed in range(amount(60, 5, 3)):
        rng, kinds = np.random.default_rng(seed), {}

        def answer(request, rng=rng, kinds=kinds):
            kind = kinds.setdefault(request, rng.integers(8)) if rng.random() > 0.1 else rng.integers(8)
            said, no = known.get(request, bytes([0x7F, request[0], 0x31])), bytes([0x7F, request[0]])
            return [
                [(2, said)],
                [(2, said), (4, said), (250, said)],
                [],
                [(2, no + bytes([rng.choice(codes)]))],
                [(2, no + b"\x78"), (500, no + b"\x78"), (1500, said)],
                [(2, rng.bytes(int(rng.integers(1, 12))))],
                [(300, said)],
                [(2, no + b"\x78")],
            ][kind]

        found = car(tmp_path, answer).run(5000)
        asked = [(t, data) for t, _, data in found.requests]
        for t, data in asked:
            assert sum(t <= at < t + 1000 for at, _ in asked) <= 10, seed
            assert sum(t <= at < t + 1000 for at, other in asked if other == data) <= 6, seed
        lines = [line.split("]", 1)[-1] for line in capsys.readouterr().out.splitlines() if "an ECU" in line]
        assert len(lines) == len(set(lines)), seed
        assert settled(found.state()), seed
        found.close()


def test_each_built_in_layout_has_the_same_answer_by_either_protocol(tmp_path):
    rng = np.random.default_rng(75)
    data = {each.identifier: rng.bytes(each.message.length).hex() for each in j1979()}
    classic = {f"01{pid:02X}": f"41{pid:02X}" + said for pid, said in data.items()} | {"0100": CLASSIC["0100"]}
    on_uds = {f"22F4{pid:02X}": f"62F4{pid:02X}" + said for pid, said in data.items()} | {"22F400": ON_UDS["22F400"]}
    reads = ", ".join(f"{{ pid = {pid}, every_ms = 86400000 }}" for pid in data)
    toml = (
        f"[bus.ask]\nrequests_per_s = 200\n[[ecu]]\nname = 'e'\nrequest = 0x7E0\nresponse = 0x7E8\nread = [{reads}]\n"
    )
    seen = []
    for table in (on_uds, classic):
        found = car(tmp_path, speaks(table), toml)
        heard, came = found.gateway.asking.hear, []
        found.gateway.asking.hear = lambda frames, hear=heard, came=came: came.append(hear(frames)) or came[-1]
        found.run(1500)
        answers = np.concatenate([frames[frames["bus"] == 1] for frames in came])
        seen.append(sorted((int(frame["can_id"]), payload(frame)) for frame in answers))
        assert found.state()["answers_decoded"] == 102
    assert seen[0] == seen[1]
    assert len(seen[0]) == 102


def test_a_car_that_answers_both_is_asked_by_the_newer_and_in_part_by_the_other(tmp_path):
    part = {asked: said for asked, said in ON_UDS.items() if asked not in ("22F40C", "194233AFFF")}
    found = car(tmp_path, speaks(part, CLASSIC)).run(3000)
    assert found.state()["speaks"] == "obd_on_uds"
    asked = requests(found)
    assert [asked.count(each) for each in ("0100", "22F40C", "0105", "194233AFFF")] == [0, 1, 0, 1]
    assert asked.count("010C") > 6
    assert (found.value("answers:obd.A_0105.ECT"), found.value("answers:obd.A_010C.RPM")) == (170, 1726)


def test_what_a_car_answered_is_asked_first_after_a_restart_and_another_car_all_the_same(tmp_path):
    memory = tmp_path / "memory.sqlite"
    for tables, first in ((CLASSIC, "22F400"), (CLASSIC, "0100"), (ON_UDS, "0100"), (ON_UDS, "22F400")):
        found = Car(write(tmp_path, BUS + ONE), [Ecu(0x7E0, 0x7E8, speaks(tables))], memory).run(3000)
        assert requests(found)[0] == first
        assert found.state()["speaks"] == ("obd" if tables is CLASSIC else "obd_on_uds")
        assert found.value("answers:obd.A_0105.ECT") == 170
        found.gateway.stop(found.now)
        found.close()


def test_what_a_car_refuses_in_each_form_is_told_once_with_all_reasons(tmp_path, capsys):
    found = car(tmp_path, speaks({"22F400": ON_UDS["22F400"]})).run(6000)
    assert found.state()["not_asked"] == {
        "0105": "22F405: requestOutOfRange (0x31); serviceNotSupported (0x11)",
        "010C": "22F40C: requestOutOfRange (0x31); serviceNotSupported (0x11)",
        "1902AF": "194233AFFF: serviceNotSupported (0x11); 19423308FF: serviceNotSupported (0x11); "
        "194233081E: serviceNotSupported (0x11); serviceNotSupported (0x11)",
        "194233041E": "194233AFFF: serviceNotSupported (0x11); 19423304FF: serviceNotSupported (0x11); "
        "serviceNotSupported (0x11)",
        "195533": "serviceNotSupported (0x11)",
    }
    asked = requests(found)
    assert len(asked) == len(set(asked)) == 12
    assert capsys.readouterr().out.count("an ECU refuses, and is not asked this again") == 5


def test_an_ecu_that_wants_its_classes_named_tells_its_dtcs(tmp_path):
    """The server takes the classes 0x1E only, and one kind of DTC at a time; its DTC goes when it is cleared."""
    dtcs_of = {"194233081E": "594233FFFF04 02 013300 2F", "194233041E": "594233FFFF04"}
    found = car(tmp_path, speaks(dtcs_of, {"22F405": ON_UDS["22F405"]})).run(3000)  # nor has it a map of PIDs
    assert found.value("answers:obd.A_0105.ECT") == 170
    assert dtcs(found) == [("P0133-00", "came")]
    assert found.gateway.memory.vehicle.all()[0].status == 0x08
    dtcs_of["194233081E"] = "594233FFFF04"
    found.ecus[0].answer = speaks(dtcs_of)
    found.run(2000)
    assert dtcs(found) == [("P0133-00", "came"), ("P0133-00", "went")]


def test_an_ecu_that_needs_longer_is_asked_no_more_meanwhile(tmp_path):
    found = car(tmp_path, speaks(ON_UDS, late=("22F400",))).run(4000)
    assert requests(found)[:2] == ["22F400", "22F405"]
    assert found.requests[1][0] - found.requests[0][0] >= 2000
    assert found.state()["absent"] == 0


def test_an_ecu_that_tells_no_map_is_asked_on_and_one_that_is_silent_less_and_less(tmp_path, capsys):
    no_map = {asked: said for asked, said in CLASSIC.items() if asked != "0100"}
    found = car(tmp_path, speaks(no_map)).run(5000)
    assert found.state()["answers"] > 20
    assert capsys.readouterr().out.count("an ECU tells no map of OBD") == 1
    wrong = car(tmp_path, lambda request: [(2, bytes.fromhex("62F40008"))]).run(20_000)
    silent = car(tmp_path, lambda _: []).run(20_000)
    assert wrong.state()["speaks"] == silent.state()["speaks"] == ""
    assert 5 < len(silent.requests) < 14
    silent.ecus[0].answer = speaks(ON_UDS)
    silent.run(30_000)
    assert silent.state()["speaks"] == "obd_on_uds"
    assert silent.value("answers:obd.A_0105.ECT") == 170
    assert not {"0105", "010C"} & set(requests(silent)[-20:])
    assert all(map(settled, (found.state(), wrong.state(), silent.state())))


def test_several_ecus_of_11_and_29_bits_are_asked_once_together_and_each_its_own_way(tmp_path):
    names = ["e0", "e1", "e2", "wide"]
    places = [f"request = 0x{0x7E0 + k:X}\nresponse = 0x{0x7E8 + k:X}" for k in range(3)] + ["address = 0x40"]
    toml = "".join(
        f'[[ecu]]\nname = "{name}"\n{place}\nread = [{{ pid = 0x0D, every_ms = 500 }}]\n'
        for name, place in zip(names, places, strict=True)
    )
    on_uds = {"22F400": "62F400 00080001", "22F40D": "62F40D 32"}
    classic = {"0100": "410000080001", "010D": "410D32"}
    ecus = [Ecu(0x7E0 + k, 0x7E8 + k, quiet(speaks(each))) for k, each in enumerate((on_uds, classic, on_uds))]
    wide = Ecu(0x18DA40F1, 0x18DAF140, quiet(speaks(on_uds)), extended=True)
    found = Car(write(tmp_path, BUS + toml), [*ecus, wide]).run(4000)
    assert [found.state(k)["speaks"] for k in range(4)] == ["obd_on_uds", "obd", "obd_on_uds", "obd_on_uds"]
    to_all = [
        (can_id, data.hex().upper()) for _, can_id, data in found.requests if can_id in (0x7DF, EXTENDED | 0x18DB33F1)
    ]
    assert to_all == [(0x7DF, "22F400"), (EXTENDED | 0x18DB33F1, "22F400"), (0x7DF, "0100")]
    assert all(settled(found.state(k)) and found.state(k)["answers_decoded"] > 4 for k in range(4))


def quiet(answer):
    """Return an ECU that refuses no request to all: as most, it says nothing."""
    return lambda request: [each for each in answer(request) if each[1][0] != 0x7F]


def test_data_of_a_dtc_that_one_of_two_lists_has_are_read_once(tmp_path):
    found = car(tmp_path, speaks(ON_UDS | {"195533": "595533FF04"})).run(4000)
    assert requests(found).count("1904013300FF") == 1
