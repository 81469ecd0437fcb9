"""ISO-TP (ISO 15765-2:2016): the server's frames, one by one; a tester that answers slowly, wrongly or not at all."""

from __future__ import annotations

from itertools import pairwise

import pytest

from gateway_conformance.target import MS, PATIENCE_NS, TESTER_PRESENT, CanTarget, fails, shown
from gateway_conformance.wires import Heard

#: Requests whose answers may need several frames, as a single frame each.
LONG = ("03 22 F1 90", "02 09 02", "02 19 0A", "03 19 02 FF", "03 22 F1 87", "03 22 F1 8C", "07 22 F1 86 F1 86 F1 86")
#: N_Bs and N_Cr end within 1 s (9.8.2).
TIMEOUT_NS = 1000 * MS
GO_ON, WAIT, OVERFLOW = "30 00 00", "31 00 00", "32 00 00"


@pytest.fixture(scope="module")
def long(target: CanTarget) -> str:
    """Return a request whose answer has at least two consecutive frames."""
    for request in LONG:
        first = _begin(target, request)
        _settle(target)
        if first and first[0] >> 4 == 1 and first[1] > 6 + 7:
            return request
    pytest.skip("no answer of three frames was found (tried 22 F190, 09 02, 19 0A, ...)")


def _begin(target: CanTarget, request: str) -> bytes:
    """Send a request in a single frame; returns the first frame of its answer."""
    target.frames(0)
    target.send(bytes.fromhex(request).ljust(8, b"\xcc"))
    return next((one.data for one in target.frames(PATIENCE_NS, bool)), b"")


def _settle(target: CanTarget) -> list[Heard]:
    """Take the rest of an answer."""
    target.send(GO_ON)
    return target.frames(200 * MS)


def _consecutive(found: list[Heard], after: int = 0) -> None:
    """Expect consecutive frames whose numbers count on."""
    for k, one in enumerate(found, start=after + 1):
        if one.data[:1] != bytes([0x20 | k & 0xF]):
            fails(f"consecutive frame {k}", f"first byte {0x20 | k & 0xF:02X}", shown(one.data))


def _serves(target: CanTarget) -> None:
    target.ask(TESTER_PRESENT).exactly("7E 00")


def test_single_frame(target: CanTarget) -> None:
    """ISO 15765-2, 9.6.2: a short answer is one frame; its length is that of the message, padding is not counted."""
    first = _begin(target, "02 3E 00")
    if first[:3] != b"\x02\x7e\x00":
        fails("asked 3E 00 in a single frame", "02 7E 00 and padding", shown(first) or "nothing")


@pytest.mark.parametrize("frame", ["02 3E 00", "02 3E 00 00 00 00 00 00", "02 3E 00 FF FF FF FF FF", "02 3E 00 55 AA"])
def test_padding_of_requests(target: CanTarget, frame: str) -> None:
    """ISO 15765-2, 10.4.2: bytes after the message mean nothing, whether they are there and whatever they are."""
    target.send(frame)
    came = target.frames(PATIENCE_NS, bool)
    if not came or came[0].data[:3] != b"\x02\x7e\x00":
        fails(f"asked in the frame {frame}", "02 7E 00", shown(came[0].data) if came else "nothing")


def test_padding_of_answers(target: CanTarget, long: str) -> None:
    """ISO 15765-2, 10.4.2: all frames of an answer are padded to eight bytes, or only its last one is shorter."""
    first = _begin(target, long)
    found = [first, *(one.data for one in _settle(target))]
    if any(len(data) != 8 for data in found[:-1]) or not 2 <= len(found[-1]) <= 8:
        fails(f"asked {long}", "frames of 8 bytes, but for the last", ", ".join(map(shown, found)))


@pytest.mark.parametrize(
    "frame", ["00 3E 00", "08 3E 00 00 00 00 00 00", "0F 3E 00 00 00 00 00 00", "05 3E 00", "40 3E 00", ""]
)
def test_frames_that_are_none(target: CanTarget, frame: str) -> None:
    """ISO 15765-2, 9.6.2: single frames of impossible lengths and reserved kinds are ignored."""
    target.send(frame)
    came = target.frames(100 * MS + target.slack_ns)
    if came:
        fails(f"sent the frame {frame or 'without bytes'}", "no answer", shown(came[0].data))
    _serves(target)


