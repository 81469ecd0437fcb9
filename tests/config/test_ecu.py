"""What is read of an ECU: its request, how often, and what is said of it."""

import pytest

from gateway.config.ecu import AUTO, OBD, ON_UDS, UDS, EcuParams, ReadParams

MOVING = [{"signal": "M.Speed", "min": 1}, {"signal": "M.Gear", "min": 2}]


@pytest.mark.parametrize(
    ("params", "name", "request_hex", "told", "apart_ms", "is_obd"),
    [
        ({"did": 0xF190, "on": "start"}, "22F190", "22f190", "on start", None, False),
        ({"did": 0x1, "every_ms": 10}, "220001", "220001", "every 10 ms", 10.0, False),
        ({"pid": 0x0C, "on": "dtc"}, "010C", "010c", "on dtc", 1000.0, True),
        ({"pid": 0xFF, "on": "dtc", "every_ms": 50}, "01FF", "01ff", "on dtc", 50.0, True),
        (
            {"service": 0x21, "identifier": 0x5, "on": "when", "when": MOVING},
            "2105", "2105", "on when while M.Speed and M.Gear are met", 1000.0, False,
        ),
        (
            {"service": 0x06, "identifier": 0x1, "every_ms": 2.5e3, "when": MOVING[:1]},
            "0601", "0601", "every 2500 ms while M.Speed are met", 2500.0, True,
        ),
        ({"service": 0x09, "identifier": 0x2, "on": "start"}, "0902", "0902", "on start", None, True),
        ({"pgn": 65260, "on": "start"}, "PGN 65260", "eaecfe00", "on start", None, False),
    ],
)  # fmt: skip
def test_a_request_and_how_often_it_is_sent(params, name, request_hex, told, apart_ms, is_obd):
    read = ReadParams(**params)
    assert (read.name, read.request.hex(), read.rate) == (name, request_hex, told)
    assert (read.apart_ms, read.is_obd) == (apart_ms, is_obd)


@pytest.mark.parametrize(
    ("more", "asks", "dtc_protocol", "finds"),
    [
        ({}, False, UDS, False),
        ({"protocol": OBD}, False, AUTO, False),
        ({"dtcs": {"every_s": 1}}, True, UDS, False),
        ({"dtcs": {"every_s": 1, "protocol": ON_UDS}}, True, ON_UDS, False),
        ({"dtcs": {"every_s": 1, "protocol": AUTO}}, True, AUTO, True),
        ({"dtcs": {"every_s": 1}, "protocol": OBD}, True, AUTO, False),
        ({"read": [{"pid": 1, "on": "start"}]}, True, AUTO, True),
        ({"read": [{"pid": 1, "on": "start"}], "protocol": ON_UDS}, True, AUTO, False),
        ({"read": [{"did": 1, "on": "start"}]}, True, UDS, False),
        ({"read": [{"did": 1, "on": "start"}], "dtcs": {"every_s": 1}}, True, UDS, False),
    ],
)
def test_what_it_is_asked_by(more, asks, dtc_protocol, finds):
    ecu = EcuParams(name="e", address=1, **more)
    assert (ecu.asks, ecu.dtc_protocol, ecu.finds_protocol) == (asks, dtc_protocol, finds)
