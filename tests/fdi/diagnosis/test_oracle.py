"""Diagnoses against an oracle that looks at all subsets of the components, in plain Python and numpy."""

import math

import numpy as np
import pytest
from amount import amount, examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_systems import a_system, ran, some_updates

from gateway_fdi.diagnosis.search import Bounds
from gateway_fdi.diagnosis.state import FAILED, NOT_TESTED, PASSED
from gateway_fdi.diagnosis.system import Component

SEED = 4711
ALL = Bounds(diagnoses=1 << 20, least=0.0, steps=1 << 30)


# The oracle ----------------------------------------------------------------------------------------------------------


def standing(tests, updates):
    """Return of each test: verdict, since, until, since when it had passed before, residual."""
    now = {test.name: [NOT_TESTED, 0, 0, None, math.nan] for test in tests}
    for name, verdict, t, residual in updates:
        row = now[name]
        if verdict != row[0]:
            row[3] = row[1] if (row[0], verdict) == (PASSED, FAILED) else None
            row[0], row[1] = verdict, t
        row[2], row[4] = t, residual
    return now


class Oracle:
    def __init__(self, components, tests, updates):
        self.components, self.tests = [c.name for c in components], tests
        self.prior = {c.name: c.prior for c in components}
        self.now = standing(tests, updates)
        self.failed = [t for t in tests if self.now[t.name][0] == FAILED]
        self.power = {(t.name, link.component): link.power for t in tests for link in t.links}
        self.own_gain = {(t.name, link.component): link.gain for t in tests for link in t.links}
        self.via = {(t.name, link.component): link.via or link.component for t in tests for link in t.links}
        self.gain = {(test, name): self.own_gain[test, via] for (test, name), via in self.via.items()}
        self.sees = {t.name: {link.component for link in t.links} for t in tests}
        self.delay = {t.name: round(t.delay_s * 1e9) for t in tests}
        self.apart = []  # components that failed tests connect
        for t in self.failed:
            mine = self.sees[t.name].union(*(one for one in self.apart if one & self.sees[t.name]))
            self.apart = [one for one in self.apart if not one & mine] + [mine]

    def signed(self, test, name):
        return (
            not math.isnan(test.noise)
            and not math.isnan(self.now[test.name][4])
            and not math.isnan(self.gain.get((test.name, name), math.nan))
        )

    def diagnoses(self):
        """Return each set whose members are needed, or asked for by what failed or by sizes -> its probability."""
        whole = {frozenset(): 0.0}
        for apart in self.apart:
            mine = Apart(self, [t for t in self.failed if self.sees[t.name] & apart]).weights()
            whole = {a | b: w + v for a, w in whole.items() for b, v in mine.items()}
        top = max(whole.values())
        every = sum(math.exp(w - top) for w in whole.values())
        return {chosen: math.exp(w - top) / every for chosen, w in whole.items()}


def likeliest(found):
    ranked = sorted(found, key=lambda one: -found[one])[:16]
    return [one for one in ranked if found[one] >= found[ranked[0]] - math.log(1e6)]


