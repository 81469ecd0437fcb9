"""Judge the crankshaft monitor on wheels and on combinations of faults that nobody chose.

``wheels``: gap patterns at random, 1 to 4 gaps of 2 to 4 pitches, 4 to 180 pulses, in pitches, scaled, or in degrees.
Each has to be accepted, unless a rotation maps it onto itself (found here by the pattern alone), and to be synchronised
within 6 turns after its places differ, with no wrong tooth proven.

``combinations``: two conditions at random on 12 wheels, through the frames of dbc/crank.dbc. Counted are the runs with
a wrong tooth proven later than two turns behind an event, the later fault that was named, reports that blame no part
that is at fault, and runs whose reports together prove a healthy part as the cause, as the gateway counts causes.

``same``: the table of docs/crank/crank.md, wheels whose pulses are those of another one with defects.

python bench/crank_judge.py wheels --count 1000 --seed 1
python bench/crank_judge.py combinations --count 10000 --seed 1
"""

from __future__ import annotations

import argparse
import json
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import cantools
import numpy as np

from gateway.bus.frames import payload
from gateway.engine.build import build_engine
from gateway.engine.depends.parts import OWN
from gateway.engine.events import QUALIFIED_FAILED
from gateway.engine.instances import MonitorInstance
from gateway.monitors.contract import FAILED
from gateway.signals.database import load_database
from gateway_causes.causes import FALSE_ALARM
from gateway_fdi.common.resources import shipped
from gateway_fdi.diagnosis.diagnoser import Diagnoser
from gateway_fdi.diagnosis.system import Component, Link, Test
from gateway_plants.crank.ecu.kinematics import cam_edges, tooth_times
from gateway_plants.crank.ecu.tooth_frames import WIRE_NS, cam_frames, tooth_frames
from gateway_plants.crank.monitor import MONITOR, sync_state
from gateway_plants.crank.monitor.candidate_wheels import MADE
from gateway_plants.crank.monitor.faults import BLAMES, FAULTS
from gateway_plants.crank.monitor.monitor import Params
from gateway_plants.crank.study import outside
from gateway_plants.crank.study.follow import follower
from gateway_plants.crank.wheel import Wheel

WHEELS = (
    *("60-2", "36-1", "36-2", "30-2", "24-1", "12-1", "36-2-1", "36-2-2-2", "16*1,3,14*1,3", "12+1"),
    *("57*6,18", "7*1,3,23*1,3"),
)
#: Turns of a run; events come at these turns, and those from key-on at 0.
TURNS, FIRST, SECOND = 48, 14, 24
GRACE = 2
HALF_MOON = ((100.0, 1), (460.0, 0))
FOUND = 6
#: What a tooth is off [pitch] before it counts as bent.
SAME = 0.15
#: Ratio from which on two patterns differ.
DIFFER = 1.3


def pattern(rng):
    """Return the pitches of a wheel at random, as text and as numbers."""
    pulses = int(np.exp(rng.uniform(np.log(4), np.log(181))))
    gaps = int(rng.integers(1, min(4, pulses - 1) + 1))
    pitches = np.ones(pulses)
    pitches[rng.choice(pulses, gaps, replace=False)] = rng.integers(2, 5, gaps)
    unit = [1.0, 1.0, 0.5, 2.0, 360.0 / pitches.sum()][int(rng.integers(5))]
    return ",".join(f"{p * unit:.6f}".rstrip("0").rstrip(".") for p in pitches), pitches


def repeats(pitches):
    """Tell whether a rotation maps a pattern onto itself."""
    return any((np.roll(pitches, k) == pitches).all() for k in range(1, len(pitches)))


def differs(pitches, first):
    """Return after how many intervals from a pulse on no other place has the same pattern, at any speed."""
    left = [k for k in range(len(pitches)) if k != first]
    n = 0
    while left:
        n += 1
        seen = pitches[(first + np.arange(n)) % len(pitches)]
        ratios = [pitches[(k + np.arange(n)) % len(pitches)] / seen for k in left]
        left = [k for k, r in zip(left, ratios, strict=True) if r.max() < DIFFER * r.min()]
    return n


