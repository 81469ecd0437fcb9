"""A residual generator driven sample by sample, and held against another."""

import numpy as np

from gateway_fdi.jit import zeros


class Runner:
    """A residual generator with its records, one sample after the other."""

    def __init__(self, loaded, **bandwidths):
        self.loaded = loaded
        self.s, self.c, self.u = (zeros(1, dtype) for dtype in (loaded.state, loaded.const, loaded.inputs))
        loaded.prepare(self.c[0], **bandwidths)
        loaded.reset(self.s[0], self.c[0])

    def start(self, **known):
        self.take(known)
        self.loaded.start(self.s[0], self.c[0], self.u[0])

    def take(self, known):
        for name in self.loaded.inputs.names:
            if name in known:
                self.u[0][name] = known[name]

    def step(self, dt, **known):
        self.take(known)
        return self.loaded.step(self.s[0], self.c[0], self.u[0], dt)

    def run(self, rows, dt):
        self.start(**rows[0])
        return np.array([self.step(dt if k else 0.0, **z) for k, z in enumerate(rows)])


def close(found, expected, scale=1.0):
    assert np.isfinite(found).all()
    assert np.abs(found - expected).max() < 1e-9 * scale
    assert np.abs(expected).max() > 1e-2 * scale  # something was compared
