"""``gateway replay`` of logs that are not what one thinks: other channels, empty, cut off, compressed."""

import bz2
import gzip
import importlib
import lzma

import can
import networks
import numpy as np
import pytest
from command import command
from own_message import DBC

import gateway_api as api
from gateway.bus.frames import to_message
from gateway.bus.logs import LogReader, open_writer
from gateway.common import extras
from gateway.faults.store import Store
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway_fdi.errors import GatewayError
from gateway_replay.log import Log

BUS = """
[[bus]]
name = "{name}"
uri = "{uri}"
database = ["own.dbc"]
"""
CHECK = """
[[bus.check]]
message = "M0"
timeout_ms = 100.0
lost = "{dtc}"
invalid = "{other}"
"""


def zstd():
    for name in ("compression.zstd", "backports.zstd"):
        try:
            return importlib.import_module(name)
        except ImportError:
            continue
    raise AssertionError("no Zstandard for tests")


@pytest.fixture
def replay(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.dbc").write_text(DBC)
    checks = [
        CHECK.format(dtc="U0101", other="U0402"),
        CHECK.format(dtc="U0102", other="U0403"),
    ]
    buses = [("chassis", "socketcan:can0"), ("body", "socketcan:can1")]
    parts = [BUS.format(name=n, uri=u) + check for (n, u), check in zip(buses, checks, strict=True)]
    (tmp_path / "two.toml").write_text("".join(parts))
    (tmp_path / "one.toml").write_text(parts[0])

    def run(log, *options, config="two.toml"):
        return command(capsys, monkeypatch, "replay", log, "-c", config, *options)

    return run


def lines(*names, count=60, begin=0.0):
    """So many frames of each channel; a silence of a second in the middle, which sets a DTC."""
    made = []
    for k in range(count):
        t = begin + k / 100 + (1.0 if k > count // 2 else 0.0)
        made += [f"({t + j / 1e4:.6f}) {name} 100#0000000000000000\n" for j, name in enumerate(names)]
    return "".join(made)


def test_a_log_without_a_configured_bus_is_no_good_log(replay, tmp_path):
    (tmp_path / "a.log").write_text(lines("vcan7", "vcan8"))
    for options in ((), ("--fail-on-dtc",), ("--json",)):
        ended = replay("a.log", *options)
        assert ended.code == 2
        assert (
            "a.log: no frame of a configured bus: the log has vcan7 (60 frames), vcan8 (60 frames), the"
            " configuration chassis (can0), body (can1); join them, e.g. --map vcan7=chassis"
        ) in ended.err
    assert ended.event("log")["state"] == "foreign"
    assert ended.event("log")["left_out"] == 120
    assert ended.events[-1]["event"] == "summary"
    meant = replay("a.log", "--allow-empty")
    assert meant.code == 0
    assert "no frame of a configured bus" in meant.out


@pytest.mark.parametrize(("ours", "strange", "foreign"), [(1, 3, "1 of 4"), (1, 2, ""), (2, 9, ""), (0, 1, "none")])
def test_a_log_that_shares_a_few_identifiers_by_chance_is_of_another_vehicle(tmp_path, ours, strange, foreign):
    """Ten are known; one in four of the log, and one in ten of the known, may be by chance."""
    bus = {"drive": {"Engine": [(0x100 + k, 10) for k in range(10)]}}
    config = networks.config_of(tmp_path, bus)
    ids = [*(0x100 + k for k in range(ours)), *(0x300 + k for k in range(strange))]
    (tmp_path / "a.log").write_text("".join(f"(1.{k:06}) drive {can_id:03X}#00\n" for k, can_id in enumerate(ids)))
    log = Log(tmp_path / "a.log", config)
    log.refuse_foreign(prepare(config).databases)
    assert log.foreign == foreign


def test_a_log_of_another_vehicle_is_not_judged(replay, tmp_path):
    """Silent messages of ours would be its DTCs, and its identifiers strangers."""
    (tmp_path / "a.log").write_text((lines("can0") + lines("can0", begin=20.0)).replace("100#", "555#"))
    ended = replay("a.log", "--fail-on-dtc", "--json", config="one.toml")
    assert ended.code == 2
    assert "a.log: of another vehicle: the databases of the configuration know none of its identifiers" in ended.err
    assert [event for event in ended.events if event["event"] == "dtc"] == []
    assert (ended.event("log")["state"], ended.event("log")["frames"]) == ("foreign", 120)
    assert replay("a.log", "--fail-on-dtc", "--allow-empty", config="one.toml").code == 1, "it is asked for"
    (tmp_path / "a.log").write_text("(1.0) can0 20000040#0000000000000000\n" * 3)
    assert replay("a.log", "--json", config="one.toml").event("log")["state"] == "whole", "the bus was off"
    (tmp_path / "a.log").write_text(lines("can0").replace("100#", "555#") + lines("can0", begin=9.0))
    assert replay("a.log", "--json", config="one.toml").event("log")["state"] == "whole"


def test_channels_are_joined_to_buses(replay, tmp_path):
    (tmp_path / "a.log").write_text(lines("vcan7", "vcan8"))
    both = replay("a.log", "--map", "vcan7=chassis", "--map", "vcan8=body", "--fail-on-dtc", "--json")
    assert both.code == 1
    assert {e["dtc"] for e in both.events if e["event"] == "dtc"} == {"U0101-87", "U0102-87"}
    found = both.event("log")
    assert found["channels"] == {
        "vcan7": {"bus": "chassis", "frames": 60},
        "vcan8": {"bus": "body", "frames": 60},
    }
    assert (found["state"], found["left_out"], found["notes"]) == ("whole", 0, [])


def test_frames_left_out_are_counted_and_named(replay, tmp_path):
    (tmp_path / "a.log").write_text(lines("can0", "vcan8"))
    ended = replay("a.log")
    assert ended.code == 0
    assert "60 of 120 frames left out, of no configured bus: vcan8 (60 frames)" in ended.out
    assert "no frame of body in this log" in ended.out
    assert replay("a.log", "--json").event("log")["left_out"] == 60


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("vcan7=chasis", "--map = 'vcan7=chasis': the buses are chassis, body; did you mean chassis?"),
        ("vcan7", "--map = 'vcan7': channel=bus, e.g. vcan7=chassis"),
        ("vcan9=body", "a.log: --map = 'vcan9': the log has no such channel; it has can0 (60 frames)"),
    ],
)  # fmt: skip
def test_wrong_maps(replay, tmp_path, asked, said):
    (tmp_path / "a.log").write_text(lines("can0"))
    ended = replay("a.log", "--map", asked)
    assert ended.code == 2
    assert said in ended.err


