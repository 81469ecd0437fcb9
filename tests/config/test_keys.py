"""Every key of a configuration has the type, the range and the default that it had, and tells the same mistakes."""

import tomllib
from pathlib import Path

from kept import kept, keys_of

import gateway_commands.configuration_schema
from gateway.config.load import config_of
from gateway_fdi.errors import InputError, InputErrors

HERE = Path(__file__).parent
BUS = '[[bus]]\nname = "b"\nuri = "virtual:b"\n'
SAID = "-> "


def test_every_key_is_that_of_before():
    lines = [*keys_of(gateway_commands.configuration_schema.schema())]
    assert lines == kept(HERE / "keys.txt", "\n".join(lines).encode()).decode().splitlines()


def said(tables):
    """Yield what is said of tables after a bus, one line each."""
    try:
        config_of(tomllib.loads(BUS + tables), None)
    except (InputError, InputErrors) as error:
        yield from (f"{SAID}{line}" for line in str(error).splitlines())


def test_every_mistake_is_told_as_before_and_its_right_neighbour_is_none():
    """Tables of mistakes.txt: each with what is said of it, in the order in which it is."""
    cases = [case.splitlines() for case in (HERE / "mistakes.txt").read_text().split("\n\n")]
    tables = [[line for line in case if not line.startswith(SAID)] for case in cases]
    told = [[*table, *said("\n".join(table))] for table in tables]
    kept(HERE / "mistakes.txt", ("\n\n".join("\n".join(case) for case in told)).encode())
    assert len(cases) > 90
    assert told == cases
