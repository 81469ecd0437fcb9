"""The client of one ECU: answers, refusals by their meaning, silence, other testers, rates; nothing but reads."""

import numpy as np
import pytest
from amount import amount
from asking_rig import BUS, MS, Car, Ecu, changed, settled, write

from gateway.bus.frames import EXTENDED
from gateway.config.ecu import EcuParams
from gateway.config.load import load_config
from gateway_ask.clients.ask import Ask, allowed
from gateway_ask.clients.ecu import MOST_AGAIN, SILENT, EcuClient
from gateway_fdi.errors import GatewayError

SEED = 11
ONE = """
[[ecu]]
name = "engine"
request = 0x7E0
response = 0x7E8
read = [{ did = 0xF40D, every_ms = 100 }]
"""
POSITIVE = bytes.fromhex("62F40D0102")


def car(folder, answer, toml=ONE, bus=BUS):
    return Car(write(folder, bus + toml), [Ecu(0x7E0, 0x7E8, answer)])


def once(*answers):
    """Return an ECU that gives these answers, one a request, and the last one for ever."""
    left = list(answers)
    return lambda _request: [(2, left.pop(0) if len(left) > 1 else left[0])]


def test_a_read_is_asked_at_its_pace_and_answered(tmp_path):
    found = car(tmp_path, once(POSITIVE)).run(2000)
    times = [t for t, _, _ in found.requests]
    assert {data.hex() for _, _, data in found.requests} == {"22f40d"}
    assert set(np.diff(times)) == {100}
    assert found.state()["answers"] == found.state()["requests"] == 20


def test_an_ecu_that_needs_longer_is_waited_for(tmp_path):
    pending = [(k * 100, b"\x7f\x22\x78") for k in range(1, 9)]
    found = car(tmp_path, lambda _: [*pending, (900, POSITIVE)]).run(3000)
    state = found.state()
    assert state["absent"] == 0
    assert state["answers"] == 3
    assert state["skipped"] == 3 * 9  # nine reads were not asked while each answer was waited for
    assert settled(state)


def test_an_ecu_that_says_for_ever_that_it_needs_longer_is_given_up(tmp_path):
    found = car(tmp_path, lambda _: [(k * 50, b"\x7f\x22\x78") for k in range(1, 400)]).run(8000)
    assert found.state()["absent"] == 2
    assert len(found.requests) == 3
    assert settled(found.state())


@pytest.mark.parametrize(
    ("code", "words"), [(0x31, "requestOutOfRange"), (0x33, "securityAccessDenied"), (0x7F, "serviceNot")]
)
def test_a_final_refusal_ends_a_read_and_is_told_once(tmp_path, code, words, capsys):
    found = car(tmp_path, once(bytes([0x7F, 0x22, code]))).run(2000)
    assert len(found.requests) == found.state()["refused"] == 1
    assert words in found.state()["not_asked"]["22F40D"]
    assert (capsys.readouterr().out + capsys.readouterr().err).count("an ECU refuses") <= 1


def test_a_busy_ecu_is_asked_again_soon_but_not_for_ever(tmp_path):
    found = car(tmp_path, once(b"\x7f\x22\x21", b"\x7f\x22\x21", POSITIVE)).run(900)
    assert list(np.diff([t for t, *_ in found.requests])[:2]) == [202, 202]
    found = car(tmp_path, once(b"\x7f\x22\x21")).run(4000)
    assert found.state()["refused"] >= MOST_AGAIN
    assert settled(found.state())


def test_conditions_that_are_not_met_are_tried_again_later_and_later(tmp_path):
    found = car(tmp_path, once(b"\x7f\x22\x22")).run(7000)
    apart = np.diff([t for t, *_ in found.requests])
    assert list(apart) == [300, 500, 900, 1700, 3300]


def test_a_silent_ecu_is_asked_less_and_less_and_again_when_it_is_back(tmp_path):
    found = car(tmp_path, lambda _: []).run(20_000)
    few = len(found.requests)
    assert SILENT < few < 12
    assert found.state()["absent"] == few
    found.ecus[0].answer = once(POSITIVE)
    found.run(40_000)
    assert found.state()["answers"] > 50
    assert settled(found.state())


