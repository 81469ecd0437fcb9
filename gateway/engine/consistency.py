"""Relations between its tables that the engine's loop takes for granted."""

from __future__ import annotations

import numpy as np

from gateway.engine.tables import Tables
from gateway.engine.timers import CHECK, DEBOUNCE, HANDLER, HEALTH
from gateway.monitors.contract import RESULTS
from gateway.monitors.sampling import KEPT


def assert_consistent(t: Tables) -> None:
    """Assert what the loop takes for granted of the tables to each other: it checks no index."""
    messages, slots, faults = len(t.messages), len(t.mailbox), len(t.debounces)
    assert len(t.vectors) == messages
    whole = t.messages[t.messages["whole"] == 1]
    assert (whole["slot"] + whole["count"] <= slots).all()
    of = np.repeat(np.arange(len(whole)), whole["count"])
    nth = np.arange(len(of)) - (whole["count"].cumsum() - whole["count"])[of]
    mine = t.signals[whole["first"][of] + nth]
    assert (mine["slot"] == whole["slot"][of] + nth).all()
    assert (mine["parent"] < 0).all()
    assert (t.vectors["first"] + t.vectors["count"] <= len(t.triggers)).all()
    assert (t.vectors["check"] < len(t.checks)).all()
    assert (t.checks["sync"] < len(t.checks)).all()
    assert (t.vectors["first_watch"] + t.vectors["watches"] <= len(t.watches)).all()
    assert ((t.triggers >= 0) & (t.triggers < max(len(t.handlers), 1))).all()
    assert ((t.slots >= 0) & (t.slots < slots)).all()
    assert (t.sampled["first"] + t.sampled["carries"] <= len(t.carried)).all()
    assert ((t.sampled["sampler"] >= 0) & (t.sampled["sampler"] < len(t.samplers))).all()
    assert ((t.sampled["counter"] >= 0) & (t.sampled["counter"] < slots)).all()
    assert ((t.sources >= -len(t.pages)) & (t.sources < messages)).all()
    assert ((t.vectors["page"] >= -1) & (t.vectors["page"] < len(t.pages))).all()
    assert ((t.pages["after"] >= -1) & (t.pages["after"] < len(t.pages))).all()
    assert ((t.pages["place"] >= 0) & (t.pages["place"] < len(t.present))).all()
    for h in t.handlers:
        assert h["first_slot"] + h["slots"] <= len(t.slots)
        assert h["first_source"] + h["sources"] <= len(t.sources)
        assert h["inputs"] + 2 <= h["cells"]
        assert h["cells"] + h["slots"] <= len(t.pool)
        assert h["first_sampled"] + h["sampled"] <= len(t.sampled)
        assert h["first_loose"] + h["loose"] <= len(t.carried)
        mine = t.sampled[h["first_sampled"] :][: h["sampled"]]
        for first, carries in [(h["first_loose"], h["loose"]), *((m["first"], m["carries"]) for m in mine)]:
            assert (t.carried[first:][:carries] < h["slots"]).all()
        for y in t.samplers[np.unique(mine["sampler"])]:
            assert h["first_sampled"] <= y["first"]
            assert y["first"] + y["const"]["messages"] <= h["first_sampled"] + h["sampled"]
            assert y["held"] + y["cells"] <= len(t.held)
            assert y["cells"] >= h["slots"] * (KEPT + 1 if y["const"]["lines"] else y["const"]["depth"])
        assert 0 <= h["fault"] <= h["fault"] + h["faults"] <= faults
        assert h["emit"] < len(t.emits)
    for rows in (t.checks, t.health):
        assert (rows["fault"] < faults).all()
    assert (t.debounces["first_condition"] + t.debounces["conditions"] <= len(t.conditions)).all()
    assert (t.debounces["first_root"] + t.debounces["roots"] <= len(t.roots)).all()
    assert ((t.roots >= 0) & (t.roots < max(faults, 1))).all()
    assert ((t.conditions["slot"] >= 0) & (t.conditions["slot"] < slots)).all()
    assert (t.emits["first"] + t.emits["count"] <= len(t.emit_signals)).all()
    count = len(t.groups)
    assert 0 < count <= len(t.heap)
    assert (t.groups["place"][t.heap["group"][:count]] == range(count)).all()
    assert (np.sort(t.members) == range(len(t.timers))).all()
    assert (t.timers["group"][t.members] == np.repeat(range(count), t.groups["count"])).all()
    for kind, owners in ((CHECK, t.checks), (HANDLER, t.handlers), (DEBOUNCE, t.debounces), (HEALTH, t.health)):
        mine = t.timers[t.timers["kind"] == kind]
        assert (mine["index"] < len(owners)).all()
        assert (t.timers["index"][owners["timer"][mine["index"]]] == mine["index"]).all()
    assert len(t.buckets) in (0, faults)
    assert t.values.shape == t.present.shape
    assert t.out.itemsize == RESULTS.itemsize