def test_a_channel_has_one_bus(replay, tmp_path):
    (tmp_path / "a.log").write_text(lines("can0"))
    ended = replay("a.log", "--map", "x=chassis", "--map", "x=body")
    assert ended.code == 2
    assert "joined to another bus" in ended.err


def test_one_bus_takes_all_channels_and_says_so(replay, tmp_path):
    (tmp_path / "a.log").write_text(lines("can3", "can4"))
    ended = replay("a.log", config="one.toml")
    assert ended.code == 0
    assert "all channels are taken as chassis: can3 (60 frames), can4 (60 frames)" in ended.out
    chosen = replay("a.log", "--map", "can4=chassis", "--json", config="one.toml")
    assert chosen.event("summary")["frames"] == 60
    assert chosen.event("log")["channels"]["can3"] == {"bus": None, "frames": 60}


def test_a_report_without_its_packages_is_refused_before_a_log_is_looked_for(replay, monkeypatch):
    monkeypatch.setattr(extras, "_found", lambda package: package != "bokeh")
    ended = replay("none.log", "--html", "report.html")
    assert (ended.code, ".[serve]" in ended.err, "--html" in ended.err) == (2, True, True), ended.err
    assert ".[serve]" not in replay("none.log").err


def test_a_log_of_nothing_that_is_watched(replay, tmp_path):
    (tmp_path / "own.dbc").write_text(f"{DBC}BO_ 291 M1: 1 B\n")
    (tmp_path / "a.log").write_text("(1.0) can0 123#00\n")
    assert "none of its frames is one that a monitor or check here wants" in replay("a.log").out


