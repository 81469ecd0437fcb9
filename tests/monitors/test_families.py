"""Monitors made from their parameters: the contract is checked of what is made; what the engine tells of arrivals."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import pytest

from gateway.config.model import MonitorConfig
from gateway.config.monitor_types import monitor_of
from gateway.monitors import contract, registry
from gateway.monitors.conformance import accepted, made
from gateway.monitors.contract import Family, Fault, Monitor, MonitorParams, Notes, Signal
from gateway_fdi.errors import InputError
from gateway_fdi.jit import Record, f8, f8s, i8s, kernel

DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 ONE: 8 A
 SG_ X : 0|16@1+ (1,0) [0|100] "V" A
BO_ 257 TWO: 8 A
 SG_ Y : 0|16@1+ (1,0) [0|100] "V" A
"""


class Params(MonitorParams):
    size: int = 2


class State(Record):
    seen: Annotated[i8s, 3]


class Const(Record):
    unused: f8


class Inputs(contract.Inputs):
    value: Annotated[f8s, 3]


@kernel
def step(s, c, u, out):
    for k in range(3):
        if u.value[k] == u.value[k]:
            s.seen[k] += 1


GOOD = Monitor(
    type="whole",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    step=step,
    connect=lambda _: {"value": [Signal("ONE.X", triggers=True), Signal("TWO.Y", triggers=True, optional=True), None]},
    prepare=lambda _p, _s, _c: None,
    faults=lambda _: (Fault("low", "P0562-16", "too low"),),
    capabilities=(Notes(lambda p: (f"{p.size} of them",)),),
)
FAMILY = Family(type="whole", api=2, params=Params, made=lambda _p, _folder: GOOD)


def test_a_family_is_accepted_and_what_it_makes_is_checked():
    assert accepted(FAMILY, "a:FAMILY") is FAMILY
    assert made(FAMILY, Params(), Path()) is GOOD
    assert GOOD.notes(Params(size=3)) == ("3 of them",)


@pytest.mark.parametrize(
    ("family", "words"),
    [
        (replace(FAMILY, api=1), "version 1 of the contract"),
        (replace(FAMILY, params=int), "MonitorParams"),
    ],
)
def test_slips_of_a_family(family, words):
    with pytest.raises(InputError, match=words):
        accepted(family, "a:FAMILY")


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (3, "no Monitor, but int"),
        (replace(GOOD, type="other"), "its type, api and params"),
        (replace(GOOD, step=kernel(lambda s, c: None)), r"step takes \(s, c, u, out\)"),
        (replace(GOOD, inputs=State), "derives from Inputs"),
    ],
)
def test_slips_of_what_it_makes(result, words):
    with pytest.raises(InputError, match=words) as caught:
        made(replace(FAMILY, made=lambda _p, _folder: result), Params(), Path())
    assert 'monitor type "whole"' in str(caught.value)


def test_what_nothing_can_be_made_of_names_the_key(monkeypatch):
    def refuse(_params, folder):
        raise InputError(f"not in {folder}", key="size", value=2)

    monkeypatch.setitem(registry.MONITORS._known, "a:FAMILY", replace(FAMILY, made=refuse))
    entry = MonitorConfig(name="m", type="a:FAMILY", size=2)
    entry.lie_in(Path("/there"))
    with pytest.raises(InputError, match=r"not in /there") as caught:
        monitor_of(entry, "monitor[3]")
    assert caught.value.key == "monitor[3].size"
