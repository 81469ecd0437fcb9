"""Layouts of service 0x01, current data, as SAE J1979 (ISO 15031-5) defines them; names are the standard's.

Each row of the table is a signal: PID, name, first bit (the highest bit of byte A is 0), length, factor, what is added,
unit; ``s`` after the length: with a sign. ``=`` and words are what the numbers from 0 on mean, ``-``: nothing.
"""

from __future__ import annotations

from collections.abc import Collection
from fractions import Fraction
from functools import cache
from typing import Any

from gateway.config.ecu import PAGES
from gateway_ask.answers.model import AnswerLayout, message_of, signal_of
from gateway_ask.answers.monitor_tests import layout_of
from gateway_ask.answers.obd_on_uds import classic

_SENSORS = ("11", "12", "13", "14", "21", "22", "23", "24")

#: Fuel trims: PID -> name, first bank; a second byte is of the bank two further, where a car has it.
TRIMS = {
    0x06: ("SHRTFT", 1), 0x07: ("LONGFT", 1), 0x08: ("SHRTFT", 2), 0x09: ("LONGFT", 2),
    0x55: ("STSO2FT", 1), 0x56: ("LGSO2FT", 1), 0x57: ("STSO2FT", 2), 0x58: ("LGSO2FT", 2),
}  # fmt: skip
#: Values of PID 0x69, by the bit that says they are there.
_EGR = ("EGR_A_CMD", "EGR_A_ACT", "EGR_A_ERR", "EGR_B_CMD", "EGR_B_ACT", "EGR_B_ERR")
#: Monitors of PIDs 0x01 and 0x41, from bit 8 of the answer on; 1 of readiness or completion: not yet.
_CONTINUOUS = ("CCM", "FUEL", "MIS")
_OTHERS = ("EGR", "HTR", "O2S", "ACRF", "AIR", "EVAP", "HCAT", "CAT")
#: Rows of one bit, from their length on.
_NO, _DONE = "1 1 0 - =no,yes", "1 1 0 - =yes,no"

_TABLE = """
01 MIL 0 1 1 0 - =off,on
01 DTC_CNT 1 7 1 0 -
03 FUELSYS1 0 8 1 0 - =off,OL,CL,-,OL-Drive,-,-,-,OL-Fault,-,-,-,-,-,-,-,CL-Fault
03 FUELSYS2 8 8 1 0 - =off,OL,CL,-,OL-Drive,-,-,-,OL-Fault,-,-,-,-,-,-,-,CL-Fault
04 LOAD_PCT 0 8 100/255 0 %
05 ECT 0 8 1 -40 degC
0A FRP 0 8 3 0 kPa
0B MAP 0 8 1 0 kPa
0C RPM 0 16 1/4 0 rpm
0D VSS 0 8 1 0 km/h
0E SPARKADV 0 8 1/2 -64 deg
0F IAT 0 8 1 -40 degC
10 MAF 0 16 1/100 0 g/s
11 TP 0 8 100/255 0 %
12 AIR_STAT 0 8 1 0 - =-,UPS,DNS,-,OFF,-,-,-,DIAG
1C OBDSUP 0 8 1 0 - =-,OBD-II,OBD,OBD-and-OBD-II,OBD-I,NO-OBD,EOBD,EOBD-and-OBD-II,EOBD-and-OBD,EOBD-OBD-OBD-II,JOBD
1E PTO_STAT 7 1 1 0 - =off,on
1F RUNTM 0 16 1 0 s
21 MIL_DIST 0 16 1 0 km
22 FRP 0 16 79/1000 0 kPa
23 FRP 0 16 10 0 kPa
2C EGR_PCT 0 8 100/255 0 %
2D EGR_ERR 0 8 100/128 -100 %
2E EVAP_PCT 0 8 100/255 0 %
2F FLI 0 8 100/255 0 %
30 WARM_UPS 0 8 1 0 -
31 CLR_DIST 0 16 1 0 km
32 EVAP_VP 0 16s 1/4 0 Pa
33 BARO 0 8 1 0 kPa
3C CATEMP11 0 16 1/10 -40 degC
3D CATEMP21 0 16 1/10 -40 degC
3E CATEMP12 0 16 1/10 -40 degC
3F CATEMP22 0 16 1/10 -40 degC
42 VPWR 0 16 1/1000 0 V
43 LOAD_ABS 0 16 100/255 0 %
44 EQ_RAT 0 16 2/65536 0 -
45 TP_R 0 8 100/255 0 %
46 AAT 0 8 1 -40 degC
47 TP_B 0 8 100/255 0 %
48 TP_C 0 8 100/255 0 %
49 APP_D 0 8 100/255 0 %
4A APP_E 0 8 100/255 0 %
4B APP_F 0 8 100/255 0 %
4C TAC_PCT 0 8 100/255 0 %
4D MIL_TIME 0 16 1 0 min
4E CLR_TIME 0 16 1 0 min
51 FUEL_TYP 0 8 1 0 - =-,GAS,METH,ETH,DSL,LPG,CNG,PROP,ELEC,BI_GAS,BI_METH,BI_ETH,BI_LPG,BI_CNG,BI_PROP,BI_ELEC
52 ALCH_PCT 0 8 100/255 0 %
53 EVAP_VPA 0 16 1/200 0 kPa
54 EVAP_VP 0 16s 1 0 Pa
59 FRP 0 16 10 0 kPa
5A APP_R 0 8 100/255 0 %
5B BAT_PWR 0 8 100/255 0 %
5C EOT 0 8 1 -40 degC
5D FUEL_TIMING 0 16 1/128 -210 deg
5E FUEL_RATE 0 16 1/20 0 l/h
61 TQ_DD 0 8 1 -125 %
62 TQ_ACT 0 8 1 -125 %
63 TQ_REF 0 16 1 0 Nm
8E TQ_FR 0 8 1 -125 %
9A HEV_BATT_V_SUP 6 1 1 0 - =no,yes
9A HEV_BATT_A_SUP 5 1 1 0 - =no,yes
9A HEV_BATT_V 16 16 1/64 0 V
9A HEV_BATT_A 32 16s 1/10 0 A
9D ENG_FUEL_RATE 0 16 1/50 0 g/s
9D VEH_FUEL_RATE 16 16 1/50 0 g/s
9E EXH_RATE 0 16 1/5 0 kg/h
A2 CYL_RATE 0 16 1/32 0 mg/stroke
A6 ODO 0 32 1/10 0 km
B2 BAT_SOH 0 8 100/255 0 %
D2 SOCE_SUP 7 1 1 0 - =no,yes
D2 SOCR_SUP 6 1 1 0 - =no,yes
D2 SOCE 8 8 100/255 0 %
D2 SOCR 16 8 100/255 0 %
D3 ODO_ENG 0 32 1/10 0 km
"""


