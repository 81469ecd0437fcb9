"""A fault from the frame to the memory, with everything a configuration can say about it.

Names in brackets are defects reported against other fault managers: each has its test here, or says where.
"""

import json
import zlib

import pytest
from rig import MS, Rig, write_config

from gateway.bus.frames import empty, put
from gateway.bus.logs import LogReader
from gateway.config.load import load_config
from gateway.faults import service
from gateway_fdi.errors import GatewayError

LIMIT = 'freeze_frame = ["M0.Value"]\n'


@pytest.fixture
def make(tmp_path):
    rigs = []

    def build(messages=3, memory=None, **options):
        rigs.append(Rig(write_config(tmp_path, messages, **options), memory))
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.close()


def entry(rig, k):
    return rig.gateway.memory.entry(rig.fault(k))


def cycles(rig):
    return [(e["cycle"], e["state"]) for e in rig.events if e["event"] == "cycle"]


def test_enable_conditions_of_the_configuration(make):
    rig = make(faults={1: 'enable = [{ signal = "M0.Value", min = 9.0, max = 16.0 }]\n'})
    rig.fail(1)
    assert rig.status(1) == 0x50, "the voltage is not known"
    rig.value(0, 8.5)
    rig.fail(1)
    assert rig.status(1) == 0x50, "and now too low"
    rig.value(0, 12.0)
    rig.fail(1)
    assert rig.status(1) == 0x2F


def test_a_root_cause_of_the_configuration(make):
    """M1's fault is what M0's would cause: with M0 broken only M0 is told."""
    rig = make(faults={1: 'caused_by = ["b.M0.length"]\n'})
    rig.feed((256, b"\x01"))
    rig.fail(1)
    rig.feed((256, b"\x01"))
    assert (rig.status(0), rig.status(1)) == (0x2F, 0x50)
    rig.heal(0)
    rig.fail(1)
    assert rig.status(1) == 0x2F


def test_a_root_cause_that_the_last_process_knew_still_counts(make, tmp_path):
    faults = {1: 'caused_by = ["b.M0.length"]\n'}
    rig = make(faults=faults, memory=tmp_path / "m.sqlite")
    rig.fail(0)
    rig.close()
    rig = make(faults=faults, memory=tmp_path / "m.sqlite")
    rig.fail(1)
    assert rig.status(1) == 0x50
    rig.heal(0)
    rig.fail(1)
    assert rig.status(1) == 0x2F


def test_operation_cycles_by_signals(make):
    extra = """
[cycle.driving]
begins = { signal = "M2.Value", min = 10.0 }
ends = { signal = "M2.Value", max = 1.0 }
"""
    rig = make(extra=extra, faults={0: 'cycle = "driving"\nconfirm_cycles = 2\nindicator = true\n'})
    for _ in range(2):
        rig.value(2, 20.0)
        rig.fail(0)
        rig.heal(0)
        rig.value(2, 0.5)
    assert cycles(rig) == [("driving", "began"), ("driving", "ended")] * 2
    assert rig.status(0) & 0x88 == 0x88, "confirmed by its second driving cycle, in one power cycle"
    rig.value(2, 20.0)
    assert rig.status(0) & 0x42 == 0x40
    rig.gateway.stop(rig.now)
    assert rig.gateway.memory.cycle_number("driving") == 3
    assert not any(c.open for c in rig.gateway.store.cycles().values()), "the gateway's end ends all"


DRIVING = """
[cycle.driving]
begins = { signal = "M2.Value", min = 10.0 }
ends = { signal = "M2.Value", max = 1.0 }
"""


def test_a_fault_that_stays_is_found_again_in_each_cycle(make):
    rig = make(extra=DRIVING, faults={0: 'cycle = "driving"\n'})
    for _ in range(2):
        rig.value(2, 20.0)
        assert rig.status(0) & 0x02 == 0
        rig.fail(0)
        assert rig.status(0) & 0x02
        rig.value(2, 0.5)
    assert entry(rig, 0).record.occurrence == 1, "it never went away"


