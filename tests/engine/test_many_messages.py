"""With many messages what comes next is fetched ahead; nothing else is another."""

from gateway.engine.build import build_engine
from gateway.engine.checks import message
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.loop import _MANY
from gateway.signals.database import load_database


def test_a_batch_of_many_messages_is_as_its_frames_one_by_one(tmp_path, tools):
    count = _MANY + 20
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: A"]
    for k in range(count):
        lines += [f"BO_ {256 + k} M{k}: 8 A", ' SG_ Value : 0|16@1+ (1,0) [0|65535] "V" A']
    path = tmp_path / "many.dbc"
    path.write_text("\n".join(lines) + "\n")
    database = load_database([path])
    checks = [CheckInstance(message.Params(message=f"M{k}", timeout_ms=200.0), 0, f"c{k}") for k in range(count)]
    whole, single = (build_engine([(0, database)], [], checks) for _ in range(2))
    rows = [(0.5 * k, 250 + k * 7 % (count + 12), bytes(8)) for k in range(6 * count)]  # some of them unknown
    frames = tools.batch(*rows)
    seen, seen_singly = tools.Collector(), tools.Collector()
    whole.process(frames, seen)
    for k in range(len(frames)):
        single.process(frames[k : k + 1], seen_singly)
    assert seen.events == seen_singly.events
    assert whole.counters() == single.counters()
    assert whole.counters()["unknown"] > 0 < whole.counters()["decoded"]
    assert whole.take_buckets().tolist() == single.take_buckets().tolist()
