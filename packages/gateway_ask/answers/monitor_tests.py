"""Results of an ECU's own monitors (service 0x06 of SAE J1979 on CAN, 22 F6xx of SAE J1979-2), with their limits.

A result has a test, a scaling, a value, a least and a greatest one. The scalings are those of SAE J1979, Appendix E,
which is for sale, as public readers have them (python-OBD reads the same: ``scripts/judge-j1979``). Names of tests are
the carmaker's.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

from gateway_ask.answers.model import AnswerLayout, message_of, signal_of
from gateway_ask.answers.obd_on_uds import RECORD

#: Results of a monitor that its layout has room for; bytes of a result there: its test, three numbers of 32 bits.
MOST, _BYTES = 8, 13
#: Bytes of that layout: a file's own layout of the raw bytes is shorter.
LENGTH = MOST * _BYTES

#: Scaling, factor, unit, what is added; from 0x80 on the numbers have signs.
_TABLE = """
01 1|02 0.1|03 0.01|04 0.001|05 0.0000305|06 0.000305|07 0.25 rpm|08 0.01 km/h|09 1 km/h|0A 0.122 mV|0B 0.001 V
0C 0.01 V|0D 0.00390625 mA|0E 0.001 A|0F 0.01 A|10 1 ms|11 100 ms|12 1 s|13 1 mohm|14 1 ohm|15 1 kohm
16 0.1 degC -40|17 0.01 kPa|18 0.0117 kPa|19 0.079 kPa|1A 1 kPa|1B 10 kPa|1C 0.01 deg|1D 0.5 deg|1E 0.0000305
1F 0.05|20 0.00390625|21 1 mHz|22 1 Hz|23 1 kHz|24 1|25 1 km|26 0.1 mV/ms|27 0.01 g/s|28 1 g/s|29 0.25 Pa/s
2A 0.001 kg/h|2B 1|2C 0.01 g|2D 0.01 mg|2F 0.01 %|30 0.001526 %|31 0.001 l|32 0.0000305 in|33 0.00024414
34 1 min|35 10 ms|36 0.01 g|37 0.1 g|38 1 g|39 0.01 % -327.68|3A 0.001 g|3B 0.0001 g|3C 0.1 us|3D 0.01 mA
3E 0.00006103516 mm^2|3F 0.01 l|40 1 ppm|41 0.01 uA
81 1|82 0.1|83 0.01|84 0.001|85 0.0000305|86 0.000305|87 1 ppm|8A 0.122 mV|8B 0.001 V|8C 0.01 V|8D 0.00390625 mA
8E 0.001 A|90 1 ms|96 0.1 degC|99 0.1 kPa|9C 0.01 deg|9D 0.5 deg|A8 1 g/s|A9 0.25 Pa/s|AD 0.01 mg|AE 0.1 mg|AF 0.01 %
B0 0.003052 %|B1 2 mV/s|FC 0.01 kPa|FD 0.001 kPa|FE 0.25 Pa
"""


class Scaling(NamedTuple):
    """A number's factor, its unit, and what is added [unit]."""

    factor: float
    unit: str = ""
    offset: float = 0.0


def _scalings() -> dict[int, Scaling]:
    found = {}
    for row in filter(None, _TABLE.replace("\n", "|").split("|")):
        number, factor, *rest = row.split()
        found[int(number, 16)] = Scaling(float(factor), "".join(rest[:1]), float("".join(rest[1:]) or 0))
    return found


#: By the standard's number of it.
SCALINGS = _scalings()


class Result(NamedTuple):
    """Result of a test; its numbers are NaN where nobody knows their scaling.

    Attributes:
        test: number of the test.
        value: of the test [unit].
        low: least value that passes [unit].
        high: greatest value that passes [unit].
        unit: of all three; "": none.
        passed: whether it passed; None: it has not run, or the scaling is not known.
    """

    test: int
    value: float
    low: float
    high: float
    unit: str
    passed: bool | None

    def __str__(self) -> str:
        """Return it for people."""
        state = {True: "passed", False: "FAILED", None: "no result"}[self.passed]
        unit = f" {self.unit}" if self.unit else ""
        return f"test {self.test:02X} {self.value:g}{unit}, {self.low:g} to {self.high:g}: {state}"


def results(data: bytes) -> Iterator[Result]:
    """Yield the results of a monitor.

    Args:
        data: of classic OBD, behind the monitor's number, which each further result repeats; a rest is left out.
    """
    for at in range(0, len(data) - RECORD + 1, RECORD + 1):
        test, number = data[at : at + 2]
        raw = struct.unpack_from(">3h" if number & 0x80 else ">3H", data, at + 2)
        factor, unit, offset = SCALINGS.get(number, Scaling(float("nan")))
        value, low, high = (factor * each + offset for each in raw)
        known = number in SCALINGS and any(raw)
        yield Result(test, value, low, high, unit, raw[1] <= raw[0] <= raw[2] if known else None)


def layout_of(monitor: int) -> AnswerLayout:
    """Return the layout of a monitor's results, as :func:`laid_out` has them: TEST1, VALUE1, LOW1, HIGH1, TEST2 ..."""
    signals = []
    for k in range(MOST):
        signals.append(signal_of(f"TEST{k + 1}", 8 * _BYTES * k + 7, 8, big=True))
        for j, name in enumerate(("VALUE", "LOW", "HIGH")):
            start = 8 * (_BYTES * k + 1 + 4 * j) + 7
            signals.append(signal_of(f"{name}{k + 1}", start, 32, big=True, real=True))
    return AnswerLayout(0x06, monitor, message_of(0x06, monitor, signals))


def laid_out(data: bytes) -> bytes:
    """Return results with their numbers in units, for the layout; their data as in :func:`results`."""
    found = list(results(data))[:MOST]
    return b"".join(struct.pack(">B3f", one.test, one.value, one.low, one.high) for one in found)
