"""What a test is, in a few digits: nu and thresholds that were found for it are of no use to another one.

Tests have their names by the equation that they check, so that another choice of tests, or another model, has other
tests of the same names. ``gateway calibrate`` keeps these digits with what it finds.
"""

from __future__ import annotations

import hashlib

from gateway_fdi.structure.model import Model
from gateway_plants.structural.monitor.filters import bandwidths
from gateway_plants.structural.monitor.params import Params
from gateway_plants.structural.monitor.plan import Test

#: Bytes of a digest.
_SIZE = 4


def digest(model: Model, test: Test, p: Params) -> str:
    """Return the digest of a test, 8 hexadecimal digits: what its residual is computed by, and how it is judged.

    Values of parameters are not in it: they may be mended without another calibration.
    """
    relations = []
    for name in test.equations:
        equation = model.by_name[name]
        text = equation.relation.text if equation.relation is not None else equation.differential
        relations.append((name, "".join(text.split())))
    filters = bandwidths(test, p)
    said = [
        test.consistency,
        test.causality,
        test.sequence,
        relations,
        p.decision,
        f"{filters.filter:.3g}" if test.filtered else "",
        f"{filters.derivative:.3g}" if test.differentiated else "",
    ]
    if test.observed:
        said.append(f"observed {p.settle_s:.3g}")
    if p.uncertain or p.sensors:
        said.append(f"{sorted(p.uncertain)} {sorted(p.sensors)} {p.drift_s}")
    return hashlib.blake2b(repr(said).encode(), digest_size=_SIZE).hexdigest()
