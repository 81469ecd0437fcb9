"""A UDS server with some data identifiers, and a tester that has each answer read by another decoder."""

from rig import Tester, dtc_text
from uds.translator import BASE_TRANSLATOR_2020

from gateway.faults.dtc import Dtc

DIDS = """
[[did]]
id = 0xF190
name = "vin"
text = "1HGCM82633A004352"

[[did]]
id = 0x0123
name = "volts"
signal = "M0.Value"
type = "u16"
scale = 0.25

[[did]]
id = 0x0124
name = "setting"
hex = "0102"
writable = true
"""
#: Of tests that are about what is done, not about who may do it.
ANYBODY = "[access]\nclear = {}\nreset = {}\nroutine = {}\n"
EXTRA = "[output.uds]\n{uds}\n" + DIDS


def hexed(k):
    return bytes(Dtc.parse(dtc_text(k))).hex()


def read_by_others(answer):
    """Read an answer as py-uds understands ISO 14229-1:2020; raises what it finds wrong."""
    known = BASE_TRANSLATOR_2020.services_mapping
    if answer[0] != 0x7F:
        known[answer[0]].decode(answer)
    elif answer[1] in known:
        known[answer[1]].decode_negative_response(answer)


class Asked(Tester):
    """Answers as hex digits, each read by another decoder on the way."""

    def __call__(self, request, **options):
        answers = self.exchange(bytes.fromhex(request), **options)
        for answer in answers:
            # 04 and 06: their length needs our table; 05 of a record that is not there is its number alone (C1 of the
            # standard's table), which this decoder does not know.
            if answer[0] != 0x59 or not (answer[1] in (0x04, 0x06) or (answer[1] == 0x05 and len(answer) == 3)):
                read_by_others(answer)
        return " ".join(answer.hex() for answer in answers)
