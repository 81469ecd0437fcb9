"""Requests by name: their forms, and answers in words."""

import pytest

from gateway.answers.names import forms_of, words_of


@pytest.mark.parametrize(
    ("asked", "forms", "answers", "words"),
    [
        ("coolant", "22F405 0105", ("62F405D2", "4105D2"), "ECT 170 degC"),
        ("Engine  Speed", "22F40C 010C", ("62F40C1AF8", "410C1AF8"), "RPM 1726 rpm"),
        ("rpm", "22F40C 010C", ("62F40C1AF8",), "RPM 1726 rpm"),
        ("VIN", "22F802 0902", ("62F802414243", "490201414243"), "ABC"),
        ("verification number", "22F806 0906", ("62F80612345680",), "12345680"),
        ("22 F1 90", "22F190", ("62F19041",), ""),
    ],
)
def test_names_are_asked_in_both_forms_and_answered_in_words(asked, forms, answers, words):
    assert " ".join(form.hex().upper() for form in forms_of(asked)) == forms
    assert {words_of(asked, bytes.fromhex(answer)) for answer in answers} == {words}


def test_what_is_no_name_has_no_request():
    assert forms_of("colant") == []
    assert words_of("coolant", bytes.fromhex("62F40CFF")) == ""
