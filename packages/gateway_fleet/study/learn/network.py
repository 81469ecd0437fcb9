"""The network of a virtual car: 40 messages drawn from a seed, with the truth of how each is sent and protected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gateway.signals.protection.checksum import Checksum
from gateway.signals.protection.crc import Crc
from gateway.signals.protection.rules import RULES, Frame

#: Messages; of these, the ones that carry the drive, and those sent when something happens.
MESSAGES, EVENTS = 40, 3
#: Periods of the others [s].
PERIODS = (0.01, 0.02, 0.02, 0.04, 0.05, 0.1, 0.1, 0.2, 0.5, 1.0)
#: How messages are protected; a carmaker's rule has its constants in the identifier.
KINDS = ("none", "none", "counter", "sum", "xor", "crc", "toyota", "subaru", "copy")
ECUS = 9


@dataclass(frozen=True)
class Field:
    """A signal: its place, its contents (name of a course), and their steps."""

    name: str
    start: int
    bits: int
    course: str
    scale: float = 1.0
    offset: float = 0.0
    signed: bool = False
    unit: str = ""
    low: float = 0.0
    high: float = 0.0


@dataclass(frozen=True)
class Sent:
    """A message with its truth.

    Attributes:
        name, can_id, length: of it; length in bytes.
        period_s: 0: it comes when something happens.
        ecu: its sender.
        fields: its signals, counter and checksum not among them.
        counter: name, first bit, bits and modulus; None: it has none.
        checksum: name and first bit of one of 8 bits, with its rule; None: it has none.
        loop: index of the period in which its course repeats, for courses of its own.
    """

    name: str
    can_id: int
    length: int
    period_s: float
    ecu: int
    fields: tuple[Field, ...]
    counter: tuple[str, int, int, int] | None = None
    checksum: tuple[str, int, Checksum] | None = None


@dataclass
class Network:
    """All messages."""

    messages: list[Sent] = field(default_factory=list)

    def dbc(self) -> str:
        """Return its database."""
        ecus = " ".join(f"E{k}" for k in range(ECUS))
        text = f'VERSION ""\nNS_ :\nBS_:\nBU_: {ecus}\n'
        for m in self.messages:
            text += f"BO_ {m.can_id} {m.name}: {m.length} E{m.ecu}\n"
            plain = list(m.fields)
            plain += [Field(m.counter[0], m.counter[1], m.counter[2], "")] if m.counter else []
            plain += [Field(m.checksum[0], m.checksum[1], 8, "")] if m.checksum else []
            for f in plain:
                sign = "-" if f.signed else "+"
                text += f' SG_ {f.name} : {f.start}|{f.bits}@1{sign} ({f.scale},{f.offset}) [{f.low}|{f.high}] "{f.unit}" E0\n'  # noqa: E501
        text += 'VAL_ 180 GearNow 0 "N" 1 "1st" 2 "2nd" 3 "3rd" 4 "4th" 5 "5th" 6 "6th" 14 "R" ;\n'
        return text


def _drive() -> list[tuple[str, float, int, list[Field]]]:
    """Return the messages that carry the drive: name, period [s], ECU, signals from byte 0 on."""
    wheel = [
        Field(f"Wheel{n}", 12 * k, 12, f"wheel{n}", 0.08, unit="km/h") for k, n in enumerate(("FL", "FR", "RL", "RR"))
    ]
    return [
        ("Wheels", 0.02, 0, wheel),
        ("Speed", 0.02, 0, [Field("Vehicle", 0, 16, "speed", 0.01, unit="km/h", high=250.0)]),
        ("Engine", 0.01, 1, [Field("Rpm", 0, 16, "rpm", 0.25, unit="rpm"), Field("Torque", 16, 12, "torque", 0.25, -200.0, unit="Nm")]),  # noqa: E501
        ("Pedal", 0.02, 1, [Field("Accel", 0, 8, "pedal", 0.4, unit="%"), Field("Brake", 8, 12, "brake", 0.1, unit="bar")]),  # noqa: E501
        ("Steering", 0.01, 2, [Field("Angle", 0, 16, "angle", 0.1, -1500.0, unit="deg", low=-780.0, high=780.0)]),
        ("Column", 0.02, 2, [Field("Angle2", 0, 12, "angle", 0.5, -1000.0, unit="deg"), Field("Effort", 16, 12, "effort", 0.01, -20.0, unit="Nm")]),  # noqa: E501
        ("Motion", 0.02, 3, [Field("Yaw", 0, 12, "yaw", 0.05, -100.0, unit="deg/s"), Field("Lateral", 12, 12, "lateral", 0.01, -20.0, unit="m/s2"), Field("Along", 24, 12, "along", 0.01, -20.0, unit="m/s2")]),  # noqa: E501
        ("Gear", 0.1, 4, [Field("GearNow", 0, 4, "gear")]),
        ("Temps", 0.5, 1, [Field("Coolant", 0, 8, "coolant", 1.0, -40.0, unit="degC"), Field("Outside", 8, 8, "outside", 0.5, -40.0, unit="degC")]),  # noqa: E501
        ("Battery", 0.1, 5, [Field("Volts", 0, 8, "volts", 0.1, unit="V")]),
        ("Cluster", 0.1, 6, [Field("Shown", 0, 8, "shown", 1.0, unit="km/h"), Field("Trip", 8, 16, "trip", 0.1, unit="km")]),  # noqa: E501
    ]  # fmt: skip


def network(seed: int) -> Network:
    """Return the network that a seed draws."""
    rng = np.random.default_rng([4096, seed])
    made = Network()
    drive = _drive()
    for k in range(MESSAGES):
        can_id = 0x100 + 16 * k + int(rng.integers(4))
        if k < len(drive):
            name, period, ecu, fields = drive[k]
            can_id = 180 if name == "Gear" else can_id
            used = max(f.start + f.bits for f in fields)
        else:
            name, ecu = f"Rest{k}", int(rng.integers(ECUS))
            period = 0.0 if k >= MESSAGES - EVENTS else float(rng.choice(PERIODS))
            fields, used = _rest(k, rng)
        made.messages.append(_protected(name, can_id, period, ecu, fields, used, rng))
    return made


def _rest(k: int, rng: np.random.Generator) -> tuple[list[Field], int]:
    """Return signals of courses of their own: wanders, ramps, states, constants, flags, a copy of another byte."""
    fields, at = [], 0
    for n in range(int(rng.integers(1, 5))):
        kind = str(rng.choice(("wander", "wander", "ramp", "state", "constant", "flag", "torque")))
        bits = {"state": 4, "flag": 1, "constant": 8, "torque": 8}.get(kind, int(rng.choice((8, 12, 16))))
        if at + bits > 40:
            break
        fields.append(Field(f"S{k}_{n}", at, bits, f"{kind} {k} {n} {bits}"))
        at += bits
        if kind == "torque" and at + 8 <= 40:
            fields.append(Field(f"S{k}_{n}c", at, 8, f"{kind} {k} {n} {bits}", offset=0.0))
            at += 8
    return fields, at


def _protected(
    name: str, can_id: int, period: float, ecu: int, fields: Sequence[Field], used: int, rng: np.random.Generator
) -> Sent:
    """Return a message with a protection drawn for it: counter after its signals, checksum in its last byte."""
    kind = str(rng.choice(KINDS))
    counter = checksum = None
    length = 8
    if kind in ("counter", "sum", "xor", "crc", "toyota", "subaru") and used <= 48:
        bits = int(rng.choice((4, 4, 4, 8, 2))) if kind == "counter" else 4
        modulus = 15 if bits == 4 and rng.random() < 0.3 else 1 << bits
        called = str(rng.choice((f"{name}_Counter", f"{name}_X", f"{name}_Botschaftszaehler")))
        counter = (called, 48, bits, modulus)
    if kind in ("sum", "xor", "crc", "toyota", "subaru") and counter is not None:
        rule = {
            "sum": Checksum(plus=int(rng.integers(256))),
            "xor": Checksum(xor=True, plus=int(rng.integers(256))),
            "crc": Checksum(Crc(8, int(rng.integers(256)) | 1, int(rng.integers(256)), False, False, int(rng.integers(256)))),  # noqa: E501
            "toyota": RULES["toyota"](Frame(can_id, False, length)),
            "subaru": RULES["subaru"](Frame(can_id, False, length)),
        }[kind]  # fmt: skip
        called = str(rng.choice((f"{name}_Checksum", f"{name}_Y")))
        checksum = (called, 0 if kind == "subaru" else 56, rule)
        if kind == "subaru":  # its byte is the first one
            fields = [
                Field(f.name, f.start + 8, f.bits, f.course, f.scale, f.offset, f.signed, f.unit, f.low, f.high)
                for f in fields
            ]
            counter = (counter[0], 56, counter[2], counter[3])
    return Sent(name, can_id, length, period, ecu, tuple(fields), counter, checksum)
