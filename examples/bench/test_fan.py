"""Tests of one's own: python -m pytest, or on a bus: python -m pytest --gateway-bus socketcan:vcan0."""

import pytest

ENGINE = {"counter": {"signal": "COUNTER"}, "crc": {"signal": "Crc", "data_id": 0x100}}


@pytest.fixture
def car(virtual_ecu):
    """Return a function that switches the car on."""

    def switch_on(faults=()):
        virtual_ecu(
            "restbus",
            name="engine",
            nodes=["ENGINE"],
            message=[{"name": "Engine", **ENGINE}],
            signals={"Engine.Load": 60},
            duration_s=30,
        )
        virtual_ecu(
            "fan:Controller",
            name="control",
            step_ms=10,
            inputs={"coolant": "Fan.Coolant"},
            start={"coolant": 85},
            outputs={"Command.Duty": "duty"},
            duration_s=30,
        )
        virtual_ecu(
            "fan:Fan",
            name="fan",
            step_ms=10,
            inputs={"duty": "Command.Duty", "load": "Engine.Load"},
            outputs={"Fan.Speed": "speed", "Fan.Coolant": "coolant"},
            faults=faults,
            duration_s=30,
        )

    return switch_on


@pytest.mark.requirement("FAN-5")
def test_a_sensor_without_a_value_is_named(car, dtcs, uds):
    car([{"kind": "sna", "signal": "Fan.Coolant", "from_s": 1.0, "to_s": 2.5}])
    dtcs.expect("P0115-86", after=1.0, by=2.5, healed_by=5.0)
    dtcs.none(but=("P0115-86",))
    assert [dtc.id for dtc in uds.get_dtc_by_status_mask(0x2C).service_data.dtcs] == [0x011586]


@pytest.mark.requirement("FAN-6")
def test_more_load_is_more_air(car, dtcs, gateway_bench, can_log):
    car()
    gateway_bench.run(1.0)
    gateway_bench.set("Engine.Load", 100)
    gateway_bench.run(1.5)
    gateway_bench.set("Engine.Load", 0)
    gateway_bench.run(0.5)
    gateway_bench.release("Engine.Load")
    dtcs.none(until=4.0)
    loads = [values["Load"] for _, values in can_log.of("Engine")]
    assert set(loads) == {0, 60, 100}
    assert max(values["Duty"] for _, values in can_log.of("Command")) > 30
