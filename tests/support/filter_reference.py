"""What tests of motor filters share: the motor, a filter's records, and filterpy's filter as their reference."""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from gateway_fdi.filters.motor import Motor
from gateway_fdi.jit import zeros

M = Motor()
T = 1e-3


def pair(module, *arguments, **options):
    c, s = zeros(1, module.Const), zeros(1, module.State)
    module.prepare(c[0], *arguments, **options)
    return s[0], c[0]


def close(ours, theirs, tolerance=1e-10):
    np.testing.assert_allclose(ours, theirs, rtol=tolerance, atol=tolerance)


def jacobian(f, x, u):
    """By complex steps: exact to rounding."""
    n = len(x)
    columns = []
    for k in range(n):
        moved = x.astype(complex)
        moved[k] += 1e-30j
        columns.append(f(moved, u).imag / 1e-30)
    return np.array(columns).T


class Reference(ExtendedKalmanFilter):
    """filterpy's filter with sub-steps of a model."""

    def __init__(self, n, f, steps, q, r, p):
        super().__init__(dim_x=n, dim_z=2)
        self.f, self.steps, self.q = f, steps, q
        self.x, self.R, self.P = np.zeros(n), np.eye(2) * r, np.diag(p)
        self.H2 = np.eye(2, n)

    def take(self, inputs, y):
        for u in inputs:
            jac = jacobian(self.f, self.x, u)
            self.x = self.f(self.x, u)
            self.P = jac @ self.P @ jac.T + self.q
        self.update(np.asarray(y), lambda _: self.H2, lambda x: self.H2 @ x)
