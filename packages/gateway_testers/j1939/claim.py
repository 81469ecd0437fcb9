"""NAME and address claim (SAE J1939-81)."""

from __future__ import annotations

import random

from pydantic import Field

from gateway.common.times import NEVER
from gateway.j1939.frame import ADDRESS_CLAIMED, GLOBAL, NULL, Pdu
from gateway_fdi.common.tomlfile import StrictModel

#: Time for others to contend after a claim.
CONTEND_NS = 250_000_000
#: Most that a look's time may lag that of the bus: some looks have the time of the monitors.
LAG_NS = 20_000_000
#: The longest random delay before "cannot claim" (J1939-81, 4.4.4.3): 255 times 0.6 ms.
DELAYS, DELAY_NS = 255, 600_000
#: Addresses that a device which can take any may take (J1939-81).
FREE = range(128, 248)


class NameParams(StrictModel):
    """The 64-bit NAME, its fields from the lowest bits up."""

    identity: int = Field(1, ge=0, le=0x1FFFFF, description="identity number")
    manufacturer: int = Field(0x7FF, ge=0, le=0x7FF, description="manufacturer code")
    ecu_instance: int = Field(0, ge=0, le=7, description="ECU instance")
    function_instance: int = Field(0, ge=0, le=31, description="function instance")
    function: int = Field(129, ge=0, le=255, description="function; 129: off-board diagnostic-service tool")
    vehicle_system: int = Field(0, ge=0, le=127, description="vehicle system")
    vehicle_system_instance: int = Field(0, ge=0, le=15, description="vehicle system instance")
    industry_group: int = Field(0, ge=0, le=7, description="industry group; 0: global")
    any_address: bool = Field(False, description="takes another address if its own is taken")

    @property
    def value(self) -> int:
        """The NAME as a number: the smaller wins an address."""
        return (
            self.identity
            | self.manufacturer << 21
            | self.ecu_instance << 32
            | self.function_instance << 35
            | self.function << 40
            | self.vehicle_system << 49
            | self.vehicle_system_instance << 56
            | self.industry_group << 60
            | int(self.any_address) << 63
        )


class Claim:
    """Claims an address and defends it; without one we may not speak, but for saying so.

    Args:
        name: our NAME; the random delays are drawn from it.
        address: the one we would like.
    """

    def __init__(self, name: NameParams, address: int) -> None:
        self._name = name
        self._data = name.value.to_bytes(8, "little")
        self._taken: set[int] = set()
        self.address = address
        self._given_ns: int | None = None  # when the claim was given to be sent
        self._due_ns: int | None = None  # when the address is claimed; None: it is not known that the claim has left
        self.claimed = False
        self.lost = False
        self._random = random.Random(name.value)
        self._cannot_ns: int | None = None  # when to say "cannot claim"

    def _claimed_message(self) -> Pdu:
        return Pdu(ADDRESS_CLAIMED, self.address, GLOBAL, self._data)

    def start(self, t_ns: int) -> list[Pdu]:
        """Claim the address.

        The claim leaves some time later: the engine's time may be old, and the first turn of a daemon takes long. The
        next look at the clock comes after it has left; from that look on others have their time to contend.
        """
        self._given_ns, self._due_ns = t_ns, None
        self.claimed = self.lost = False
        self._cannot_ns = None
        return [self._claimed_message()]

    def command(self, name: bytes, address: int, t_ns: int) -> list[Pdu]:
        """Take a commanded address (J1939-81, 4.2.3), if it is our NAME that is meant."""
        if name != self._data or address == self.address or address >= NULL:
            return []
        self.address = address
        return self.start(t_ns)

    def on_time(self, t_ns: int) -> list[Pdu]:
        """Claim at first; have the address once no other has contended in time."""
        if self._given_ns is None:
            return [] if self.lost else self.start(t_ns)
        if self._cannot_ns is not None and t_ns >= self._cannot_ns:
            self._cannot_ns = None
            return [self._claimed_message()]
        if not self.claimed and not self.lost:
            if self._due_ns is not None:
                self.claimed = t_ns >= self._due_ns
            elif t_ns > self._given_ns:
                self._due_ns = t_ns + LAG_NS + CONTEND_NS
        return []

    def _say_cannot(self, t_ns: int) -> None:
        """Say "cannot claim" after a random delay: others that lost may say it at once, too."""
        if self._cannot_ns is None:
            self._cannot_ns = t_ns + self._random.randint(0, DELAYS) * DELAY_NS

    @property
    def next_ns(self) -> int:
        """Time at which :meth:`on_time` has something to do."""
        if self._cannot_ns is not None:
            return self._cannot_ns
        if self.claimed or self.lost:
            return NEVER
        if self._given_ns is None:
            return 0
        return self._given_ns + 1 if self._due_ns is None else self._due_ns

    def on_claim(self, pdu: Pdu, t_ns: int) -> list[Pdu]:
        """Take another's claim: defend the address, or give it up to a smaller NAME.

        One with our NAME is our own that has come back, from a bridge, a second adapter, an echo: NAMEs are unique
        (J1939-81, 4.1.1), so it is no contention.
        """
        if len(pdu.data) != 8 or pdu.source == NULL or pdu.data == self._data:
            return []
        self._taken.add(pdu.source)
        if pdu.source != self.address or self.lost:
            return []
        if self._name.value < int.from_bytes(pdu.data, "little"):
            return [self._claimed_message()]
        free = [address for address in FREE if address not in self._taken]
        if self._name.any_address and free:
            self.address = free[0]
            return self.start(t_ns)
        self.address, self.lost, self.claimed = NULL, True, False
        self._say_cannot(t_ns)
        return []

    def on_request(self, t_ns: int) -> list[Pdu]:
        """Answer a request for the address claimed: with the claim, or that there is none (J1939-81, 4.2.1)."""
        if self._given_ns is None:
            return []
        if self.lost:
            self._say_cannot(t_ns)
            return []
        return [self._claimed_message()]
