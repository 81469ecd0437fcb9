"""Failed tests that share components: how probable is each set of components that explains them?

With independent components, a test fails unless every faulty component that it sees escapes it, and no false alarm
comes: 1 - (1 - a) (1 - w1) (1 - w2) ... with its false alarm rate a and its powers w (noisy-or: Pearl, "Probabilistic
reasoning in intelligent systems" (1988), section 4.3.2). A test passes with what is left, so that passed tests are
factors of single components, and tests that failed count only where they share components. Weights are logarithms
against the weight of "nothing is faulty".

A passed test counts for a component if it passed still when it would have seen it: as long behind the latest failure
that blames the component as the test takes. A test that failed counts as *late* for a component if it had passed all
the time that it takes, behind the first failure that this component alone explains: it did not see the fault when it
should have, so that its failure is the less probable (w (1 - w)).

A component may be seen by way of another one: a message by its signals. If it alone explains a test that failed, that
signal is wrong; so what passed counts for it as for this signal, wherever it is seen by way of it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.diagnosis import sizes
from gateway_fdi.diagnosis.answer import Against, Wait
from gateway_fdi.diagnosis.state import FAILED, PASSED, State
from gateway_fdi.diagnosis.system import Floats, Ints, System
from gateway_fdi.hitting import NEVER

#: A contradiction is worth telling from this factor on.
TOLD = 0.5
#: Sizes that fit less well by chance once in so many times ask for one part more.
MISFIT = 1e-3


class Cluster:
    """Failed tests that share components.

    Args:
        system: what there is.
        state: what the tests say.
        failed: places of the tests, ascending.
        more: places of components that are suspected though none of them blames these.

    Attributes:
        failed: places of the tests, ascending.
        suspects: places of the components that they blame, and of those more, ascending.
        power: of each test for each suspect, 0: it does not see it, shape (tests, suspects).
        weights: of each suspect, by its prior and what passed, shape (suspects,).
    """

    def __init__(self, system: System, state: State, failed: tuple[int, ...], more: tuple[int, ...] = ()) -> None:
        self._system, self._state, self.failed = system, state, failed
        links = np.concatenate([system.of_test[t] for t in failed]) if failed else np.zeros(0, np.int64)
        self.suspects = np.union1d(system.link_component[links], np.array(more, np.int64))
        column = np.searchsorted(self.suspects, system.link_component[links])
        self._row = {t: k for k, t in enumerate(failed)}
        row = np.repeat(np.arange(len(failed)), [len(system.of_test[t]) for t in failed])
        self._rows, self._columns = row, column
        self.power: Floats = np.zeros((len(failed), len(self.suspects)))
        self.power[row, column] = system.power[links] * state.weaker[links]
        places = np.array(failed, np.int64)
        self._since: Ints = state.since[places]
        self._from: Ints = state.passed_from[places]
        self._due: Ints = system.delay_ns[places]
        self._alarm: Floats = system.false_alarm[places]
        sized = np.isfinite(state.gain[links]) & np.isfinite(self._residual_of(system.link_test[links]))
        self._sized = np.bincount(column, weights=sized, minlength=len(self.suspects)) > 0
        self._sized |= np.isin(self.suspects, more)
        self._known: dict[int, dict[int, float]] = {}
        self._by: dict[int, tuple[Ints, dict[int, float]]] = {}
        self._count_passes()

    def told(self, components: tuple[int, ...]) -> tuple[str, ...]:
        """Return the names that components, by their places, are told by, each once."""
        return tuple(sorted({self._system.components[c].told for c in components}))

    def widened(self, more: tuple[int, ...]) -> Cluster:
        """Return the same failed tests with more suspects, by their places."""
        return Cluster(self._system, self._state, self.failed, more)

    def _residual_of(self, tests: Ints) -> Floats:
        """Return the residuals of tests whose noise is known, NaN for others."""
        return np.where(np.isfinite(self._state.noise[tests]), self._state.residual[tests], np.nan)

    def _count_passes(self) -> None:
        """Weigh suspects by their priors, and by the tests that would have seen them."""
        system, state = self._system, self._state
        number = np.full(len(system.components), -1)
        number[self.suspects] = np.arange(len(self.suspects))
        links = system.by_component[number[system.link_component[system.by_component]] >= 0]
        column = number[system.link_component[links]]
        test = system.link_test[links]
        passed = state.verdict[test] == PASSED
        links, column, test = links[passed], column[passed], test[passed]
        never = np.iinfo(np.int64).min
        latest = np.full(len(self.suspects), never)
        np.maximum.at(latest, self._columns, self._since[self._rows])
        latest[latest == never] = self._since.max(initial=never)  # what none blames may be behind any
        due = latest[column] + system.delay_ns[test]
        counts = state.until[test] >= due
        by_size = self._sized[column] & np.isfinite(state.gain[links]) & np.isfinite(self._residual_of(test))
        clear = np.where(counts & ~by_size, system.log_escape[links], 0.0)
        self.weights: Floats = system.odds[self.suspects] + np.bincount(
            column, weights=clear, minlength=len(self.suspects)
        )
        sharp = by_size | (system.power[links] >= 1.0 - TOLD)  # its pass would say much
        self._passes = (column, test, clear, counts, due, sharp)

    @property
    def conflicts(self) -> list[int]:
        """Suspects of each test, as bits."""
        packed = np.packbits(self.power > 0.0, axis=1, bitorder="little")
        return [int.from_bytes(row.tobytes(), "little") for row in packed]

    @property
    def prices(self) -> list[float]:
        """Weight of each test as a false alarm."""
        return [float(value) for value in np.log(self._alarm)]

    # A set of suspects -----------------------------------------------------------------------------------------------

    def weight(self, suspects: tuple[int, ...], missed: tuple[int, ...] = ()) -> float:
        """Return the weight of a set of suspects, by their numbers; what it misses are false alarms."""
        chosen = list(suspects)
        total = math.fsum(self.weights[chosen])
        if not chosen:
            return total + math.fsum(self.prices)
        escape = np.prod(1.0 - self._powers(chosen), axis=1)
        fails = 1.0 - (1.0 - self._alarm) * escape
        fitted = self.fit(suspects)
        chance = 1.0 if fitted is None else fitted.chance
        if not fails.all():
            return NEVER
        return total + float(np.log(fails).sum()) + math.log(chance) + self._by_way(chosen)

    def _by_way(self, chosen: list[int]) -> float:
        """Return what passes weigh more, as those suspects see them by way of others that are wrong for sure."""
        sees = self.power[:, chosen] > 0.0
        alone = sees & (sees.sum(axis=1) == 1)[:, None]
        total = 0.0
        for at, k in enumerate(chosen):
            ways, more = self._ways(k)
            if more:
                total += math.fsum(more.get(way, 0.0) for way in {ways[row] for row in np.flatnonzero(alone[:, at])})
        return total

    def _ways(self, k: int) -> tuple[Ints, dict[int, float]]:
        """Return what each failed test sees a suspect by way of, and by each of these, what passes weigh more."""
        if k not in self._by:
            system, own = self._system, self.suspects[k]
            links = system.of_component[own]
            tests, via = system.link_test[links], system.via[links]
            ways = system.link_component[via]
            of_row, more = np.full(len(self.failed), own), dict[int, float]()
            if (ways != own).any():
                column, passed, clear, *_ = self._passes
                mine = slice(*np.searchsorted(column, (k, k + 1)))
                heavier = np.minimum(system.log_escape[via] - system.log_escape[links], 0.0)
                heavier[~np.isin(tests, passed[mine][clear[mine] < 0.0])] = 0.0
                for test, way, value in zip(tests.tolist(), ways.tolist(), heavier.tolist(), strict=True):
                    if test in self._row:
                        of_row[self._row[test]] = way
                    if way != own:
                        more[way] = more.get(way, 0.0) + value
            self._by[k] = (of_row, more)
        return self._by[k]

    def _powers(self, chosen: list[int]) -> Floats:
        """Return the powers of the failed tests for some suspects, less where a test is late, shape (tests, chosen)."""
        power: Floats = self.power[:, chosen]
        late = self._late(power)
        return np.where(late, power * (1.0 - power), power)

    def _late(self, power: Floats) -> NDArray[np.bool_]:
        sees = power > 0.0
        alone = sees & (sees.sum(axis=1) == 1)[:, None]
        never = np.iinfo(np.int64).max
        begun = np.where(alone, self._since[:, None], never).min(axis=0)
        known = begun < never
        due = np.where(known, begun, 0)[None, :] + self._due[:, None]
        late: NDArray[np.bool_] = sees & known & (self._from[:, None] <= due) & (due < self._since[:, None])
        return late

    def _signed(self, k: int) -> dict[int, float]:
        """Return tests that say something of a suspect's size -> gain: those that failed, those whose pass counts."""
        if k not in self._known:
            self._known[k] = self._look(k) if self._sized[k] else {}
        return self._known[k]

    def _look(self, k: int) -> dict[int, float]:
        system = self._system
        column, test, _, counts, _, _ = self._passes
        mine = slice(*np.searchsorted(column, (k, k + 1)))
        cleared = set(test[mine][counts[mine]].tolist())
        links = system.of_component[self.suspects[k]]
        tests = system.link_test[links]
        told = np.isfinite(self._state.gain[links]) & np.isfinite(self._residual_of(tests))
        pairs = zip(tests[told].tolist(), self._state.gain[links[told]].tolist(), strict=True)
        return {t: gain for t, gain in pairs if t in self._row or t in cleared}

    def fit(self, suspects: tuple[int, ...]) -> sizes.Fit | None:
        """Return the sizes of the suspects of a set whose gains are known; None: there are none.

        A residual that another suspect of the set disturbs, in a way that is not known, says nothing.
        """
        sized = [k for k in suspects if self._sized[k]]
        if not sized:
            return None
        system = self._system
        gains: dict[int, list[float]] = {}
        for at, k in enumerate(sized):
            for test, gain in self._signed(k).items():
                gains.setdefault(test, [0.0] * len(sized))[at] = gain
        for k in suspects if len(suspects) > 1 else ():
            known = self._signed(k)
            for link in system.of_component[self.suspects[k]]:
                if int(system.link_test[link]) not in known:
                    gains.pop(int(system.link_test[link]), None)
        tests = sorted(gains)
        if not tests:
            return None
        state = self._state
        return sizes.fit(
            state.residual[tests], np.array([gains[t] for t in tests]), state.noise[tests], state.gain_error[tests]
        )

    def hidden_by(self, suspects: tuple[int, ...]) -> tuple[int, ...]:
        """Return places of components that may cancel what one of a set of suspects does; none, where its sizes fit.

        Two errors that cancel each other in a test leave it passing, so that no failed test needs the second one.
        """
        fitted = self.fit(suspects)
        if fitted is None or fitted.chance >= MISFIT:
            return ()
        system, state = self._system, self._state
        tests = sorted({test for k in suspects for test in self._signed(k)})
        links = np.concatenate([system.of_test[t] for t in tests])
        found = np.unique(system.link_component[links[np.isfinite(state.gain[links])]])
        own = np.isin(system.link_test, self.failed)
        others = system.link_component[(state.verdict[system.link_test] == FAILED) & ~own]
        gone = np.union1d(others, self.suspects[list(suspects)])  # of another group, or there already
        return tuple(np.setdiff1d(found, gone).tolist())

    def against(self, suspects: tuple[int, ...], missed: tuple[int, ...]) -> tuple[Against, ...]:
        """Return what contradicts a set of suspects, heaviest first."""
        column, test, clear, _, _, _ = self._passes
        own = np.isin(column, suspects) & (clear < math.log(TOLD))
        told = [Against(int(t), "passed", math.exp(value)) for t, value in zip(test[own], clear[own], strict=True)]
        told += [Against(self.failed[k], "false alarm", float(self._alarm[k])) for k in missed]
        if suspects:
            power = self.power[:, list(suspects)]
            late = self._late(power) & (1.0 - power < TOLD)
            told += [Against(self.failed[k], "late", float(1.0 - power[k].max())) for k in np.flatnonzero(late.any(1))]
        fitted = self.fit(suspects)
        if fitted is not None and fitted.chance < TOLD**3:  # as small by chance once in eight times
            told.append(Against(-1, "size", fitted.chance))
        return tuple(sorted(told, key=lambda one: (one.factor, one.test)))

    def waiting(self, suspects: set[int]) -> tuple[Wait, ...]:
        """Return the tests that can still speak.

        Those that passed, but not late enough, and that could clear one of some suspects; and those that fail still
        where another one has healed since, until they have had their time: they may heal by the same cause.
        """
        column, test, _, counts, due, sharp = self._passes
        open_ = ~counts & sharp & np.isin(column, list(suspects))
        until: dict[int, int] = {}
        for t, at in zip(test[open_].tolist(), due[open_].tolist(), strict=True):
            until[t] = max(until.get(t, 0), at)
        state = self._state
        healed = np.unique(test[state.healed[test] > self._since.min()]) if len(self.failed) else test[:0]
        for t, since, takes in zip(self.failed, self._since, self._due, strict=True):
            mine = healed[(state.healed[healed] > since) & (state.until[healed] < state.healed[healed] + takes)]
            if len(mine):
                until[t] = int(state.healed[mine].max() + takes)
        return tuple(Wait(t, until[t]) for t in sorted(until))
