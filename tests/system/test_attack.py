"""All sockets of real processes attacked at once, by bench/attack.py: seconds here, two minutes in the full size."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from amount import amount
from debian import program

BENCH = Path(__file__).parents[2] / "bench"


@pytest.mark.system
def test_every_honest_request_is_answered_while_all_sockets_are_attacked():
    program("mosquitto")
    command = [sys.executable, str(BENCH / "attack.py"), "--untimed", "--json", "--seconds", str(amount(120, 5))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False, cwd=BENCH)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)
    assert not found["broken"]
    assert not found["first_wall"], "an exception of ours: the seed is in the output"
    assert min(found["acts"].values()) > 0