def test_a_cycle_that_the_gateways_end_ended_begins_anew(make):
    rig = make(extra=DRIVING)
    rig.value(2, 20.0)
    rig.gateway.stop(rig.now)
    rig.gateway.start(rig.now)
    rig.value(2, 20.0)
    assert cycles(rig) == [("driving", "began"), ("driving", "began")]
    assert rig.gateway.memory.cycle_number("driving") == 2


def test_a_root_cause_that_is_cleared_holds_nothing_back(make):
    rig = make(faults={1: 'caused_by = ["b.M0.length"]\n'})
    rig.fail(0)
    rig.gateway.controls.clear(rig.gateway.catalogue[0].dtc.value)
    rig.fail(1)
    assert rig.status(1) == 0x2F


def test_time_debounce_of_the_configuration(make):
    rig = make(faults={0: "debounce = { failed_ms = 100.0, passed_ms = 200.0 }\n" + LIMIT})
    rig.value(0, 3.0)
    rig.feed((256, b"\x01"))
    begun = rig.now
    rig.wait(99)
    assert rig.status(0) == 0x50
    rig.wait(2)
    assert rig.status(0) == 0x2F
    assert entry(rig, 0).record.first_ns == begun + 100 * MS
    assert entry(rig, 0).record.evidence["value"] == 1.0


def test_a_verdict_from_a_timer_has_freeze_frame_and_evidence_like_any_other(tmp_path):
    """[the timer's path forgot the snapshot] There is one way into the memory, whoever found the fault."""
    frame = '[fault."b.M1.timeout"]\nfreeze_frame = ["M0.Value", "M1.Value"]\n'
    config = write_config(tmp_path, 2, extra=frame)
    watched = 'message = "M1"\ntimeout_ms = 50.0\n'
    config.write_text(config.read_text().replace('message = "M1"\n', watched))
    rig = Rig(config)
    rig.value(0, 7.0)
    rig.value(1, 8.0)
    last = rig.now
    rig.wait(200)
    kept = rig.gateway.memory.entry("b.M1.timeout")
    assert kept.freeze_frames[0].content == {"M0.Value": 7.0, "M1.Value": 8.0}
    assert kept.freeze_frames[0].t_ns == last + 50 * MS
    assert kept.record.evidence["silent [ms]"] == 50.0
    rig.close()


@pytest.mark.parametrize(
    ("lines", "key"),
    [
        ("debounce = { failed_ms = nan, passed_ms = 1.0 }", "debounce.failed_ms"),
        ("debounce = { failed_ms = inf, passed_ms = 1.0 }", "debounce.failed_ms"),
        ("debounce = { failed_ms = 5.0 }", "debounce"),
        ("debounce = { failed_ms = 5.0, passed_ms = 5.0, failed_after = 3 }", "debounce"),
        ('enable = [{ signal = "M0.Value", min = nan }]', "enable[0].min"),
        ('enable = [{ signal = "M0.Value" }]', "enable[0]"),
        ('enable = [{ signal = "M0.Value", min = 3.0, max = 2.0 }]', "enable[0]"),
        ('enable = [{ signal = "M9.Value", min = 3.0 }]', "enable[0].signal"),
        ('caused_by = ["b.M9.length"]', "caused_by"),
        ('cycle = "winter"', "cycle"),
        ("spn = 5", "b.M0.length"),
        ("freeze_frame_at = 127", "b.M0.length"),
        ('freeze_frame = ["nothing"]', "freeze_frame[0]"),
        ("aging_cycles = 0", "aging_cycles"),
    ],
)
def test_what_makes_no_sense_is_refused_at_load_and_named(make, lines, key):
    """[NaN in settings] Nothing that could never be met, or always, gets as far as a monitor."""
    with pytest.raises(GatewayError) as refused:
        make(faults={0: lines + "\n"})
    assert key in str(refused.value)
    assert "rig.toml" in str(refused.value)


