"""Databases as the community writes them: opendbc's are read with all that they have; what was put right is said."""

import re

import pytest

from gateway.signals.database import load_database
from gateway.signals.dialect import mended
from gateway_fdi.errors import InputError

DATABASES = pytest.importorskip("opendbc.dbc.generator.generator").generate_all()


@pytest.mark.parametrize("name", sorted(DATABASES))
def test_every_generated_database_of_opendbc_is_read_whole(name, tmp_path):
    file = tmp_path / f"{name}.dbc"
    file.write_text(DATABASES[name], encoding="cp1252", errors="replace")
    database = load_database([file])
    messages = re.findall(r"^BO_ (\d+) (\w+)", DATABASES[name], re.MULTILINE)
    assert {message.name for message in database} >= {
        text for _, text in messages if sum(other == text for _, other in messages) == 1
    }
    for message in database:
        assert message.is_extended_frame or message.frame_id <= 0x7FF


def test_what_is_put_right_is_said_and_nothing_else_is_touched():
    text = (
        'BO_ 419361024 Far: 8 A\n SG_ X : 0|8@1+ (.25,-.5) [0|.5] "" A\n'
        'CM_ SG_ 304 "of no signal";\nCM_ BO_ 419361024 "far .5";\nVAL_ 419361024 X 0 "off" ;\nVAL_ 7 Y 0 "gone" ;\n'
        'VAL_ 419361024 X 1 "on"\n'
    )
    made, said = mended(text)
    assert len(said) == 5
    assert made == (
        'BO_ 2566844672 Far: 8 A\n SG_ X : 0|8@1+ (0.25,-0.5) [0|0.5] "" A\n'
        'CM_ BO_ 2566844672 "far .5";\nVAL_ 2566844672 X 0 "off" ;\nVAL_ 2566844672 X 1 "on" ;\n'
    )
    assert mended(made) == (made, [])


def test_a_file_that_is_wrong_otherwise_has_the_error_that_it_had(tmp_path):
    file = tmp_path / "car.dbc"
    file.write_text('BO_ 1 M: 8 A\n SG_ X : 0|8@ what\nCM_ SG_ 304 "of no signal";\n')
    with pytest.raises(InputError) as told:
        load_database([file])
    assert told.value.line == 2


def test_names_that_begin_with_a_digit_and_identifiers_that_no_bus_has(tmp_path):
    """As in opendbc's psa_aee2010_r3, mazda_2017, toyota_2017_ref_pt and hyundai_kia_generic."""
    file = tmp_path / "car.dbc"
    file.write_text(
        'VERSION ""\nBS_:\nBU_: A\nBO_ 1275 2017_5: 8 A\n SG_ 0_COUNTER : 0|4@1+ (1,0) [0|15] "" A\n'
        'BO_ 1075054137 Gone: 8 A\n SG_ X : 0|8@1+ (1,0) [0|255] "" A\n'
        'CM_ 145 "no name";\nCM_ SG_ 1075054137 X "of the one that is gone";\nVAL_ 1275 0_COUNTER 0 "zero" ;\n'
    )
    database = load_database([file])
    assert [message.name for message in database] == ["_2017_5"]
    assert [signal.name for signal in database.message("_2017_5").signals] == ["_0_COUNTER"]
