"""Messages of several frames, and PDUs of containers, as frames among the others: all decode them as any frame.

A woven frame (``bus.frames.WOVEN``) stands behind the one that completes its message. Of a bus without such messages
no frame is looked at.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, FRAME, MORE, RAW, WOVEN, Frames, empty, joined
from gateway.bus.id_filter import IdFilter
from gateway.j1939.frame import TP_CM, TP_DT, Pdu, group_of, pdu_of
from gateway.j1939.overheard import CUTS, FAST, STRAY, Overheard
from gateway.signals.containers import Container, unpack
from gateway.signals.decode import lookup
from gateway.signals.tables import DecodePlan

#: Bytes of a frame at most.
_FRAME = 64
#: Identifiers of messages whose rows are remembered.
_MOST = 4096
_NONE = empty(0)


def woven_of(plan: DecodePlan) -> Woven | None:
    """Return what puts the messages of a plan together; None: each of them is a frame."""
    return Woven(plan) if any(plan.woven) or plan.containers else None


class Woven:
    """Messages of several frames, and PDUs of containers, of all buses.

    Args:
        plan: of the signals that are decoded.

    Attributes:
        heard: frames that it looks at, on any bus.
        woven: messages that were whole.
        carrying: frames that carry parts of messages, of those that it has looked at.
        contained: PDUs of containers: those that are decoded, others, and containers that do not end where they say.
    """

    def __init__(self, plan: DecodePlan) -> None:
        self._plan = plan
        wanted: dict[int, set[int]] = {}
        looked: set[int] = set()
        masks: set[tuple[int, int]] = set()
        for row in np.flatnonzero(plan.woven).tolist():
            bus, can_id = plan.message_names[row][0], int(plan.messages[row]["can_id"])
            group = group_of(can_id)
            wanted.setdefault(bus, set()).add(group)
            alone = lookup(plan.keys, plan.rows, bus, can_id) == row
            for each in (TP_CM, TP_DT, *(() if alone else (group,))):
                looked.add(bus << 18 | each)
                masks.add((EXTENDED | each << 8, EXTENDED | (0x3FFFF if each >> 8 & 0xFF >= 240 else 0x3FF00) << 8))
        self._overheard = {bus: Overheard(groups) for bus, groups in wanted.items()}
        self._looked = np.asarray(sorted(looked), np.uint32)
        self._held = np.asarray(sorted(bus << 32 | can_id for bus, can_id in plan.containers), np.uint64)
        self.heard = IdFilter(frozenset(can_id for _, can_id in plan.containers), frozenset(masks))
        self.contained = {"whole": 0, "unknown": 0, "cut": 0}
        self._most: dict[tuple[int, int], int] = {}
        self.woven = self.carrying = 0

    def carries(self, bus: int, can_id: int) -> bool:
        """Return whether frames of an identifier (with EXTENDED) may carry parts of messages."""
        place = bus << 18 | group_of(can_id)
        return can_id & (EXTENDED | WOVEN) == EXTENDED and place in self._looked

    def among(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames may carry parts of messages, shape (n,)."""
        ids = frames["can_id"]
        places = frames["bus"].astype(np.uint32) << np.uint32(18) | group_of(ids)
        return np.asarray((ids & (EXTENDED | WOVEN) == EXTENDED) & np.isin(places, self._looked), np.bool_)

    def hear(self, frames: Frames) -> Frames:
        """Take frames in order of time; returns them with the messages that they complete."""
        if not len(frames):
            return frames
        places, made = list[int](), list[Frames]()
        mine = self.among(frames)
        self.carrying += int(mine.sum())
        if len(self._held):
            keys = frames["bus"].astype(np.uint64) << np.uint64(32) | frames["can_id"]
            mine |= np.isin(keys, self._held)
        found = np.flatnonzero(mine)
        some = frames[found]
        body, each = some["data"].tobytes(), (some[name].tolist() for name in ("bus", "can_id", "t_ns", "length"))
        for k, (place, bus, can_id, t_ns, length) in enumerate(zip(found.tolist(), *each, strict=True)):
            parts = self._take(bus, can_id, t_ns, body[_FRAME * k : _FRAME * k + length])
            if len(parts):
                places += [place] * len(parts)
                made.append(parts)
        for overheard in self._overheard.values():
            overheard.pass_time(int(frames["t_ns"][-1]))
        return behind(frames, joined(made), places) if places else frames

    def _take(self, bus: int, can_id: int, t_ns: int, data: bytes) -> Frames:
        held = self._plan.containers.get((bus, can_id))
        if held is not None:
            return self._unpacked(bus, held, data, t_ns)
        pdu = pdu_of(can_id, data)
        if pdu.pgn < FAST and pdu.pgn not in (TP_CM, TP_DT):  # a group that may be longer than a frame, and is not
            return self._long(bus, pdu, pdu.data, t_ns)
        message = self._overheard[bus].take(pdu, t_ns)
        if message is None:
            return _NONE
        whole = Pdu(message.pgn, message.source, message.destination, b"", message.priority)
        return self._long(bus, whole, message.data, t_ns)

    def _long(self, bus: int, pdu: Pdu, data: bytes, t_ns: int) -> Frames:
        made = self._frames(bus, pdu.can_id | WOVEN, data, t_ns)
        self.woven += len(made) > 0
        return made

    def _unpacked(self, bus: int, held: Container, data: bytes, t_ns: int) -> Frames:
        """Return the frames of a container's PDUs."""
        found, whole = unpack(data, held)
        self.contained["cut"] += not whole
        made = [self._frames(bus, number | WOVEN, part, t_ns) for number, part in found if number in held.known]
        self.contained["whole"] += sum(len(each) > 0 for each in made)
        self.contained["unknown"] += len(found) - len(made)
        return joined(made)

    def _frames(self, bus: int, can_id: int, data: bytes, t_ns: int) -> Frames:
        """Return the frames of a message, its identifier with WOVEN; none if it is none of those that are wanted."""
        most = self._most.get((bus, can_id))
        if most is None:
            row = lookup(self._plan.keys, self._plan.rows, bus, can_id)
            most = -1 if row < 0 else _FRAME * self._plan.parts(row)
            if len(self._most) >= _MOST:
                self._most.clear()
            self._most[bus, can_id] = most
        if most < 0:
            return _NONE
        return woven_frames(bus, can_id, data[:most], t_ns)

    def succeed(self, old: Woven, buses: Mapping[int, int]) -> None:
        """Go on with the messages that are under way.

        Args:
            old: not to be used any more.
            buses: index of a bus there -> its index here.
        """
        for bus, overheard in old._overheard.items():
            if buses.get(bus) in self._overheard:
                self._overheard[buses[bus]].succeed(overheard)
        self.contained = {name: count + old.contained[name] for name, count in self.contained.items()}
        self.woven += old.woven
        self.carrying += old.carrying

    def counters(self) -> dict[str, int]:
        """Return how many messages were whole, of how many frames that carry any, and why others were not."""
        held = {f"contained_{name}": count for name, count in self.contained.items()} if len(self._held) else {}
        if not self._overheard:
            return held
        total = sum((each.counts for each in self._overheard.values()), Counter[str]())
        found = {"long_whole": self.woven, "long_parts": self.carrying}
        return found | {f"long_{name}": total[name] for name in (*CUTS, STRAY)} | held

    def notes(self) -> list[str]:
        """Return what came of the messages, as lines for people."""
        counts, held = self.counters(), self.contained
        inside = f"{held['whole']} PDUs of containers, {held['unknown']} unknown; {held['cut']} containers cut off"
        told = [inside] if any(held.values()) else []
        if not self.carrying:
            return told
        cut = [f"{counts[f'long_{name}']} {name}" for name in CUTS if counts[f"long_{name}"]]
        text = f"{self.woven} messages of several frames put together, {', '.join(cut) if cut else 'none'} not whole"
        if counts["long_stray"]:
            text += f", {counts['long_stray']} packets whose beginning is not there"
        return [text, *told]


def woven_frames(bus: int, can_id: int, data: bytes, t_ns: int) -> Frames:
    """Return a message as frames of 64 bytes at most.

    Args:
        bus: index of its bus.
        can_id: of the message, with WOVEN.
        data: of it.
        t_ns: when it was whole [ns].
    """
    made = empty(max(-(-len(data) // _FRAME), 1))
    made["t_ns"], made["can_id"], made["bus"] = t_ns, can_id, bus
    made["flags"][:-1], made["length"] = MORE, _FRAME
    made["length"][-1] = len(data) - _FRAME * (len(made) - 1)
    made["data"] = np.frombuffer(data.ljust(_FRAME * len(made), b"\0"), np.uint8).reshape(-1, _FRAME)
    return made


def behind(frames: Frames, more: Frames, places: Sequence[int]) -> Frames:
    """Return frames with further ones among them.

    Args:
        frames: shape (n,).
        more: further ones, shape (k,).
        places: of the frame that each of these stands behind, ascending, shape (k,).
    """
    order = np.argsort(np.concatenate([np.arange(len(frames)), places]), kind="stable")
    return np.concatenate([frames.view(RAW), more.view(RAW)]).take(order).view(FRAME)