def test_the_counter_clamps_and_does_not_run_away(make):
    """[debounce must clamp and latch] A thousand failures take no longer to heal than one."""
    rig = make()
    for _ in range(500):
        rig.fail(0)
    assert rig.gateway.engine.fault_detection_counter(0) == 127
    rig.heal(0)
    assert rig.gateway.engine.fault_detection_counter(0) == -128
    assert rig.status(0) & 1 == 0
    assert entry(rig, 0).record.occurrence == 1, "and it failed once, not five hundred times"


RECORDING = """
[memory]
recording = { before_ms = 20.0, after_ms = 10.0, most_frames = 40, most_per_fault = 2, cooldown_s = 1.0 }
"""


def recorded(rig, tmp_path, k):
    made = []
    for number, recording in enumerate(rig.gateway.store.recordings(rig.fault(k))):
        path = tmp_path / f"{number}.log"
        path.write_bytes(zlib.decompress(recording.log))
        frames = [f for batch in LogReader(path) for f in batch]
        made.append((recording, [int(f["t_ns"]) // MS for f in frames]))
    return made


def test_frames_before_and_after_a_failure_are_kept(make, tmp_path):
    rig = make(extra=RECORDING)
    for _ in range(50):
        rig.value(1, 1.0)
    rig.fail(0)
    at = rig.now // MS
    assert recorded(rig, tmp_path, 0) == [], "not before its time is over"
    for _ in range(20):
        rig.value(1, 1.0)
    ((recording, times),) = recorded(rig, tmp_path, 0)
    assert recording.t_ns == at * MS
    assert times == list(range(at - 20, at + 11))
    assert (recording.frames, recording.dropped) == (31, 0)


@pytest.mark.evidence("Bounded: storm")
def test_a_storm_of_failures_is_bounded(make, tmp_path):
    """[snapshot storm] A cap for each fault, a cooldown, and a count of what was left out."""
    rig = make(extra=RECORDING)
    for _ in range(100):
        rig.fail(0)
        rig.heal(0)
    made = recorded(rig, tmp_path, 0)
    assert len(made) == 2, "the latest two"
    times = [recording.t_ns for recording, _ in made]
    assert times[1] - times[0] >= 1000 * MS
    assert rig.gateway.summary(1.0)["counters"]["recordings_refused"] > 90


def test_a_flood_of_frames_keeps_those_nearest_the_failure(make, tmp_path):
    rig = make(extra=RECORDING.replace("most_frames = 40", "most_frames = 5"))
    for _ in range(50):
        rig.value(1, 1.0)
    rig.fail(0)
    at = rig.now // MS
    for _ in range(20):
        rig.value(1, 1.0)
    ((recording, times),) = recorded(rig, tmp_path, 0)
    assert times == [at - 2, at - 1, at, at + 1, at + 2]
    assert recording.dropped == 26


@pytest.mark.evidence("Live is replay: recorded freeze frames")
@pytest.mark.parametrize("most", [40, 5])
def test_a_replay_in_any_chunks_keeps_the_same_recordings(make, most):
    rows = [(256 + (t % 3), bytes(8 if t % 50 else 1)) for t in range(400)]
    rows[200] = rows[201] = (256, b"\x01")
    frames = empty(len(rows))
    for t, (can_id, data) in enumerate(rows):
        put(frames, t, t // 2 * 2 * MS, can_id, data)  # two at each time
    kept = []
    for chunk in (1, 7, 400):
        rig = make(extra=RECORDING.replace("most_frames = 40", f"most_frames = {most}"))
        for at in range(0, len(frames), chunk):
            rig.gateway.feed(frames[at : at + chunk])
        rig.gateway.stop(len(rows) * MS)
        kept.append(rig.gateway.store.recordings())
    assert kept[0]
    assert kept[0] == kept[1] == kept[2]


def test_recordings_go_with_a_clear_and_an_unfinished_one_is_kept_at_the_end(make, tmp_path):
    rig = make(extra=RECORDING)
    rig.fail(0)
    rig.fail(1)
    rig.gateway.controls.clear(rig.gateway.catalogue[0].dtc.value)
    rig.gateway.stop(rig.now)
    assert recorded(rig, tmp_path, 0) == []
    assert len(recorded(rig, tmp_path, 1)) == 1
    rig.gateway.start(rig.now)
    rig.fail(0)
    rig.gateway.stop(rig.now)
    assert len(recorded(rig, tmp_path, 0)) == 1, "a cleared fault is recorded at once again"


def test_freeze_frames_survive_a_restart_and_go_with_a_clear(make, tmp_path):
    """[freeze frame lost at restart; clear policy] Written before anyone is told; gone when cleared, not before."""
    path = tmp_path / "m.sqlite"
    rig = make(memory=path, faults={0: LIMIT})
    rig.value(0, 4.5)
    rig.fail(0)
    (listed,) = service.list_entries(path)  # the process has not ended, and another reads it
    assert listed["freeze_frames"][0]["signals"] == {"M0.Value": 4.5}
    rig.close()
    rig = make(memory=path, faults={0: LIMIT})
    assert entry(rig, 0).freeze_frames[0].content == {"M0.Value": 4.5}
    rig.gateway.controls.clear(0xFFFFFF)
    assert entry(rig, 0).freeze_frames == ()
    assert service.list_entries(path) == []


def test_near_misses_and_the_greatest_counter_reach_the_reader(make, tmp_path):
    path = tmp_path / "m.sqlite"
    rig = make(
        memory=path,
        faults={0: "debounce = { failed_after = 10, passed_after = 1, jump_down = true }\n"},
    )
    for failures in (6, 2, 9):
        for _ in range(failures):
            rig.feed((256, b"\x01"))
        rig.feed((256, bytes(8)))
    rig.gateway.stop(rig.now)
    (found,) = service.near_misses(path)
    assert (found["fault"], found["near_misses"], found["peak_fdc"]) == ("b.M0.length", 2, 114)


def test_a_bounded_memory_of_the_configuration(make):
    faults = {k: f"priority = {priority}\n" for k, priority in enumerate((10, 30, 20))}
    rig = make(faults=faults, extra="[memory]\nentries = 2\n")
    for k in (1, 2, 0):
        rig.fail(k)
    assert [e.fault for e in rig.gateway.memory.entries()] == ["b.M0.length", "b.M2.length"]


def test_a_catalogue_in_a_file_of_its_own(tmp_path):
    write_config(tmp_path, 2, head='catalogue = ["faults.toml"]\n')
    (tmp_path / "faults.toml").write_text('[fault."b.M0.timeout"]\ndtc = "U0100-00"\n')
    text = (tmp_path / "rig.toml").read_text()
    with pytest.raises(GatewayError, match="no monitor reports this fault"):
        Rig(tmp_path / "rig.toml")
    (tmp_path / "rig.toml").write_text(text.replace('message = "M0"\n', 'message = "M0"\ntimeout_ms = 9.0\n'))
    config = load_config(tmp_path / "rig.toml")
    assert config.fault["b.M0.timeout"].dtc == "U0100-00"
    (tmp_path / "faults.toml").write_text('[fault."b.M0.length"]\ndtc = "U0100-00"\n')
    with pytest.raises(GatewayError, match=r'faults\.toml: fault\."b\.M0\.length": this fault is set elsewhere'):
        load_config(tmp_path / "rig.toml")
    (tmp_path / "faults.toml").write_text('[fault."b.M0.timeout"]\ndtc = "Q0100"\n')
    with pytest.raises(GatewayError, match=r"faults\.toml.*dtc"):
        load_config(tmp_path / "rig.toml")
    with pytest.raises(GatewayError, match=r"gone\.toml"):
        (tmp_path / "rig.toml").write_text(text.replace("faults.toml", "gone.toml"))
        load_config(tmp_path / "rig.toml")


@pytest.mark.parametrize(
    ("extra", "key"),
    [
        ("[output.uds]\nclear = { security = 1 }\n", "output.uds"),
        ('[output.uds]\nsecurity = [{ level = 1, secret = "0g" }]\n', "output.uds.security[0]"),
        (
            '[output.uds]\nsecurity = [{ level = 1, secret = "00", key = "no.such:thing" }]\n',
            "output.uds.security[0].key",
        ),
        ("[output.uds]\nrequest = 0x7E0\n[output.obd]\nresponse = 0x7E9\n", "output.obd"),
        ("[output.obd]\npid = [{ id = 0x0C, signal = 'M7.Value' }]\n", "output.obd.pid[0].signal"),
        ("[output.obd]\npid = [{ id = 0x99, signal = 'M0.Value' }]\n", "output.obd.pid[0]"),
        ('[output.obd]\nvin = "TOO-SHORT"\n', "output.obd.vin"),
        ("[output.j1939]\naddress = 254\n", "output.j1939.address"),
        (
            '[[did]]\nid = 0xF190\nname = "a"\ntext = "x"\n[[did]]\nid = 0xF190\nname = "b"\ntext = "x"\n',
            "did[1].id",
        ),
        ('[[did]]\nid = 0x1234\nname = "a"\nsignal = "M7.Value"\n', "did[0].signal"),
        ('[[did]]\nid = 0x1234\nname = "a"\nsignal = "M0.Value"\nwritable = true\n', "did[0]"),
        (
            '[cycle.power]\nbegins = { signal = "M0.Value", min = 1.0 }\nends = { signal = "M0.Value", max = 0.0 }\n',
            "cycle.power",
        ),
    ],
)
def test_wrong_servers_are_refused_and_named(make, extra, key):
    with pytest.raises(GatewayError) as refused:
        make(extra=extra)
    assert key in str(refused.value)


def test_what_is_exported_is_json_and_whole(make):
    rig = make(
        faults={0: 'spn = 91\nfmi = 3\nseverity = "next_halt"\n' + LIMIT},
        extra="[output.uds]\n",
    )
    told = json.loads(json.dumps(rig.gateway.describe()))
    assert {"id", "dtc", "spn", "fmi", "severity", "debounce", "cycle"} <= told["faults"][0].keys()
    assert (told["faults"][0]["dtc"], told["faults"][0]["spn"]) == ("P1000-11", 91)
    did, trace = told["identifiers"]
    assert (trace["id"], trace["name"]) == ("0xFD10", "interventions")
    assert (did["id"], did["signal"], did["length"]) == ("0x4000", "M0.Value", 4)


def test_results_outside_the_operation_cycle_do_not_count(make):
    rig = make(
        extra=DRIVING,
        faults={
            0: 'cycle = "driving"\nconfirm_cycles = 2\n',
            1: 'caused_by = ["b.M0.length"]\n',
        },
    )
    rig.fail(0)
    assert rig.status(0) == 0x50, "before the first drive"
    assert rig.gateway.engine.fault_detection_counter(0) == 0
    rig.fail(1)
    assert rig.status(1) == 0x2F, "what is not tested holds nothing back"
    rig.value(2, 20.0)
    rig.fail(0)
    assert rig.status(0) == 0x27, "the first trip"
    rig.value(2, 0.5)
    rig.heal(0)
    rig.fail(0)
    assert rig.status(0) == 0x27, "engine stopped"
    rig.value(2, 20.0)
    rig.fail(0)
    assert rig.status(0) == 0x2F, "the second trip"


def test_a_time_debounce_does_not_ripen_after_its_cycle(make):
    rig = make(
        extra=DRIVING,
        faults={0: 'cycle = "driving"\ndebounce = { failed_ms = 100.0, passed_ms = 100.0 }\n'},
    )
    rig.value(2, 20.0)
    rig.fail(0)
    rig.value(2, 0.5)
    rig.wait(1000)
    assert rig.status(0) == 0x50
    rig.value(2, 20.0)
    rig.fail(0)
    rig.wait(200)
    assert rig.status(0) == 0x2F
