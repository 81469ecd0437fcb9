"""Protected messages by configuration, through a whole gateway: frames that other programs made, and faults in them."""

import random

import e2e
import pytest
from amount import examples
from car import MS
from car import Car as AnyCar
from car import write as write_tables
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.bus.frames import EXTENDED
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.errors import InputError, InputErrors


def write(folder, messages, check, **options):
    return write_tables(folder, messages, f"[[bus.check]]\n{check}", **options)


class Car(AnyCar):
    """A car whose checks are told by their names alone."""

    def failed(self):
        return [fault.split(".", 1)[1] for fault in super().failed()]


def e2e_p01(count, data_id=0x1234, length=8, seed=1, mode=e2e.p01.E2E_P01_DATAID_BOTH):
    rng, data, frames = random.Random(seed), bytearray(length), []
    for _ in range(count):
        data[2:] = rng.randbytes(length - 2)
        e2e.p01.e2e_p01_protect(data, data_id, data_id_mode=mode)
        frames.append(bytes(data))
    return frames


P01 = 'message = "M"\ne2e = { profile = "P01", data_id = 0x1234 }'
PLAIN = 'BO_ 256 M: 8 A\n SG_ Speed : 16|16@1+ (1,0) [0|0] "" B\n'


@pytest.fixture
def p01(tmp_path):
    return Car(write(tmp_path, PLAIN, P01))


@pytest.mark.evidence("AUTOSAR E2E: counter")
def test_a_healthy_counter_from_0_to_14_wraps_in_silence(p01):
    p01.feed(e2e_p01(3000))
    assert p01.failed() == []
    assert not [e for e in p01.of("monitor") if e["result"] == "failed"]
    assert p01.gateway.engine.counters()["crc_failed"] == 0


