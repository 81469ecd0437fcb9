"""What a verdict was found with: the configuration, and all files that it consists of."""

import pytest

from gateway.config.load import load_config
from gateway_fdi.common.resources import shipped
from gateway_fleet.fleet.task import digest_of


@pytest.fixture
def config(tmp_path):
    """The motor's configuration, with its model and database beside it."""
    for name in ("models/motor.toml", "dbc/structural/motor.dbc"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(shipped(name).read_bytes())
    text = shipped("configs/motor.toml").read_text()
    (tmp_path / "car.toml").write_text(text)
    return tmp_path / "car.toml"


@pytest.mark.parametrize("name", ["models/motor.toml", "dbc/structural/motor.dbc", "car.toml"])
def test_every_file_counts(config, name):
    before = digest_of(load_config(config), ())
    assert digest_of(load_config(config), ()) == before
    file = config.parent / name
    said = file.read_text()
    change = 'VERSION "' if name.endswith("dbc") else "# "
    file.write_text(said.replace(change, change + "other ", 1) if change in said else said + "# other\n")
    changed = digest_of(load_config(config), ())
    assert (changed != before) == (name != "car.toml"), "a comment of the configuration itself changes nothing"


def test_the_module_of_an_own_type_counts(tmp_path):
    for file in shipped("examples/motor_load").glob("*.*"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    config = load_config(tmp_path / "gateway.toml")
    before = digest_of(config, ())
    source = tmp_path / "motor_load.py"
    source.write_text(source.read_text() + "# changed\n")
    assert digest_of(config, ()) != before
