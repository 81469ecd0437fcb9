"""Requests by name: their forms, and answers in words."""

import pytest

from gateway_ask.answers.names import forms_of, words_of
from gateway_ask.answers.snapshots import snapshots_in_words


@pytest.mark.parametrize(
    ("asked", "forms", "answers", "words"),
    [
        ("coolant", "22F405 0105", ("62F405D2", "4105D2"), "ECT 170 degC"),
        ("Engine  Speed", "22F40C 010C", ("62F40C1AF8", "410C1AF8"), "RPM 1726 rpm"),
        ("rpm", "22F40C 010C", ("62F40C1AF8",), "RPM 1726 rpm"),
        ("VIN", "22F802 0902 22F190", ("62F802414243", "490201414243", "62F190414243"), "ABC"),
        ("verification number", "22F806 0906", ("62F80612345680",), "12345680"),
        ("monitor A1", "22F6A1 06A1", ("62F6A10B2400050000000A", "46A10B2400050000000A"), "test 0B 5, 0 to 10: passed"),
        ("clear DTCs", "14FFFF33 04", ("54", "44"), "cleared"),
        ("22 F1 90", "22F190", ("62F19041",), ""),
    ],
)
def test_names_are_asked_in_both_forms_and_answered_in_words(asked, forms, answers, words):
    assert " ".join(form.hex().upper() for form in forms_of(asked)) == forms
    assert {words_of(asked, bytes.fromhex(answer)) for answer in answers} == {words}


def test_readiness_and_the_lamp_are_the_same_in_both_forms():
    words = {words_of("MIL", bytes.fromhex(head + "83076504")) for head in ("62F401", "4101")}
    assert len(words) == 1
    assert words.pop().startswith("MIL on, DTC_CNT 3, CCM_RDY yes, FUEL_RDY yes, MIS_RDY yes, CIM_SUP spark")


def test_what_is_no_name_has_no_request():
    assert forms_of("colant") == []
    assert words_of("coolant", bytes.fromhex("62F40CFF")) == ""


def test_snapshots_by_obd_on_uds_are_told_in_words():
    """Trims have one byte, or two where the car has a third bank; what ends elsewhere, or is of others, is not read."""
    assert snapshots_in_words(bytes.fromhex("0102 F40680 F405D2 0201 F40C1AF8")) == [
        "record 1: SHRTFT1 0 %, ECT 170 degC",
        "record 2: RPM 1726 rpm",
    ]
    assert snapshots_in_words(bytes.fromhex("0102 F4068040 F405D2")) == [
        "record 1: SHRTFT1 0 %, SHRTFT3 -50 %, ECT 170 degC"
    ]
    for other in ("", "01", "0000", "0101 F19031", "0101 F405", "0101 F405D2 00", "0102 F405D2"):
        assert snapshots_in_words(bytes.fromhex(other)) == []
