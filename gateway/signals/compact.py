"""Messages of cantools in a third of their memory: equal parts are shared, codecs are made when they are first used.

The gateway decodes by tables of its own; codecs of cantools are for tools that ask a message to decode.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cantools.database.can import Message
from cantools.database.can.signal import Signal
from cantools.database.utils import create_encode_decode_formats

from gateway.signals.ranges import Ranges, runs


class Branches(dict[int, Any]):
    """Codecs of a multiplexer's branches, each made when it is asked for: ranges have too many of them."""

    def __init__(self, message: CompactMessage, multiplexer: Signal) -> None:
        super().__init__()
        self._message, self._name = message, multiplexer.name
        self._named = {int(value) for value in multiplexer.choices or {}}
        for signal in message.signals:  # the first of each range, which cantools names where a value selects nothing
            if signal.multiplexer_signal == self._name and signal.multiplexer_ids:
                self.__missing__(runs(signal.multiplexer_ids)[0][0])

    def __missing__(self, value: int) -> Any:
        made = self._message.branch(self._name, value)
        if not made["signals"] and value not in self._named:
            raise KeyError(value)
        return self.setdefault(value, made)


class CompactMessage(Message):
    """A message whose codecs are made at the first use; multiplexer values may be ranges."""

    @property
    def _codecs(self) -> Any:
        if self.__dict__.get("_codecs") is None:
            self.refresh(strict=False)
        return self.__dict__["_codecs"]

    @_codecs.setter
    def _codecs(self, codecs: Any) -> None:
        self.__dict__["_codecs"] = codecs

    def refresh(self, strict: bool | None = None) -> None:
        """Make the codecs again, as cantools does."""
        if not any(isinstance(signal.multiplexer_ids, Ranges) for signal in self._signals):
            super().refresh(strict)
            return
        self._codecs = self.branch(None, 0)
        self._signal_dict = {signal.name: signal for signal in self._signals}

    def branch(self, multiplexer: str | None, value: int) -> Any:
        """Return the codec of the signals that a multiplexer's value selects; None: of those that are always there."""
        of = [signal for signal in self._signals if signal.multiplexer_signal == multiplexer]
        mine = [one for one in of if multiplexer is None or value in Ranges(runs(one.multiplexer_ids or ()))]
        parents = {signal.multiplexer_signal for signal in self._signals}
        return {
            "signals": mine,
            "formats": create_encode_decode_formats(mine, self._length),
            "multiplexers": {one.name: Branches(self, one) for one in mine if one.name in parents},
        }


def compact(messages: Sequence[Message]) -> None:
    """Share equal parts of messages, and leave their codecs out."""
    shared: dict[Any, Any] = {}
    owner: Any

    def same(key: tuple[Any, ...], part: Any) -> Any:
        return shared.setdefault((type(part), *key), part)

    for message in messages:
        message.__class__ = CompactMessage
        message._codecs = None
        for owner in (message, *message.signals):
            if owner.dbc is not None and not owner.dbc.attributes:
                defined = owner.dbc.attribute_definitions
                owner.dbc = same((id(defined) if defined else 0,), owner.dbc)
        for signal in message.signals:
            signal.receivers = same(tuple(signal.receivers), signal.receivers)
            if not signal.choices:  # texts are a table each
                signal.conversion = same((repr(signal.conversion.__dict__),), signal.conversion)
