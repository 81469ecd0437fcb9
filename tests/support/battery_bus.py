"""A bus with a battery's messages, for monitors that tests make up."""

from gateway.bus.frames import empty, put
from gateway.signals.database import load_database

DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 BATT: 8 A
 SG_ Volts : 0|16@1+ (0.01,0) [0|100] "V" A
 SG_ Amps : 16|16@1- (0.01,0) [-100|100] "A" A
BO_ 257 OTHER: 8 A
 SG_ Volts : 0|16@1+ (0.01,0) [0|100] "V" A
BO_ 258 SAID: 8 A
 SG_ Twice : 0|16@1+ (0.01,0) [0|100] "V" A
 SG_ Half : 16|16@1+ (0.01,0) [0|100] "V" A
BO_ 259 CELLS: 8 A
 SG_ Page M : 0|8@1+ (1,0) [0|255] "" A
 SG_ First m0 : 8|16@1+ (0.01,0) [0|100] "V" A
 SG_ Second m1 : 8|16@1+ (0.01,0) [0|100] "V" A
 SG_ Third m2 : 8|32@1- (1,0) [0|100] "V" A
SIG_VALTYPE_ 259 Third : 1;
"""
PERIOD_NS = 1_000_000


def battery_database(folder):
    """Return the database, written to a folder."""
    path = folder / "battery.dbc"
    path.write_text(DBC)
    return load_database([path])


def voltages(volts, after_ns=0):
    """Return frames of BATT, one a millisecond."""
    frames = empty(len(volts))
    for k, value in enumerate(volts):
        put(frames, k, after_ns + (k + 1) * PERIOD_NS, 256, round(100 * value).to_bytes(2, "little") + bytes(6))
    return frames
