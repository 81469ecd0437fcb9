"""DBC files as people write them: extensions of the format in community databases (opendbc).

A file that is not DBC is first read as it stands; only if that fails are these put right, and said.
"""

from __future__ import annotations

import re

#: Largest identifier of 11 bits, of 29 bits; the flag by which DBC tells the latter.
_STANDARD, _EXTENDED, _FLAG = 0x7FF, 0x1FFF_FFFF, 1 << 31

_NAMELESS = re.compile(
    r'^CM_ +(?:(?:SG_ +\d+|BO_|BU_|EV_|\d+) *"[^"]*" *;|"[^"\n]*"(?=[ \t]*\n))[ \t]*\n?', re.MULTILINE
)
_POINT = re.compile(r"(?<=[(\[,|])(-?)\.(?=\d)")
_SIGNAL_LINE = re.compile(r"^ *SG_ .*$", re.MULTILINE)
_ENDLESS = re.compile(r'^VAL_ +\d+ +\w+(?: +-?\d+ +"[^"\n]*")+(?=[ \t]*\r?\n)', re.MULTILINE)
_IDENTIFIED = re.compile(
    r"^((?:BO_|BO_TX_BU_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_|CM_ +BO_|CM_ +SG_"
    r'|BA_ +"[^"]*" +BO_|BA_ +"[^"]*" +SG_) +)(\d+)\b',
    re.MULTILINE,
)
_DIGIT = re.compile(r"^((?:BO_ +\d+|VAL_ +\d+|CM_ +SG_ +\d+|SIG_VALTYPE_ +\d+| *SG_) +)(\d)", re.MULTILINE)
_BLOCK = re.compile(r"^BO_ +(\d+) [^\n]*\n(?: *SG_ [^\n]*\n)*", re.MULTILINE)
_MESSAGE = re.compile(r"^BO_ +(\d+) ")
_SIGNAL = re.compile(r"^ *SG_ +(\w+)")
_TEXTS = re.compile(r"^VAL_ +(\d+) +(\w+) ")


def mended(text: str) -> tuple[str, list[str]]:
    """Return a database's text as the format has it, and the corrections made, for people.

    Args:
        text: of a DBC file.
    """
    said = []
    for what, change in (
        ("comments of no name or without an end left out", lambda now: _NAMELESS.sub("", now)),
        ("texts of values without an end", lambda now: _ENDLESS.sub(r"\g<0> ;", now)),
        ("numbers without a digit before their point", _numbers),
        ("names that begin with a digit, a _ before them", lambda now: _DIGIT.sub(r"\1_\2", now)),
        ("messages of identifiers that no bus has left out", _impossible),
        ("29-bit identifiers without their flag", lambda now: _IDENTIFIED.sub(_flagged, now)),
        ("texts of signals that are not there left out", _texts),
    ):
        before, text = text, change(text)
        if text != before:
            said.append(what)
    return text, said


def _numbers(text: str) -> str:
    return _SIGNAL_LINE.sub(lambda line: _POINT.sub(r"\g<1>0.", line[0]), text)


def _impossible(text: str) -> str:
    """Leave out messages whose identifier has more than 29 bits, and statements about them."""
    gone = [found[1] for found in _BLOCK.finditer(text) if int(found[1]) & ~_FLAG > _EXTENDED]
    text = _BLOCK.sub(lambda found: "" if found[1] in gone else found[0], text)
    for number in gone:
        text = re.sub(rf"^(?:CM_|BA_)[^\n]* {number} [^;]*;[^\n]*\n", "", text, flags=re.MULTILINE)
    return text


def _flagged(found: re.Match[str]) -> str:
    number = int(found[2])
    return f"{found[1]}{number | _FLAG if _STANDARD < number <= _EXTENDED else number}"


def _texts(text: str) -> str:
    """Leave out the texts of values whose signal the database does not have."""
    known, message = set(), ""
    lines = text.splitlines(keepends=True)
    for line in lines:
        if found := _MESSAGE.match(line):
            message = found[1]
        elif found := _SIGNAL.match(line):
            known.add((message, found[1]))
    return "".join(line for line in lines if (found := _TEXTS.match(line)) is None or (found[1], found[2]) in known)