class Apart:
    """Failed tests that components connect."""

    def __init__(self, oracle, failed):
        self.o, self.failed = oracle, failed
        self.blamed = [name for name in oracle.components if any(name in oracle.sees[t.name] for t in failed)]
        self.more = frozenset()

    def is_sized(self, name):
        return name in self.more or any(self.o.signed(t, name) for t in self.failed)

    def counts(self, test, name):
        mine = [t for t in self.failed if name in self.o.sees[t.name]] or self.failed
        latest = max(self.o.now[t.name][1] for t in mine)
        verdict, _, until, _, _ = self.o.now[test.name]
        return verdict == PASSED and until >= latest + self.o.delay[test.name]

    def of_component(self, name):
        p = self.o.prior[name]
        weight = math.log(p / (1 - p))
        for t in self.o.tests:
            by_size = self.is_sized(name) and self.o.signed(t, name)
            if name in self.o.sees[t.name] and not by_size and self.counts(t, name):
                weight += math.log(1 - self.o.power[t.name, name])
        return weight

    def by_way(self, name, chosen):
        """What passes weigh more, where only this one of the set explains a failure, by way of another one."""
        o = self.o
        wrong = {o.via[t.name, name] for t in self.failed if o.sees[t.name] & chosen == {name}} - {name}
        weight = 0.0
        for t in o.tests:
            if name not in o.sees[t.name] or o.via[t.name, name] not in wrong:
                continue
            if self.counts(t, name) and not (self.is_sized(name) and o.signed(t, name)):
                own, other = o.power[t.name, name], o.power[t.name, o.via[t.name, name]]
                weight += min(math.log(1 - other) - math.log(1 - own), 0.0)
        return weight

    def weight(self, chosen):
        o = self.o
        total = sum(self.of_component(name) + self.by_way(name, chosen) for name in chosen)
        alone = {}
        for t in self.failed:
            mine = o.sees[t.name] & chosen
            if len(mine) == 1:
                name = next(iter(mine))
                alone[name] = min(alone.get(name, math.inf), o.now[t.name][1])
        for t in self.failed:
            passes = 1 - t.false_alarm
            _, since, _, passed_from, _ = o.now[t.name]
            for name in sorted(o.sees[t.name] & chosen):
                power = o.power[t.name, name]
                if name in alone and passed_from is not None:
                    due = alone[name] + o.delay[t.name]
                    if passed_from <= due < since:
                        power *= 1 - power
                passes *= 1 - power
            total += math.log(1 - passes)
        return total + math.log(self.chance(chosen))

    def rows(self, chosen):
        """Return the tests that say something of the sizes of a set, and how likely another one disturbs each."""
        for t in self.o.tests:
            mine = self.o.sees[t.name] & chosen
            signed = {name for name in mine if self.is_sized(name) and self.o.signed(t, name)}
            if signed and (t in self.failed or all(self.counts(t, name) for name in signed)):
                calm = math.prod(1 - self.o.power[t.name, name] for name in mine - signed)
                yield t, signed, 1 - calm if mine - signed else None

    def chance(self, chosen):
        rows = list(self.rows(chosen))
        optional = self.optional(chosen) if len(chosen) > 1 else {}
        disturb = [p for _, _, p in rows if p is not None]
        quiet = [(t, {n for n in mine if (n, self.o.via[t.name, n]) not in optional}, p) for t, mine, p in rows]
        none = self.misfit([row for row in quiet if row[1]])
        used = {(n, self.o.via[t.name, n]) for t, mine, _ in rows for n in mine} & set(optional)
        if not disturb and not used:
            return none
        price = math.prod(disturb) * math.prod(optional[one] for one in used)
        return max(none, price * self.misfit([row for row in rows if row[2] is None]))

    def optional(self, chosen):
        """Return what each is seen by way of, if no failed test shows it alone -> how often it makes that wrong."""
        shares = {}
        for (test, name), via in self.o.via.items():
            if name in chosen and via != name:
                share = min(self.o.power[test, name] / self.o.power[test, via], 1.0)
                shares[name, via] = max(shares.get((name, via), 0.0), share)
        alone = {(n, self.o.via[t.name, n]) for t in self.failed for n in chosen if self.o.sees[t.name] & chosen == {n}}
        return {one: share for one, share in shares.items() if one not in alone}

    def misfit(self, told):
        from scipy.stats import chi2

        # each size is of a component, or of what it is seen by way of
        sizes = sorted({(name, self.o.via[t.name, name]) for t, mine, _ in told for name in mine})
        rows = [
            (t, [self.o.gain[t.name, n] if n in mine and self.o.via[t.name, n] == way else 0.0 for n, way in sizes])
            for t, mine, _ in told
        ]
        if not rows:
            return 1.0
        r = np.array([self.o.now[t.name][4] for t, _ in rows])
        gains, expected = np.array([g for _, g in rows]), r
        for _ in range(2):
            most = np.maximum(abs(r), abs(expected))
            spread = np.array([math.hypot(t.noise, t.gain_error * m) for (t, _), m in zip(rows, most, strict=True)])
            size, _, rank, _ = np.linalg.lstsq(gains / spread[:, None], r / spread, rcond=None)
            expected = gains @ size
        degrees = len(r) - rank
        misfit = float((((r - expected) / spread) ** 2).sum())
        return max(float(chi2.sf(misfit, degrees)), 1e-9) if degrees > 0 else 1.0

    def needed(self):
        """Yield each set all of whose members are needed."""
        index = np.arange(1 << len(self.blamed))
        hit = np.zeros((len(self.failed), len(index)), np.int64)
        for k, name in enumerate(self.blamed):
            for row, t in enumerate(self.failed):
                if name in self.o.sees[t.name]:
                    hit[row] += index >> k & 1
        needed = np.ones(len(index), bool)
        for k, name in enumerate(self.blamed):
            own = np.zeros(len(index), bool)
            for row, t in enumerate(self.failed):
                if name in self.o.sees[t.name]:
                    own |= hit[row] == 1
            needed &= own | (index >> k & 1 == 0)
        for mask in index[needed].tolist():
            yield frozenset(name for k, name in enumerate(self.blamed) if mask >> k & 1)

    def asks_for(self, chosen):
        """Return those with one of whom a set makes what failed likelier than that one costs, by powers alone."""

        def fails(names):
            escape = (math.prod(1 - self.o.power.get((t.name, n), 0.0) for n in names) for t in self.failed)
            return sum(math.log(1 - (1 - t.false_alarm) * e) for t, e in zip(self.failed, escape, strict=True))

        own = fails(chosen)
        return [n for n in self.blamed if n not in chosen and fails(chosen | {n}) - own + self.of_component(n) > 0]

    def larger(self, found):
        """Return sets that are likelier than each with one part less; each has one of the likeliest in it."""
        looked = likeliest(found)
        known = dict(found)
        for chosen in looked:
            for name in self.asks_for(chosen) if len(looked) < 64 else []:
                wider = chosen | {name}
                if wider not in known:
                    known[wider] = self.weight(wider)
                    looked.append(wider)
        less = {one: max(known.get(one - {n}, -math.inf) for n in one) for one in looked if one not in found}
        return {one: known[one] for one in less if known[one] > less[one]}

    def weights(self):
        """Return each set -> its weight; of the likeliest ones the first whose sizes do not fit, with one more."""
        found = {chosen: self.weight(chosen) for chosen in self.needed()}
        found |= self.larger(found)
        for chosen in likeliest(found):
            if self.chance(chosen) < 1e-3:
                others = {n for t in self.o.failed if t not in self.failed for n in self.o.sees[t.name]}
                tests = {t for name in chosen for t, *_ in self.rows({name})}
                near = {n for t in tests for n in self.o.sees[t.name] if not math.isnan(self.o.own_gain[t.name, n])}
                self.more = frozenset(near - others - chosen)
                if self.more:
                    with_one = {chosen | {n}: self.weight(chosen | {n}) + math.log(0.1) for n in self.more}
                    less = {one: max(found.get(one - {n}, -math.inf) for n in one) for one in with_one}
                    return {one: w for one, w in with_one.items() if w > less[one]} | found
        return found