def test_many_frames_of_another_channel_do_not_end_the_log(tmp_path):
    """python-can's formats: a whole chunk of a channel that is left out was taken for the end."""
    with can.Logger(tmp_path / "a.asc") as logger:
        for k in range(40):
            logger(can.Message(timestamp=k / 10, arbitration_id=1, channel=5 if k < 30 else 0))
    reader = LogReader(tmp_path / "a.asc", chunk=10, channels={"0": 0})
    assert sum(map(len, reader)) == 10
    assert reader.seen == {"5": 30, "0": 10}


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".csv", ".mf4"])
def test_an_empty_log_is_no_good_log(replay, tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    if suffix in (".log", ".blf", ".mf4"):
        with open_writer(path):
            pass
    else:
        path.write_text("")
    ended = replay(path, config="one.toml")
    assert ended.code == 2
    assert "no frame in this log" in ended.err
    assert replay(path, "--allow-empty", config="one.toml").code == 0


def written(folder, suffix):
    """A log of one bus with a silence in its middle, in a format."""
    (folder / "base.log").write_text(lines("can0", count=400, begin=1.7e9))
    path = folder / f"drive{suffix}"
    frames = np.concatenate(list(LogReader(folder / "base.log")))
    if suffix == ".blf":  # containers so small that some lie before the cut
        with can.BLFWriter(path, max_container_size=2000) as logger:
            for frame in frames:
                logger(to_message(frame, channel=0))
    else:
        with open_writer(path) as writer:
            writer.write(frames)
    return path


@pytest.mark.evidence("Nothing is silent: cut log")
@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".csv"])
def test_a_log_cut_off_is_told_and_shown_up_to_there(replay, tmp_path, suffix):
    path = written(tmp_path, suffix)
    whole = path.read_bytes()
    assert replay(path, config="one.toml").code == 0
    size = len(whole) * 8 // 10
    for drop in range(5):  # wherever it is cut in a line or record
        if suffix != ".blf" and b"\n" in whole[size - drop - 1 : size - drop + 1]:
            continue  # between two lines: nothing can tell
        path.write_bytes(whole[: size - drop])
        ended = replay(path, "--json", config="one.toml")
        assert ended.code == 2, drop
        assert f"{path}" in ended.err
        assert "cut off" in ended.err
        assert ended.event("log")["state"] == "cut off"
        assert 250 < ended.event("summary")["frames"] < 400
        assert "U0101-87" in [e["dtc"] for e in ended.events if e["event"] == "dtc"]
    text = replay(path, config="one.toml")
    assert text.code == 2
    assert "DTC U0101-87 SET" in text.out
    assert "U0101-87" in text.out.splitlines()[-1]
    meant = replay(path, "--allow-cut", "--fail-on-dtc", config="one.toml")
    assert meant.code == 1
    assert "cut off" in meant.out


