"""A preset's values replaced one by one, and what is said of wrong ones."""

import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

from gateway.cli import app
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import GatewayError
from gateway_plants.pedal.monitor.params import PRESETS, PairParams


def test_the_noise_of_a_preset_can_be_told_alone():
    changed = PairParams(preset="brake", noise_mV=4.0).channels
    assert [c.noise for c in changed] == [0.004, 0.004]
    assert [c.model_copy(update={"noise": 0.002}) for c in changed] == list(PRESETS["brake"].channels)
    assert PairParams(resolution_mV=5).channels[1].resolution == 0.005


def test_one_channel_of_a_preset_can_be_changed():
    first, second = PairParams(channel=({}, {"at_rest": 4.4})).channels
    usual = PRESETS["brake"].channels
    assert first == usual[0]
    assert second == usual[1].model_copy(update={"at_rest": 4.4})


def test_a_channel_with_a_signal_of_its_own_says_all():
    with pytest.raises(ValidationError) as error:
        PairParams(channel=({"signal": "Other.Ch1"}, {}))
    assert {e["loc"] for e in error.value.errors()} == {
        ("channel", 0, k) for k in ("at_rest", "at_full", "low", "high")
    }


def test_millivolts_are_of_the_presets_channels():
    own = {"signal": "Other.Ch1", "at_rest": 0, "at_full": 9, "low": -1, "high": 10}
    with pytest.raises(ValidationError, match=r"noise_mV is of the preset's channels; those of Other\.Ch1"):
        PairParams(channel=(own, own), noise_mV=3)


CONFIG = """
[[bus]]
name = "can0"
uri = "loopback:127.0.0.1:29555"
database = ["{database}"]
[[monitor]]
name = "brake"
type = "redundant_pair"
{line}
"""


@pytest.mark.parametrize(
    ("line", "key", "says"),
    [
        ("noise_mv = 3", "monitor[0].noise_mv", "did you mean noise_mV"),
        ("noise_mV = -1", "monitor[0].noise_mV", "a number of 0 at least"),
        ("lag_ms = 50", "monitor[0].lag_ms", "a number of 12 at most"),
        ('preset = "brakes"', "monitor[0].preset", "did you mean brake"),
        ("channel = [{ at_rest = 4.5 }, {}]", "monitor[0].channel[0]", "no slope"),
        ("channel = [{ att_rest = 1 }, {}]", "monitor[0].channel[0].att_rest", "did you mean at_rest"),
        ("channel = [{}, {}, {}]", "monitor[0].channel[2].signal", "missing"),
        ("period_ms = 0", "monitor[0].period_ms", "a number above 0"),
    ],
)
def test_check_names_a_wrong_parameter_by_its_key(tmp_path, line, key, says):
    config = tmp_path / "c.toml"
    config.write_text(CONFIG.format(database=shipped("dbc/pedal.dbc"), line=line))
    shown = CliRunner().invoke(app, ["check", str(config)])
    assert shown.exit_code != 0
    text = " ".join(f"{shown.output} {shown.exception}".split())
    assert key in text, text
    assert says in text, text
    assert isinstance(shown.exception, GatewayError | SystemExit)
