"""Gains of observers in predictor form, x(k+1) = Phi x + Gamma u + L (y - C x): from noise, or from poles.

From noise L is that of the stationary Kalman filter. From poles there is freedom left with more than one output: each
pole has a left eigenvector w = (Phi^T - lambda)^-1 C^T g with a free g, and L = (G W^-1)^T. It is spent on what the
poles do not tell: little noise in what is estimated, and a fault of one input that does not show in another's estimate
while the observer settles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gain:
    """An observer's gain with the stationary covariances that noise makes of it.

    Attributes:
        gain: L, shape (n, p).
        error: covariance of the predicted state's error, shape (n, n).
        innovation: covariance of y - C x, shape (p, p).
    """

    gain: Array
    error: Array
    innovation: Array


def with_noise(phi: Array, c: Array, gain: Array, q: Array, r: Array) -> Gain:
    """Return a gain with its covariances, for white noise on states (q) and outputs (r)."""
    from scipy.linalg import solve_discrete_lyapunov  # noqa: PLC0415 - slow to load

    f = phi - gain @ c
    error = solve_discrete_lyapunov(f, gain @ r @ gain.T + q)
    return Gain(gain, error, c @ error @ c.T + r)


def from_noise(phi: Array, c: Array, q: Array, r: Array) -> Gain:
    """Return the stationary Kalman filter.

    Raises:
        ValueError: there is none: something neither dies out nor is observed, or is not driven by any noise.
    """
    from scipy.linalg import solve_discrete_are  # noqa: PLC0415 - slow to load

    try:
        error = solve_discrete_are(phi.T, c.T, q, r)
    except np.linalg.LinAlgError as error_:
        raise ValueError(f"no stationary Kalman filter: {error_}") from error_
    innovation = c @ error @ c.T + r
    return Gain(phi @ error @ c.T @ np.linalg.inv(innovation), error, innovation)


#: Share of the innovation's variance below which an error has gone; samples after which it is said never to.
GONE, NEVER = 0.1, 20_000


def settling(phi: Array, c: Array, gain: Gain, error: Array) -> int:
    """Return the samples after which an error of the state is small beside the innovation's noise.

    Args:
        phi: shape (n, n).
        c: shape (p, n).
        gain: of the observer.
        error: covariance of the state's error beyond the stationary one, shape (n, n).
    """
    f, spread, last, k = phi - gain.gain @ c, np.diag(gain.innovation), 0, 0
    # As long as anything of it is left: what does not show at first may later.
    while k < NEVER and np.abs(error).max() > 1e-9 * np.abs(gain.error).max():
        if (np.diag(c @ error @ c.T) > GONE * spread).any():
            last = k + 1
        error, k = f @ error @ f.T, k + 1
    return last


def _from_vectors(phi: Array, c: Array, poles: NDArray[np.complex128], g: Array) -> Array:
    """Return L for free vectors g, shape (n, p): a real pole's own; of a pair the real and the imaginary part."""
    n = len(phi)
    w = np.empty((n, n), dtype=np.complex128)
    of = np.empty((c.shape[0], n), dtype=np.complex128)
    k = 0
    while k < n:
        pole = poles[k]
        if pole.imag == 0.0:
            of[:, k] = g[k]
            w[:, k] = np.linalg.solve(phi.T - pole * np.eye(n), c.T @ of[:, k])
            k += 1
        else:
            of[:, k] = g[k] + 1j * g[k + 1]
            w[:, k] = np.linalg.solve(phi.T - pole * np.eye(n), c.T @ of[:, k])
            of[:, k + 1], w[:, k + 1] = of[:, k].conj(), w[:, k].conj()
            k += 2
    return np.asarray(np.linalg.solve(w.T, of.T).real)


def _ordered(poles: tuple[complex, ...]) -> NDArray[np.complex128]:
    """Return the poles with each conjugate pair side by side, the one above first.

    Raises:
        ValueError: a complex pole stands without its conjugate.
    """
    real = [p for p in poles if p.imag == 0.0]
    above = [p for p in poles if p.imag > 0.0]
    below = [p for p in poles if p.imag < 0.0]
    mirrored = [p.conjugate() for p in below]
    if sorted((p.real, p.imag) for p in above) != sorted((p.real, p.imag) for p in mirrored):
        raise ValueError("complex poles come in conjugate pairs")
    pairs = [q for p in above for q in (p, p.conjugate())]
    return np.array(real + pairs, dtype=np.complex128)


#: Cost of a gain that makes the observer unstable, or that cannot be computed.
_UNUSABLE = 1e9


