"""UDS (ISO 14229-1:2020, ISO 14229-2): sessions, suppressed answers, lengths, functional requests, identifiers."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from gateway_conformance.target import MS, P2_MS, PATIENCE_NS, TESTER_PRESENT, Target, shown

#: A service that the standard reserves, an identifier that it reserves (Annex C.1).
NO_SERVICE, NO_DID = "8A", "00 01"
#: A session ends after this time without a request (ISO 14229-2).
S3_NS = 5000 * MS
#: Identifiers of the standard that servers have (Annex C.1).
DIDS = ("F1 90", "F1 86", "F1 87", "F1 8A", "F1 8C", "F1 91", "F1 95", "F1 93", "F1 97", "F1 80")


@pytest.fixture(scope="module")
def known(target: Target) -> dict[str, bytes]:
    """Return some identifiers with their data."""
    found = {}
    for did in DIDS:
        answer = target.ask(f"22 {did}")
        if answer.came and answer.came[0].startswith(b"\x62" + bytes.fromhex(did)):
            found[did] = answer.came[0][3:]
    if not found:
        pytest.skip("22 is not supported, or has none of F180 to F197")
    return found


def test_tester_present(target: Target) -> None:
    """ISO 14229-1, 10.7: 3E 00 is answered by 7E 00, and nothing more."""
    target.ask(TESTER_PRESENT).exactly("7E 00")


def test_suppressed(target: Target) -> None:
    """ISO 14229-1, 8.2.2: with bit 7 of the sub-function there is no positive answer."""
    target.silent("3E 80")


@pytest.mark.parametrize("request_", ["3E 81", "10 FF"])
def test_refusals_are_not_suppressed(target: Target, request_: str) -> None:
    """ISO 14229-1, 8.2.2, 8.7: bit 7 suppresses positive answers only."""
    target.ask(request_).refused(0x12)


@pytest.mark.parametrize("request_", ["3E 01", "3E 7F", "10 7F", "10 00", "19 00", "19 7F"])
def test_unknown_sub_functions(target: Target, request_: str) -> None:
    """ISO 14229-1, 8.7, Annex A.1: a sub-function that is none is refused with 12."""
    answer = target.ask(request_)
    if answer.refusal in (0x11, 0x7F) and not request_.startswith("3E"):
        pytest.skip(f"{request_[:2]} is not supported")
    answer.refused(0x12)


@pytest.mark.parametrize(
    "request_", ["3E", "3E 00 00", "10", "10 01 00", "19", "19 02", "19 02 FF 00", "22", "22 F1", "22 F1 90 F1"]
)
def test_wrong_lengths(target: Target, request_: str) -> None:
    """ISO 14229-1, 8.7, Annex A.1: a request of a wrong length is refused with 13."""
    answer = target.ask(request_)
    if answer.refusal in (0x11, 0x7F) or (answer.refusal in (0x12, 0x7E) and request_.startswith("19 02")):
        pytest.skip(f"{request_[:5]} is not supported")
    answer.refused(0x13)


def test_an_unknown_service(target: Target) -> None:
    """ISO 14229-1, 8.7, Annex A.1: a service that is none is refused with 11."""
    target.ask(f"{NO_SERVICE} 00").refused(0x11)


@pytest.mark.parametrize("request_", [f"{NO_SERVICE} 00", "3E 01", f"22 {NO_DID}", "3E 80", "10 7F"])
def test_functional_silence(target: Target, request_: str) -> None:
    """ISO 14229-1, 8.7: asked together with all others, a server keeps 11, 12, 31, 7E and 7F to itself."""
    target.needs_functional()
    target.silent(request_, functional=True)


def test_functional_answers(target: Target) -> None:
    """ISO 14229-1, 8.7: what it can do it does for functional requests, too; a wrong length (13) is told."""
    target.needs_functional()
    target.ask(TESTER_PRESENT, functional=True).exactly("7E 00")
    target.ask("3E", functional=True).refused(0x13)


def test_default_session(target: Target) -> None:
    """ISO 14229-1, 10.2: 10 01 tells P2 [ms] and P2* [10 ms]; suppressed it tells nothing."""
    answer = target.positive("10 01", 2)
    p2, p2_star = int.from_bytes(answer[2:4], "big"), 10 * int.from_bytes(answer[4:6], "big")
    target.ask("10 01").needs(
        len(answer) == 6 and 0 < p2 <= p2_star, "50 01, P2 and P2*, two bytes each, P2 the shorter"
    )
    target.silent("10 81")


@pytest.mark.parametrize("request_", [TESTER_PRESENT, "19 02 FF", "22 F1 90", "10 01"])
def test_times(target: Target, request_: str) -> None:
    """ISO 14229-2, 7.2: the answer, or 0x78, begins within the P2 that 10 01 told (50 ms, if it told none)."""
    told = target.ask("10 01").came
    p2_ms = int.from_bytes(told[0][2:4], "big") if told and told[0][:2] == b"\x50\x01" and len(told[0]) == 6 else P2_MS
    answer = target.ask(request_)
    took_ms = answer.took_ns / MS
    good = bool(answer.came) and took_ms <= p2_ms + target.slack_ns / MS
    answer.needs(good, f"the first frame within {p2_ms} ms, not after {took_ms:.0f} ms")


def test_an_identifier_is_repeated(target: Target, known: dict[str, bytes]) -> None:
    """ISO 14229-1, 11.2: each identifier stands before its data, which is not empty."""
    for did, data in known.items():
        target.ask(f"22 {did}").needs(bool(data), f"62 {did} and its data")


def test_several_identifiers(target: Target, known: dict[str, bytes]) -> None:
    """ISO 14229-1, 11.2: several identifiers are answered in the order in which they are asked for."""
    dids = [*known][:2] * (1 if len(known) > 1 else 2)
    answer = target.ask(f"22 {' '.join(dids)}")
    if answer.refusal == 0x13:
        pytest.skip("one identifier a request")
    answer.exactly(shown(b"\x62" + b"".join(bytes.fromhex(did) + known[did] for did in dids)))


def test_an_unknown_identifier(target: Target, known: dict[str, bytes]) -> None:
    """ISO 14229-1, 11.2: an identifier that is none is refused with 31; beside a known one it is left out."""
    target.ask(f"22 {NO_DID}").refused(0x31)
    did = next(iter(known))
    answer = target.ask(f"22 {did} {NO_DID}")
    if answer.refusal != 0x13:
        answer.exactly(shown(b"\x62" + bytes.fromhex(did) + known[did]))


def test_too_many_identifiers(target: Target, known: dict[str, bytes]) -> None:
    """ISO 14229-1, 11.2: too many are refused with 13, an answer too long with 14; else all are there."""
    did = next(iter(known))
    answer = target.ask(f"22 {' '.join([did] * 300)}", patience_ns=5 * PATIENCE_NS)
    if answer.refusal not in (0x13, 0x14):
        answer.exactly(shown(b"\x62" + 300 * (bytes.fromhex(did) + known[did])))


@pytest.fixture
def extended(target: Target) -> Target:
    """Open the extended session; afterwards it is the default one again."""
    target.positive("10 03", 2)
    return target


@pytest.fixture(autouse=True)
def _default_session(target: Target) -> Iterator[None]:
    yield
    target.ask("10 01")


@pytest.mark.intervene
def test_extended_session(extended: Target) -> None:
    """ISO 14229-1, 10.2: 10 03 tells its times as 10 01 does; 10 01 ends it."""
    extended.ask("10 03").needs(len(extended.positive("10 03", 1)) == 6, "50 03 and four bytes")
    extended.ask("10 01").positive(b"\x50\x01")


@pytest.mark.intervene
def test_a_session_ends_by_itself(extended: Target) -> None:
    """ISO 14229-2, 7.5 (S3 of 5 s): without requests the extended session ends."""
    extended.ask("22 F1 86").needs(extended.positive("22 F1 86", 2)[3:] == b"\x03", "62 F1 86 03, the extended session")
    extended.rest(S3_NS + 500 * MS + extended.slack_ns)
    extended.ask("22 F1 86").exactly("62 F1 86 01")


@pytest.mark.intervene
def test_security_access(extended: Target) -> None:
    """ISO 14229-1, 10.4: 27 01 tells a seed; a key that nobody asked a seed for is refused with 24, 27 00 with 12."""
    answer = extended.ask("27 02 00 00 00 00")
    if answer.refusal in (0x11, 0x12, 0x7E, 0x7F):
        pytest.skip("27 is not supported")
    answer.refused(0x24, 0x13, 0x37)
    extended.ask("27 00").refused(0x12)
    answer = extended.ask("27 01")
    answer.needs(answer.refusal == 0x37 or len(answer.positive(b"\x67\x01")) > 2, "67 01 and a seed")
    extended.ask("27 02").refused(0x13, 0x24, 0x37)


@pytest.mark.intervene
def test_dtc_setting(extended: Target) -> None:
    """ISO 14229-1, 10.8: 85 02 and 85 01 are answered alike; 85 00 is none."""
    extended.positive("85 02", 1)
    extended.ask("85 01").exactly("C5 01")
    extended.ask("85 00").refused(0x12)


@pytest.mark.intervene
def test_communication_control(extended: Target) -> None:
    """ISO 14229-1, 10.5: 28 00 01 is answered by 68 00; a request without its kind is refused with 13."""
    extended.positive("28 00 01", 1)
    extended.ask("28 00").refused(0x13)


@pytest.mark.intervene
def test_write(extended: Target) -> None:
    """ISO 14229-1, 11.7: 2E of an unknown identifier is refused with 31 (33: a key is missing), without data 13."""
    answer = extended.ask(f"2E {NO_DID} 00")
    if answer.refusal in (0x11, 0x7F):
        pytest.skip("2E is not supported")
    answer.refused(0x31, 0x33, 0x34, 0x22)
    extended.ask(f"2E {NO_DID}").refused(0x13)


@pytest.mark.intervene
def test_clear(target: Target) -> None:
    """ISO 14229-1, 12.2: a wrong length gets 13, an unknown group 31; FFFFFF is answered by 54."""
    answer = target.ask("14 FF FF")
    if answer.refusal in (0x11, 0x7F):
        pytest.skip("14 is not supported")
    answer.refused(0x13)
    target.ask("14 00 00 01").refused(0x31, 0x33, 0x34, 0x22)
    answer = target.ask("14 FF FF FF", patience_ns=5 * PATIENCE_NS)
    if answer.refusal not in (0x33, 0x34, 0x22):
        answer.exactly("54")