@pytest.mark.long
def test_a_cut_mf4_is_one_line(replay, tmp_path):
    path = written(tmp_path, ".mf4")
    whole = path.read_bytes()
    for size in (len(whole) - 1, len(whole) - 2000, len(whole) // 2, 100):
        path.write_bytes(whole[:size])
        ended = replay(path, "--json", config="one.toml")
        assert ended.code == 2
        assert ended.err.count("\n") == 1
        assert f"{path}: cut off after frame" in ended.err
        assert ended.event("log")["state"] == "cut off"


def test_a_blf_that_its_recorder_did_not_finish(replay, tmp_path):
    path = tmp_path / "a.blf"
    logger = can.BLFWriter(path, max_container_size=300)
    for k in range(50):
        logger(can.Message(timestamp=k / 10, arbitration_id=256, is_extended_id=False, channel=0, data=bytes(8)))
    logger.file.flush()
    ended = replay(path, config="one.toml")
    logger.stop()
    assert ended.code == 2
    assert "its recorder did not finish the file" in ended.err
    assert replay(path, config="one.toml").code == 0


def ends_of_containers(data):
    """Where the top objects of a BLF file end (16 bytes of header: mark, sizes, type)."""
    at, ends = 144, []
    while data[at : at + 4] == b"LOBJ":
        size = int.from_bytes(data[at + 8 : at + 12], "little")
        at += size + size % 4
        ends.append(at)
    return ends


def test_a_blf_cut_between_two_containers_is_shorter_than_it_says(replay, tmp_path):
    path = written(tmp_path, ".blf")
    whole = path.read_bytes()
    ends = ends_of_containers(whole)
    assert ends[-1] == len(whole)
    path.write_bytes(whole[: ends[-3]])
    ended = replay(path, config="one.toml")
    assert ended.code == 2
    assert f"{ends[-3]} bytes of {len(whole)}" in ended.err


def test_a_blf_cut_first_and_compressed_then(replay, tmp_path):
    """Its size says nothing; that its last container is short does."""
    path = written(tmp_path, ".blf")
    packed = tmp_path / "drive.blf.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()[:-10]))
    ended = replay(packed, config="one.toml")
    assert ended.code == 2
    assert "cut off after frame" in ended.err


def test_an_asc_that_its_recorder_did_not_finish(replay, tmp_path):
    path = written(tmp_path, ".asc")
    text = path.read_text()
    assert "End TriggerBlock" in text
    path.write_text(text[: text.index("End TriggerBlock")])
    ended = replay(path, "--json", config="one.toml")
    assert ended.code == 2
    assert "its trigger block has no end" in ended.err
    assert ended.event("summary")["frames"] == 400
    path.write_text(text.rstrip("\n"))
    assert replay(path, config="one.toml").code == 0


def test_a_damaged_line_is_no_cut(replay, tmp_path):
    text = lines("can0").replace("(0.100000) can0 100", "(0.100000) can0 1")
    (tmp_path / "a.log").write_text(text)
    ended = replay("a.log", "--allow-cut", "--json", config="one.toml")
    assert ended.code == 2
    assert "a.log:11: " in ended.err
    assert ended.event("log")["state"] == "damaged"
    assert ended.event("summary")["frames"] == 59, "the rest is read"


def test_a_last_line_without_an_end_may_be_whole(replay, tmp_path):
    """As a script writes it that joins lines; the frame is as long as the others of its identifier."""
    (tmp_path / "a.log").write_text(lines("can0").rstrip("\n"))
    ended = replay("a.log", "--json", config="one.toml")
    assert ended.code == 0
    assert ended.event("summary")["frames"] == 60
    (tmp_path / "b.log").write_text(lines("can0").rstrip("\n")[:-2])
    cut = replay("b.log", "--json", config="one.toml")
    assert cut.code == 2
    assert cut.event("summary")["frames"] == 59
    assert cut.event("log")["channels"]["can0"]["frames"] == 59


PACK = {
    ".gz": gzip.compress,
    ".bz2": bz2.compress,
    ".xz": lzma.compress,
    ".zst": lambda data: zstd().compress(data),
}


@pytest.mark.long
@pytest.mark.parametrize("packed", sorted(PACK))
@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".csv", ".mf4"])
def test_compressed_logs(replay, tmp_path, suffix, packed):
    path = written(tmp_path, suffix)
    plain = replay(path, "--json", config="one.toml")
    packed_path = path.with_name(path.name + packed)
    packed_path.write_bytes(PACK[packed](path.read_bytes()))
    ended = replay(packed_path, "--json", config="one.toml")
    assert ended.code == plain.code == 0
    assert [e for e in ended.events if e["event"] in ("dtc", "monitor")] == [
        e for e in plain.events if e["event"] in ("dtc", "monitor")
    ]
    assert ended.event("log")["frames"] == 400


