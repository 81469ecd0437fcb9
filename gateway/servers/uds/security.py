"""Security access (ISO 14229-1, 0x27): seeds and keys."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gateway.common.plugins import Registry, accept_callable
from gateway.servers.uds.attempts import Attempts
from gateway.servers.uds.nrc import NegativeError, Nrc
from gateway.servers.uds.params import SecurityLevel
from gateway_fdi.errors import InputError, under

#: Takes seed, secret and level; returns the key.
KeyFunction = Callable[[bytes, bytes, int], bytes]


def hmac_sha256(seed: bytes, secret: bytes, level: int) -> bytes:
    """Return the first bytes, as many as the seed has, of HMAC-SHA256 over seed and level."""
    return hmac.new(secret, seed + bytes([level]), hashlib.sha256).digest()[: len(seed)]


#: Key functions of other packages, by name.
KEYS: Registry[KeyFunction] = Registry("gateway.keys", accept_callable)


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
    attempts: Attempts


class Security:
    """State of security access.

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
                attempts = Attempts(str(params.level), params.attempts, params.delay_s, params.start_delay_s)
                self._levels[params.level] = _Level(params, key_function(params.key), attempts)
        self._random = random
        self._seed: tuple[int, bytes] | None = None
        self.unlocked = 0

    def beside(self) -> Security:
        """Return the security of another tester: unlocked by itself, but wrong keys count for both."""
        other = Security((), self._random)
        other._levels = self._levels
        return other

    @property
    def attempts(self) -> list[Attempts]:
        """Attempts at each level."""
        return [level.attempts for level in self._levels.values()]

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
        state.attempts.check(t_ns)
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
        state.attempts.begin(t_ns)
        right = state.key(seed, bytes.fromhex(state.params.secret), level)
        if not hmac.compare_digest(right, key):
            state.attempts.fail(t_ns, Nrc.INVALID_KEY)
        state.attempts.forgive()
        self.unlocked = level