def one_wheel(job):
    """Return what happened on one wheel: text, turns until it was proven, wrong pulses, error."""
    seed, number = job
    rng = np.random.default_rng([seed, number])
    text, pitches = pattern(rng)
    if repeats(pitches):
        return None
    try:
        wheel = Params(wheel=text).wheel
    except ValueError as error:
        return text, np.inf, 0, str(error)
    rpm = float(np.exp(rng.uniform(np.log(max(500.0, sync_state.proof_rpm(wheel))), np.log(6500.0))))
    ripple = [(2.0, min(0.05, 40 / rpm), rng.uniform(0, 6))]
    first = int(rng.integers(wheel.pulses))
    turns = 24
    times = (
        tooth_times(wheel, [(0, rpm)], turns * 60 / rpm, ripple=ripple, jitter=0.01, tooth_error=0.003, rng=rng)[first:]
        / 1e3
    )
    teeth = np.arange(first, first + len(times)) % wheel.pulses
    found = follower("adaptive", wheel)(times)
    proven = np.flatnonzero(found.proven)
    begins = proven[0] + 1 if len(proven) else np.inf
    late = (begins - differs(np.asarray(wheel.pitches), first)) / wheel.pulses
    wrong = int((found.proven & (found.teeth != teeth[1:])).sum())
    names = ",".join(sorted({FAULTS[k].name for k in found.fault}))
    return text, late, wrong, names


@dataclass
class Run:
    """A run that is being made: pulses, and what is done to them."""

    wheel: Wheel
    rng: np.random.Generator
    rpm: float
    times: np.ndarray = field(default_factory=lambda: np.zeros(0))
    teeth: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    turn: np.ndarray = field(default_factory=lambda: np.zeros(0))
    events: list = field(default_factory=list)
    allowed: set = field(default_factory=set)
    wanted: list = field(default_factory=list)
    asked: dict = field(default_factory=dict)
    now: str = ""
    loss: float = 0.0
    restart: float = -1.0
    cam_moved: float = 0.0
    turned: tuple = ()

    def insert(self, times):
        both = np.concatenate([self.times, times])
        order = np.argsort(both, kind="stable")
        turn = np.interp(both, self.times, self.turn)
        self.teeth = np.concatenate([self.teeth, np.full(len(times), -1)])[order]
        self.times, self.turn = both[order], turn[order]
        self.keep(np.concatenate([[True], np.diff(self.times) > 1.0]))

    def keep(self, which):
        self.times, self.teeth, self.turn = self.times[which], self.teeth[which], self.turn[which]

    def inner(self):
        """Return a tooth that is two away from any wide pitch."""
        pitches = np.asarray(self.wheel.pitches)
        wide = pitches > 1.2 * np.median(pitches)
        near = wide | np.roll(wide, 1) | np.roll(wide, 2) | np.roll(wide, -1) | np.roll(wide, 3)
        free = np.flatnonzero(~near)
        return int(self.rng.choice(free if len(free) else np.arange(self.wheel.pulses)))

    def pitch(self, which=slice(None)):
        """Return the time of a pitch behind some pulses [us]: an engine that was started has run up."""
        spans = np.asarray(self.wheel.pitches)[self.teeth]
        intervals = np.diff(self.times, append=2 * self.times[-1] - self.times[-2])
        alone = np.diff(self.teeth, append=self.teeth[-1] + 1) % self.wheel.pulses == 1
        usual = 60e6 / self.rpm / self.wheel.turn
        return np.where(alone & (self.teeth >= 0), np.minimum(intervals / spans, usual), usual)[which]

    def told(self, names, others=()):
        self.wanted.append(set(names))
        self.asked.setdefault(self.now, set(names))
        self.allowed |= {*names, *others}


