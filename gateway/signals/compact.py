"""Messages of cantools in a third of their memory: equal parts are shared, codecs are made when they are first used.

The gateway decodes by tables of its own; codecs of cantools are for tools that ask a message to decode.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cantools.database.can import Message

from gateway.signals.ranges import Ranges, follow, narrow_signals


class CompactMessage(Message):
    """A message whose codecs are made at the first use."""

    @property
    def _codecs(self) -> Any:
        if self.__dict__.get("_codecs") is None:
            self.refresh(strict=False)
        return self.__dict__["_codecs"]

    @_codecs.setter
    def _codecs(self, codecs: Any) -> None:
        self.__dict__["_codecs"] = codecs

    def refresh(self, strict: bool | None = None) -> None:
        """Make the codecs again, as cantools does; multiplexer values may be ranges."""
        signals = self._signals
        if not any(isinstance(signal.multiplexer_ids, Ranges) for signal in signals):
            super().refresh(strict)
            return
        self._signals, firsts = narrow_signals(signals)
        try:
            super().refresh(strict)
        finally:
            self._signals = signals
        self._signal_dict = {signal.name: signal for signal in signals}
        follow(self._codecs, firsts)


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
