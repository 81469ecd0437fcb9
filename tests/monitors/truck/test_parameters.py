"""Parameters of one's own truck: a name that the model does not have is one clear line, not a traceback."""

import pytest

from gateway.common.resources import shipped
from gateway.config.load import load_config
from gateway.errors import InputError
from gateway.runtime.assemble import prepare


@pytest.mark.parametrize(("name", "nearest"), [("m_v", "m_v0"), ("f_3", "k_3"), ("J_tott", "J_tot")])
def test_a_name_that_is_none(name, nearest, tmp_path):
    text = shipped("configs/truck.toml").read_text().replace("../dbc", str(shipped("dbc")))
    path = tmp_path / "truck.toml"
    asked = f'type = "hybrid_powertrain"\nparameters = {{ {name} = 1.0 }}\n'
    path.write_text(text.replace('type = "hybrid_powertrain"\n', asked))
    with pytest.raises(InputError) as told:
        prepare(load_config(path), path)
    assert f"monitor[0].parameters.{name} = 1.0" in str(told.value)
    assert nearest in str(told.value)
    assert str(path) in str(told.value)
