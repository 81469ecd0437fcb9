"""``gateway simulate --control SOCKET``: signals and faults of virtual ECUs while they run, and the command that asks.

A request is a line of JSON, its answer another one: ``{"set": {"Drive.Speed": 50}}``, ``{"release": ["Drive.Speed"]}``
(an empty list: all), ``{"inject": {"kind": "lost", "message": "Drive"}}``, ``{"heal": true}``, ``{"show": true}``. The
answer is ``{"now_s": ..., "set": {...}}``, or ``{"error": "..."}``.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from gateway.common.jsonlines import line
from gateway.host.sockets import connect, listen_at
from gateway_bench.vecu.player import Player
from gateway_fdi.errors import GatewayError, InputError, nearest

#: Longest request [byte].
LINE_BYTES = 64 << 10
#: Requests.
WORDS = ("set", "release", "inject", "heal", "show")


class Control:
    """The socket, served between two steps of the scenario.

    Args:
        path: of the socket.
        player: of the scenario, which goes step by step.
        now_s: returns the scenario's time [s].

    Raises:
        InputError: another process listens there, or something else is at this path.
    """

    def __init__(self, path: Path, player: Player, now_s: Callable[[], float]) -> None:
        self._path, self._player, self._now_s = path, player, now_s
        self._socket = listen_at(path, "control socket")
        self._peers: dict[socket.socket, bytearray] = {}

    def turn(self) -> None:
        """Do what is asked, without waiting."""
        with suppress(BlockingIOError):
            while True:
                peer, _ = self._socket.accept()
                peer.setblocking(False)
                self._peers[peer] = bytearray()
        for peer in list(self._peers):
            self._serve(peer)

    def _serve(self, peer: socket.socket) -> None:
        heard = self._peers[peer]
        try:
            while True:
                data = peer.recv(LINE_BYTES)
                if not data:
                    self._drop(peer)
                    return
                heard += data
                if len(heard) > LINE_BYTES:
                    self._drop(peer)
                    return
        except BlockingIOError:
            pass
        except OSError:
            self._drop(peer)
            return
        *lines, rest = bytes(heard).split(b"\n")
        heard[:] = rest
        try:
            for text in lines:
                peer.sendall(line(self._answer(text)).encode() + b"\n")
        except OSError:  # it does not take its answers
            self._drop(peer)

    def _answer(self, text: bytes) -> dict[str, Any]:
        try:
            asked = json.loads(text)
            if not isinstance(asked, dict) or len(asked) != 1:
                raise InputError(
                    f"one of {', '.join(WORDS)} in {{...}}", key="request", value=text.decode(errors="replace")
                )
            [(word, value)] = asked.items()
            self._do(word, value)
        except (ValueError, RecursionError) as error:
            return {"error": f"no JSON: {error}"}
        except GatewayError as error:
            return {"error": str(error)}
        return {"now_s": round(self._now_s(), 6), "set": self._player.overrides.values}

    def _do(self, word: str, value: Any) -> None:
        """Do a request.

        Raises:
            GatewayError: it is none, or names what is not there.
        """
        if word == "set" and isinstance(value, Mapping):
            for name, number in value.items():
                if not isinstance(number, int | float | str):
                    raise InputError("a number, or a text of the database", key=str(name), value=number)
            self._player.overrides.set(value)
        elif word == "release" and isinstance(value, Sequence) and not isinstance(value, str):
            wrong = [name for name in value if not isinstance(name, str)]
            if wrong:
                raise InputError("names of signals", key="release", value=wrong[0])
            for name in value or [None]:
                self._player.overrides.release(name)
        elif word == "inject" and isinstance(value, Mapping):
            self._player.inject(value)
        elif word == "heal":
            self._player.heal()
        elif word not in WORDS:
            raise InputError(f"there are {', '.join(WORDS)}{nearest(word, WORDS)}", key="request", value=word)
        elif word != "show":
            raise InputError("not what it wants", key=word, value=value)

    def _drop(self, peer: socket.socket) -> None:
        self._peers.pop(peer, None)
        peer.close()

    def close(self) -> None:
        """End it."""
        for peer in list(self._peers):
            self._drop(peer)
        self._socket.close()
        self._path.unlink(missing_ok=True)


def ask(path: Path, request: Mapping[str, Any], *, patience_s: float = 30.0) -> dict[str, Any]:
    """Ask a running simulation.

    Args:
        path: of its socket.
        request: one of WORDS with its value.
        patience_s: how long an answer may take [s].

    Raises:
        InputError: no simulation listens there, no answer came, or it was refused.
    """
    try:
        with connect(path, patience_s=patience_s) as peer:
            peer.sendall(line(dict(request)).encode() + b"\n")
            heard = b""
            while not heard.endswith(b"\n"):
                data = peer.recv(LINE_BYTES)
                if not data:
                    raise InputError("the simulation has ended", value=str(path))
                heard += data
    except OSError as error:
        text = f"no simulation with --control listens here: {error.strerror or error}"
        raise InputError(text, value=str(path)) from error
    answer: dict[str, Any] = json.loads(heard)
    if "error" in answer:
        raise InputError(str(answer["error"]))
    return answer


def request_of(words: Sequence[str]) -> dict[str, Any]:
    """Return the request that words on the command line are: ``set A.x=5``, ``release A.x``, ``inject kind=lost ...``.

    Raises:
        InputError: words that are none.
    """
    word, rest = (words[0], words[1:]) if words else ("show", ())
    pairs = dict(text.partition("=")[::2] for text in rest)
    if word in ("set", "inject"):
        wrong = [text for text in rest if "=" not in text]
        if wrong or not rest:
            raise InputError(f"{word} NAME=VALUE ...", value=wrong[0] if wrong else word)
        return {word: {name: _value(text) for name, text in pairs.items()}}
    if word == "release":
        return {word: list(rest)}
    return {word: True}


def _value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
