"""SecOC of a received frame: which freshness value its MAC is right for, if for any.

Only a value that is greater than the last right one is new. A truncated one may stand for several: the next, then as
many further as the configuration lets. Where frames may have passed unheard (at the start, after losses on our side)
the next ones are looked for farther, some at each frame, and nobody is accused meanwhile: the data are not used, that
is all. A value that was found so far away counts once a second frame confirms it: chance finds one in ``2**bits``
tries.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.engine.checks.kinds import COUNTER
from gateway.engine.results import report_result, store_evidence
from gateway.signals.bits import read_bits
from gateway.signals.protection.cmac import mac_of
from gateway.signals.protection.freshness import COUNTER as COUNTED
from gateway.signals.protection.freshness import SYNC, SYNCED, mask, next_value, truncated_of
from gateway_fdi.jit import kernel

#: Kinds of frames: the MAC is right for a new value, for one that was seen or is older, for none that was tried; or it
#: cannot be told yet, because too little is known of the sender's values.
NEW, OLD, FORGED, UNKNOWN = range(4)
#: Further values that are tried at a frame where frames may have passed unheard, and after how many its MAC is wrong.
SEARCHED = 64
MOST_SEARCHED = 1 << 16
#: By how much a sender's and the master's reset counter may differ: a reset is on its way.
_ASIDE = (0, -1, 1, -2, 2)


@kernel
def fits(c: Any, words: Any, value: Any, tables: Any) -> bool:
    """Return whether a payload's MAC is the one for a whole freshness value."""
    p = c.protection
    if p.fresh.bits < 64 and value >> np.uint64(p.fresh.bits) != np.uint64(0):
        return False
    return bool(read_bits(words, p.field) == mac_of(words, value, p.checksum, tables))


@kernel
def sought_new(c: Any, words: Any, least: Any, epoch: Any, tries: int, tables: Any) -> Any:
    """Return whether a payload's MAC is right for one of the next values, and the value that was tried last.

    Args:
        c: its record of CHECK.
        words: payload.
        least: smallest value that is new, uint64.
        epoch: of SYNCED, the trip and reset counter that the value has to have.
        tries: how many, one after the other.
        tables: of MACs.
    """
    f = c.protection.fresh
    value = next_value(f, truncated_of(words, f), least)
    for k in range(tries):
        if k > 0:
            value += mask(int(f.truncated)) + np.uint64(1)
        if value < least or (f.kind == SYNCED and value >> np.uint64(f.message + f.flag) != epoch):
            return False, value
        if fits(c, words, value, tables):
            return True, value
    return False, value


@kernel
def sought_old(c: Any, words: Any, tables: Any) -> Any:
    """Return whether a payload's MAC is right for an older value: a recent one, or one of a sender that began again."""
    f = c.protection.fresh
    step, received = mask(int(f.truncated)) + np.uint64(1), truncated_of(words, f)
    value = next_value(f, received, c.fresh)
    for k in range(f.attempts + 1):
        if k > 0 or value >= c.fresh:
            if step == np.uint64(0) or value < step:
                break
            value -= step
        if fits(c, words, value, tables):
            return True, value
    begun = next_value(f, received, np.uint64(f.start))
    return bool(f.kind == COUNTED and begun < c.fresh and fits(c, words, begun, tables)), begun


@kernel
def judged_by_epoch(T: Any, c: Any, words: Any) -> Any:
    """Return what a frame of SYNCED is, and its value: by trip and reset counter that the master has sent."""
    f, tables = c.protection.fresh, T.crc_tables
    master = T.checks[c.sync]
    if master.synced == 0:
        return UNKNOWN, np.uint64(0)
    below, one = np.uint64(f.message + f.flag), np.uint64(1)
    flag = truncated_of(words, f) & mask(int(f.flag))
    latest = np.int64(master.fresh - one)
    for k in range(len(_ASIDE) + 1):  # the last: the master has just begun another trip
        epoch = master.trial if k == len(_ASIDE) else np.uint64(max(int(latest) + _ASIDE[k], 0))
        if epoch & mask(int(f.flag)) != flag:
            continue
        least = max(c.fresh, epoch << below)
        found, value = sought_new(c, words, least, epoch, f.attempts + 1, tables)
        if found:
            return NEW, value
    found, value = sought_old(c, words, tables)
    return OLD if found else FORGED, value


@kernel
def judged_by_count(T: Any, c: Any, words: Any) -> Any:
    """Return what a frame with a counter is, and its value."""
    f, tables, one = c.protection.fresh, T.crc_tables, np.uint64(1)
    if c.synced == 0 and c.trial > c.fresh:
        found, value = sought_new(c, words, c.trial, c.trial, f.attempts + 1, tables)
        if found:
            return NEW, value
    found, value = sought_new(c, words, c.fresh, c.fresh, f.attempts + 1, tables)
    if found:
        return NEW, value
    old, before = sought_old(c, words, tables)
    if old:
        return OLD, before
    if c.synced == 1 or c.sought >= MOST_SEARCHED or f.truncated == f.bits:
        return FORGED, value
    far = c.fresh + np.uint64(c.sought) * (mask(int(f.truncated)) + one)
    c.sought += SEARCHED
    found, value = sought_new(c, words, far, far, SEARCHED, tables)
    if found:
        c.trial = value + one
    return UNKNOWN, value


@kernel(inlined=False)
def judge_secured(T: Any, c: Any, words: Any) -> Any:
    """Return what a secured frame is, the MAC that it has, the one for the value tried last, and that value."""
    p = c.protection
    if p.fresh.bits == 0:
        value = np.uint64(0)
        verdict = NEW if fits(c, words, value, T.crc_tables) else FORGED
    elif p.fresh.kind == SYNCED:
        verdict, value = judged_by_epoch(T, c, words)
    else:
        verdict, value = judged_by_count(T, c, words)
    received = computed = read_bits(words, p.field)
    if verdict == FORGED:
        computed = mac_of(words, value, p.checksum, T.crc_tables)
    return verdict, received, computed, value


@kernel
def take_freshness(T: Any, t_ns: int, c: Any, value: Any, verdict: int) -> bool:
    """Report the freshness of a frame whose MAC is right, and keep it; returns whether it is new."""
    one = np.uint64(1)
    old = verdict == OLD
    if c.fault[COUNTER] >= 0:
        place = report_result(T, t_ns, c.fault[COUNTER], old, float(value), float(c.fresh))
        store_evidence(T, c.fault[COUNTER], place, 0, float(value))
        store_evidence(T, c.fault[COUNTER], place, 1, float(c.fresh))
    if old:
        T.clock[0].repeated += 1
        return False
    f = c.protection.fresh
    reset = np.uint64(f.reset)
    if f.kind == SYNC and c.synced == 1 and value >> reset != (c.fresh - one) >> reset:
        c.trial = c.fresh - one  # what others may use still: the trip before
    c.fresh = value + one
    c.synced = 1
    c.sought = 0
    return True
