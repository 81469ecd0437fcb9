"""Rival that knows the equations: a bank of extended Kalman filters, one without a fault and one for each fault.

The equations of the structural model are measured to be zero (Nikoukhah, Willsky, Levy, "Kalman filtering and Riccati
equations for descriptor systems", IEEE Transactions on Automatic Control 37(9), 1992). The state of a filter has all
unknowns, and its fault's size as a random walk; derivatives are taken implicitly; unknowns that no derivative holds are
free in each sample. Likelihoods of the filters weigh the faults (multiple-model estimation: Magill 1965).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import newton

from gateway_arena.contract import Array, Found, NotForThisPlantError, Plant, Record
from gateway_arena.methods.cusum import settled, summed
from gateway_fdi.structure.model import Model, Quantity, der

#: Errors of equations, as a share of what their variables change: the likeliest of these is taken.
SHARES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
#: Change of an unknown in a sample, as a share of its size; of a fault's size; and the size that a fault is scaled by.
CHANGE, WALK, FAULT = 0.3, 0.02, 0.1
#: Samples whose likelihoods weigh the faults, and that share a Jacobian; iterations at a record's begin; difference.
WINDOW, SAME, ITERATIONS, STEP = 120, 4, 10, 1e-6
#: No unknown is further than this many times its size; healthy records that the errors of equations are learned from.
FAR, LEARNED = 50.0, 3
#: NumPy's own for two arguments are several times as slow.
FASTER: dict[str, Callable[..., Array]] = {
    "amax": lambda pair, axis: np.maximum(*pair) if len(pair) == 2 else np.amax(pair, axis),
    "amin": lambda pair, axis: np.minimum(*pair) if len(pair) == 2 else np.amin(pair, axis),
    "select": lambda when, then, default: (
        np.where(when[0], then[0], then[1]) if len(then) == 2 else np.select(when, then, default)
    ),
}


class Equations:
    """The equations of a model as functions of arrays.

    Raises:
        NotForThisPlantError: an equation is known by its structure only.

    Attributes:
        names: of the unknowns, derivatives among them.
        zero: (unknowns (n, c), known variables (m,), faults (k, c)) -> left less right, (equations, c).
        laws: which equations have several unknowns, as numbers 0 and 1.
    """

    def __init__(self, model: Model, knowns: Sequence[str]) -> None:
        import sympy  # noqa: PLC0415 - slow to load, and an extra

        from gateway_fdi.structure.generator.symbols import Symbols  # noqa: PLC0415

        if any(e.relation is None and not e.differential for e in model.equations):
            raise NotForThisPlantError("its equations are not written")
        symbols = Symbols(model, faulty=True)
        self._model, self._knowns = model, knowns
        self._equations = [e for e in model.equations if e.relation is not None]
        self.names = tuple(model.full_variables)
        values = {symbols.of[p]: model.quantities[p].value for p in model.parameters}
        told = [symbols.residual(e.relation).subs(values) for e in self._equations if e.relation is not None]
        tables = {name: lambda r, t=t: np.interp(r, t.x, t.y) for name, t in model.tables.items()}
        groups = [[symbols.of[x] for x in some] for some in (self.names, knowns, model.faults)]
        made: Callable[..., list[Array]] = sympy.lambdify(groups, told, modules=[FASTER | tables, "numpy"], cse=True)

        def zero(w: Array, z: Array, f: Array) -> Array:
            found = np.empty((len(told), w.shape[1]))
            with np.errstate(all="ignore"):
                for k, each in enumerate(made(w, z, f)):
                    found[k] = each
            return found

        self.zero = zero
        self.laws = np.array([float(len(e.variables) > 1) for e in self._equations])

    def begun(self, values: Array) -> Array:
        """Return unknowns that go with values of the known variables: each from an equation where it alone is left."""
        model, have = self._model, dict[str, float]()
        none = np.zeros((len(model.faults), 1))
        while len(have) < len(self.names):
            before = len(have)
            for k, equation in enumerate(self._equations):
                missing = [x for x in equation.variables if x not in have]
                if len(missing) == 1:
                    have[missing[0]] = self._solved(k, missing[0], have, values, none)
            left = [x for x in self.names if x not in have]
            if len(have) == before:
                name = next((x for x in left if x in model.states), left[0])
                moves = name in model.states or name.startswith("der(")
                have[name] = (model.quantities.get(name, Quantity()).value or 0.0) if moves else 1.0
        return np.array([have[x] for x in self.names])

    def _solved(self, k: int, name: str, have: dict[str, float], values: Array, none: Array) -> float:
        w = np.array([[have.get(x, 1.0)] for x in self.names])
        place = self.names.index(name)

        def off(value: float) -> float:
            w[place] = value
            return float(self.zero(w, values, none)[k, 0])

        for guess in (1.0, 100.0, 0.1):
            try:
                found = float(newton(off, guess, maxiter=100))
            except RuntimeError:
                continue
            if np.isfinite(found):
                return found
        return 1.0


class Ekf:
    """The bank: by how much the likeliest filter with a fault is likelier than the one without, in the last samples."""

    def fit(self, plant: Plant, healthy: Sequence[Record], faulty: Sequence[Record]) -> None:
        """Scale unknowns and faults, and choose the errors that make healthy records likeliest."""
        del faulty
        model = plant.model
        self._equations = Equations(model, plant.knowns)
        self._noise, names = np.array(plant.noise), self._equations.names
        first = settled(healthy[0].values)[0]
        begun = self._equations.begun(first)
        scale = np.maximum(np.abs(begun), 1e-3)
        self._move = np.zeros((len(names) + 1, len(names) + 1))
        self._move[-1, -1] = 1.0
        self._change = np.zeros((len(names) + 1, len(names) + 1))
        for k, name in enumerate(names):
            if name in model.states:
                at = names.index(der(name))
                scale[at] = scale[k] / plant.period_s
                # implicitly: the state moves by the derivative at its end, which is as unknown as all others
                self._move[k, k] = 1.0
                self._change[[k, k, at, at], [k, at, k, at]] = CHANGE**2
            elif not name.startswith("der("):
                self._move[k, k], self._change[k, k] = 1.0, CHANGE**2
        self._change[-1, -1] = WALK**2
        self._scale, self._faults, self._states = scale, tuple(plant.sizes), model.states
        self._place = [model.faults.index(fault) for fault in self._faults]
        self._sized(begun, first)
        likely = []
        for self._share in SHARES:
            likely.append(sum(float(settled(self._filtered(record, ())[1]).sum()) for record in healthy[:LEARNED]))
        self._share = SHARES[int(np.nanargmax(likely))]
        squared = [settled(self._filtered(record, ())[0]).mean() for record in healthy[:LEARNED]]
        self._wide = max(1.0, float(np.mean(squared)) / self._dof)

    def _sized(self, begun: Array, values: Array) -> None:
        """Scale the faults by what they change in an equation, and tell those that have one sign."""
        none = np.zeros((len(self._place), 1))
        zero = self._equations.zero
        here = zero(begun[:, None], values, none)
        steps = np.diag(STEP * self._scale)
        slopes = (zero(begun[:, None] + steps, values, none) - here) / STEP
        rows = np.sqrt(np.nansum(slopes**2, 1))
        self._dof = len(rows) - len(begun) + len(self._states)  # what a state was is known, too
        self._sizes, self._one_sided = np.ones(len(self._place)), np.zeros(len(self._place), np.bool_)
        for k, place in enumerate(self._place):
            some = none.copy()
            some[place] = 1e-3
            ahead, behind = (np.abs(zero(begun[:, None], values, each) - here)[:, 0] for each in (some, -some))
            slope = np.nanmax(ahead / (rows + 1e-12)) / 1e-3
            self._sizes[k] = FAULT / slope if slope > 0.0 else 1.0
            self._one_sided[k] = bool((ahead > 0.0).any()) and not (behind > 0.0).any()

    def _values(self, x: Array, z: Array, which: Sequence[int]) -> Array:
        """Return the equations' values, shape (b, columns, q), of states and size, shape (b, columns, n + 1)."""
        faults = np.zeros((*x.shape[:2], len(self._place)))
        for k, fault in enumerate(which):
            faults[k + 1, :, self._place[fault]] = self._sizes[fault] * x[k + 1, :, -1]
        flat = (x[:, :, :-1] * self._scale).reshape(-1, len(self._scale)).T
        found = self._equations.zero(flat, z[:, None], faults.reshape(-1, len(self._place)).T)
        return np.nan_to_num(found.T.reshape(*x.shape[:2], -1))

    def _slopes(self, x: Array, z: Array, which: Sequence[int], value: Array) -> tuple[Array, Array]:
        """Return the slopes of the equations by states and size (b, q, n + 1), and their covariance by noise (q, q)."""
        m, by = len(z), STEP * (np.abs(z) + 1e-3)
        ahead = self._values(x[:, None] + STEP * np.eye(x.shape[1]), z, which)
        slopes = (ahead - value[:, None]).transpose(0, 2, 1) / STEP
        w = np.repeat((x[0, :-1] * self._scale)[:, None], m, 1)
        known = self._equations.zero(w, z[:, None] + np.diag(by), np.zeros((len(self._place), m))).T
        known = np.nan_to_num((known - value[0]).T / by)
        return slopes, (known * self._noise**2) @ known.T

    def _filtered(self, record: Record, which: Sequence[int]) -> tuple[Array, Array]:
        """Return squared innovations without a fault, shape (n,), and log-likelihoods of each filter, (n, 1 + faults).

        Args:
            record: of the plant.
            which: faults that have a filter.
        """
        n, b = len(self._scale), 1 + len(which)
        x = np.zeros((b, n + 1))
        x[:, :n] = self._equations.begun(record.values[0]) / self._scale
        p = np.repeat(np.diag([*np.ones(n), 1.0])[None], b, 0)
        p[0, -1, -1] = 0.0
        change = np.repeat(self._change[None], b, 0)
        change[0, -1, -1] = 0.0
        signed = np.array([False, *(self._one_sided[fault] for fault in which)])
        squared, likely = np.empty(len(record.values)), np.empty((len(record.values), b))
        for k, z in enumerate(record.values):
            if k:
                x = x @ self._move.T
                p = self._move @ p @ self._move.T + change
            for _ in range(1 if k else ITERATIONS):
                value = self._values(x[:, None], z, which)[:, 0]
                if k % SAME == 0:
                    slopes, r = self._slopes(x, z, which, value)
                    rows = np.sqrt((slopes**2).sum(2)) * self._share * self._equations.laws + 1e-9
                    r = r + np.einsum("bq,qr->bqr", rows**2, np.eye(len(r)))
                gain = p @ slopes.transpose(0, 2, 1)
                s = slopes @ gain + r
                solved = np.linalg.solve(s, np.concatenate([value[:, :, None], gain.transpose(0, 2, 1)], 2))
                x = x - (gain @ solved[:, :, :1])[:, :, 0]
            x = np.clip(x, -FAR, FAR)
            x[signed, n] = np.maximum(x[signed, n], 0.0)
            p = p - gain @ solved[:, :, 1:]
            p = 0.5 * (p + p.transpose(0, 2, 1))
            distance = (value * solved[:, :, 0]).sum(1)
            squared[k] = distance[0]
            likely[k] = -0.5 * (distance + np.linalg.slogdet(s)[1])
        return squared, likely

    def run(self, record: Record) -> Found:
        """Return the largest logarithm of the likelihoods' ratio, and the faults by these."""
        _, likely = self._filtered(record, range(len(self._faults)))
        ahead = np.nan_to_num((likely[:, 1:] - likely[:, :1]) / self._wide, neginf=-1e3, nan=-1e3)
        found = np.hstack([np.zeros((len(ahead), 1)), summed(ahead, WINDOW)])
        weights = np.exp(found - found.max(1, keepdims=True))
        weights /= weights.sum(1, keepdims=True)
        return Found(found.max(1), weights[:, 1:])
