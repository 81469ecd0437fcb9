"""A rig with a UDS server, and its tester."""

import pytest
from rig import Rig, write_config
from uds_tester import EXTRA, Asked


@pytest.fixture
def uds(tmp_path):
    """Build a rig with a UDS server; returns it with its tester."""
    rigs = []

    def build(messages=3, uds="", memory=None, more="", **options):
        path = write_config(tmp_path, messages, extra=EXTRA.format(uds=uds) + more, **options)
        rigs.append(Rig(path, memory))
        return rigs[-1], Asked(rigs[-1])

    yield build
    for rig in rigs:
        rig.close()