def broken(run, at):
    tooth = run.inner()
    run.keep(~((run.teeth == tooth) & (run.turn >= at)))
    run.told(("missed_pulse", "damaged_tooth", "two_places", "wrong_wheel"), ("pulses_lost", "relocated", "sync_lost"))


def bent(run, at):
    tooth, off = run.inner(), run.rng.choice([-1, 1]) * run.rng.uniform(0.25, 0.4)
    run.times = run.times + np.where((run.teeth == tooth) & (run.turn >= at), off * run.pitch(), 0.0)
    if run.rpm < 850.0:  # slower, ripple of an engine moves teeth as far
        run.allowed |= {"damaged_tooth", "missed_pulse", "added_pulse", "sync_lost", "runout"}
        return
    run.told(("damaged_tooth",), ("missed_pulse", "added_pulse", "sync_lost", "runout"))


def doubled(run, at):
    tooth = run.inner()
    which = (run.teeth == tooth) & (run.turn >= at)
    run.insert(run.times[which] + run.rng.uniform(0.15, 0.5) * run.pitch(which))
    run.told(("added_pulse", "doubled_edges", "two_places"), ("noise", "sync_lost", "wrong_wheel"))


def filled(run, at):
    last = run.wheel.pulses - 1
    if max(run.wheel.pitches) < 1.5 * np.median(run.wheel.pitches):
        doubled(run, at)  # no gap: halfway between two teeth it would be the wheel's own mark
        return
    share = run.rng.uniform(0.3, 0.7) * max(run.wheel.pitches)
    which = (run.teeth == last) & (run.turn >= at)
    run.insert(run.times[which] + share * run.pitch(which))
    run.told(("added_pulse", "wrong_wheel", "no_gap", "two_places"), ("missed_pulse", "sync_lost", "relocated"))


def loss(run, _):
    run.loss = run.rng.uniform(0.0, 0.1)


def jitter(run, _):
    run.times = run.times + run.rng.normal(size=len(run.times)) * run.rng.uniform(0.0, 0.05) * run.pitch()


def stamps(run, _):
    unit = np.exp(run.rng.uniform(0, np.log(100)))
    run.times = np.floor(run.times / unit) * unit


def restart(run, at):
    run.restart = at


def reversal(run, at):
    """The engine stops, turns back, and is started again; `at` is not used: it is made like that from the start."""
    run.allowed |= {"reversed"}


def cam(run, at):
    run.cam_moved = float(run.rng.choice([-1, 1]) * run.rng.uniform(28, 60))
    run.told(("cam_correlation",), ("cam_silent",))


def burst(run, at):
    k = min(int(np.searchsorted(run.turn, at + run.rng.random())), len(run.times) - 2)
    width = min(1000.0, 0.95 * (run.times[k + 1] - run.times[k]))
    run.insert(run.times[k] + np.sort(run.rng.uniform(0.02, 0.98, int(run.rng.integers(5, 41)))) * width)
    run.told(("noise", "added_pulse"), ("sync_lost", "doubled_edges", "missed_pulse", "pulses_lost"))


KINDS = {f.__name__: f for f in (broken, bent, doubled, filled, loss, jitter, stamps, restart, reversal, cam, burst)}
CONDITIONS = {"loss", "jitter", "stamps", "restart", "reversal"}
#: Parts that are at fault; a pulse too many at one tooth of each turn is the sensor's, or the wheel's.
AT_FAULT = {
    "broken": {"wheel", "wheel configured"},
    "bent": {"wheel", "wheel configured"},
    "doubled": {"crankshaft sensor", "wheel", "wheel configured"},
    "filled": {"crankshaft sensor", "wheel", "wheel configured"},
    "burst": {"crankshaft sensor"},
    "cam": {"cam sensor", "timing"},
    "reversal": {"engine"},
}


