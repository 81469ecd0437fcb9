"""Files of layouts as people have them, made for tests: an ODX-D, a signal set, a CDD."""

import json

# ruff: noqa: E501 - texts of files
_NUMBER = """<DATA-OBJECT-PROP ID="D.{name}"><SHORT-NAME>{name}</SHORT-NAME>{compu}
<DIAG-CODED-TYPE BASE-DATA-TYPE="{base}" IS-HIGHLOW-BYTE-ORDER="{high}" xsi:type="STANDARD-LENGTH-TYPE">
<BIT-LENGTH>{bits}</BIT-LENGTH></DIAG-CODED-TYPE><PHYSICAL-TYPE BASE-DATA-TYPE="{physical}"/>{unit}</DATA-OBJECT-PROP>"""
_LINEAR = """<COMPU-METHOD><CATEGORY>LINEAR</CATEGORY><COMPU-INTERNAL-TO-PHYS><COMPU-SCALES><COMPU-SCALE>
<COMPU-RATIONAL-COEFFS><COMPU-NUMERATOR><V>{0}</V><V>{1}</V></COMPU-NUMERATOR><COMPU-DENOMINATOR><V>{2}</V>
</COMPU-DENOMINATOR></COMPU-RATIONAL-COEFFS></COMPU-SCALE></COMPU-SCALES></COMPU-INTERNAL-TO-PHYS></COMPU-METHOD>"""
_TEXTS = """<COMPU-METHOD><CATEGORY>TEXTTABLE</CATEGORY><COMPU-INTERNAL-TO-PHYS><COMPU-SCALES>
<COMPU-SCALE><LOWER-LIMIT>0</LOWER-LIMIT><UPPER-LIMIT>0</UPPER-LIMIT><COMPU-CONST><VT>open</VT></COMPU-CONST></COMPU-SCALE>
<COMPU-SCALE><LOWER-LIMIT>1</LOWER-LIMIT><UPPER-LIMIT>3</UPPER-LIMIT><COMPU-CONST><VT>shut</VT></COMPU-CONST></COMPU-SCALE>
</COMPU-SCALES></COMPU-INTERNAL-TO-PHYS></COMPU-METHOD>"""
_SAME = "<COMPU-METHOD><CATEGORY>IDENTICAL</CATEGORY></COMPU-METHOD>"
_CONST = """<PARAM xsi:type="CODED-CONST"><SHORT-NAME>{name}</SHORT-NAME><BYTE-POSITION>{byte}</BYTE-POSITION>
<CODED-VALUE>{value}</CODED-VALUE><DIAG-CODED-TYPE BASE-DATA-TYPE="A_UINT32" xsi:type="STANDARD-LENGTH-TYPE">
<BIT-LENGTH>{bits}</BIT-LENGTH></DIAG-CODED-TYPE></PARAM>"""
_VALUE = """<PARAM xsi:type="VALUE"><SHORT-NAME>{name}</SHORT-NAME><BYTE-POSITION>{byte}</BYTE-POSITION>
<BIT-POSITION>{bit}</BIT-POSITION><DOP-REF ID-REF="D.{dop}"/></PARAM>"""

#: Name, type, bits, most significant byte first, conversion, byte and bit in the answer.
NUMBERS = (
    ("voltage", "A_UINT32", 16, "true", _LINEAR.format(0, 1, 1000), "A_FLOAT64", 3, 0),
    ("current", "A_INT32", 12, "true", _LINEAR.format(-5, 2, 4), "A_FLOAT64", 5, 3),
    ("speed", "A_UINT32", 16, "false", _LINEAR.format(100, 0.25, 1), "A_FLOAT64", 7, 0),
    ("door", "A_UINT32", 2, "true", _TEXTS, "A_UNICODE2STRING", 9, 5),
    ("ratio", "A_FLOAT32", 32, "true", _SAME, "A_FLOAT32", 10, 0),
    ("odd", "A_INT32", 10, "false", _SAME, "A_INT32", 14, 2),
)