def test_first_and_consecutive_frames(target: CanTarget, long: str) -> None:
    """ISO 15765-2, 9.6.3, 9.6.4: 1h and the length, then numbers from 1 on; as many bytes as were said."""
    first = _begin(target, long)
    came = _settle(target)
    _consecutive(came)
    length = (first[0] & 0xF) << 8 | first[1]
    packets = -(-(length - 6) // 7)
    if len(came) != packets:
        fails(f"asked {long}, {length} bytes said", f"{packets} consecutive frames", str(len(came)))


def test_nothing_before_flow_control(target: CanTarget, long: str) -> None:
    """ISO 15765-2, 9.6.5: after the first frame the server waits for flow control."""
    _begin(target, long)
    came = target.frames(100 * MS + target.slack_ns)
    _settle(target)
    if came:
        fails(f"asked {long}, no flow control sent", "nothing after the first frame", shown(came[0].data))


def test_block_size(target: CanTarget, long: str) -> None:
    """ISO 15765-2, 9.6.5.3: after BS frames the server waits for the next flow control."""
    _begin(target, long)
    target.send("30 01 00")
    came = target.frames(100 * MS + target.slack_ns)
    rest = _settle(target)
    if len(came) != 1:
        fails(f"asked {long}, flow control 30 01 00", "one consecutive frame", f"{len(came)}")
    _consecutive(came + rest)


@pytest.mark.parametrize(("code", "least_ms"), [("64", 100), ("F9", 0.9), ("80", 127)])
def test_separation_time(target: CanTarget, long: str, code: str, least_ms: float) -> None:
    """ISO 15765-2, 9.6.5.4, 9.6.5.5: frames are STmin apart; reserved values stand for 127 ms."""
    _begin(target, long)
    target.send(f"30 00 {code}")
    came = target.frames(1000 * MS, lambda found: len(found) >= 2)
    target.frames(1000 * MS)
    _consecutive(came)
    gaps = [(b.t_ns - a.t_ns) / MS for a, b in pairwise(came)]
    if not gaps or gaps[0] < least_ms - target.slack_ns / MS:
        fails(f"asked {long}, flow control 30 00 {code}", f"two frames {least_ms} ms apart", f"gaps {gaps} ms")


def test_wait(target: CanTarget, long: str) -> None:
    """ISO 15765-2, 9.6.5.1: flow status 1 (wait) has the server wait on, and starts N_Bs again."""
    _begin(target, long)
    came = []
    for _ in range(3):
        target.send(WAIT)
        came += target.frames(600 * MS)
    rest = _settle(target)
    if came:
        fails(f"asked {long}, flow control {WAIT}", "nothing while it waits", shown(came[0].data))
    if not rest:
        fails(f"asked {long}, {WAIT} three times in 1.8 s, then {GO_ON}", "the rest of the answer", "nothing")
    _consecutive(rest)


def test_overflow(target: CanTarget, long: str) -> None:
    """ISO 15765-2, 9.6.5.1: flow status 2 (overflow) ends the answer."""
    _begin(target, long)
    target.send(OVERFLOW)
    came = target.frames(50 * MS) + _settle(target)
    if came:
        fails(f"asked {long}, flow control {OVERFLOW}", "no frame any more", shown(came[0].data))
    _serves(target)


def test_reserved_flow_status(target: CanTarget, long: str) -> None:
    """ISO 15765-2, 9.6.5.2: a flow status that is none ends the answer."""
    _begin(target, long)
    target.send("35 00 00")
    came = target.frames(50 * MS) + _settle(target)
    if came:
        fails(f"asked {long}, flow control 35 00 00", "no frame any more", shown(came[0].data))
    _serves(target)


def test_no_flow_control_comes(target: CanTarget, long: str) -> None:
    """ISO 15765-2, 9.8.2: N_Bs ends the answer after 1 s; the server serves again."""
    _begin(target, long)
    target.frames(TIMEOUT_NS + 100 * MS + target.slack_ns)
    came = _settle(target)
    if came:
        fails(f"asked {long}, flow control after 1.1 s", "no frame any more", shown(came[0].data))
    _serves(target)


def _long_request(target: CanTarget) -> None:
    """Begin a request of eleven bytes (22 with five identifiers), and expect flow control."""
    target.frames(0)
    target.send("10 0B 22 F1 90 F1 90 F1")
    came = target.frames(PATIENCE_NS, bool)
    if not came or came[0].data[:1] != b"\x30" or len(came[0].data) < 3:
        fails("sent a first frame of 11 bytes", "flow control 30 BS STmin", shown(came[0].data) if came else "nothing")


def _answered(target: CanTarget, frames: tuple[str, ...], ns: int = 100 * MS) -> list[bytes]:
    for frame in frames:
        target.send(frame)
    came = target.frames(ns + target.slack_ns, lambda found: any(one.data[0] >> 4 < 2 for one in found))
    _settle(target)
    return [one.data for one in came if one.data[0] >> 4 < 2]


def test_a_long_request(target: CanTarget) -> None:
    """ISO 15765-2, 9.6.3, 9.6.5: a first frame gets flow control, and the whole request an answer."""
    _long_request(target)
    if not _answered(target, ("21 90 F1 90 F1 90",), PATIENCE_NS):
        fails("sent 22 with five identifiers in two frames", "an answer, be it negative", "nothing")


def test_a_wrong_sequence_number(target: CanTarget) -> None:
    """ISO 15765-2, 9.6.4: a wrong sequence number ends the reception; the request is not answered."""
    _long_request(target)
    came = _answered(target, ("22 90 F1 90 F1 90",))
    if came:
        fails("sent 22 with five identifiers, sequence number 2 for 1", "no answer", shown(came[0]))
    _serves(target)


def test_no_consecutive_frame_comes(target: CanTarget) -> None:
    """ISO 15765-2, 9.8.2: N_Cr ends the reception after 1 s; what comes later is ignored."""
    _long_request(target)
    target.frames(TIMEOUT_NS + 100 * MS + target.slack_ns)
    came = _answered(target, ("21 90 F1 90 F1 90",))
    if came:
        fails("sent the consecutive frame after 1.1 s", "no answer", shown(came[0]))
    _serves(target)


def test_a_single_frame_ends_a_reception(target: CanTarget) -> None:
    """ISO 15765-2, 9.8.3: a single frame amid a reception ends it, and is served."""
    _long_request(target)
    came = _answered(target, ("02 3E 00",))
    if [data[:3] for data in came] != [b"\x02\x7e\x00"]:
        fails("sent 3E 00 amid a longer request", "02 7E 00", ", ".join(map(shown, came)) or "nothing")
    if came := _answered(target, ("21 90 F1 90 F1 90",)):
        fails("sent the rest of the longer request", "no answer", shown(came[0]))


def test_a_first_frame_ends_a_reception(target: CanTarget) -> None:
    """ISO 15765-2, 9.8.3: a first frame amid a reception begins another one."""
    _long_request(target)
    test_a_long_request(target)


@pytest.mark.parametrize(
    "frame", ["21 00 00 00 00 00 00 00", "30 00 00", "31 00 00", "32 00 00", "10 07 22 F1 90 F1 90 F1", "10 0B 22"]
)
def test_unexpected_frames(target: CanTarget, frame: str) -> None:
    """ISO 15765-2, 9.8.3, 9.6.3: frames that belong to no message, and first frames that are none, are ignored."""
    target.send(frame)
    came = target.frames(100 * MS + target.slack_ns)
    if came:
        fails(f"sent the frame {frame} by itself", "no answer", shown(came[0].data))
    _serves(target)


def test_a_request_too_long(target: CanTarget) -> None:
    """ISO 15765-2, 9.6.5.1: a first frame of 4095 bytes gets flow control, or overflow (2); never silence."""
    target.send("1F FF 22 F1 90 F1 90 F1")
    came = target.frames(PATIENCE_NS, bool)
    if not came or came[0].data[0] not in (0x30, 0x31, 0x32):
        fails(
            "sent a first frame of 4095 bytes", "flow control 30, 31 or 32", shown(came[0].data) if came else "nothing"
        )
    _serves(target)


def test_functional_requests_are_single_frames(target: CanTarget) -> None:
    """ISO 15765-2, 9.6: functional requests are single frames: a first frame to all gets no flow control."""
    target.needs_functional()
    target.send("10 0B 22 F1 90 F1 90 F1", functional=True)
    came = target.frames(100 * MS + target.slack_ns)
    if came:
        fails("sent a first frame to the functional address", "nothing", shown(came[0].data))
    _serves(target)
