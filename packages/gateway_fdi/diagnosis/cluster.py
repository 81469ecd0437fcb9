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
signal is wrong; so what passed counts for it as for this signal, wherever it is seen by way of it. Each signal has a
size of its own then, that all tests have to fit which see it.
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


def _alone(power: Floats) -> NDArray[np.bool_]:
    """Return which component sees a test alone, by the powers, shape (tests, components)."""
    sees = power > 0.0
    alone: NDArray[np.bool_] = sees & (sees.sum(axis=1) == 1)[:, None]
    return alone


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
        sized = self._says_size(links)
        self._sized = np.bincount(column, weights=sized, minlength=len(self.suspects)) > 0
        self._sized |= np.isin(self.suspects, more)
        self._known: dict[int, dict[int, tuple[int, float]]] = {}
        self._by: dict[int, tuple[Ints, dict[int, float]]] = {}
        self._others: dict[int, list[tuple[int, float]]] = {}
        self._makes: dict[int, dict[int, float]] = {}
        self._count_passes()

    def told(self, components: tuple[int, ...]) -> tuple[str, ...]:
        """Return the names that components, by their places, are told by, each once."""
        return tuple(sorted({self._system.components[c].told for c in components}))

    def widened(self, more: tuple[int, ...]) -> Cluster:
        """Return the same failed tests with more suspects, by their places."""
        return Cluster(self._system, self._state, self.failed, more)

    def _gain_of(self, links: Ints) -> Floats:
        """Return the gains by which tests see components, or what they see these by way of; NaN: not known."""
        gains: Floats = self._state.gain[self._system.via[links]]
        return gains

    def _says_size(self, links: Ints) -> NDArray[np.bool_]:
        """Return whether a link has a gain, and its test a residual whose noise is known, shape (links,)."""
        test, state = self._system.link_test[links], self._state
        finite: NDArray[np.bool_] = np.isfinite(self._gain_of(links) + state.noise[test] + state.residual[test])
        return finite

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
        by_size = self._sized[column] & self._says_size(links)
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
        if not fails.all():
            return NEVER
        return total + float(np.log(fails).sum()) + math.log(self.fit(suspects)) + self._by_way(chosen)

    def _by_way(self, chosen: list[int]) -> float:
        """Return what passes weigh more, as those suspects see them by way of others that are wrong for sure."""
        shown = self._shown(chosen)
        return math.fsum(self._ways(k)[1].get(way, 0.0) for k in chosen for way in shown[k])

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
        sees, alone = power > 0.0, _alone(power)
        never = np.iinfo(np.int64).max
        begun = np.where(alone, self._since[:, None], never).min(axis=0)
        known = begun < never
        due = np.where(known, begun, 0)[None, :] + self._due[:, None]
        late: NDArray[np.bool_] = sees & known & (self._from[:, None] <= due) & (due < self._since[:, None])
        return late

    def _signed(self, k: int) -> dict[int, tuple[int, float]]:
        """Return tests that say something of a suspect's sizes: those that failed, those whose pass counts.

        Of each the place of the component whose size it is, itself or what it is seen by way of; and the gain.
        """
        if k not in self._known:
            self._known[k] = self._look(k) if self._sized[k] else {}
        return self._known[k]

    def _look(self, k: int) -> dict[int, tuple[int, float]]:
        system = self._system
        column, test, _, counts, _, _ = self._passes
        mine = slice(*np.searchsorted(column, (k, k + 1)))
        cleared = set(test[mine][counts[mine]].tolist())
        links = system.of_component[self.suspects[k]]
        tests, gains = system.link_test[links], self._gain_of(links)
        told = self._says_size(links)
        ways = system.link_component[system.via[links[told]]].tolist()
        each = zip(tests[told].tolist(), ways, gains[told].tolist(), strict=True)
        return {t: (way, gain) for t, way, gain in each if t in self._row or t in cleared}

    def fit(self, suspects: tuple[int, ...]) -> float:
        """Return how probable it is that residuals fit the sizes of a set's suspects as badly; 1: none has a size.

        A suspect of the set may disturb a residual, or leave it alone: one whose gain is not known, by its power; one
        that is seen by way of another, unless a failed test shows that this is wrong, as often as it makes that wrong.
        The likelier of both counts: that all do so, or that none does.
        """
        if not any(self._sized[list(suspects)]):
            return 1.0
        shown = self._shown(list(suspects))
        gains: dict[int, dict[tuple[int, int], float]] = {}
        price: dict[tuple[int, int], float] = {}
        for k in suspects:
            for test, (way, gain) in self._signed(k).items():
                gains.setdefault(test, {})[k, way] = gain
            if len(suspects) > 1:
                price |= {(k, way): share for way, share in self._shares(k).items() if way not in shown[k]}
        disturbed = dict[int, float]()
        for k in suspects if len(suspects) > 1 else ():
            for test, power in self._unsigned(k):
                if power < 0.0:
                    gains.pop(test, None)
                else:
                    disturbed[test] = 1.0 - (1.0 - disturbed.get(test, 0.0)) * (1.0 - power)
        quiet = {t: {size: g for size, g in row.items() if size not in price} for t, row in gains.items()}
        none = self._chance({t: row for t, row in quiet.items() if row})
        prices = [disturbed[test] for test in gains if test in disturbed]
        prices += [price[size] for size in {size for row in gains.values() for size in row} & price.keys()]
        if not prices:
            return none
        left = {test: row for test, row in gains.items() if test not in disturbed}
        return max(none, math.prod(prices) * self._chance(left))

    def _unsigned(self, k: int) -> list[tuple[int, float]]:
        """Return the other tests that see a suspect, and its powers; -1: a gain is known, but the pass is too early."""
        if k not in self._others:
            links, known = self._system.of_component[self.suspects[k]], self._signed(k)
            tests = self._system.link_test[links]
            powers = np.where(self._says_size(links) & self._sized[k], -1.0, self._system.power[links])
            self._others[k] = [(t, w) for t, w in zip(tests.tolist(), powers.tolist(), strict=True) if t not in known]
        return self._others[k]

    def _shown(self, chosen: list[int]) -> dict[int, set[int]]:
        """Return by suspect what it is seen by way of in tests that fail by it alone: that is wrong for sure."""
        alone = _alone(self.power[:, chosen])
        return {k: {int(self._ways(k)[0][row]) for row in np.flatnonzero(alone[:, at])} for at, k in enumerate(chosen)}

    def _shares(self, k: int) -> dict[int, float]:
        """Return by what a suspect is seen by way of, how often it makes that wrong."""
        if k not in self._makes:
            system, own = self._system, self.suspects[k]
            links = system.of_component[own]
            via = system.via[links]
            made = self._makes[k] = dict[int, float]()
            ways = system.link_component[via].tolist()
            for way, share in zip(ways, (system.power[links] / system.power[via]).tolist(), strict=True):
                if way != own:
                    made[way] = max(made.get(way, 0.0), min(share, 1.0))
        return self._makes[k]

    def _chance(self, gains: dict[int, dict[tuple[int, int], float]]) -> float:
        """Return how probable as large a misfit is, of tests with their gains by each size."""
        if not gains:
            return 1.0
        state, tests = self._state, sorted(gains)
        each = sorted({size for of_test in gains.values() for size in of_test})
        by_test = np.array([[gains[t].get(size, 0.0) for size in each] for t in tests])
        return sizes.fit(state.residual[tests], by_test, state.noise[tests], state.gain_error[tests]).chance

    def beside(self, suspects: tuple[int, ...]) -> list[int]:
        """Return suspects that may be wrong beside a set: with one of them, what failed is likelier than it costs."""
        passes = (1.0 - self._alarm) * np.prod(1.0 - self.power[:, list(suspects)], axis=1)
        fails = 1.0 - passes[:, None] * (1.0 - self.power)
        more = self.weights + np.log(fails / (1.0 - passes)[:, None]).sum(axis=0)
        more[list(suspects)] = NEVER
        return [int(k) for k in np.flatnonzero(more > 0.0)]

    def hidden_by(self, suspects: tuple[int, ...]) -> tuple[int, ...]:
        """Return places of components that may cancel what one of a set of suspects does; none, where its sizes fit.

        Two errors that cancel each other in a test leave it passing, so that no failed test needs the second one.
        """
        if self.fit(suspects) >= MISFIT:
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
        chance = self.fit(suspects)
        if chance < TOLD**3:  # as small by chance once in eight times
            told.append(Against(-1, "size", chance))
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
