"""Current frames that wait for the voltage of their counter: both may come in bursts, one behind the other."""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8s, i8, i8s, kernel, means

#: Frames that are kept; of one that is further back than its counter goes round nobody knows which it is.
KEPT = 64
MODULO = 16


class State(Record):
    """State: of the last frames each one's place is its number modulo KEPT."""

    next: i8 = means("number of the next frame")
    behind: i8 = means("number of the first frame that no voltage has come for")
    counter: Annotated[i8s, KEPT] = means("alive counter")
    i_u: Annotated[f8s, KEPT] = means("phase current", "A")
    i_v: Annotated[f8s, KEPT] = means("phase current", "A")
    theta: Annotated[f8s, KEPT] = means("electrical angle used for Park", "deg")
    valid: Annotated[i8s, KEPT] = means("1: the sender calls the frame valid")
    t_ns: Annotated[i8s, KEPT] = means("when the frame came", "ns")


@kernel
def keep(s: State, t_ns: int, counter: int, i_u: float, i_v: float, theta: float, valid: bool, stale_ns: int) -> None:
    """Take a frame of currents [A] with the angle used for Park [deg]; those that came so long before are given up."""
    k = s.next % KEPT
    s.counter[k], s.i_u[k], s.i_v[k], s.theta[k] = counter, i_u, i_v, theta
    s.valid[k] = 1 if valid else 0
    s.t_ns[k] = t_ns
    s.next += 1
    s.behind = max(s.behind, s.next - KEPT)
    while t_ns - s.t_ns[s.behind % KEPT] > stale_ns:
        s.behind += 1


@kernel
def find(s: State, counter: int) -> int:
    """Return the place of the first frame with a counter that no voltage has come for; -1: there is none."""
    for number in range(s.behind, min(s.next, s.behind + MODULO)):
        if s.counter[number % KEPT] == counter:
            return int(number % KEPT)
    return -1


@kernel
def taken(s: State, place: int) -> None:
    """The voltage of the frame at a place has come: what is before that waits for none any more."""
    s.behind += (place - s.behind) % KEPT + 1
