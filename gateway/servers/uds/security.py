"""Security access (ISO 14229-1, 0x27): seeds, keys, attempts, delay."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

from gateway.common.plugins import Registry
from gateway.servers.uds.nrc import NegativeError, Nrc, refuse_unless
from gateway.servers.uds.params import SecurityLevel
from gateway_fdi.errors import InputError, under

#: Takes seed, secret and level; returns the key.
KeyFunction = Callable[[bytes, bytes, int], bytes]


def hmac_sha256(seed: bytes, secret: bytes, level: int) -> bytes:
    """Return the first bytes, as many as the seed has, of HMAC-SHA256 over seed and level."""
    return hmac.new(secret, seed + bytes([level]), hashlib.sha256).digest()[: len(seed)]


def _accepted(found: object, name: str) -> KeyFunction:
    if not callable(found):
        raise InputError("this is no function", value=name)
    return cast("KeyFunction", found)


#: Key functions of other packages, by name.
KEYS: Registry[KeyFunction] = Registry("gateway.keys", _accepted)


def key_function(name: str) -> KeyFunction:
    """Return a key function by its name.

    Raises:
        InputError: there is none of this name, it cannot be imported, or it is no function.
    """
    if name == "hmac_sha256":
        return hmac_sha256
    if ":" not in name and name not in KEYS:
        known = ", ".join(["hmac_sha256", *sorted(KEYS)])
        raise InputError(f'a key function is one of {known}, or "package.module:function"', value=name)
    return KEYS[name]


@dataclass
class _Level:
    params: SecurityLevel
    key: KeyFunction
    wrong: int = 0  # keys since the last right one; at most as many as are allowed
    locked_until_ns: int = 0

    def lock_out(self, t_ns: int, seconds: float) -> None:
        self.locked_until_ns = max(self.locked_until_ns, t_ns + round(seconds * 1e9))

    @property
    def is_spent(self) -> bool:
        return self.wrong >= self.params.attempts


#: Keeps how many wrong keys a level has had, durable on return; returns that number.
Keep = Callable[[int, int], None]
Kept = Callable[[int], int]


class Security:
    """State of security access.

    Wrong keys are counted in the fault memory's file, before they are looked at: neither a restart nor a power cut
    makes them forgotten. Restarting the gateway during a delay restarts the delay.

    Args:
        levels: those of the configuration.
        random: gives a seed of a number of bytes.

    Raises:
        InputErrors: a key function that cannot be found.
    """

    def __init__(
        self,
        levels: Sequence[SecurityLevel],
        random: Callable[[int], bytes] = secrets.token_bytes,
    ) -> None:
        self._levels: dict[int, _Level] = {}
        for k, params in enumerate(levels):
            with under(f"output.uds.security[{k}].key"):
                self._levels[params.level] = _Level(params, key_function(params.key))
        self._random = random
        self._keep: Keep = lambda level, wrong: None
        self._started = [False]  # one for all testers
        self._seed: tuple[int, bytes] | None = None
        self.unlocked = 0

    def beside(self) -> Security:
        """Return the security of another tester: unlocked by itself, but wrong keys count for both."""
        other = Security((), self._random)
        other._levels, other._keep, other._started = self._levels, self._keep, self._started
        return other

    def keep_in(self, kept: Kept, keep: Keep) -> None:
        """Count wrong keys where they outlast this process.

        Args:
            kept: level -> how many it has had.
            keep: takes level and number.
        """
        self._keep = keep
        for level, state in self._levels.items():
            state.wrong = min(max(kept(level), 0), state.params.attempts)

    def start(self, t_ns: int) -> None:
        """Begin the delays of a start, with the first request: before it no time is known."""
        if not self._started[0]:
            self._started[0] = True
            for state in self._levels.values():
                state.lock_out(t_ns, state.params.delay_s if state.is_spent else state.params.start_delay_s)

    @property
    def levels(self) -> list[int]:
        """Levels that there are."""
        return sorted(self._levels)

    def lock(self) -> None:
        """Lock everything, as at a change of session; attempts stay counted."""
        self.unlocked = 0
        self._seed = None

    def seed(self, level: int, t_ns: int) -> bytes:
        """Return a seed; all zero if the level is unlocked already.

        Raises:
            NegativeError: the delay after wrong keys is not over.
        """
        state = self._levels[level]
        if self.unlocked == level:
            return bytes(state.params.seed_length)
        refuse_unless(t_ns >= state.locked_until_ns, Nrc.REQUIRED_TIME_DELAY_NOT_EXPIRED)
        seed = self._random(state.params.seed_length)
        while not any(seed):  # would say "unlocked"
            seed = self._random(state.params.seed_length)
        self._seed = level, seed
        return seed

    def try_key(self, level: int, key: bytes, t_ns: int) -> None:
        """Unlock a level.

        Raises:
            NegativeError: no seed was asked for, the key is wrong, or was wrong too often.
        """
        state = self._levels[level]
        if self._seed is None or self._seed[0] != level:
            raise NegativeError(Nrc.REQUEST_SEQUENCE_ERROR)
        seed = self._seed[1]
        self._seed = None
        self._count(level, state, min(state.wrong + 1, state.params.attempts))
        right = state.key(seed, bytes.fromhex(state.params.secret), level)
        if hmac.compare_digest(right, key):
            self._count(level, state, 0)
            self.unlocked = level
            return
        if state.is_spent:  # and stays so: one attempt after each further delay (Annex I)
            state.lock_out(t_ns, state.params.delay_s)
            raise NegativeError(Nrc.EXCEEDED_NUMBER_OF_ATTEMPTS)
        raise NegativeError(Nrc.INVALID_KEY)

    def _count(self, level: int, state: _Level, wrong: int) -> None:
        state.wrong = wrong
        self._keep(level, wrong)
