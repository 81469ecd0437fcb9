"""A small catalogue and events for it."""

import numpy as np

from gateway.engine.events import EVENT, QUALIFIED_FAILED, QUALIFIED_PASSED, each
from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.dtc import Dtc
from gateway.faults.failures import Observed
from gateway.faults.memory import FaultMemory
from gateway.faults.status import Rules

#: Rules of the three faults: they differ in every number.
RULES = (Rules(1, 3, 2, False), Rules(2, 2, 3, True), Rules(3, 1, 4, False))


def catalogue(confirm=None, **settings):
    """Three faults by RULES; or as many as there are numbers of cycles that confirm, the second lit.

    Args:
        confirm: cycles that confirm each.
        settings: name -> value of each fault, by its place.
    """
    rules = RULES if confirm is None else tuple(Rules(n, indicator=k == 1) for k, n in enumerate(confirm))
    return Catalogue(
        FaultDefinition(
            f"m.f{k}",
            Dtc.parse(f"P0{300 + k}-11"),
            f"fault {k}",
            ("residual", "tooth"),
            confirm_cycles=rule.confirm_cycles,
            healing_cycles=rule.healing_cycles,
            aging_cycles=rule.aging_cycles,
            indicator=rule.indicator,
            **{name: values[k] for name, values in settings.items()},
        )
        for k, rule in enumerate(rules)
    )


def event(fault, failed, t_ns=0, value=1.5, evidence=(7.0, 3.0)):
    made = np.zeros(1, EVENT)
    made["fault"] = fault
    made["kind"] = QUALIFIED_FAILED if failed else QUALIFIED_PASSED
    made["fdc"] = 127 if failed else -128
    made["t_ns"] = t_ns
    made["value"] = value
    made["threshold"] = 1.0
    made["evidence"][0, : len(evidence)] = evidence
    return each(made)[0]


def nothing(_definition):
    """See nothing at a failure."""
    return Observed()


def frame(content, inputs=None):
    """See these signals at a failure."""
    return lambda _definition: Observed(content, inputs or {})


class AtOnce(FaultMemory):
    """A memory that writes each change at once, so that it is to be read right away."""

    def apply(self, event, snapshot):
        changes = super().apply(event, snapshot)
        self.commit()
        return changes

    def admit_refused(self, t_ns):
        changes = super().admit_refused(t_ns)
        self.commit()
        return changes

    def fold_statistics(self):
        super().fold_statistics()
        self.commit()
