"""What a page gets that comes later: the peak of one sample, however it is looked at; and messages in any pieces."""

import base64
import json
import random

import numpy as np
import pytest

from gateway.bus.traffic import Seen
from gateway.engine.buckets import TickRow
from gateway_serve.buses import BusLoads
from gateway_serve.history import COARSE, FIELDS, FINE, PAST_BYTES, TICKS, History
from gateway_serve.hub import MANY_EVENTS, MOST_PASSING, MOST_WAITING, Viewer
from gateway_serve.messages import MessageNames
from gateway_serve.wire import Garbled, Splitter
from gateway_serve.words import sentences


def tick(fault, low, high, *, ratio=0.1):
    rows = np.zeros(1, TickRow.dtype)
    rows["fault"], rows["count"], rows["numbers"] = fault, 1, 1
    rows["low"], rows["high"], rows["ratio"], rows["limit"] = low, high, ratio, 10.0
    return rows


def ticks(faults, ratios):
    return np.concatenate([tick(fault, 0.0, 1.0, ratio=ratio) for fault, ratio in zip(faults, ratios, strict=True)])


def columns(text):
    """Columns as the page unpacks them."""
    found = np.frombuffer(base64.b64decode(text), "<f8").reshape(len(FIELDS), -1)
    return dict(zip(FIELDS, found.tolist(), strict=True))


def of(history, fault):
    return {kind: columns(text) for kind, text in history.of(fault).items()}


def test_a_peak_is_in_one_column_of_each_kind_and_what_is_kept_is_bounded():
    history = History(2)
    count = TICKS * (COARSE + 50)
    for k in range(count):
        history.add(50.0 * k, tick(1, 0.0, 7.5 if k == count - 25 else 1.0))
    found = of(history, 1)
    for kind in ("fine", "coarse"):
        highs = found[kind]["high"]
        assert highs.count(7.5) == 1
        assert set(highs) == {1.0, 7.5}
        assert set(found[kind]["threshold"]) == {10.0}
        assert np.all(np.diff(found[kind]["t"]) == (50.0 if kind == "fine" else 500.0)), "in order, none missing"
    assert found["fine"]["t"][-1] == found["coarse"]["t"][-1] == 50.0 * (count - 1)
    assert len(found["fine"]["t"]) == FINE
    assert len(found["coarse"]["t"]) == COARSE
    assert of(history, 0)["fine"]["t"] == []
    assert of(history, 99)["fine"]["t"] == []
    history.add(0.0, tick(7, 0.0, 1.0))  # of a catalogue that is another by now


def test_many_faults_take_no_more_bytes_but_keep_less_time():
    most = 100_000
    history = History(500, most)
    rows = ticks(range(500), [0.1] * 500)
    for k in range(100):
        history.add(50.0 * k, rows)
    found = of(history, 499)["fine"]["t"]
    assert found == [50.0 * k for k in range(100 - len(found), 100)], "the latest"
    assert 3 <= len(found) <= most / 500 / 40
    one = History(3, most)
    one.add(0.0, tick(2, 0.0, 1.0))
    assert len(of(one, 2)["fine"]["t"]) == 1
    assert [json.loads(text) for text in History(0).past()] == [{"faults": {}, "end": True}]


def test_a_page_that_comes_late_is_told_the_past_nearest_first_and_no_column_twice():
    history = History(300)
    seed = random.randrange(10**6)
    print(f"seed {seed}")
    ratios = np.random.default_rng(seed).uniform(0.0, 1.5, 250)
    rows = ticks(range(250), ratios)
    for k in range(1300):
        history.add(50.0 * k, rows)
    past = history.past()
    history.add(50.0 * 1300, rows)  # comes by itself
    pieces = [json.loads(text) for text in past]
    assert [piece["end"] for piece in pieces] == [False] * (len(pieces) - 1) + [True]
    told = [int(fault) for piece in pieces for fault in piece["faults"]]
    assert told == np.argsort(-ratios, kind="stable")[: len(told)].tolist()
    size = sum(len(json.dumps(piece)) for piece in pieces)
    assert 0.9 * PAST_BYTES < size < 1.1 * PAST_BYTES, "more is there than is told"
    for piece in pieces:
        for fault, found in piece["faults"].items():
            assert columns(found["fine"])["t"][-1] == 50.0 * 1299
            assert columns(found["fine"])["ratio"][0] == ratios[int(fault)]
    (only,) = History(5).past()
    assert json.loads(only) == {"faults": {}, "end": True}


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
        viewer.put("memory", str(k))
        if k % 10 == 0:
            viewer.put("event", str(k))
    taken = viewer.take()
    kinds = [kind for kind, _ in taken]
    assert kinds.count("event") == 50
    assert kinds.count("tick") < 50
    assert [text for kind, text in taken if kind == "memory"] == ["499"], "what holds now is told once"
    for k in range(MOST_WAITING + 1):
        viewer.put("event", str(k))
    assert viewer.ended


def test_events_go_with_the_next_tick_and_many_of_them_at_once():
    viewer = Viewer()
    viewer.put("event", "one")
    assert not viewer.news.is_set()
    viewer.put("tick", "tick")
    assert viewer.news.is_set()
    assert len(viewer.take()) == 2
    for k in range(MANY_EVENTS):
        assert not viewer.news.is_set()
        viewer.put("event", str(k))
    assert viewer.news.is_set()


def test_a_page_gets_the_state_then_a_piece_of_the_past_at_a_time_then_what_comes():
    viewer = Viewer()
    viewer.put("memory", "old")
    for k in range(MOST_PASSING + 2):
        viewer.put("tick", str(k))
    viewer.begin("state", "tests", iter(["one", "two"]))
    assert viewer.take()[-3:] == [("state", "state"), ("tests", "tests"), ("history", "one")], (
        "a state is never given up"
    )
    assert viewer.news.is_set()
    viewer.put("tick", "next")
    assert viewer.take() == [("tick", "next"), ("history", "two")]
    assert viewer.take() == []
    assert not viewer.news.is_set()


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
    said = sentences(entry)
    assert said[0] == "It is there now; it came twice and is confirmed."
    assert said[1] == "Value: 1.5, limit 1 (1.5 times the limit)."
    assert said[2] == "Measured with it: tooth: 20."
    assert said[3].startswith("What to do: look; have it checked at the next halt")
    low = sentences({**entry, "evidence": {"value": 2.0, "threshold": 8.0}, "status": 0x08, "occurrence": 1})
    assert low[0] == "It is not there at present; it came once and is confirmed."
