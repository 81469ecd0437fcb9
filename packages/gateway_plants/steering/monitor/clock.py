"""When a periodic message was sampled: told by its counter, not by when its frame came.

Frames wait: for the bus, for a sender or a receiver that gets no turn. A message has a period and its frames are
counted, so that a frame is dated one period behind the one before; the frames that waited least say where the periods
lie. Whenever that has to be found anew, the dates are not to be relied on for a while; nor is the date of a frame that
seems to have waited: its sender may have started anew. What compares messages by such dates is not tested.
"""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, i8, kernel, means

#: A sender's clock is not faster or slower than ours by more than this.
DRIFT = 2e-4
#: Counters are modulo this; behind a silence longer by so many periods nobody knows how often it went round.
MODULO, SURE = 16, 12
#: Periods that lie wrong by less are not wrong [ns].
TOLERANCE_NS = 1_000_000.0
#: Frames that all waited, for so long: the periods lie elsewhere now [ns].
WINDOW_NS = 1_000_000_000
#: Periods behind a correction until no other one is likely: what had waited together has come by then.
SETTLES = 20


class Clock(Record):
    """What is known of when the frames of a message were sampled."""

    started: i8 = means("1: a frame has come")
    t_ns: f8 = means("date of the last frame", "ns")
    arrived_ns: i8 = means("when the last frame came", "ns")
    counter: i8 = means("its alive counter")
    since_ns: i8 = means("when the periods were last found anew", "ns")
    least: f8 = means("what frames have waited at least since window_ns", "ns")
    window_ns: i8 = means("begin of the window of least", "ns")


@kernel
def _anew(s: Clock, arrived_ns: int, t_ns: float) -> None:
    """Let the periods lie elsewhere from here on."""
    s.t_ns = t_ns
    s.since_ns = s.window_ns = arrived_ns
    s.least = arrived_ns - t_ns


@kernel
def sampled_at(s: Clock, arrived_ns: int, counter: int, period_ns: float) -> int:
    """Return when a frame was sampled [ns].

    Args:
        s: record of Clock.
        arrived_ns: when it came.
        counter: its alive counter, modulo 16.
        period_ns: of the message.
    """
    steps = (counter - s.counter) % MODULO
    silence = arrived_ns - s.arrived_ns
    due = s.t_ns + steps * period_ns * (1.0 + DRIFT)
    s.arrived_ns, s.counter = arrived_ns, counter
    if s.started == 0 or silence > (steps + SURE) * period_ns:
        s.started = 1
        _anew(s, arrived_ns, float(arrived_ns))
    elif due - arrived_ns > TOLERANCE_NS:
        _anew(s, arrived_ns, float(arrived_ns))
    else:
        s.t_ns = min(due, float(arrived_ns))
        s.least = min(s.least, arrived_ns - s.t_ns)
        if arrived_ns - s.window_ns >= WINDOW_NS:
            if s.least > TOLERANCE_NS:
                _anew(s, arrived_ns, s.t_ns + s.least)
            s.window_ns = arrived_ns
            s.least = arrived_ns - s.t_ns
    return int(s.t_ns)


@kernel
def sure(s: Clock, period_ns: float) -> bool:
    """Tell whether the last frame's date can be relied on, the message's period given [ns]."""
    if s.started == 0 or s.arrived_ns - s.since_ns < SETTLES * period_ns:
        return False
    return bool(s.arrived_ns - s.t_ns <= TOLERANCE_NS)