@cache
def _parts():
    gateway = load_database([shipped("dbc/gateway.dbc")])
    sync = cantools.database.load_file(shipped("dbc/gateway.dbc")).get_message_by_name("GW_EngineSync")
    return load_database([shipped("dbc/crank.dbc")]), gateway.message("GW_EngineSync"), sync


def proven_causes(failed):
    """Return the parts that are certain as causes of failed tests, by what each blames."""
    parts = {(one.part, one.kind) for blamed in BLAMES.values() for one in blamed}
    tests = [
        Test(name, tuple(Link(b.part, OWN * b.share) for b in blamed), FALSE_ALARM) for name, blamed in BLAMES.items()
    ]
    diagnoser = Diagnoser([Component(*part) for part in sorted(parts)], tests)
    for name in failed:
        if name in BLAMES:
            diagnoser.update(name, FAILED, 0)
    causes = [group.cause for group in diagnoser.diagnose()]
    return {diagnoser.system.components[k].name for cause in causes if cause for k in cause.components}


def _base(run, kinds):
    """Make the healthy engine of a run."""
    if "reversal" in kinds:
        make = (outside._start, outside._stop)[int(run.rng.integers(2))]
        run.times, run.teeth, _ = make(run.wheel, run.rng, 0)
        run.turn = np.arange(len(run.times)) / run.wheel.pulses
        run.rpm = 250.0
        odd = np.flatnonzero(np.diff(run.teeth) % run.wheel.pulses != 1)
        run.turned = (run.turn[odd[0]], run.turn[odd[-1]]) if len(odd) else ()
        return
    ripple = [(2.0, min(0.05, 40 / run.rpm), run.rng.uniform(0, 6))]
    seconds = TURNS * 60 / run.rpm
    run.times = (
        tooth_times(run.wheel, [(0, run.rpm)], seconds, ripple=ripple, jitter=0.01, tooth_error=0.003, rng=run.rng)
        / 1e3
    )
    run.teeth = np.arange(len(run.times)) % run.wheel.pulses
    run.turn = np.arange(len(run.times)) / run.wheel.pulses


def _frames(run, form, with_cam):
    """Return the frames of a run that reach the gateway."""
    run.times = np.maximum.accumulate(np.rint(run.times)) + 1.0
    run.keep(np.concatenate([[True], np.diff(run.times) > 0]))
    ns = (run.times * 1e3).astype(np.int64)
    frames = tooth_frames(ns, form)
    if run.restart > 0:
        at = ns[min(int(np.searchsorted(run.turn, run.restart)), len(ns) - 2)]
        frames = np.concatenate([frames[frames["t_ns"] <= at], tooth_frames(ns[ns >= at], form)])
    if with_cam:
        seconds = run.times[-1] / 1e6
        edges, levels = cam_edges(HALF_MOON, [(0, run.rpm)], seconds)
        change = np.searchsorted(run.turn, SECOND)
        moved = edges + np.where(edges > ns[min(change, len(ns) - 1)], run.cam_moved / 360 * 60e9 / run.rpm, 0.0)
        frames = np.concatenate([frames, cam_frames(ns, moved.astype(np.int64), levels)])
        frames = frames[np.argsort(frames["t_ns"], kind="stable")]
    lost = run.rng.random(len(frames)) < run.loss
    return frames[~lost], ns


def elsewhere(run):
    """Tell whether the last turn's pulses are the wheel's own from another tooth on, but for one bent tooth at most."""
    last = int(run.turn[-1]) - 1
    first, end = np.searchsorted(run.turn, (last, last + 1))
    if end - first != run.wheel.pulses:
        return False
    seen = (run.times[first:end] - run.times[first]) / (run.times[end] - run.times[first]) * run.wheel.turn
    for k in range(1, run.wheel.repeats):
        other = np.cumsum(np.roll(run.wheel.pitches, -k)) - run.wheel.pitches[k]
        off = np.abs(seen - other - np.median(seen - other))
        if (off > SAME).sum() <= 1 and off.max() < 0.5:
            return True
    return False


