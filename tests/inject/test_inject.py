"""Everything goes wrong at random, from a seed, in a daemon in this process: nothing is silent, nothing is lost."""

import os

import pytest
from run import QUIET_S, Run, schedule_for
from schedule import draw, read, text_of

SEEDS = [int(os.environ["GATEWAY_SEED"])] if "GATEWAY_SEED" in os.environ else range(1, 5)
SECONDS = 30.0


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_lost_and_nothing_is_silent(seed, tmp_path):
    schedule = schedule_for(seed, SECONDS - QUIET_S)
    print(text_of(schedule))
    run = Run(tmp_path, seed, SECONDS, schedule).play()
    print(run.summary())


def test_a_schedule_can_be_read_again():
    schedule = draw(1, 60.0)
    assert read(text_of(schedule)) == schedule
    assert draw(1, 60.0) == schedule
    assert draw(2, 60.0) != schedule
