"""Shipped files: by kind and name, by the names of before version 0.2, and beside the file that names them."""

from pathlib import Path

import pytest

from gateway_fdi.common.resources import beside_or_shipped, renamed, shipped
from gateway_fdi.errors import InputError


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("scenarios/hybrid_hills.toml", "scenarios/truck_hills.toml"),
        ("configs/belt.toml", "configs/linear_belt.toml"),
        ("configs/comma_pedal.toml", "configs/pedal_comma.toml"),
        ("dbc/engine.dbc", "dbc/crank.dbc"),
        ("models/hybrid_truck.toml", "models/truck.toml"),
        ("dbc/gateway.dbc", None),
        ("other/dbc/engine.dbc", None),
    ],
)
def test_a_file_that_was_called_otherwise_is_found_by_its_name_of_now(old, new):
    assert renamed(old) == new


def test_a_file_is_found_by_its_kind_and_name_wherever_it_lies():
    assert shipped("models/example_1.toml").parent.parent.name == "structure"
    with pytest.raises(InputError, match="no such file"):
        shipped("models/example_0.toml")


def test_a_file_beside_goes_before_a_shipped_one(tmp_path):
    name = Path("models/example_1.toml")
    assert beside_or_shipped(tmp_path, name) == shipped(str(name))
    assert beside_or_shipped(tmp_path, Path("models/none.toml")) == tmp_path / "models/none.toml"
    assert beside_or_shipped(tmp_path, Path("../models/example_1.toml")) == tmp_path / "../models/example_1.toml"
    (tmp_path / name).parent.mkdir()
    (tmp_path / name).touch()
    assert beside_or_shipped(tmp_path, name) == tmp_path / name
