"""What a page gets that comes later: the peak of one sample, however it is looked at; and messages in any pieces."""

import json
import random

import numpy as np
import pytest

from gateway.bus.traffic import Seen
from gateway.engine.buckets import TickRow
from gateway.serve.buses import BusLoads
from gateway.serve.history import COARSE, FINE, TICKS, History
from gateway.serve.hub import MOST_WAITING, Viewer
from gateway.serve.messages import MessageNames
from gateway.serve.wire import Garbled, Splitter
from gateway.serve.words import told_in_words


def tick(fault, low, high, *, ratio=0.1):
    rows = np.zeros(1, TickRow.dtype)
    rows["fault"], rows["count"], rows["numbers"] = fault, 1, 1
    rows["low"], rows["high"], rows["ratio"], rows["limit"] = low, high, ratio, 10.0
    return rows


def test_a_peak_is_in_one_column_of_each_kind_and_what_is_kept_is_bounded():
    history = History(2)
    count = TICKS * (COARSE + 50)
    for k in range(count):
        history.add(50.0 * k, tick(1, 0.0, 7.5 if k == count - 25 else 1.0))
    found = history.of(1)
    for kind in ("fine", "coarse"):
        highs = found[kind]["high"]
        assert highs.count(7.5) == 1
        assert set(highs) == {1.0, 7.5}
    assert len(found["fine"]["t"]) == FINE
    assert len(found["coarse"]["t"]) == COARSE
    assert history.of(0)["fine"]["t"] == []
    assert history.of(99)["fine"]["t"] == []
    history.add(0.0, tick(7, 0.0, 1.0))  # of a catalogue that is another by now


def test_messages_come_whole_in_whatever_pieces():
    seed = random.randrange(10**6)
    print(f"seed {seed}")
    draw = random.Random(seed)
    sent, stream = [], b""
    for k in range(200):
        block = bytes(draw.randrange(256) for _ in range(draw.choice((0, 1, 10, 300))))
        message = {"kind": "x", "k": k, **({"size": len(block)} if block else {})}
        sent.append((message, block))
        stream += json.dumps(message).encode() + b"\n" + block
    splitter, got = Splitter(), []
    while stream:
        cut = draw.randrange(1, 400)
        got += list(splitter.feed(stream[:cut]))
        stream = stream[cut:]
    assert got == sent


@pytest.mark.parametrize(
    "wrong", [b"nonsense\n", b"[1]\n", b'{"size": -1}\n', b'{"size": 99999999999}\n', b'{"size": "a"}\n']
)
def test_what_no_gateway_says_is_refused(wrong):
    with pytest.raises(Garbled):
        list(Splitter().feed(wrong))


def test_a_page_that_does_not_read_loses_ticks_and_then_comes_again():
    viewer = Viewer()
    for k in range(500):
        viewer.put("tick", str(k))
        if k % 10 == 0:
            viewer.put("event", str(k))
    kinds = [kind for kind, _ in viewer.take()]
    assert kinds.count("event") == 50
    assert kinds.count("tick") < 50
    for k in range(MOST_WAITING + 1):
        viewer.put("event", str(k))
    assert viewer.ended


def test_load_is_of_the_time_between_two_looks():
    loads = BusLoads([{"name": "a", "bitrate": 500_000, "data_bitrate": None, "filtered": False}])

    def shown(t_s, bits, frames):
        traffic = {"frames": frames, "errors": 0, "nominal_bits": bits, "data_bits": 0, "others": 0}
        return loads.shown({"t_ns": int(t_s * 1e9), "buses": [{"bus": "a", "errors": {}, "traffic": traffic}]})[0]

    assert shown(1.0, 1000, 10)["load"] is None
    now = shown(1.5, 126_000, 1010)
    assert now["load"] == pytest.approx(0.5)
    assert now["frames_per_s"] == pytest.approx(2000)


def test_messages_have_names_periods_and_signals(tmp_path):
    (tmp_path / "a.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 One: 2 A\n SG_ Level : 0|16@1- (0.5,0) [-100|100] "V" A\n'
    )
    names = MessageNames(
        [
            {
                "name": "a",
                "database": [
                    str(tmp_path / "a.dbc"),
                ],
            },
            {"name": "b", "database": ["/none.dbc"]},
        ]
    )
    assert len(names.wrong) == 1
    rows = np.zeros(2, Seen.dtype)
    rows["used"], rows["can_id"], rows["length"] = 1, (0x100, 0x1FF), (2, 3)
    rows["gaps"], rows["sum_ns"], rows["count"] = (4, 0), (40_000_000, 0), (5, 1)
    rows["words"][0][0], rows["words"][1][0] = 5, 0x030201
    one, other = names.shown(rows.tobytes(), 10**9)
    assert (one["name"], one["period_ms"], one["signals"]) == ("One", 10.0, [["Level", 2.5, "V"]])
    assert (other["name"], other["period_ms"], other["data"]) == (None, None, "01 02 03")


def test_evidence_in_words():
    entry = {
        "status": 0x2F, "occurrence": 2, "evidence": {"value": 1.5, "threshold": 1.0, "tooth": 20.0, "odd": None},
        "remedy": "look", "severity": "next_halt",
    }  # fmt: skip
    said = told_in_words(entry)
    assert said[0] == "It is there now; it came twice and is confirmed."
    assert said[1] == "The test found 1.5; its limit is 1 (1.5 of what is allowed)."
    assert said[2] == "Known of it: tooth 20."
    assert said[3].startswith("What to do: look; have it checked at the next halt")
    low = told_in_words({**entry, "evidence": {"value": 2.0, "threshold": 8.0}, "status": 0x08, "occurrence": 1})
    assert low[0] == "It is not there at present; it came once and is confirmed."
