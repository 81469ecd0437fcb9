"""Multiplex ranges of DBC files stay ranges: 32 bits load in no time, and decode as the file says."""

import random
import resource
import time

import numpy as np
import pytest

from gateway.bus.frames import empty, put
from gateway.signals.database import load_database
from gateway.signals.payloads import columns
from gateway.signals.ranges import Ranges, runs
from gateway.signals.tables import compile_plan

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\n'


def database(path, ranges, bits=32, more=""):
    """Write a message of a multiplexer and a signal each for some ranges, in words of eight bits behind it."""
    text = f'{HEAD}BO_ 256 M: 64 A\n SG_ Mux M : 0|{bits}@1+ (1,0) [0|0] "" A\n SG_ Always : 32|8@1+ (1,0) [0|0] "" A\n'
    for k, pairs in enumerate(ranges):
        text += f' SG_ S{k} m{pairs[0][0]} : {40 + 8 * k}|8@1+ (1,0) [0|0] "" A\n'
    for k, pairs in enumerate(ranges):
        text += f"SG_MUL_VAL_ 256 S{k} Mux {', '.join(f'{low}-{high}' for low, high in pairs)};\n"
    path.write_text(text + more)
    return load_database([path])


def decoded(found, value):
    plan = compile_plan([(0, found)])
    frames = empty(1)
    put(frames, 0, 0, 256, value.to_bytes(4, "little") + bytes(range(60)))
    values = columns(frames, plan, 0)
    names = {plan.position(*ref): ref.signal for ref in plan.slot_names}
    return {names[k] for k in np.flatnonzero(~np.isnan(values[0]))}


@pytest.mark.parametrize("bits", [8, 16, 24, 32])
def test_a_range_of_any_width_loads_at_once(tmp_path, bits):
    last = (1 << bits) - 1
    begun, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = database(tmp_path / "a.dbc", [[(0, last)], [(1, 1), (last // 2, last)]], bits)
    assert decoded(found, 0) == {"Mux", "Always", "S0"}
    assert decoded(found, 1) == decoded(found, last) == {"Mux", "Always", "S0", "S1"}
    assert decoded(found, last // 2 - 1) == {"Mux", "Always", "S0"}
    assert time.process_time() - begun < 60.0, "only catches what expands them"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


def test_random_ranges_select_what_the_file_says(tmp_path):
    seed = 12
    print("seed", seed)
    rng = random.Random(seed)
    for _ in range(20):
        ranges = []
        for _ in range(rng.randint(1, 6)):
            ends = sorted(rng.sample(range(1 << 32), 2 * rng.randint(1, 3)))
            ranges.append([(ends[k], ends[k + 1]) for k in range(0, len(ends), 2)])
        values = {end + d for pairs in ranges for low, high in pairs for end in (low, high) for d in (-1, 0, 1)}
        named = rng.choice(sorted(values))
        found = database(tmp_path / "a.dbc", ranges, more=f'VAL_ 256 Mux {named} "named" 7 "seven" ;\n')
        message = found.message("M")
        for value in sorted(value for value in values | {0, 7, (1 << 32) - 1} if 0 <= value < 1 << 32):
            right = {f"S{k}" for k, pairs in enumerate(ranges) if any(low <= value <= high for low, high in pairs)}
            assert decoded(found, value) == right | {"Mux", "Always"}, (value, ranges)
            if right or value in (7, named):
                data = value.to_bytes(4, "little") + bytes(60)
                assert set(message.decode(data, decode_choices=False)) == right | {"Mux", "Always"}


def test_ranges_are_a_sequence_of_numbers():
    ranges = Ranges([(20, 30), (5, 5), (6, 9), (25, 1 << 40)])
    assert runs(ranges) == [(5, 9), (20, 1 << 40)]
    assert (ranges[0], ranges[5], ranges[-1]) == (5, 20, 1 << 40)
    assert ranges[1:3] == [6, 7]
    assert 10 not in ranges
    assert 1 << 39 in ranges
    assert len(Ranges([(3, 5)])) == len(list(Ranges([(3, 5)]))) == 3
    with pytest.raises(IndexError):
        Ranges([(3, 5)])[3]
    assert runs([3, 1, 2, 7]) == [(1, 3), (7, 7)]