def test_an_answer_to_another_request_is_not_taken_for_ours(tmp_path):
    for wrong in ("62F40E01", "59020D", "7F1931", "62F4"):
        found = car(tmp_path, once(bytes.fromhex(wrong))).run(400)
        assert (found.state()["answers"], found.state()["refused"]) == (0, 0)
        assert found.state()["absent"] > 0


def test_it_gives_way_to_another_tester_and_takes_no_part_in_his_talk(tmp_path):
    long = bytes.fromhex("62F190") + bytes(range(60))
    found = car(tmp_path, lambda data: [(3, long if data == b"\x22\xf1\x90" else POSITIVE)])
    found.run(350)
    before = len(found.sent)
    # He asks for something long, and gives the flow control himself.
    found.run(4900, (1, 0x7E0, b"\x03\x22\xf1\x90\0\0\0\0"), (6, 0x7E0, b"\x30\0\0\0\0\0\0\0"))
    assert found.sent[before:] == []
    found.run(1000)
    assert len(found.sent) > before
    found.run(1000, (500, 0x7DF, b"\x02\x3e\x80\0\0\0\0\0"))
    last = found.sent[-1][0]
    found.run(4000)
    assert found.sent[-1][0] == last


def test_a_request_under_way_is_given_up_for_another_tester(tmp_path):
    found = car(tmp_path, lambda _: [])
    found.run(5, (3, 0x7E0, b"\x02\x10\x03\0\0\0\0\0"))
    assert found.state()["yielded"] == 1
    assert settled(found.state())


@pytest.mark.evidence("Bounded: polling")
def test_no_more_requests_leave_than_the_bus_may_have(tmp_path):
    ecus, cars = "", []
    for k in range(20):
        ecus += f'[[ecu]]\nname = "e{k}"\nrequest = {0x600 + k}\nresponse = {0x680 + k}\n'
        ecus += "read = [" + ", ".join(f"{{ did = {n}, every_ms = 1000 }}" for n in range(10)) + "]\n"
        cars.append(Ecu(0x600 + k, 0x680 + k, lambda data: [(3, b"\x62" + data[1:3] + b"\x01")]))
    found = Car(write(tmp_path, BUS + ecus), cars).run(10_000)
    assert len(found.requests) == 100
    apart = np.diff([t for t, *_ in found.requests])
    assert apart.min() >= 100
    asked = [sum(can_id == 0x600 + k for _, can_id, _ in found.requests) for k in range(20)]
    assert min(asked) >= 4  # nobody starves
    for k in range(20):
        assert settled(found.state(k))


def test_nothing_is_sent_without_an_ecu_or_where_it_is_only_listened_to(tmp_path):
    for toml in ("", ONE.replace("read = [{ did = 0xF40D, every_ms = 100 }]", "")):
        found = Car(write(tmp_path, BUS + toml), [Ecu(0x7E0, 0x7E8, once(POSITIVE))])
        found.run(3000, (10, 0x7E8, b"\x10\x20\x62\xf4\x0d\0\0\0"), (20, 0x7DF, b"\x02\x3e\x00\0\0\0\0\0"))
        assert found.sent == []
    found = car(tmp_path, once(POSITIVE), bus=BUS + "listen_only = true\n").run(
        3000, (10, 0x7E8, b"\x10\x20\x62\xf4\x0d\0\0\0")
    )
    assert found.sent == []
    assert found.gateway.next_ns > 1 << 62
    assert found.gateway.asking._said == []


def test_a_sleeping_vehicle_is_not_asked(tmp_path):
    power = '[power]\nawake = [{ signal = "obd.State.Terminal15", min = 1 }]\n'
    dbc = 'VERSION ""\nBU_: A\nBO_ 256 State: 1 A\n SG_ Terminal15 : 0|8@1+ (1,0) [0|1] "" A\n'
    (tmp_path / "state.dbc").write_text(dbc)
    found = car(tmp_path, once(POSITIVE), power + ONE, BUS + 'database = ["state.dbc"]\n')
    found.run(1000, (500, 0x100, b"\x00"))
    asked = len(found.requests)
    assert asked == 5
    found.run(2000)
    assert len(found.requests) == asked
    found.run(1000, (10, 0x100, b"\x01"))
    assert len(found.requests) > asked + 5