@dataclass(frozen=True)
class _Observer:
    """What a gain is chosen for.

    Attributes:
        phi: shape (n, n).
        c: shape (p, n).
        q: covariance of the noise on the states, shape (n, n).
        r: of the outputs, shape (p, p).
        faults: so many of the last states are estimates of inputs' faults.
    """

    phi: Array
    c: Array
    q: Array
    r: Array
    faults: int

    def with_noise(self, gain: Array) -> Gain:
        """Return a gain with its covariances."""
        return with_noise(self.phi, self.c, gain, self.q, self.r)

    def variances(self, gain: Array) -> Array:
        """Return the stationary variances of what is estimated: the faults, or all states if there are none."""
        n = len(self.phi)
        estimated = np.arange(n - self.faults, n) if self.faults else np.arange(n)
        return np.asarray(np.diag(self.with_noise(gain).error)[estimated])

    def crosstalk(self, gain: Array, steps: int) -> float:
        """Return how much of an input's fault another's estimate shows at most, within some samples of its start."""
        n = len(self.phi)
        f = self.phi - gain @ self.c
        largest, response = 0.0, np.eye(n)
        for _ in range(steps if self.faults > 1 else 0):
            response = f @ response
            block = response[n - self.faults :, n - self.faults :]
            largest = max(largest, float(np.abs(block - np.diag(np.diag(block))).max()))
        return largest

    def unstable(self, gain: Array) -> bool:
        """Tell whether the observer does not forget its error."""
        return bool(np.abs(np.linalg.eigvals(self.phi - gain @ self.c)).max() >= 1.0)


def _place(phi: Array, c: Array, wanted: NDArray[np.complex128]) -> Array:
    """Return a gain with these poles.

    Raises:
        ValueError: they cannot be placed.
    """
    from scipy.signal import place_poles  # noqa: PLC0415 - slow to load

    try:
        gain = place_poles(phi.T, c.T, wanted).gain_matrix.T
    except ValueError as error:
        raise ValueError(f"the poles cannot be placed: {error}") from error
    return np.asarray(gain.real)


def _free_vectors(phi: Array, c: Array, gain: Array, wanted: NDArray[np.complex128]) -> Array:
    """Return the free vectors g of a gain with these poles, shape (n, p), as :func:`_from_vectors` takes them."""
    n, p = len(phi), len(c)
    values, vectors = np.linalg.eig((phi - gain @ c).T)
    g = np.zeros((n, p))
    k = 0
    while k < n:
        nearest = int(np.argmin(np.abs(values - wanted[k])))
        free = gain.T @ vectors[:, nearest]
        free = free / np.linalg.norm(free)
        if wanted[k].imag == 0.0:
            g[k] = (free / free[np.argmax(np.abs(free))]).real
            k += 1
        else:
            g[k], g[k + 1] = free.real, free.imag
            k += 2
    return g


def _robust(observer: _Observer, wanted: NDArray[np.complex128], start: Array) -> Array:
    """Return the gain with these poles that is best in the sense of this module, found from another one with them."""
    from scipy.optimize import minimize  # noqa: PLC0415 - slow to load

    phi, c = observer.phi, observer.c
    n, p = len(phi), len(c)
    scale = observer.variances(start)
    steps = round(min(max(3.0 / (1.0 - max(abs(wanted))), 10.0), 200.0))

    def cost(gain: Array) -> float:
        if observer.unstable(gain):
            return _UNUSABLE
        noise = float((observer.variances(gain) / scale).sum())
        return noise + observer.crosstalk(gain, steps) ** 2

    def of_free(flat: Array) -> float:
        try:
            return cost(_from_vectors(phi, c, wanted, flat.reshape(n, p)))
        except np.linalg.LinAlgError:
            return _UNUSABLE

    g = _free_vectors(phi, c, start, wanted)
    found = minimize(of_free, g.ravel(), method="L-BFGS-B", options={"maxiter": 40})
    if found.fun >= cost(start):
        return start
    return _from_vectors(phi, c, wanted, found.x.reshape(n, p))


def from_poles(phi: Array, c: Array, poles: tuple[complex, ...], q: Array, r: Array, faults: int = 0) -> Gain:
    """Return a gain with these poles, robust in the sense of this module.

    Args:
        phi: shape (n, n).
        c: shape (p, n).
        poles: n of discrete time, inside the unit circle.
        q: covariance of the noise on the states, shape (n, n).
        r: of the outputs, shape (p, p).
        faults: so many of the last states are estimates of inputs' faults.

    Raises:
        ValueError: they cannot be placed.
    """
    if len(poles) != len(phi):
        raise ValueError(f"{len(phi)} poles are needed, {len(poles)} are given")
    if max(abs(pole) for pole in poles) >= 1.0:
        raise ValueError("a pole lies outside the unit circle: the observer would be unstable")
    wanted = _ordered(poles)
    gain = _place(phi, c, wanted)
    observer = _Observer(phi, c, q, r, faults)
    if len(c) > 1:  # with one output nothing is free
        gain = _robust(observer, wanted, gain)
    return observer.with_noise(gain)
