"""A small catalogue and events for it."""

import numpy as np

from gateway.engine.events import EVENT, QUALIFIED_FAILED, QUALIFIED_PASSED
from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.dtc import Dtc
from gateway.faults.memory import Observed


def catalogue(confirm=(1, 2, 3)):
    return Catalogue(
        FaultDefinition(
            f"m.f{k}", Dtc.parse(f"P030{k}-11"), f"fault {k}", ("residual", "tooth"), confirm_cycles=n,
            indicator=k == 1,
        )
        for k, n in enumerate(confirm)
    )  # fmt: skip


def event(fault, failed, t_ns=0, value=1.5, evidence=(7.0, 3.0)):
    made = np.zeros(1, EVENT)
    made["fault"] = fault
    made["kind"] = QUALIFIED_FAILED if failed else QUALIFIED_PASSED
    made["fdc"] = 127 if failed else -128
    made["t_ns"] = t_ns
    made["value"] = value
    made["threshold"] = 1.0
    made["evidence"][0, : len(evidence)] = evidence
    return made


def nothing(_definition):
    """See nothing at a failure."""
    return Observed()


def frame(content, inputs=None):
    """See these signals at a failure."""
    return lambda _definition: Observed(content, inputs or {})