def test_a_dead_bus_is_not_asked(tmp_path):
    from gateway.bus.conditions import LOST, RUNNING, condition_frame

    found = car(tmp_path, once(POSITIVE)).run(500)
    found._feed(condition_frame(found.now, 0, LOST))
    asked = len(found.requests)
    found.run(2000)
    assert len(found.requests) == asked
    found._feed(condition_frame(found.now, 0, RUNNING))
    assert len(found.run(500).requests) > asked


def test_nobody_is_asked_while_a_tester_has_switched_sending_off(tmp_path):
    found = car(tmp_path, once(POSITIVE)).run(500)
    found.gateway.controls.set_communication(receive=True, send=False, by="a tester")
    asked = len(found.requests)
    found.run(2000)
    assert len(found.requests) == asked
    found.gateway.controls.set_communication(receive=True, send=True, by="a tester")
    assert len(found.run(500).requests) > asked


def test_addresses_of_every_kind_reach_their_ecu(tmp_path):
    toml = """
[[ecu]]
name = "fixed"
address = 0xE4
read = [{ did = 1, every_ms = 500 }]
[[ecu]]
name = "bmw"
request = 0x6F1
response = 0x612
target = 0x12
read = [{ service = 0x22, identifier = 2, every_ms = 500 }]
"""
    found = Car(write(tmp_path, BUS + toml))
    said = []
    for _ in range(40):
        found.run(10)
        for t, can_id, data in found.sent[len(said) :]:
            said.append((t, can_id, data))
            if can_id == 0x6F1 and data[1] == 3:  # first frame of 12 bytes: one less fits
                found.say(0x612, b"\xf1\x10\x0c\x62\x00\x02\x01\x02")
            elif can_id == 0x6F1:
                assert data[:4] == b"\x12\x30\x00\x00"
                found.say(0x612, b"\xf1\x21\x03\x04\x05\x06\x07\x08")
                found.say(0x612, b"\xf1\x22\x09\0\0\0\0\0")
            else:
                found.say(EXTENDED | 0x18DAF1E4, b"\x04\x62\x00\x01\x07\0\0\0")
    assert {can_id for _, can_id, _ in said} == {0x6F1, EXTENDED | 0x18DAE4F1}
    assert [found.state(k)["absent"] for k in (0, 1)] == [0, 0]
    assert all(found.state(k)["answers"] >= 1 for k in (0, 1))


@pytest.mark.evidence("SAE J1939-21: request")
def test_groups_of_j1939_are_requested(tmp_path):
    toml = """
[[ecu]]
name = "engine"
address = 0x00
read = [{ pgn = 65253, every_ms = 500 }, { pgn = 65259, every_ms = 500 }, { pgn = 65260, every_ms = 500 }]
"""
    dbc = 'VERSION ""\nBU_: A\nBO_ 2566841600 HOURS: 8 A\n SG_ Hours : 0|32@1+ (0.05,0) [0|0] "h" A\n'
    (tmp_path / "j1939.dbc").write_text(dbc)
    signal = '[[monitor]]\nname = "h"\ntype = "signal"\nsignal = [{ signal = "HOURS.Hours", plausible = [0, 9e9] }]\n'
    bus = BUS + 'database = ["j1939.dbc"]\nmatch = "pgn"\n'
    found = Car(write(tmp_path, bus + toml + signal))
    asked, seen = [], 0
    for _ in range(300):
        found.run(10)
        for _, can_id, data in found.sent[seen:]:
            assert can_id == EXTENDED | 0x18EA00F9
            asked.append(int.from_bytes(data, "little"))
            if asked[-1] == 65253:
                found.say(EXTENDED | 0x18FEE500, b"\x64\0\0\0\xff\xff\xff\xff")
            elif asked[-1] == 65259:  # several packets: a broadcast is announced
                found.say(EXTENDED | 0x1CECFF00, b"\x20\x0a\x00\x02\xff\xeb\xfe\x00")
            else:
                found.say(EXTENDED | 0x18E8FF00, b"\x01\xff\xff\xff\xf9\xec\xfe\x00")
        seen = len(found.sent)
    assert asked.count(65260) == 1
    assert found.state()["not_asked"] == {"PGN 65260": "requestOutOfRange (0x31)"}
    assert (found.state()["refused"], found.state()["absent"]) == (1, 0)
    assert found.state()["answers"] == len(asked) - 1 >= 10
    assert found.value("obd.HOURS.Hours") == 5.0
    with pytest.raises(GatewayError, match="give the ECU's J1939 address"):
        load_config(write(tmp_path, BUS + ONE.replace("did = 0xF40D", "pgn = 65253")))


