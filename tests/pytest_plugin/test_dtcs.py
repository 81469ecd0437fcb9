"""Expectations of DTCs over the events of a bench that are given."""

from types import SimpleNamespace

import pytest

from gateway.faults.status import Status
from gateway_bench.pytest_plugin.dtcs import Dtcs

SET, HEALED = int(Status.TEST_FAILED | Status.CONFIRMED_DTC), int(Status.CONFIRMED_DTC)


def dtcs(*events):
    told = [{"event": "dtc", "t_ns": round(t_s * 1e9), "dtc": dtc, "status": status} for t_s, dtc, status in events]
    catalogue = [SimpleNamespace(dtc=dtc) for dtc in ("P0001-01", "P0002-02")]
    return Dtcs(SimpleNamespace(events=told, gateway=SimpleNamespace(catalogue=catalogue)))


def test_only_what_was_set_counts_as_set():
    dtcs((1.0, "P0001-01", HEALED)).none()
    once = dtcs((1.0, "P0001-01", HEALED), (2.5, "P0001-01", SET), (3.0, "P0001-01", SET), (4.0, "P0002-02", HEALED))
    with pytest.raises(AssertionError, match=r"^P0001-01 set at 2\.500 s, not expected$"):
        once.none()
    once.none(but=("P0001-01",))
    assert once.failed == ["P0001-01"]