def odx(did=0x1234):
    """Return the text of an ODX-D file with one service that reads an identifier, and one that does something else."""
    dops = [
        _NUMBER.format(
            name=name, base=base, bits=bits, high=high, compu=compu, physical=physical,
            unit='<UNIT-REF ID-REF="U.V"/>' if name == "voltage" else "",
        )
        for name, base, bits, high, compu, physical, _, _ in NUMBERS
    ]  # fmt: skip
    values = [_VALUE.format(name=name, byte=byte, bit=bit, dop=name) for name, *_, byte, bit in NUMBERS]
    answer = [
        _CONST.format(name="sid", byte=0, value=0x62, bits=8),
        _CONST.format(name="did", byte=1, value=did, bits=16),
    ]
    ask = [_CONST.format(name="sid", byte=0, value=0x22, bits=8), _CONST.format(name="did", byte=1, value=did, bits=16)]
    reset = [_CONST.format(name="sid", byte=0, value=0x11, bits=8), _CONST.format(name="kind", byte=1, value=1, bits=8)]
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<ODX xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" MODEL-VERSION="2.2.0"><DIAG-LAYER-CONTAINER ID="C">
<SHORT-NAME>C</SHORT-NAME><BASE-VARIANTS><BASE-VARIANT ID="B"><SHORT-NAME>battery</SHORT-NAME><DIAG-DATA-DICTIONARY-SPEC>
<DATA-OBJECT-PROPS>{"".join(dops)}</DATA-OBJECT-PROPS><UNIT-SPEC><UNITS><UNIT ID="U.V"><SHORT-NAME>volt</SHORT-NAME>
<DISPLAY-NAME>V</DISPLAY-NAME></UNIT></UNITS></UNIT-SPEC></DIAG-DATA-DICTIONARY-SPEC><DIAG-COMMS>
<DIAG-SERVICE ID="S.read"><SHORT-NAME>read_state</SHORT-NAME><REQUEST-REF ID-REF="R.read"/><POS-RESPONSE-REFS>
<POS-RESPONSE-REF ID-REF="P.read"/></POS-RESPONSE-REFS></DIAG-SERVICE>
<DIAG-SERVICE ID="S.reset"><SHORT-NAME>reset</SHORT-NAME><REQUEST-REF ID-REF="R.reset"/></DIAG-SERVICE></DIAG-COMMS>
<REQUESTS><REQUEST ID="R.read"><SHORT-NAME>read</SHORT-NAME><PARAMS>{"".join(ask)}</PARAMS></REQUEST>
<REQUEST ID="R.reset"><SHORT-NAME>reset</SHORT-NAME><PARAMS>{"".join(reset)}</PARAMS></REQUEST></REQUESTS>
<POS-RESPONSES><POS-RESPONSE ID="P.read"><SHORT-NAME>answer</SHORT-NAME><PARAMS>{"".join(answer + values)}</PARAMS>
</POS-RESPONSE></POS-RESPONSES></BASE-VARIANT></BASE-VARIANTS></DIAG-LAYER-CONTAINER></ODX>"""


def signal_set():
    """Return a signal set with what such files have: addresses, years, texts, bytes turned round, limits."""
    volts = {
        "id": "U",
        "name": "Voltage",
        "fmt": {"len": 16, "max": 60, "div": 1000, "unit": "volts", "nullmax": 65.535},
    }
    mode = {
        "id": "MODE",
        "name": "Mode",
        "fmt": {"bix": 17, "len": 2, "map": {"0": {"value": "idle"}, "2": {"value": "run"}}},
    }
    turned = {"id": "T", "name": "Turned", "fmt": {"bix": 24, "len": 12, "blsb": True, "sign": True, "max": 99, "min": -99,
                                                  "unit": "celsius", "mul": 0.5, "add": 1, "omin": 0, "omax": 40}}  # fmt: skip
    switch = {"id": "S", "name": "Switch", "fmt": {"bix": 16, "len": 1, "max": 1, "unit": "offon"}}
    vin = {"id": "VIN", "name": "VIN", "fmt": {"len": 136, "max": 1, "unit": "ascii"}}
    return json.dumps(
        {
            "commands": [
                {
                    "hdr": "7E4",
                    "rax": "7EC",
                    "cmd": {"22": "0101"},
                    "freq": 1,
                    "signals": [volts, mode, turned, switch],
                },
                {"hdr": "7E4", "cmd": {"21": "05"}, "freq": 5, "filter": {"to": 2015}, "signals": [switch]},
                {"hdr": "7E4", "cmd": {"21": "05"}, "freq": 5, "filter": {"from": 2016}, "signals": [volts]},
                {"hdr": "DA10", "rax": "10", "cmd": {"22": "F190"}, "freq": 60, "signals": [vin, switch]},
                {"hdr": "750", "rax": "758", "eax": "2A", "cmd": {"21": "30"}, "freq": 5, "signals": [switch]},
            ]
        }
    )


#: One identifier, with a signed number, a number and a text.
CDD = """<?xml version='1.0'?><CANDELA><ECUDOC><DATATYPES>
<IDENT id='t1'><NAME><TUV>s16</TUV></NAME><CVALUETYPE bl='16' bo='21' enc='sgn' minsz='0' maxsz='255'/><COMP f='0.5' o='0'/></IDENT>
<IDENT id='t2'><NAME><TUV>u8</TUV></NAME><CVALUETYPE bl='8' bo='21' enc='uns' minsz='0' maxsz='255'/></IDENT>
<IDENT id='t3'><NAME><TUV>a4</TUV></NAME><CVALUETYPE bl='32' bo='21' enc='asc' minsz='0' maxsz='255'/></IDENT>
</DATATYPES><ECU id='e'><VAR id='v'><DIAGCLASS><DIAGINST id='d'><STATICVALUE v='4660'/><QUAL>State</QUAL><SIMPLECOMPCONT>
<DATAOBJ id='a' dtref='t1'><QUAL>Torque</QUAL></DATAOBJ><DATAOBJ id='b' dtref='t2'><QUAL>Level</QUAL></DATAOBJ>
<DATAOBJ id='c' dtref='t3'><QUAL>Text</QUAL></DATAOBJ></SIMPLECOMPCONT></DIAGINST></DIAGCLASS></VAR></ECU></ECUDOC></CANDELA>"""