def test_a_request_that_would_change_something_cannot_be_sent_or_configured(tmp_path):
    assert [service for service in range(256) if allowed(bytes([service]))] == [
        1, 3, 6, 7, 9, 10, 0x19, 0x21, 0x22, 0xEA,
    ]  # fmt: skip
    params = EcuParams(name="e", request=1, response=2)
    for request in ("1003", "14FFFFFF", "2701", "2E010001", "310101", "1101", "04", "8502", "3E00"):
        with pytest.raises(AssertionError):
            EcuClient(params, 0, [Ask(bytes.fromhex(request), MS)]).begin(0)
    for read in ("service = 0x2E, identifier = 1", "service = 4, identifier = 0", "service = 0x31, identifier = 1"):
        with pytest.raises(GatewayError, match="is not read by schedule"):
            load_config(write(tmp_path, BUS + ONE.replace("did = 0xF40D", read)))


WRONG = {
    'name = "engine"': ('name = "en gine"', "ecu[0].name"),
    "request = 0x7E0": ("", "give request and response, or address"),
    "= 0x7E0": ("= 0x7DF", "this request is to all ECUs"),
    "response = 0x7E8": ("response = 0x7E0", "same identifier"),
    "every_ms = 100": ("every_ms = 1", "ecu[0].read[0].every_ms"),
    "did = 0xF40D": ("did = 0x1F40D", "ecu[0].read[0].did"),
    "{ did = 0xF40D, ": ("{ did = 0xF40D, pid = 1, ", "give did, or pid"),
    "read = [": ('signals = ["none.dbc"]\nread = [', "ecu[0].signals[0]"),
    "read = [{": ("read = [{ did = 0xF40D, every_ms = 200 }, {", "is read twice"),
    "[[ecu]]": ('[[ecu]]\nbus = "odb"', "ecu[0].bus"),
    "[{ did": (
        "[{ did = 5, every_ms = 100 }]\ndtcs = { every_s = 9, when = [{ signal = 'X.Y', min = 1 }] }\n#",
        "ecu[0].dtcs.when[0]",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_mistakes_are_told_with_file_key_and_value(wrong, tmp_path):
    from gateway.runtime.assemble import prepare

    text, told = WRONG[wrong]
    assert wrong in ONE
    file = write(tmp_path, BUS + ONE.replace(wrong, text, 1))
    with pytest.raises(GatewayError) as error:
        prepare(load_config(file), file)
    assert told in str(error.value)
    assert str(tmp_path) in str(error.value)


def test_check_names_the_mistakes_of_several_tables_at_once(tmp_path):
    from gateway_commands.validation import mistakes

    first = ONE.replace("read =", 'signals = ["none.dbc"]\nread =')
    other = ONE.replace("engine", "other").replace("0x7E", "0x7D")
    other = other.replace("did = 0xF40D", "service = 5, identifier = 0")
    text = BUS + first + other + '[fault."nobody.x"]\ndtc = "P0001-00"\n'
    found = [error.key for error in mistakes(write(tmp_path, text))]
    assert found == ["ecu[0].signals[0]", "ecu[1].read[0]", 'fault."nobody.x"']
    again = [error.key for error in mistakes(write(tmp_path, text.replace("service = 5, identifier = 0", "did = 7")))]
    assert again == ["ecu[0].signals[0]", 'fault."nobody.x"']


def test_its_own_servers_and_other_ecus_have_other_addresses(tmp_path):
    for more, told in (
        ("[output.uds]\n", "this is the gateway itself"),
        (ONE.replace("engine", "other"), "answers with this identifier"),
        (ONE.replace("0x7E", "0x7D"), "this name is taken"),
    ):
        with pytest.raises(GatewayError, match=told):
            load_config(write(tmp_path, BUS + ONE + more))
    with pytest.raises(GatewayError, match="only listened to"):
        load_config(write(tmp_path, BUS + "listen_only = true\n[output.uds]\n"))


def ask_again(found):
    """Have the first ECU asked at once, whatever was before."""
    client = found.gateway.asking.ecus[0].client
    client._rests_ns, client.asks[0].refused, client.asks[0].delays = 0, "", 0
    found.gateway.asking._plan()


@pytest.mark.long
def test_mutated_answers_lose_nothing_and_nothing_grows(tmp_path):
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    toml = ONE.replace("engine", "e").replace("response = 0x7E8", 'response = 0x7E8\nsignals = ["cells.dbc"]')
    found = car(
        tmp_path,
        once(POSITIVE),
        toml.replace("every_ms = 100", "every_ms = 20"),
        BUS.replace('"\n', '"\n', 1) + "ask = { requests_per_s = 1000 }\n",
    )
    kinds = [
        b"\x05\x62\xf4\x0d\x01\x02\0\0",
        b"\x10\x99\x62\x21\x01\x01\x02\x03",
        b"\x21\1\2\3\4\5\6\7",
        b"\x03\x7f\x22\x31",
        b"\x03\x7f\x22\x78",
        b"\x00\x20\x62\xf4",
    ]
    for k in range(amount(100_000, 3_000, 500)):
        found.now += MS
        found.say(0x7E8, changed(rng, kinds[rng.integers(len(kinds))]))
        found.gateway.poll(found.now)
        if not k % 1000:
            ask_again(found)  # a refusal may have been among them
    found.log.clear()
    client = found.gateway.asking.ecus[0]
    assert settled(found.state())
    assert len(client.answers._data) <= 4095 + 64
    assert len(client.client.asks) == 1
    assert len(found.gateway.asking._said) <= 1
    ask_again(found)
    found.run(70_000)
    assert found.run(1000).state()["answers"] > 20


@pytest.mark.long
def test_ecus_that_die_in_the_middle_are_accounted_for(tmp_path):
    print("seed", SEED)
    rng, whole = np.random.default_rng(SEED), bytes.fromhex("62F40D") + bytes(100)
    left = {"frames": 0}
    found = car(tmp_path, lambda _: [(2, whole)])
    ecu, died = found.ecus[0], 0
    step, take = ecu.step, ecu.take

    def dying(made):
        nonlocal died
        kept = made[: max(left["frames"], 0)]
        left["frames"] -= len(made)
        died += len(kept) < len(made)
        return kept

    ecu.step, ecu.take = (lambda t: dying(step(t))), (lambda f: dying(take(f)))
    for _ in range(amount(1000, 40, 10)):
        left["frames"] = int(rng.integers(0, 16))
        found.run(1500)
        left["frames"] = 10**6
        ask_again(found)
        ecu.due.clear()
        ecu.transport = Ecu(0x7E0, 0x7E8, None).transport
        found.log.clear()
    assert died
    assert settled(found.state())
    assert found.run(3000).state()["answers"] > 0


class Bridged(Car):
    """Its own frames come back, a moment later, without a mark."""

    def _send(self, frames):
        super()._send(frames)
        for one in frames:
            self.say(int(one["can_id"]), one["data"][: int(one["length"])].tobytes())


def test_own_requests_that_come_back_are_no_other_tester(tmp_path):
    long = POSITIVE + bytes(30)  # a flow control of ours comes back, too
    for answer in (POSITIVE, long):
        path = write(tmp_path, BUS + ONE)
        plain = Car(path, [Ecu(0x7E0, 0x7E8, once(answer))]).run(2000)
        bridged = Bridged(path, [Ecu(0x7E0, 0x7E8, once(answer))]).run(2000)
        assert bridged.state()["yielded"] == 0
        assert bridged.state()["answers"] == plain.state()["answers"] > 10


def test_the_same_request_of_another_tester_is_one(tmp_path):
    path = write(tmp_path, BUS + ONE)
    found = Bridged(path, [Ecu(0x7E0, 0x7E8, lambda _: [])])
    found.run(110, *[(105, 0x7E0, bytes.fromhex("0322F40DCCCCCCCC"))] * 2)
    assert found.state()["yielded"] == 1