@pytest.mark.evidence("AUTOSAR E2E: CRC")
@pytest.mark.parametrize("bit", range(0, 64, 7))
def test_flips_are_the_crc_s_fault(p01, bit):
    frames = e2e_p01(40)
    for k in (20, 21, 22):
        broken = bytearray(frames[k])
        broken[bit // 8] ^= 1 << bit % 8
        frames[k] = bytes(broken)
    assert p01.feed(frames).failed() == ["crc"]


@pytest.mark.evidence("AUTOSAR E2E: counter")
def test_repeats_losses_and_swaps_are_the_counter_s_fault(tmp_path):
    frames = e2e_p01(60)
    lost = frames[:20] + frames[20:40:3] + frames[40:]
    repeated = frames[:20] + [frames[19]] * 3 + frames[20:]
    swapped = frames[:20] + [frames[k + (2, 0, -2)[k % 3]] for k in range(21, 33)] + frames[33:]
    for broken in (lost, repeated, swapped):
        assert Car(write(tmp_path, PLAIN, P01)).feed(broken).failed() == ["counter"]


def test_a_frame_out_of_sequence_is_not_used_with_e2e_and_is_without(tmp_path):
    frames = e2e_p01(30)
    strict = Car(write(tmp_path, PLAIN, P01)).feed([*frames[:10], frames[15]])
    assert strict.gateway.engine.counters()["wrong_sequence"] == 1
    lenient = Car(write(tmp_path, PLAIN, P01.replace("0x1234", "0x1234, max_delta = 6"))).feed(
        [*frames[:10], frames[15]]
    )
    assert lenient.gateway.engine.counters()["wrong_sequence"] == 0


WINDOW = "window = { size = 10, min_ok = [3, 2, 5], max_error = [2, 3, 3] }"


def test_the_state_machine_uses_frames_only_while_enough_are_right(tmp_path):
    car = Car(write(tmp_path, PLAIN, P01.replace("0x1234", f"0x1234, {WINDOW}")))
    frames = e2e_p01(60)
    rejected = []
    for k, data in enumerate(frames):
        broken = bytearray(data)
        broken[4] ^= 20 <= k < 24  # four wrong ones: more than it bears
        before = car.gateway.engine.counters()["window_rejected"]
        car.feed([bytes(broken)])
        rejected.append(car.gateway.engine.counters()["window_rejected"] - before)
    assert rejected[:4] == [1, 1, 1, 0], "one begins, and the third right one after it is used"
    assert sum(rejected[4:20]) == 0
    assert rejected[24:26] == [1, 1]
    assert rejected[35:] == [0] * 25, "used again, once the window is clear"


class StateMachine:
    """E2E_SMCheck as PRS_E2EProtocol has it, with one size for all windows: a ring of the last statuses."""

    def __init__(self, size, min_ok, max_error):
        self.ring, self.size, self.min_ok, self.max_error = [], size, min_ok, max_error
        self.state = "NODATA"

    def check(self, status):
        if self.state == "NODATA":
            if status not in ("ERROR", "NONEWDATA"):
                self.state = "INIT"
            return self.state
        self.ring = [*self.ring, status][-self.size :]
        ok, errors = self.ring.count("OK"), self.ring.count("ERROR")
        at = ("INIT", "VALID", "INVALID").index(self.state)
        if ok >= self.min_ok[at] and errors <= self.max_error[at]:
            self.state = "VALID"
        elif self.state != "INIT" or errors > self.max_error[at]:
            self.state = "INVALID"
        return self.state


@pytest.mark.evidence("AUTOSAR E2E: E2E state machine")
@settings(max_examples=examples(40), deadline=None)
@given(
    st.lists(
        st.sampled_from([*["OK"] * 6, "ERROR", "REPEATED", "WRONGSEQUENCE", *["NONEWDATA"] * 3]),
        min_size=30,
        max_size=80,
    ),
    st.sampled_from([(6, (3, 2, 4), (1, 3, 1)), (3, (2, 1, 3), (0, 2, 0)), (10, (1, 1, 8), (2, 2, 1))]),
)
@pytest.mark.long
def test_the_state_machine_is_autosar_s_with_cycles_without_a_frame(tmp_path_factory, course, sizes):
    """A frame a cycle, or none: a frame is used where the model is valid and it is right, and nowhere else."""
    size, ok, errors = sizes
    window = f"window = {{ size = {size}, min_ok = {list(ok)}, max_error = {list(errors)}, cycle_ms = 10.5 }}"
    folder = tmp_path_factory.mktemp("w")
    config = write(folder, PLAIN, P01.replace("0x1234", f"0x1234, max_delta = 3, {window}"))
    car, model = Car(config), StateMachine(size, ok, errors)
    frames = iter(e2e_p01(1000))
    last = next(frames)
    car.feed([last])  # the first one is right: it says that the rule is
    model.check("OK")
    unread = 0  # counters of wrong frames are not read, and may be missing
    for status in course:
        before = car.gateway.engine.counters()
        state = model.check(status)
        if status == "NONEWDATA":
            car.t_ns += car.period_ns
            continue
        if status == "WRONGSEQUENCE":
            for _ in range(5 + unread):
                last = next(frames)
        unread = unread + 1 if status == "ERROR" else 0
        if status != "REPEATED":
            data = last = next(frames) if status != "ERROR" else last
        data = bytes([last[0] ^ 1]) + last[1:] if status == "ERROR" else last
        after = car.feed([data]).gateway.engine.counters()
        used = after["decoded"] - before["decoded"]
        assert used == (status == "OK" and state == "VALID"), (status, state)


def test_without_a_cycle_a_timeout_is_one_and_without_both_only_frames_count(tmp_path):
    window = "window = { size = 4, min_ok = 2, max_error = 1%s }"
    for cycle, timeout, used in (("", "", True), (", cycle_ms = 20.0", "", False), ("", "\ntimeout_ms = 20.0", False)):
        check = P01.replace("0x1234", f"0x1234, {window % cycle}") + timeout
        car, frames = Car(write(tmp_path, PLAIN, check)), e2e_p01(20)
        car.feed(frames[:10])
        car.t_ns += 100_000_000
        before = car.gateway.engine.counters()["decoded"]
        car.feed(frames[10:11])
        assert (car.gateway.engine.counters()["decoded"] > before) == used, (cycle, timeout)


def e2e_p04(count, data_id=0x1234, length=16):
    data, frames = bytearray(length), []
    for k in range(count):
        data[12] = k
        e2e.p04.e2e_p04_protect(data, data_id)
        frames.append(bytes(data))
    return frames


WIDE = 'BO_ 256 M: 16 A\n SG_ Speed : 96|16@1+ (1,0) [0|0] "" B\n'
P04 = 'message = "M"\ne2e = { profile = "P04", data_id = 0x1234 }'


def test_a_header_of_another_message_is_told_by_what_differs(tmp_path):
    car = Car(write(tmp_path, WIDE, P04))
    car.feed(e2e_p04(30))
    assert car.failed() == []
    car.feed(e2e_p04(34, data_id=0x1235)[30:])
    assert car.failed() == ["crc"]
    told = car.of("dtc")[-1]["evidence"]
    assert (told["received"], told["computed"], told["constant of the header"]) == (0x1235, 0x1234, 2)


def test_where_no_frame_has_the_configured_header_it_is_said_in_words(tmp_path):
    car = Car(write(tmp_path, WIDE, P04)).feed(e2e_p04(40, data_id=0xABCDEF))
    assert car.failed() == ["rule"]
    (told,) = car.of("protection")
    assert told["differs"] == ["data id: received 0xABCDEF, configured 0x1234"]
    broken = [bytes([data[0], data[1] ^ 1, *data[2:]]) for data in e2e_p04(40)]
    other = Car(write(tmp_path, WIDE, P04)).feed(broken)
    assert other.of("protection")[0]["differs"] == [], "there the checksum is wrong, too"


def test_fd_with_64_bytes(tmp_path):
    check = 'message = "M"\ne2e = { profile = "P07", data_id = 0x12345678, offset = 8 }'
    car = Car(write(tmp_path, 'BO_ 256 M: 64 A\n SG_ Speed : 0|16@1+ (1,0) [0|0] "" B\n', check))
    data, frames = bytearray(64), []
    for k in range(100):
        data[40] = k
        e2e.p07.e2e_p07_protect(data, 0x12345678, offset=8)
        frames.append(bytes(data))
    assert car.feed(frames).failed() == []
    frames[-3:] = [data[:50] + b"x" + data[51:] for data in frames[-3:]]
    assert car.feed(frames[-3:]).failed() == ["crc"]


MUXED = (
    "BO_ 256 M: 8 A\n"
    ' SG_ Page M : 0|8@1+ (1,0) [0|1] "" B\n'
    ' SG_ CHECKSUM m1 : 63|8@0+ (1,0) [0|255] "" B\n'
    ' SG_ Plain m0 : 8|16@1+ (1,0) [0|0] "" B\n'
    ' SG_ Speed m1 : 8|16@1+ (1,0) [0|0] "" B\n'
)


def test_a_multiplexed_checksum_is_tested_where_it_is(tmp_path):
    car = Car(write(tmp_path, MUXED, 'message = "M"\nchecksum = "toyota"'))
    rng, frames = random.Random(3), []
    for k in range(200):
        data = bytes([k % 2]) + rng.randbytes(6)
        frames.append(data + bytes([sum(data) + 8 + 0x01 & 0xFF if k % 2 else rng.getrandbits(8)]))
    assert car.feed(frames).failed() == []
    broken = [bytes([1]) + rng.randbytes(6) + b"\x00" for _ in range(3)]
    assert car.feed(broken).failed() == ["crc"]


def test_j1939_by_pgn_with_several_senders(tmp_path):
    message = f'BO_ {0x18FEF100 | 0x80000000} M: 8 A\n SG_ Speed : 16|16@1+ (1,0) [0|0] "" B\n'
    car = Car(write(tmp_path, message, P01, more='match = "pgn"\n'))
    one, other = e2e_p01(100), e2e_p01(100, seed=2)
    for sent in zip(one, other, strict=True):
        for address, data in zip((0x17, 0x21), sent, strict=True):
            car.feed([data], can_id=0x18FEF100 | address | EXTENDED)
    assert "crc" not in car.failed()


@pytest.mark.evidence("Healthy parts: wrong rule")
def test_a_rule_that_no_frame_passes_is_doubted_not_the_sender(tmp_path):
    name = "toyota_new_mc_pt_generated"
    packer = pytest.importorskip("opendbc.can.packer").CANPacker(name)
    names = pytest.importorskip("opendbc.can.dbc").DBC(name).name_to_msg
    message = names["STEERING_LKA"]
    text = f'BO_ {message.address} M: {message.size} A\n SG_ CHECKSUM : 39|8@0+ (1,0) [0|0] "" B\n'
    car = Car(write(tmp_path, text, 'message = "M"\nchecksum = "honda"'.replace("honda", "subaru")))
    frames = [packer.make_can_msg("STEERING_LKA", 0, {"STEER_TORQUE_CMD": k * 3})[1] for k in range(300)]
    car.feed(frames, can_id=message.address)
    assert car.failed() == ["rule"]
    (told,) = car.of("protection")
    assert (told["bus"], told["message"], told["rule"]) == ("b", "M", "subaru")
    assert told["fits"] == ['checksum = "toyota"']
    (dtc,) = [e for e in car.of("dtc") if e["status"] & 1]
    assert dtc["dtc"].endswith("-56")
    # With the rule that was told, all is well.
    fine = Car(write(tmp_path, text, f'message = "M"\n{told["fits"][0]}'))
    assert fine.feed(frames, can_id=message.address).failed() == []


def broken(frames):
    return [bytes([data[0] ^ 1]) + data[1:] for data in frames]


def test_after_as_many_right_frames_as_chance_does_not_give_the_sender_is_judged(tmp_path):
    frames = e2e_p01(60)
    one, three = (Car(write(tmp_path, PLAIN, P01)) for _ in range(2))
    assert one.feed([*frames[:2], *broken(frames[2:])]).failed() == ["rule"], "two of 8 bits: once in 65536"
    assert three.feed([*frames[:3], *broken(frames[3:])]).failed() == ["crc"]
    assert three.of("protection") == []


def test_a_rule_that_has_fitted_is_remembered_in_the_next_ignition(tmp_path):
    frames, memory = e2e_p01(60), tmp_path / "faults.sqlite"
    for fed, failed in ((frames, []), (broken(frames), ["crc"]), (broken(frames), ["crc"])):
        car = Car(write(tmp_path, PLAIN, P01), memory=memory).feed(fed)
        car.gateway.stop(car.t_ns)
        car.gateway.close()
        assert car.failed() == failed
    # Another rule has fitted nobody. Nor has the first one any more, once there was another.
    for data_id in ("0x1235", "0x1234"):
        car = Car(write(tmp_path, PLAIN, P01.replace("0x1234", data_id)), memory=memory).feed(broken(frames))
        car.gateway.stop(car.t_ns)
        car.gateway.close()
        assert [fault for fault in car.failed() if fault != "crc"] == ["rule"]
        assert len(car.of("protection")) == 1


def test_a_rule_is_remembered_after_kill_9(tmp_path):
    """At the next look for requests it goes to the file, not at the end."""
    memory = tmp_path / "faults.sqlite"
    first = Car(write(tmp_path, PLAIN, P01), memory=memory).feed(e2e_p01(20))
    first.gateway.serve_requests()
    first.gateway.advance(first.t_ns + MS)
    first.gateway.store.close()
    assert Car(tmp_path / "gateway.toml", memory=memory).feed(broken(e2e_p01(60))).failed() == ["crc"]


def reloaded(car, folder, check, *, before="", messages=PLAIN):
    """Let the gateway of a configuration with another check take over."""
    path = write(folder, messages, f"{before}{check}")
    old = car.gateway
    old.finish(car.t_ns)
    car.gateway = Gateway(load_config(path), file=path, store=old.store)
    car.gateway.succeed(old)
    return car


def with_window(timeout_ms):
    return P01.replace("0x1234", f"0x1234, {WINDOW}") + f"\ntimeout_ms = {timeout_ms}"


def test_another_timeout_leaves_the_crc_the_counter_and_the_window_as_they_are(tmp_path):
    frames = e2e_p01(60)
    car = Car(write(tmp_path, PLAIN, with_window(100))).feed(frames[:20])
    reloaded(car, tmp_path, with_window(500)).feed(frames[20:22])
    assert car.gateway.engine.counters()["window_rejected"] == 3, "those of its start: it is valid still"
    car.feed([frames[21], frames[21], frames[21]])
    assert car.failed() == ["counter"]
    # The message of finding A: a CRC that breaks at the reload is the sender's fault, at its second frame.
    reloaded(car, tmp_path, with_window(400)).feed(broken(frames[22:24]))
    assert car.failed() == ["counter", "crc"]


def test_another_message_s_crc_before_it_changes_nothing(tmp_path):
    """Tables of CRCs are put in order of the checks: their place is no part of a rule."""
    other = PLAIN + PLAIN.replace("256 M", "257 N").replace("Speed : 16|16", "Sum : 0|16")
    frames = e2e_p01(60)
    car = Car(write(tmp_path, other, P01)).feed(frames[:20])
    before = 'message = "N"\ninvalid = "U0402"\ncrc = { signal = "Sum", algorithm = "crc16_arc" }\n[[bus.check]]\n'
    reloaded(car, tmp_path, P01, before=before, messages=other)
    assert car.feed([frames[19]] * 3).failed() == ["counter"], "the last one before is known"


def test_another_rule_is_not_proven_by_a_reload(tmp_path):
    frames = e2e_p01(60)
    car = Car(write(tmp_path, PLAIN, P01)).feed(frames[:20])
    assert reloaded(car, tmp_path, P01.replace("0x1234", "0x1235")).feed(frames[20:45]).failed() == ["rule"]


NIBBLE = 'BO_ 256 M: 8 A\n SG_ CHECKSUM : 59|4@0+ (1,0) [0|15] "" B\n'


@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_rule_of_4_bits_is_doubted_for_good_though_frames_pass_by_chance(tmp_path, seed):
    rng = random.Random(seed)
    wrong = Car(write(tmp_path, NIBBLE, 'message = "M"\nchecksum = "honda"'))
    assert wrong.feed([rng.randbytes(8) for _ in range(600)]).failed() == ["rule"]
    assert 15 < 600 - wrong.gateway.engine.counters()["crc_failed"] < 75, "by chance"
    assert len(wrong.of("protection")) == 1


def test_a_doubt_does_not_end_with_one_payload_that_passes_by_chance_again_and_again(tmp_path):
    text = 'BO_ 256 M: 8 A\n SG_ CHECKSUM : 56|8@1+ (1,0) [0|255] "" B\n'
    made = Car(write(tmp_path, text, 'message = "M"\nchecksum = { rule = "sum" }'))
    made.feed([bytes([k, 7, 0, 0, 0, 0, 0, k + 8]) for k in range(60)])
    assert made.failed() == ["rule"]
    made.feed([bytes([1, 7, 0, 0, 0, 0, 0, 8])] * 200)
    assert [e for e in made.of("dtc") if e["dtc"].endswith("-56")][-1]["status"] & 1, "one in 256"
    made.feed([bytes([k, 7, 0, 0, 0, 0, 0, k + 7]) for k in range(60)])
    assert not [e for e in made.of("dtc") if e["dtc"].endswith("-56")][-1]["status"] & 1


def test_a_right_rule_of_4_bits_is_taken_after_7_frames_and_one_payload_again_and_again_is_one_frame(tmp_path):
    frames = [bytes([k, 0, 0, 0, 0, 0, 0, -k & 0xF]) for k in range(1, 16)]  # a sum of nibbles
    check = 'message = "M"\nchecksum = { rule = "sum", of = "nibbles", negative = true }'
    wrong = [bytes([data[0], 0, 0, 0, 0, 0, 1, data[7]]) for data in frames]
    for right, found in ((frames[:6], ["rule"]), (frames[:7], ["crc"]), (frames[:1] * 100, ["rule"])):
        assert Car(write(tmp_path, NIBBLE, check)).feed([*right, *wrong, *wrong, *wrong]).failed() == found


@pytest.mark.parametrize(
    ("check", "said"),
    [
        ('message = "M"\nchecksum = "toyotta"', "did you mean toyota?"),
        ('message = "M"\nchecksum = "toyota"', "which signal of M is the checksum? Give signal; it has Speed"),
        ('message = "M"\nchecksum = { rule = "sum", signal = "Sped" }', "did you mean Speed?"),
        ('message = "M"\ncrc = { signal = "Speed" }', "the CRC has 8 bits, its signal 16"),
        ('message = "M"\ncrc = { signal = "Speed", width = 16 }', "width and poly are given together"),
        ('message = "M"\ncrc = { signal = "Speed", width = 16, poly = 0x11021 }', "poly has more than 16 bits"),
        ('message = "M"\ne2e = { profile = "P02" }', "P02 wants a list of 16 data ids"),
        ('message = "M"\ne2e = { profile = "P04" }', "P04's header has 12 bytes, the message 8"),
        ('message = "M"\ne2e = { profile = "P01" }\ncounter = { signal = "Speed" }', "e2e has a counter of its own"),
        (
            'message = "M"\nchecksum = "toyota"\ne2e = { profile = "P01" }',
            "checksum and e2e: a message has one of them",
        ),
        ('message = "M"\ncounter = { signal = "Speed", modulus = 70000 }', "16 bits have 65536 values"),
        ('message = "M"\ne2e = { profile = "P01", window = { size = 65, min_ok = 1, max_error = 1 } }', "1 to 64"),
        (
            'message = "M"\ne2e = { profile = "P01", window = { size = 9, min_ok = [3, 5, 5], max_error = 1 } }',
            "while valid it takes no more right ones, and bears no fewer wrong ones",
        ),
    ],
)
def test_mistakes_are_one_line_that_names_file_key_and_value(tmp_path, check, said):
    with pytest.raises((InputError, InputErrors)) as told:
        Gateway(load_config(write(tmp_path, PLAIN, check)), file=tmp_path / "gateway.toml")
    (line,) = str(told.value).splitlines()
    assert said in line
    assert "gateway.toml" in line


ATTRIBUTES = (
    'BA_DEF_ BO_ "E2E_Profile" STRING ;\nBA_DEF_ BO_ "E2E_DataID" INT 0 65535;\nBA_DEF_ BO_ "E2E_DataIDMode" STRING ;\n'
    'BA_DEF_DEF_ "E2E_Profile" "";\nBA_DEF_DEF_ "E2E_DataID" 0;\nBA_DEF_DEF_ "E2E_DataIDMode" "";\n'
    'BA_ "E2E_Profile" BO_ 256 "PROFILE_01";\nBA_ "E2E_DataID" BO_ 256 4660;\n'
    'BA_ "E2E_DataIDMode" BO_ 256 "E2E_P01_DATAID_LOW";\n'
)
NAMED = (
    'BO_ 256 M: 8 A\n SG_ COUNTER : 7|4@0+ (1,0) [0|15] "" B\n SG_ CHECKSUM : 63|8@0+ (1,0) [0|255] "" B\n'
    'BO_ 257 Plain: 8 A\n SG_ Speed : 16|16@1+ (1,0) [0|0] "" B\n'
)


def test_auto_takes_what_attributes_say_and_check_says_so(tmp_path, capsys):
    from gateway_commands.check import check

    path = write(tmp_path, PLAIN + ATTRIBUTES, 'message = "M"\nprotection = "auto"')
    assert check(path, schema_wanted=False, json=False) == 0
    said = capsys.readouterr().out
    assert 'taken: b.M: e2e = { profile = "P01", data_id = 4660, data_id_mode = "low" }, as attributes' in said
    assert Car(path).feed(e2e_p01(100, mode=e2e.p01.E2E_P01_DATAID_LOW)).failed() == []
    frames = e2e_p01(100)
    assert Car(path).feed(frames).failed() == ["rule"], "these are of another mode"


def test_auto_takes_opendbc_s_names_and_says_where_it_takes_nothing(tmp_path):
    more = '\n[[bus.check]]\nmessage = "Plain"\nlost = "U0101"\ninvalid = "U0402"\nprotection = "auto"'
    path = write(tmp_path, NAMED, f'message = "M"\nprotection = "auto"{more}', name="toyota_mine.dbc")
    car = Car(path)
    one, other = car.gateway.notes
    assert 'checksum = { rule = "toyota", signal = "CHECKSUM" }, by the name of toyota_mine.dbc' in one
    assert 'counter = { signal = "COUNTER" }, by its name' in one
    assert other.startswith("b.Plain: nothing")
    frames = []
    for k in range(100):
        data = bytes([k % 16 << 4, *range(6)])
        frames.append(data + bytes([sum(data) + 8 + 1 & 0xFF]))
    assert car.feed(frames).failed() == []
    assert car.feed([frames[-1]] * 4).failed() == ["counter"]


def test_auto_is_given_alone(tmp_path):
    path = write(tmp_path, PLAIN, 'message = "M"\nprotection = "auto"\nchecksum = "toyota"')
    with pytest.raises(InputErrors, match="give it, or the rest"):
        load_config(path)