@pytest.mark.parametrize("packed", sorted(PACK))
def test_a_compressed_log_cut_off(replay, tmp_path, packed):
    path = written(tmp_path, ".log")
    packed_path = path.with_name(path.name + packed)
    packed_path.write_bytes(PACK[packed](path.read_bytes())[:-9])
    ended = replay(packed_path, "--json", config="one.toml")
    assert ended.code == 2
    assert "cut off after frame" in ended.err
    assert ended.event("log")["state"] == "cut off"


def test_a_compressed_log_that_is_none(replay, tmp_path):
    (tmp_path / "a.log.gz").write_bytes(b"not at all")
    ended = replay("a.log.gz")
    assert ended.code == 2
    assert "damaged after frame 0" in ended.err


def test_a_ring_whose_newest_segment_is_unfinished(replay, tmp_path):
    """Being written still: told in the log, no error. One cut off in the middle of the ring is one."""
    ring = tmp_path / "ring"
    ring.mkdir()
    first, second, third = (lines("can0", count=20, begin=60.0 * k) for k in range(3))
    (ring / "frames-000001-20250101T000000Z.log").write_text(first)
    (ring / "frames-000002-20250101T000100Z.log").write_text(second[:-15])
    assert replay(ring, config="one.toml").code == 0
    (ring / "frames-000003-20250101T000200Z.log").write_text(third)
    ended = replay(ring, "--json", config="one.toml")
    assert ended.code == 2
    assert "frames-000002-20250101T000100Z.log:20" in ended.err
    assert ended.event("summary")["frames"] == 59


def power(memory):
    """Number of the power cycle that a memory has last, and whether it is open."""
    store = Store(memory, write=False)
    cycle = store.cycles()["power"]
    store.close()
    return cycle.number, cycle.open


def test_only_a_whole_log_completes_the_operation_cycle(replay, tmp_path):
    """With the memory of a file: what is damaged, cut off or ended by Ctrl-C goes on with the next log."""
    memory = tmp_path / "f.sqlite"
    whole, config = lines("can0"), "one.toml"
    logs = {
        "whole": whole,
        "damaged": whole.replace("(0.100000) can0 100", "(0.100000) can0 1"),
        "cut": whole[:-3],
    }
    for name, text in logs.items():
        (tmp_path / f"{name}.log").write_text(text)

    def run(name, *options):
        return replay(f"{name}.log", "--memory", str(memory), "--json", *options, config=config)

    assert run("whole").code == 0
    assert power(memory) == (1, False)
    assert run("damaged").code == 2
    assert power(memory) == (2, True)
    for _ in range(3):
        assert run("cut", "--allow-cut").code == 0
        assert power(memory) == (2, True)
    ended = run("whole")
    assert power(memory) == (2, False)
    assert ended.event("restart")["reason"] == "the process ended without a stop"
    assert run("whole").code == 0
    assert power(memory) == (3, False)


def test_ctrl_c_completes_no_operation_cycle(replay, tmp_path, monkeypatch):
    memory = tmp_path / "f.sqlite"
    (tmp_path / "a.log").write_text(lines("can0"))

    def interrupt(gateway, frames):
        raise KeyboardInterrupt

    monkeypatch.setattr(Gateway, "feed", interrupt)
    assert replay("a.log", "--memory", str(memory), config="one.toml").code == 130
    assert power(memory) == (1, True)


def test_a_cut_log_in_python_completes_no_operation_cycle_either(replay, tmp_path):
    memory = tmp_path / "f.sqlite"
    (tmp_path / "a.log").write_text(lines("can0")[:-3])
    opened = api.open("one.toml")
    opened.replay("a.log", memory=memory, allow_cut=True)
    assert power(memory) == (1, True)
    with pytest.raises(GatewayError, match="cut off"):
        opened.replay("a.log", memory=memory)
    assert power(memory) == (1, True)
