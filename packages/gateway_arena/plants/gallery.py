"""Plants of the gallery: simulated from their structural models, as their scenarios say."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gateway_arena.contract import SAMPLES, Record, WithoutSlopes
from gateway_arena.plants.scipy_plant import onset_of
from gateway_fdi.structure.file import load_own_model
from gateway_fdi.structure.simulation.plant import Course
from gateway_fdi.structure.simulation.plant import Plant as Simulation
from gateway_plants.structural.ecu.params import Repeated, StructuralFault, StructuralParams, points_of
from gateway_plants.structural.study.gallery import PLANTS, cases, scenario

#: Names.
GALLERY = PLANTS


class GalleryPlant(WithoutSlopes):
    """A plant of the gallery as the arena takes it; its sensors are sampled together, a fault lasts half a record."""

    def __init__(self, name: str) -> None:
        self.name = name
        (ecu,) = scenario(name).ecu
        assert isinstance(ecu, StructuralParams)
        self._ecu = ecu
        self.source = f"models/{ecu.model.name} (docs/structural/gallery.md)"
        self.model = load_own_model(ecu.model, key="model")
        found = list(cases(name))
        self._faults: dict[str, StructuralFault] = {case.fault.name: case.fault for case in found}
        self.period_s = 2 * max(case.lasts_s for case in found) / SAMPLES
        self.commands = tuple(z for z in self.model.knowns if z in ecu.inputs and z not in ecu.noise)
        self.knowns = (*self.commands, *(z for z in self.model.knowns if z not in self.commands))
        self.noise = tuple(ecu.noise.get(z, 0.0) for z in self.knowns)
        self.sizes: Mapping[str, str] = {fault: f"{case.kind} {case.size:g}" for fault, case in self._faults.items()}

    def record(self, seed: int, fault: str = "", off: float = 0.0, size: float = 1.0) -> Record:
        """Return a run (:class:`gateway_arena.contract.Plant`); the inputs' courses begin anywhere."""
        rng = np.random.default_rng(seed)
        onset = onset_of(seed) if fault else SAMPLES
        begin = float(rng.uniform(0.0, 1.0))
        inputs = {}
        for name, course in self._ecu.inputs.items():
            points, repeat = points_of(course), course.repeat_s if isinstance(course, Repeated) else 0.0
            inputs[name] = _shifted(points, begin * repeat, repeat)
        values = {name: self.model.quantities[name].value for name in self.model.parameters} if off else {}
        changed = {name: value * (1 + off * rng.choice([-1, 1])) for name, value in values.items() if value is not None}
        plant = Simulation(
            self.model,
            inputs,
            parameters={**changed, **self._ecu.parameters},
            start=self._ecu.start,
            rest=self._ecu.rest,
        )
        times = np.arange(float(SAMPLES)) * self.period_s
        courses = {}
        if fault:
            case, t = self._faults[fault], onset * self.period_s
            courses[fault] = Course((0.0, t, t + case.ramp_s), (0.0, 0.0, size * case.size))
        rows = plant.run(times, courses, longest_s=self._ecu.longest_ms * 1e-3)
        exact = np.stack([rows[z] for z in self.knowns], 1)
        return Record(times, exact + rng.normal(size=exact.shape) * np.array(self.noise), fault, onset)


def _shifted(points: tuple[tuple[float, float], ...], by: float, repeat: float) -> Course:
    """Return a course that begins ``by`` seconds later in its repetition."""
    if not repeat:
        return Course(tuple(t for t, _ in points), tuple(v for _, v in points))
    t, v = np.array(points).T
    first = float(np.interp(by, t, v))
    late = [(a - by, b) for a, b in points if a > by]
    early = [(a - by + repeat, b) for a, b in points if a <= by]
    moved = [(0.0, first), *late, *early, (repeat, first)]
    return Course(tuple(a for a, _ in moved), tuple(b for _, b in moved), repeat)
