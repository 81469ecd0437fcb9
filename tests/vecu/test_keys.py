"""Every key of a scenario has the type, the range and the default that it had."""

from pathlib import Path

from kept import kept, keys_of

import gateway_bench.vecu.scenario_schema


def test_every_key_is_that_of_before():
    lines = [*keys_of(gateway_bench.vecu.scenario_schema.schema())]
    before = kept(Path(__file__).with_name("keys.txt"), "\n".join(lines).encode())
    assert lines == before.decode().splitlines()
