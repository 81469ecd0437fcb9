"""Faults of the wire begin with the frame at their first moment, and end before the frame at their last."""

import numpy as np

from gateway.bus.frames import empty
from gateway_bench.vecu.scenario import WireFault
from gateway_bench.vecu.wire_faults import Wire


def test_a_fault_has_its_first_moment_and_not_its_last():
    frames = empty(5)
    frames["t_ns"] = np.arange(5) * 10**9
    frames["can_id"], frames["length"] = 0x100, 8
    wire = Wire([WireFault(kind="lost", from_s=1.0, to_s=3.0)], np.random.default_rng(1), {}, {"can": 0})
    left = wire.apply(frames, 5 * 10**9)
    assert (left["t_ns"] // 10**9).tolist() == [0, 3, 4]
    (truth,) = wire.truth
    assert (truth.t_ns, truth.count) == (10**9, 2)
