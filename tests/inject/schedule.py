"""What is done to a gateway, and when: drawn from a seed, printed, and read again from what was printed."""

import random
from dataclasses import dataclass
from typing import NamedTuple

BUSES = ("virtual:a", "virtual:b")


@dataclass(frozen=True, order=True)
class Disturbance:
    """One thing that goes wrong.

    Attributes:
        at_ms: when, of the run's time.
        kind: one of :data:`KINDS`.
        for_ms: for how long.
        amount: of what, see :data:`KINDS`.
        bus: which one, "" where it is of none.
    """

    at_ms: int
    kind: str
    for_ms: int = 0
    amount: int = 0
    bus: str = ""

    def __str__(self):
        return f"{self.at_ms} {self.kind} {self.for_ms} {self.amount} {self.bus}".rstrip()


class Kind(NamedTuple):
    """How often a disturbance comes, and what is drawn of it."""

    every_s: float
    for_ms: tuple[int, int] = (0, 0)
    amounts: tuple[int, ...] = (0,)
    on_a_bus: bool = False


#: Where a statement of SQLite fails: at the transaction's begin, in it, at its end, and right after its end.
PLACES = (0, 1, 2, 3)
STEPS_MS = (3_600_000, -3_600_000, 500, -500, 15, -15, 86_400_000, -86_400_000)

KINDS = {
    # The fault memory's disk; amounts are PLACES, and for a slow one how long a transaction's end takes [ms].
    "disk_full": Kind(8, (20, 3000), PLACES),
    "disk_error": Kind(12, (20, 3000), PLACES),
    "disk_read_only": Kind(15, (20, 2000), PLACES),
    "disk_busy": Kind(12, (20, 1500), PLACES[:1]),
    "disk_slow": Kind(6, (50, 2000), (5, 30, 150, 700)),
    "file_deleted": Kind(20),
    # Clocks and threads: by how much the wall clock is set, how late a thread or the loop itself is [ms].
    "clock_step": Kind(5, (0, 0), STEPS_MS),
    "loop_late": Kind(3, (0, 0), (10, 40, 150, 600)),
    "writer_late": Kind(5, (100, 3000), (3, 20, 100, 500)),
    "reload": Kind(9, (0, 0), (5, 50, 400)),
    # What is sent: frames that the bus takes at a time.
    "queue_full": Kind(5, (10, 900), (0, 0, 1, 3), on_a_bus=True),
    # Interfaces, and what comes: in percent of the frames, or frames lost at once.
    "cut": Kind(6, (5, 1500), on_a_bus=True),
    "lost": Kind(4, (20, 800), (2, 20, 100), on_a_bus=True),
    "twice": Kind(4, (20, 800), (2, 20), on_a_bus=True),
    "out_of_order": Kind(4, (20, 800), (2, 20), on_a_bus=True),
    "overflow": Kind(5, (0, 0), (1, 17, 400), on_a_bus=True),
    # The other ECUs: alive counters that jump, frames that are too short, in percent; values that are none.
    "jumps": Kind(3, (20, 600), (10, 50, 100), on_a_bus=True),
    "short": Kind(4, (20, 600), (10, 50, 100), on_a_bus=True),
    "no_value": Kind(5, (20, 600), (0, 1, 2)),
}  # fmt: skip


def draw(seed, span_s, kinds=KINDS):
    """Return a schedule for so long [s]; each kind has a stream of its own, so that one more changes no other."""
    found = []
    for name in kinds:
        kind = KINDS[name]
        rng = random.Random(f"{seed} {name}")
        at = rng.expovariate(1 / kind.every_s)
        while at < span_s:
            bus = rng.choice(BUSES) if kind.on_a_bus else ""
            for_ms, amount = rng.randint(*kind.for_ms), rng.choice(kind.amounts)
            found.append(Disturbance(round(at * 1000), name, for_ms, amount, bus))
            at += rng.expovariate(1 / kind.every_s)
    return sorted(found)


def text_of(schedule):
    """Return a schedule as text, one disturbance a line."""
    return "\n".join(map(str, schedule))


def read(text):
    """Return the schedule of a text (see :func:`text_of`)."""
    found = []
    for line in text.splitlines():
        at_ms, kind, for_ms, amount, *bus = line.split()
        assert kind in KINDS, line
        found.append(Disturbance(int(at_ms), kind, int(for_ms), int(amount), *bus))
    return sorted(found)
