"""What redundant sensors can have: each channel its faults, and those of all together."""

from __future__ import annotations

from typing import Annotated

from gateway.monitors.contract import VAGUE, Blame, Debounce, Fault
from gateway_fdi.jit import Record, f8, f8s, labels, means
from gateway_plants.pedal.monitor.params import PRESETS, Params
from gateway_plants.pedal.voting.simple import MOST_CHANNELS

#: Faults of a channel, by their place; channel i's begin at ``i * PER_CHANNEL``.
LOW, HIGH, RANGE, STUCK, IMPLAUSIBLE, ERRATIC, MISSING = range(7)
PER_CHANNEL = 7
#: Faults of all channels, by their place behind those of the channels; then, of three, one "drifts" a channel. Of
#: two nobody could tell which. Last of all, where
#: channels tell it, the supply.
CORRELATION, DRIFT, JUMP, INVALID, DRIFTS = range(5)


class ChannelEvidence(Record):
    """Evidence of a channel's fault."""

    reading: f8 = means("reading")
    position: f8 = means(unit="%")
    voted: f8 = means(unit="%")
    innovation: f8 = means(unit="%")
    gate: f8 = means(unit="%")
    mismatch: f8 = means(unit="%")
    rejected: f8 = means(unit="samples")
    repeated: f8 = means(unit="samples")


class CommonEvidence(Record):
    """Evidence of a fault of all channels together."""

    channel: Annotated[f8s, MOST_CHANNELS] = means(unit="%")
    voted: f8 = means(unit="%")
    speed: f8 = means(unit="%/s")
    mismatch: f8 = means(unit="%")
    split: f8 = means("without agreement", "share")


class SupplyEvidence(Record):
    """Evidence of a wrong supply of all channels."""

    reading: Annotated[f8s, MOST_CHANNELS] = means("reading")
    voted: f8 = means(unit="%")
    share: f8 = means("supply, of what it should be", "%")


class Evidence(Record, overlay=True):
    """Evidence of a fault: one of these."""

    channel: ChannelEvidence = means("a channel's fault")
    common: CommonEvidence = means("what all channels have in common")
    supply: SupplyEvidence = means("a wrong supply")


_ELECTRIC = Debounce(failed_after=20, passed_after=200)
_JUDGED = Debounce(failed_after=1, passed_after=200)
_SLOW = Debounce(failed_after=20, passed_after=200)

#: Name, failure type byte (SAE J2012-DA), description, debounce, what is tested.
_CHANNEL = (
    ("low", "14", "reading below its range: short to ground, or open", _ELECTRIC, "reading"),
    ("high", "15", "reading above its range: short to the supply, or open", _ELECTRIC, "reading"),
    ("range", "1C", "reading beyond the pedal's travel", _ELECTRIC, "position [%]"),
    ("stuck", "2A", "repeats its reading while the pedal moves", _JUDGED, "equal readings in a row [samples]"),
    (
        "implausible",
        "64",
        "does not go with the pedal: rejected again and again",
        _JUDGED,
        "rejected in a row [samples]",
    ),
    ("erratic", "2F", "single readings are wrong, too often", _SLOW, "share of samples at which it goes wrong [%]"),
    (
        "missing",
        "87",
        "no reading: its message stays away, or carries no value; redundancy is lost, the others go on without it",
        Debounce(failed_after=100, passed_after=200),
        "no reading for [samples]",
    ),
)
_DRIFTS = ("drifts", "28", "has moved away from the other two slowly", _JUDGED, "distance from the others [%]")
_COMMON = (
    (
        "correlation",
        "62",
        "the channels do not agree, and none can be told to be wrong",
        _JUDGED,
        "share of time without agreement",
    ),
    (
        "drift",
        "28",
        "the channels move apart slowly; which one drifts, two cannot tell",
        _SLOW,
        "distance of the channels [%]",
    ),
    (
        "jump",
        "27",
        "all channels jump together, faster than the pedal can move",
        Debounce(failed_after=2, passed_after=200),
        "common jump / the largest possible",
    ),
    ("invalid", "29", "no channel has a reading that can be believed", _JUDGED, "no reading for [samples]"),
)
_SUPPLY = (
    "supply",
    "1C",
    "the common supply of all channels is wrong: both slopes tell; the value is put right by it",
    _JUDGED,
    "supply away from what it should be [share]",
)


def _dtcs(preset: str) -> dict[str, str]:
    bases = PRESETS[preset].bases
    codes = {
        f"channel_{i + 1}_{name}": f"{bases[i]}-{byte}"
        for i in range(MOST_CHANNELS)
        for name, byte, *_ in (*_CHANNEL, _DRIFTS)
    }
    return codes | {name: f"{bases[-1]}-{byte}" for name, byte, *_ in (*_COMMON, _SUPPLY)}


#: Preset -> name of a fault -> its DTC.
DTCS = {preset: _dtcs(preset) for preset in PRESETS}


def faults(p: Params) -> tuple[Fault, ...]:
    """Return the faults of redundant sensors, in the order of the places above."""
    codes, channels = DTCS[p.preset], len(p.channels)

    def of_channel(i: int, row: tuple[str, str, str, Debounce, str]) -> Fault:
        name = f"channel_{i + 1}_{row[0]}"
        text = f"channel {i + 1}: {row[2]}"
        return Fault(name, codes[name], text, labels(ChannelEvidence), row[3], tested=row[4])

    found = [of_channel(i, row) for i in range(channels) for row in _CHANNEL]
    found += [Fault(n, codes[n], text, labels(CommonEvidence), d, tested=tested) for n, _, text, d, tested in _COMMON]
    if channels == MOST_CHANNELS:
        found += [of_channel(i, _DRIFTS) for i in range(channels)]
    if p.tells_supply:
        name, _, text, debounce, tested = _SUPPLY
        found.append(Fault(name, codes[name], text, labels(SupplyEvidence), debounce, tested=tested))
    return tuple(found)


#: How likely all channels move as by their supply, because one is wrong while another has been.
_BOTH = 0.02


def blames(p: Params) -> dict[str, list[Blame]]:
    """Return what each fault blames: a channel its sensor, what concerns all of them each sensor, or their supply."""
    every = [Blame(channel.signal, share=0.5 if len(p.channels) == 2 else VAGUE) for channel in p.channels]
    supply = [Blame("supply", "supply")]
    found = {
        f"channel_{i + 1}_{name}": [Blame(channel.signal)]
        for i, channel in enumerate(p.channels)
        for name, *_ in (*_CHANNEL, *([_DRIFTS] if len(p.channels) == MOST_CHANNELS else []))
    }
    found |= dict.fromkeys(("correlation", "drift", "invalid"), every)
    both = [*supply, *(Blame(channel.signal, share=_BOTH) for channel in p.channels)]
    return found | dict.fromkeys(("jump", "supply") if p.tells_supply else ("jump",), both)