def one_run(job):
    """Return what happened in one run.

    Its number, wheel, frame and conditions, wrong labels, if the later fault was named, other reports, all of them,
    whether the labels were wrong because nothing can tell the place (:func:`elsewhere`, a fault from key-on), and
    healthy parts that are proven as causes.
    """
    seed, number = job
    rng = np.random.default_rng([seed, number, 70])
    text = WHEELS[number % len(WHEELS)]
    kinds = [str(k) for k in rng.choice(list(KINDS), 2, replace=False)]
    form = "classic" if rng.random() < 0.5 else "fd"
    run = Run(Wheel.parse(text), rng, float(np.exp(rng.uniform(np.log(700), np.log(6000)))))
    _base(run, kinds)
    events = [0.0 if rng.random() < 0.4 else FIRST, SECOND]
    order = sorted(kinds, key=lambda k: k in ("jitter", "stamps", "loss"))
    if order[1] not in ("jitter", "stamps", "loss") and order[0] in ("burst", "restart", "cam"):
        order.reverse()
    at = dict(zip(order, events, strict=True))
    for kind in ("burst", "restart", "cam"):
        if kind in at:
            at[kind] = SECOND + (8 if kind == "restart" else 0)
    if run.turned:
        at = {kind: 0.0 if turn == 0.0 else run.turned[1] + 4 for kind, turn in at.items()}
    for kind in order:
        run.now = kind
        KINDS[kind](run, at[kind])
    frames, ns = _frames(run, form, "cam" in kinds)
    database, emission, sync = _parts()
    options = {"cam": HALF_MOON} if "cam" in kinds else {}
    monitor = MonitorInstance("crank", MONITOR, Params(wheel=run.wheel, frame=form, **options), emission=emission)
    failed, qualified = Counter(), set()

    def take(e):
        failed.update(FAULTS[k].name for k in e["fault"][e["result"] == FAILED])
        qualified.update(FAULTS[k].name for k in e["fault"][e["kind"] == QUALIFIED_FAILED])

    engine = build_engine([(0, database)], [monitor], [])
    sent = engine.process(frames, take)
    last = np.searchsorted(ns, sent["t_ns"] - WIRE_NS[form], side="right") - 1
    teeth = frames["t_ns"][np.isin(frames["can_id"], (0x700, 0x703))]
    exact = (last >= 0) & np.isin(sent["t_ns"], teeth)
    wrong = 0
    begun = {max(k, 0.0) for k in at.values()}
    for frame, k, known in zip(sent, last, exact, strict=True):
        value = sync.decode(payload(frame), decode_choices=False)
        if value["SyncState"] != 2 or not known or run.teeth[k] < 0:
            continue
        near = any(event - 1 <= run.turn[k] <= event + GRACE for event in begun)
        near = near or (run.turned and run.turned[0] - 1 <= run.turn[k] <= run.turned[1] + GRACE)
        r = run.wheel.repeats
        wrong += int(not near and value["ToothIndex"] % r != run.teeth[k] % r)
    same = bool(wrong and 0.0 in begun and elsewhere(run))
    later = order[1] if order[1] not in CONDITIONS else order[0]
    named = None
    came = run.turn[-1] >= at[later] + 6
    if later not in CONDITIONS and run.wanted and came:
        named = bool(run.asked[later] & set(failed)) if later in run.asked else None
    others = sorted(set(failed) - run.allowed - {"frames_lost"})
    healthy = sorted(proven_causes(qualified) - set().union(*(AT_FAULT.get(kind, set()) for kind in order)))
    return number, text, form, order, 0 if same else wrong, named, others, dict(failed), same, healthy


