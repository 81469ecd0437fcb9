"""Messages of cantools in a third of their memory: equal parts are shared, codecs are made when they are first used.

The gateway decodes by tables of its own; codecs of cantools are for tools that ask a message to decode.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cantools.database.can import Message


class CompactMessage(Message):
    """A message whose codecs are made at the first use."""

    @property
    def _codecs(self) -> Any:
        if self.__dict__.get("_codecs") is None:
            self.__dict__["_codecs"] = self._create_codec()
        return self.__dict__["_codecs"]

    @_codecs.setter
    def _codecs(self, codecs: Any) -> None:
        self.__dict__["_codecs"] = codecs


def compact(messages: Sequence[Message], kept: frozenset[int] = frozenset()) -> None:
    """Share equal parts of messages, and leave their codecs out.

    Args:
        messages: of one file.
        kept: places of those whose codecs stay, since they cannot be made again.
    """
    shared: dict[Any, Any] = {}

    def same(key: tuple[Any, ...], part: Any) -> Any:
        return shared.setdefault((type(part), *key), part)

    for k, message in enumerate(messages):
        message.__class__ = CompactMessage
        if k not in kept and not message.is_container:
            message._codecs = None
        for owner in (message, *message.signals):
            if owner.dbc is not None and not owner.dbc.attributes:
                defined = owner.dbc.attribute_definitions
                owner.dbc = same((id(defined) if defined else 0,), owner.dbc)
        for signal in message.signals:
            signal.receivers = same(tuple(signal.receivers), signal.receivers)
            if not signal.choices:  # texts are a table each
                signal.conversion = same((repr(signal.conversion.__dict__),), signal.conversion)