def _rows() -> list[str]:
    """Return the rows of the table, and those that the standard repeats."""
    rows = _TABLE.split("\n")
    for pid, state, enabled in (("01", "RDY", "SUP"), ("41", "CMPL", "ENA")):
        rows.append(f"{pid} CIM_SUP 12 1 1 0 - =spark,compression")
        for k, name in enumerate(_CONTINUOUS):
            rows += [f"{pid} {name}_{state} {9 + k} {_DONE}", f"{pid} {name}_{enabled} {13 + k} {_NO}"]
        for k, name in enumerate(_OTHERS):
            rows += [f"{pid} {name}_{enabled} {16 + k} {_NO}", f"{pid} {name}_{state} {24 + k} {_DONE}"]
    rows += [f"64 TQ_MAX{k + 1} {8 * k} 8 1 -125 %" for k in range(5)]
    for trim, (name, bank) in TRIMS.items():
        rows += [f"{trim:02X} {name}{bank + 2 * k} {8 * k} 8 100/128 -100 %" for k in (0, 1)]
    for k, name in enumerate(_EGR):
        scale = "100/128 -100" if name.endswith("ERR") else "100/255 0"
        rows += [f"69 {name}_SUP {7 - k} {_NO}", f"69 {name} {8 + 8 * k} 8 {scale} %"]
    for k, name in enumerate(_SENSORS):
        rows += [f"{0x14 + k:02X} O2S{name} 0 8 1/200 0 V", f"{0x14 + k:02X} SHRTFT{name} 8 8 100/128 -100 %"]
        rows += [f"{0x24 + k:02X} LAMBDA{name} 0 16 2/65536 0 -", f"{0x24 + k:02X} O2S{name} 16 16 8/65536 0 V"]
        rows += [f"{0x34 + k:02X} LAMBDA{name} 0 16 2/65536 0 -", f"{0x34 + k:02X} O2S{name} 16 16 1/256 -128 mA"]
        rows.append(f"13 O2S{name}_EXISTS {7 - k} {_NO}")
    return rows


def _signal(name: str, first: str, length: str, scale: str, offset: str, unit: str, texts: str = "=") -> Any:
    start = int(first)
    return signal_of(
        name,
        8 * (start // 8) + 7 - start % 8,
        int(length.rstrip("s")),
        big=True,
        signed=length.endswith("s"),
        scale=float(Fraction(scale)),
        offset=float(offset),
        texts={k: text for k, text in enumerate(texts[1:].split(",")) if text not in ("", "-")},
        unit=None if unit == "-" else unit,
    )


@cache
def j1979() -> tuple[AnswerLayout, ...]:
    """Return the layouts of the standard's PIDs, in their order."""
    signals: dict[int, list[Any]] = {}
    for row in filter(None, _rows()):
        pid, *fields = row.split()
        signals.setdefault(int(pid, 16), []).append(_signal(*fields))
    return tuple(AnswerLayout(0x01, pid, message_of(0x01, pid, found)) for pid, found in sorted(signals.items()))


def layouts_of_obd(keys: Collection[tuple[int, int]], *, whole: bool) -> list[AnswerLayout]:
    """Return the layouts of what is read of an ECU by OBD, whichever protocol it speaks.

    Args:
        keys: service and identifier of what is read; one of OBD on UDS by its own number gets a layout of its own.
        whole: all layouts of the standard, also where nothing is read.
    """
    standard = {(layout.service, layout.identifier): layout for layout in j1979()}
    found = list(standard.values()) if whole or any(service in PAGES for service, _ in keys) else []
    for key in keys:
        of = classic(*key) or key
        if of[0] == 0x06 and of[1] % 0x20:
            found.append(layout_of(of[1]))
        elif of in standard and of not in keys:
            found.append(AnswerLayout(*key, message_of(*key, standard[of].message.signals)))
    return found