def defects_of(told, real):
    """Return how many teeth broken off and pulses too many make a wheel's pulses those of a real one; None: none do.

    Both in half pitches, from any place on, the real one as often a turn as it fits.
    """
    parts = told.turn / real.turn
    if parts != round(parts):
        return None
    size = round(2 * told.turn)
    whole = {round(2 * p) for p in told.positions}
    turn = [round(2 * (p + k * real.turn)) for k in range(round(parts)) for p in real.positions]
    options = [{(p + shift) % size for p in turn} for shift in range(size)]
    return min(((len(whole - o), len(o - whole)) for o in options), key=lambda edit: (sum(edit), edit))


#: Teeth broken off and pulses too many, the columns of the table.
EDITS = ((1, 0), (2, 0), (0, 1), (0, 2), (1, 1))


def same_rows():
    """Return the rows of the table of wheels whose pulses are those of another one with at most two defects."""
    rows = []
    for told in MADE:
        others = {real: defects_of(Wheel.parse(told), Wheel.parse(real)) for real in MADE if real != told}
        cells = [", ".join(f"`{real}`" for real, edit in others.items() if edit == column) for column in EDITS]
        if any(cells):
            rows.append(f"| `{told}` | {' | '.join(cells)} |")
    return rows


def _pool(work, jobs):
    work(jobs[0])
    with ProcessPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        yield from pool.map(work, jobs, chunksize=8)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("wheels", "combinations", "same"))
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", help="file for all runs of combinations, a line of JSON each")
    parser.add_argument("--show", type=int, default=20, help="how many failures to print")
    options = parser.parse_args()
    if options.what == "same":
        print(*same_rows(), sep="\n")
        return
    print("seed", options.seed)
    jobs = [(options.seed, k) for k in range(options.count)]
    if options.what == "wheels":
        rows = [row for row in _pool(one_wheel, jobs) if row is not None]
        bad = [row for row in rows if row[1] > FOUND or row[2] or row[3]]
        print(f"{len(rows)} wheels, {options.count - len(rows)} that a rotation maps onto themselves")
        print(f"not synchronised within {FOUND} turns: {sum(row[1] > FOUND for row in rows)}")
        print(f"wrong tooth proven: {sum(row[2] > 0 for row in rows)}")
        print(f"with a report: {sum(bool(row[3]) for row in rows)}")
        for text, late, wrong, names in bad[: options.show]:
            print(f"  {text}: {late:.1f} turns, {wrong} wrong, {names}")
        return
    rows = []
    with Path(options.rows or os.devnull).open("w") as file:
        for row in _pool(one_run, jobs):
            rows.append(row)
            print(json.dumps(row), file=file, flush=True)
    asked = [row for row in rows if row[5] is not None]
    print(f"{len(rows)} runs, wrong proven later than {GRACE} turns: {sum(row[4] > 0 for row in rows)}")
    print(f"  besides, with the pulses of the wheel at another place from key-on: {sum(row[8] for row in rows)}")
    print(f"later fault named: {sum(row[5] for row in asked)} of {len(asked)}")
    print(f"runs with a report that blames no part at fault: {sum(bool(row[6]) for row in rows)}")
    print(f"runs with a healthy part proven as a cause: {sum(bool(row[9]) for row in rows)}")
    print("pair: runs, wrong, later fault named of those asked, runs with another report")
    for pair in sorted({tuple(sorted(row[3])) for row in rows}):
        of = [row for row in rows if tuple(sorted(row[3])) == pair]
        told = [row[5] for row in of if row[5] is not None]
        wrong, others = sum(row[4] > 0 for row in of), sum(bool(row[6]) for row in of)
        print(f"  {' + '.join(pair):20s} {len(of):4d} {wrong:3d} {sum(told):4d} of {len(told):4d} {others:3d}")
    for title, chosen in (
        ("wrong", [row for row in rows if row[4]]),
        ("not named", [row for row in asked if not row[5]]),
        ("others", [row for row in rows if row[6]]),
        ("healthy part proven", [row for row in rows if row[9]]),
    ):
        print(title, Counter(tuple(sorted(row[3])) for row in chosen).most_common(12))
        for row in chosen[: options.show]:
            print("  ", *row)


if __name__ == "__main__":
    main()