def combined(groups, names):
    """Return what is wrong as a whole -> its probability: one diagnosis of each group."""
    whole = {frozenset(): 1.0}
    for group in groups:
        whole = {
            chosen | {names[c] for c in one.components}: p * one.probability
            for chosen, p in whole.items()
            for one in group.diagnoses
        }
    return whole


def test_all_subsets():
    """Every case: the same sets, with the same probabilities."""
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    several = late = 0
    for case in range(amount(10_000, 400, 80)):
        components, tests = a_system(rng)
        updates = some_updates(rng, components, tests)
        diagnoser = ran(components, tests, updates, ALL)
        groups = diagnoser.diagnose()
        oracle = Oracle(components, tests, updates)
        assert sorted(t for g in groups for t in g.failed) == [tests.index(t) for t in oracle.failed], case
        if not groups:
            continue
        wanted = oracle.diagnoses()
        found = combined(groups, [c.name for c in components])
        assert set(found) == set(wanted), case
        for chosen, p in wanted.items():
            assert found[chosen] == pytest.approx(p, rel=1e-6, abs=1e-12), (case, sorted(chosen))
        several += len(groups) > 1
        late += any(one.why == "late" for g in groups for d in g.diagnoses for one in d.against)
    assert several > 0
    assert late > 0


def test_a_search_of_usual_bounds_has_what_all_subsets_have():
    """The likeliest, with nearly the same probabilities: what is not looked at is not forgotten."""
    print("seed", SEED + 1)
    rng = np.random.default_rng(SEED + 1)
    for case in range(amount(4000, 150, 40)):
        components, tests = a_system(rng)
        components = [Component(c.name, prior=c.prior * 0.03) for c in components]
        updates = some_updates(rng, components, tests)
        every = ran(components, tests, updates, ALL).diagnose()
        few = ran(components, tests, updates, Bounds(diagnoses=4)).diagnose()
        for whole, part in zip(every, few, strict=True):
            for one, other in zip(whole.diagnoses, part.diagnoses, strict=False):
                assert other.probability == pytest.approx(one.probability, rel=0.05, abs=1e-6), case
            assert part.rest + sum(d.probability for d in part.diagnoses) == pytest.approx(1.0)


@settings(max_examples=examples(60), deadline=None, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 2**32 - 1))
def test_all_subsets_of_any_seed(seed):
    """As above, with cases that hypothesis looks for."""
    rng = np.random.default_rng(seed)
    components, tests = a_system(rng)
    updates = some_updates(rng, components, tests)
    groups = ran(components, tests, updates, ALL).diagnose()
    if groups:
        wanted = Oracle(components, tests, updates).diagnoses()
        found = combined(groups, [c.name for c in components])
        assert set(found) == set(wanted)
        assert all(found[chosen] == pytest.approx(p, rel=1e-6, abs=1e-12) for chosen, p in wanted.items())
