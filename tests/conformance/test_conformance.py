"""The conformance suite: it passes on our servers, and finds each defect of wrong ones by the cases that ought to."""

import pytest
from conformance_wires import SAID, TAKEN
from doip_wire import Wired
from foreign_project import ROOT, run
from junitparser import JUnitXml

from gateway_testers.doip.codec import Activation, Nack

PATHS = " ".join(str(ROOT / "tests" / name) for name in ("conformance", "servers", "support"))
#: Servers with defects -> defect -> the cases that find it, and no others do.
WRONG = {
    1: {
        "suppress": {"test_suppressed", "test_functional_silence"},
        "count": {"test_counts_equal_lists"},
        "snapshot": {"test_snapshots"},
        "pids": {"test_maps_say_what_is_answered"},
        "block_size": {"test_block_size"},
        "refuses_all": {"test_an_unknown_group_of_all"},
    },
    2: {
        "functional": {"test_functional_silence"},
        "mask": {"test_counts_equal_lists", "test_lists_keep_their_masks"},
        "unknown_dtc": {"test_an_unknown_dtc", "test_wwh_obd"},
        "record": {"test_records"},
        "dtcs": {"test_dtcs", "test_the_count_of_dtcs", "test_dtcs_are_those_of_uds", "test_freeze_frame"},
        "separation": {"test_separation_time"},
        "wait": {"test_wait"},
        "page": {"test_maps_say_what_is_answered"},
        "vin": {"test_vin_on_uds"},
    },
    3: {
        "length": {"test_wrong_lengths"},
        "dids": {"test_several_identifiers"},
        "sequence": {"test_a_wrong_sequence_number"},
        "reserved": {"test_frames_that_are_none"},
        "group": {"test_dtcs_of_the_emission_system"},
        "permanent": {"test_permanent_dtcs_of_the_emission_system"},
        "available": {"test_status_availability", "test_counts_equal_lists", "test_no_bit_no_dtc"},
    },
}


def tried(folder, *arguments):
    """Run the suite in a process of its own; returns the exit code, its cases as (name, outcome), and what it said."""
    options = ("-o", f"pythonpath={PATHS}", "--junitxml=out.xml", "--pyargs", "gateway_conformance")
    code, said = run(folder, *options, *arguments)
    cases = [case for suite in JUnitXml.fromfile(str(folder / "out.xml")) for case in suite]
    told = [(case.name, type(case.result[0]).__name__ if case.result else "Passed") for case in cases]
    return code, told, said


def found(cases, target):
    """Return the cases that failed on a target."""
    return {name.partition("[")[0] for name, said in cases if target in name and said in ("Failure", "Error")}


@pytest.mark.evidence("ISO 14229-1: others kit")
@pytest.mark.long
def test_our_server_passes_and_defects_are_found(tmp_path):
    targets = {number: f"inside:conformance_wires:Wrong:{'+'.join(defects)}" for number, defects in WRONG.items()}
    ours = "inside:conformance_wires:Right"
    chosen = [word for uri in (ours, *targets.values()) for word in ("--target", uri)]
    code, cases, said = tried(tmp_path, "--address", "0x10", "--intervene", "--demand", "19", "--demand", "22", *chosen)
    assert {*SAID, *TAKEN, "refuses_all"} == {defect for defects in WRONG.values() for defect in defects}
    assert found(cases, ours) == set(), said
    skipped = {name.partition("[")[0] for name, outcome in cases if ours in name and outcome == "Skipped"}
    assert skipped == set()
    for number, target in targets.items():
        assert found(cases, target) == set().union(*WRONG[number].values()), (number, said)
    assert code == 1
    assert "asked inside:conformance_wires:Wrong" in said


class WrongDoip(Wired):
    """Our DoIP server with four defects."""

    def open(self):
        super().open()
        server, identity = self.server, self.server.identity
        activation, refuse, acknowledge, answer = (
            server._answer_activation, server._refuse, server._acknowledge, identity.answer
        )  # fmt: skip

        def wrong_activation(one, source, code):
            activation(one, source, Activation.UNKNOWN_SOURCE if code == Activation.UNSUPPORTED_TYPE else code)

        def wrong_refusal(one, body, code):
            refuse(one, body, Nack.TRANSPORT if code == Nack.UNKNOWN_TARGET else code)

        def wrong_answer(datagram, sockets):
            return answer(datagram[:8] + identity._eid if datagram[3] == 2 else datagram, sockets)

        server._answer_activation, server._refuse, identity.answer = wrong_activation, wrong_refusal, wrong_answer
        server._acknowledge = lambda one, body: acknowledge(one, body[2:4] + body[:2] + body[4:])


DOIP_DEFECTS = {
    "test_activation_denied", "test_an_unknown_target", "test_identification_by_eid_and_vin", "test_acknowledgement",
}  # fmt: skip


@pytest.mark.long
def test_by_doip(tmp_path):
    (tmp_path / "right").mkdir()
    (tmp_path / "wrong").mkdir()
    right, wrong = Wired(tmp_path / "right"), WrongDoip(tmp_path / "wrong")
    try:
        with right.running(), wrong.running():
            uris = [f"doip://127.0.0.1:{each.port}/0x1000?functional=0xE400" for each in (right, wrong)]
            _, cases, said = tried(tmp_path, "--slack", "10000", "--target", uris[0], "--target", uris[1])
    finally:
        right.close()
        wrong.close()
    assert found(cases, uris[0]) == set(), said
    assert sum(uris[0] in name and outcome == "Passed" for name, outcome in cases) > 60
    assert found(cases, uris[1]) == DOIP_DEFECTS, said
