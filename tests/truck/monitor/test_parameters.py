"""Parameters of one's own truck: a name that the model does not have is one clear line, not a traceback."""

import pytest

from gateway.config.load import load_config
from gateway.runtime.assemble import prepare
from gateway_fdi.common.resources import shipped
from gateway_fdi.common.tomlfile import read_toml
from gateway_fdi.errors import InputError, InputErrors
from gateway_plants.truck.monitor.params import Params


@pytest.mark.parametrize(("name", "nearest"), [("m_v", "m_v0"), ("f_3", "k_3"), ("J_tott", "J_tot")])
def test_a_name_that_is_none(name, nearest, tmp_path):
    text = shipped("configs/truck.toml").read_text()
    path = tmp_path / "truck.toml"
    asked = f'type = "hybrid_powertrain"\nparameters = {{ {name} = 1.0 }}\n'
    path.write_text(text.replace('type = "hybrid_powertrain"\n', asked))
    with pytest.raises(InputError) as told:
        prepare(load_config(path), path)
    assert f"monitor[0].parameters.{name} = 1.0" in str(told.value)
    assert nearest in str(told.value)
    assert str(path) in str(told.value)


def test_each_wrong_name_is_told_at_once_and_tables_that_are_too_long(tmp_path):
    text = shipped("configs/truck.toml").read_text()
    path = tmp_path / "truck.toml"
    points = list(range(1, 14))
    path.write_text(
        text.replace(
            'type = "hybrid_powertrain"\n',
            'type = "hybrid_powertrain"\nparameters = { m_v = 1.0, R_m = 1.0, k_i = 1.0, J_tott = 1.0 }\n'
            f"tables = {{ f_3 = {{ x = {points}, y = {points} }} }}\n",
        )
    )
    with pytest.raises(InputErrors) as told:
        prepare(load_config(path), path)
    assert [error.key.rpartition(".")[2] for error in told.value.errors] == ["m_v", "R_m", "J_tott", "f_3"]


def test_the_shipped_configuration_follows_warmth_and_age():
    table = read_toml(shipped("configs/truck.toml"))["monitor"][0]
    told = Params.model_validate({key: value for key, value in table.items() if key in Params.model_fields})
    assert told.follow
    assert told.observer == Params().observer


def test_the_accuracy_of_a_sensor_is_as_its_data_sheet_says_it():
    told = Params.model_validate({"sensors": {"U_em": {"gain": "1 %", "bias": "2 V"}, "I_b": {"bias": 0.25}}}).sensors
    assert (told.U_em.gain, told.U_em.bias.value) == (0.01, 2.0)
    assert (told.I_b.gain, told.I_b.bias.value) == (0.005, 0.25), "what is left out keeps its default"
    assert told.I_em == Params().sensors.I_em


def test_each_wrong_accuracy_is_told_at_once_with_its_key(tmp_path):
    text = shipped("configs/truck.toml").read_text()
    path = tmp_path / "truck.toml"
    asked = (
        'sensors = { U_em = { gain = "30 %", bias = "1 A" }, I_em = { bias = "1 V", offset = 1 }, I_c = {} }\n'
        "setle_s = 1\nfollow = { resistence = { low = -0.1, high = 0.1, rate = 1e-3 } }\n"
    )
    path.write_text("\n".join(asked if line.startswith("sensors") else line for line in text.splitlines()))
    with pytest.raises(InputErrors) as told:
        load_config(path)
    keys = {error.key for error in told.value.errors}
    assert keys == {
        f"monitor[0].{key}"
        for key in (
            "sensors.U_em.gain", "sensors.U_em.bias", "sensors.I_em.bias", "sensors.I_em.offset", "sensors.I_c",
            "setle_s", "follow.resistence",
        )
    }  # fmt: skip
    assert 'its unit is "V"' in str(told.value)


@pytest.mark.parametrize("key", ["system", "signed_charge"])
def test_a_key_of_the_papers_systems_says_where_they_are(key):
    with pytest.raises(ValueError, match=f"{key}.*the paper's systems.*gateway evaluate truck"):
        Params.model_validate({key: "RDS"})
