"""The contract of events: its documents are those of the code, and are what they say they are."""

import json
import zlib
from pathlib import Path

import jsonschema_rs
from road import Memory, car_of, event

from gateway.runtime.contract import EVENTS, schema, wrong
from gateway_fleet.live.asyncapi import document
from gateway_fleet.live.batch import batch_schema, packed, unpacked

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_documents_are_those_of_the_code():
    """gateway fleet contract [--asyncapi], with an indent of 1."""
    assert json.loads((DOCS / "events.schema.json").read_text()) == schema()
    assert json.loads((DOCS / "fleet.asyncapi.json").read_text()) == document()


def test_a_batch_of_a_car_is_what_the_document_says(tmp_path):
    memory = Memory(tmp_path / "faults.sqlite", car_of())
    memory.post(event(1), event(2, "statistics"))
    memory.commit()
    payload, _ = packed(car_of(), memory.store.outgoing(), memory.store.tally())
    memory.close()
    told = json.loads(zlib.decompress(payload))
    registry = jsonschema_rs.Registry([(schema()["$id"], schema())])
    validator = jsonschema_rs.validator_for({"$schema": schema()["$schema"], **batch_schema()}, registry=registry)
    validator.validate(told)
    told["events"][0]["event"]["status"] = "47"
    assert not validator.is_valid(told)


def test_a_batch_is_sent_the_shorter_way_and_read_again(tmp_path):
    memory, ways = Memory(tmp_path / "faults.sqlite", car_of()), []
    for count in (1, 150):
        memory.post(*(event(n, pad=n % 7) for n in range(count)))
        memory.commit()
        rows = memory.store.outgoing(0, 200)
        payload, _ = packed(car_of(), rows, memory.store.tally())
        assert [sent.body for sent in unpacked(payload).events] == [row.body for row in rows]
        ways.append(payload.startswith(b"BZh"))
    memory.close()
    assert ways == [False, True]


def test_the_quick_look_and_the_schema_say_the_same():
    """The collector looks without a library; a value of each type is put into each field."""
    validator = jsonschema_rs.validator_for(schema())
    values = [0, -1, 2**63, 10**400, 1.5, "x", True, None, [], ["x"], [1.5], [{}], {}, {"a": 1.5}, {"a": "x"}, [None]]
    right = {
        "int": 1,
        "text": "x",
        "bool": True,
        "number": 1.5,
        "number?": None,
        "texts": [],
        "numbers": [],
        "values": {},
    }
    right |= {"object": {}, "objects": [], "any": None}
    both = set()
    for name, kind in EVENTS.items():
        whole = {"event": name} | {field.rstrip("?"): right[of] for field, of in kind.fields.items()}
        assert validator.is_valid(whole)
        assert not wrong(whole)
        for field in kind.fields:
            for changed in (*({**whole, field.rstrip("?"): value} for value in values), dict(whole)):
                if changed == whole:
                    del changed[field.rstrip("?")]
                both.add(validator.is_valid(changed))
                assert validator.is_valid(changed) == (not wrong(changed)), (changed, wrong(changed))
    assert both == {True, False}
    for none in (None, [], {}, {"event": 1}, {"event": "nothing"}):
        assert wrong(none)
        assert not validator.is_valid(none)
