"""Databases as people and their tools write them: bytes to text, and departures from DBC, SYM and KCD.

A file is first read as it stands; only if that fails are these put right, and said.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Sequence

#: Largest identifier of 11 bits, of 29 bits; the flag by which DBC tells the latter.
_STANDARD, _EXTENDED, _FLAG = 0x7FF, 0x1FFF_FFFF, 1 << 31

_NAMELESS = re.compile(
    r'^CM_ +(?:(?:SG_ +\d+|BO_|BU_|EV_|\d+) *"[^"]*" *;|"[^"\n]*"(?=[ \t]*\n))[ \t]*\n?', re.MULTILINE
)
_POINT = re.compile(r"(?<=[(\[,|])(-?)\.(?=\d)")
_SIGNAL_LINE = re.compile(r"^[ \t]*SG_ .*$", re.MULTILINE)
_ENDLESS = re.compile(r'^VAL_ +\d+ +\w+(?: +-?\d+ +"[^"\n]*")+(?=[ \t]*\r?\n)', re.MULTILINE)
_IDENTIFIED = re.compile(
    r"^((?:BO_|BO_TX_BU_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_|CM_ +BO_|CM_ +SG_"
    r'|BA_ +"[^"]*" +BO_|BA_ +"[^"]*" +SG_) +)(\d+)\b',
    re.MULTILINE,
)
_DIGIT = re.compile(r"^((?:BO_ +\d+|VAL_ +\d+|CM_ +SG_ +\d+|SIG_VALTYPE_ +\d+| *SG_) +)(\d)", re.MULTILINE)
_BLOCK = re.compile(r"^BO_ +(\d+) [^\n]*\n(?:\s*SG_ [^\n]*\n)*", re.MULTILINE)
_MESSAGE = re.compile(r"^BO_ +(\d+) ")
_SIGNAL = re.compile(r"^ *SG_ +(\w+)")
_OF_NO_MESSAGE = "3221225472"  # VECTOR__INDEPENDENT_SIG_MSG
_TEXTS = re.compile(r"^VAL_ +(\d+) +(\w+) ")
_HEX = re.compile(r"^(\s*(?:BO_|CM_ +BO_|CM_ +SG_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_) +)0[xX]([0-9a-fA-F]+)\b", re.MULTILINE)
_NO_SENDER = re.compile(r"^(BO_ +\d+ +[^\s:]+ *: *\d+)[ \t]*(?=\r?$)", re.MULTILINE)
_NAME = re.compile(
    r'^([ \t]*(?:BO_ +\d+|(?:CM_ +|BA_ +"[^"]*" +)?SG_ +\d+(?= +\D)|VAL_ +\d+|SIG_VALTYPE_ +\d+|SG_) +)([^\s:;"\d]\S*?)'
    r"(?=[\s:;]|$)",
    re.MULTILINE,
)
_TAIL = re.compile(
    r'^([ \t]*SG_[^\n:"]*:[^\n"(]*\([^\n)]*\))[ \t]*(\[[^\n\]]*\])?[ \t]*("[^"\n]*")?[ \t]*([^\n"]*?)[ \t]*(?=\r?$)',
    re.MULTILINE,
)
_BRANCH = re.compile(r"^([ \t]*SG_ +\w+ +)[MV](\d+)(?= *:)", re.MULTILINE)
_NO_BITS = re.compile(r"^[ \t]*SG_[^\n:]*:[ \t]*\d+\|0+@[^\n]*\n", re.MULTILINE)
_KIND = re.compile(r"^(SIG_VALTYPE_ +\d+ +\w+) +(?=\d)", re.MULTILINE)
_DEFINED = re.compile(
    r'^BA_DEF_ +(?:(?:BO_|SG_|BU_|EV_) +)?"([^"]*)" +((?:INT|HEX|FLOAT|STRING|ENUM)\b[^;]*)', re.MULTILINE
)
_ENUM_NUMBER = re.compile(r"^BA_ .*?(\d+) *;")
_ATTRIBUTE = re.compile(
    r'^BA_(?:DEF_|DEF_DEF_)? +(?:(?:BO_|SG_|BU_|EV_) +)?"([^"]*)"(?:[^;"]|"[^"]*")*;[^\n]*\n?', re.MULTILINE
)

_SYM_FIVE = re.compile(r"^([ \t]*)FormatVersion[ \t]*=[ \t]*[1-5]\.\d+", re.MULTILINE)
_SYM_LENGTH = re.compile(r"^([ \t]*)DLC[ \t]*=", re.MULTILINE)
_SYM_ENUM = re.compile(r"^([ \t]*)enum[ \t]+(?=\w+[ \t]*\()", re.MULTILINE)
_SYM_HEX = re.compile(
    r"^(\s*(?:(?:ID|Color)\s*=\s*(?:[0-9A-F]+h-)?|Mux\s*=[^\n/]*?\d\s*,\s*\d+\s+))([0-9a-fA-F]+)h\b", re.MULTILINE
)
_SYM_NAME = re.compile(r'^([ \t]*Var[ \t]*=[ \t]*)([^"\s]+(?:[ \t]+[^"\s]+)+)(?=[ \t]+\w+[ \t]+\d+,\d+)', re.MULTILINE)
_SYM_BLOCK = re.compile(r"^[ \t]*ID[ \t]*=[ \t]*([0-9A-F]+)h[^\n]*\n(?:(?!\s*[\[{])[^\n]*\n?)*", re.MULTILINE)
_SYM_DEFAULT = re.compile(r'(?<=\s)/d:"[^"\n]*"')

_KCD_MESSAGE = re.compile(r"<Message\b[^>]*>")
_KCD_ID = re.compile(r"""\bid\s*=\s*["'](0[xX][0-9a-fA-F]+|\d+)["']""")
_KCD_FORMAT = re.compile(r"""\s*\bformat\s*=\s*["']\w*["']""")
_XML_ENCODING = re.compile(rb"""^\s*<\?xml[^>]*\bencoding\s*=\s*["']([\w.-]+)["']""")


def text_of(data: bytes) -> str:
    """Return the text of a database: UTF-8 (a mark of byte order is left out) where bytes are, else Windows-1252.

    UTF-16 by its mark, and what an XML file says of itself, come before.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    said = _XML_ENCODING.match(data)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode(said[1].decode() if said and _is_known(said[1].decode()) else "cp1252", "replace")


def _is_known(encoding: str) -> bool:
    try:
        return codecs.lookup(encoding).name != "utf-8"
    except LookupError:
        return False


def signals_said(text: str) -> int:
    """Return how many signals the messages of a DBC file have; its place for signals of no message does not count."""
    return sum(len(_SIGNAL_LINE.findall(found[0])) for found in _BLOCK.finditer(text) if found[1] != _OF_NO_MESSAGE)


def mended(text: str, suffix: str = ".dbc") -> tuple[str, list[str]]:
    """Return a database's text as the format has it, and the corrections made, for people."""
    said = []
    for what, change in _CHANGES.get(suffix, ()):
        before, text = text, change(text)
        if text != before:
            said.append(what)
    return text, said


def without(text: str, line: int) -> tuple[str, str] | None:
    """Return a DBC file without the statement of a line (from 1), and its keyword; None: it says where bits are."""
    lines = text.splitlines(keepends=True)
    word = lines[line - 1].split(maxsplit=1)[:1] if line <= len(lines) else []
    if not word or word[0] in ("BO_", "SG_", "SIG_VALTYPE_", "SG_MUL_VAL_") or not re.match(r"[A-Z;]", word[0]):
        return None
    end = line
    while end < len(lines) and ";" not in lines[end - 1] and not re.match(r"[A-Z][A-Z_]*_\b", lines[end]):
        end += 1
    return "".join([*lines[: line - 1], *lines[end:]]), word[0]


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


def _named(found: re.Match[str]) -> str:
    name = re.sub(r"\W", "_", found[2], flags=re.ASCII)
    return f"{found[1]}{name}"


def _tail(found: re.Match[str]) -> str:
    """Return a signal's line with all that DBC has behind its scaling: range, unit, receivers."""
    if (
        found[2]
        and found[3]
        and re.fullmatch(r"[A-Za-z_]\w*(?:\s*,\s*[A-Za-z_]\w*)*", found[4].partition("//")[0].strip())
    ):
        return found[0]
    receivers = [f"_{name}" if name[0].isdigit() else name for name in re.findall(r"\w+", found[4].partition("//")[0])]
    return f"{found[1]} {found[2] or '[0|0]'} {found[3] or chr(34) * 2} {','.join(receivers or ['Vector__XXX'])}"


def _attributes(text: str) -> str:
    """Leave out the attributes that are not defined, of a kind that DBC has not, or beyond their enumeration."""
    known = {found[1]: found[2] for found in _DEFINED.finditer(text)}

    def kept(found: re.Match[str]) -> str:
        kind, number = known.get(found[1], ""), _ENUM_NUMBER.search(found[0])
        beyond = number is not None and kind.startswith("ENUM") and int(number[1]) >= kind.count('"') // 2
        return "" if not kind or beyond else found[0]

    return _ATTRIBUTE.sub(kept, text)


def _sym_hex(found: re.Match[str]) -> str:
    digits = found[2].upper()
    return f"{found[1]}{'' if digits[0].isdigit() else '0'}{digits}h"


def _sym_extended(found: re.Match[str]) -> str:
    if int(found[1], 16) <= _STANDARD or re.search(r"^\s*Type\s*=\s*(?!.*Standard)", found[0], re.MULTILINE):
        return found[0]
    head, line, rest = re.sub(r"^\s*Type\s*=.*\n", "", found[0], flags=re.MULTILINE).partition("\n")
    return f"{head}{line}Type=Extended\n{rest}"


def _kcd_flagged(found: re.Match[str]) -> str:
    number = _KCD_ID.search(found[0])
    if number is None or not _STANDARD < int(number[1], 0) <= _EXTENDED:
        return found[0]
    return f'<Message format="extended"{_KCD_FORMAT.sub("", found[0])[len("<Message") :]}'


_Changes = Sequence[tuple[str, Callable[[str], str]]]
_CHANGES: dict[str, _Changes] = {
    ".dbc": (
        ("comments of no name or without an end left out", lambda now: _NAMELESS.sub("", now)),
        ("texts of values without an end", lambda now: _ENDLESS.sub(r"\g<0> ;", now)),
        ("numbers without a digit before their point", _numbers),
        ("hexadecimal identifiers", lambda now: _HEX.sub(lambda found: f"{found[1]}{int(found[2], 16)}", now)),
        ("names that begin with a digit, a _ before them", lambda now: _DIGIT.sub(r"\1_\2", now)),
        ("names of other characters than letters, digits and _, a _ for these", lambda now: _NAME.sub(_named, now)),
        ("messages without a sender", lambda now: _NO_SENDER.sub(r"\1 Vector__XXX", now)),
        ("branches of a multiplexer that do not begin with m", lambda now: _BRANCH.sub(r"\1m\2", now)),
        ("signals of no bits left out", lambda now: _NO_BITS.sub("", now)),
        ("signals without range, unit or receivers, or whose receivers are no list", lambda now: _TAIL.sub(_tail, now)),
        ("kinds of values without their colon", lambda now: _KIND.sub(r"\1 : ", now)),
        ("messages of identifiers that no bus has left out", _impossible),
        ("29-bit identifiers without their flag", lambda now: _IDENTIFIED.sub(_flagged, now)),
        ("texts of signals that are not there left out", _texts),
        ("attributes without a definition, or of a kind that DBC has not, left out", _attributes),
    ),
    ".sym": (
        ("an older version of the format", lambda now: _SYM_FIVE.sub(r"\1FormatVersion=6.0", now)),
        ("lengths called DLC", lambda now: _SYM_LENGTH.sub(r"\1Len=", now)),
        ("enumerations of version 5", lambda now: _SYM_ENUM.sub(r"\1Enum=", now)),
        ("hexadecimal numbers that begin with a letter", lambda now: _SYM_HEX.sub(_sym_hex, now)),
        ("29-bit identifiers that are not called extended", lambda now: _SYM_BLOCK.sub(_sym_extended, now)),
        ("texts as defaults left out", lambda now: _SYM_DEFAULT.sub("", now)),
        ("names with spaces", lambda now: _SYM_NAME.sub(r'\1"\2"', now)),
    ),
    ".kcd": (("29-bit identifiers that are not called extended", lambda now: _KCD_MESSAGE.sub(_kcd_flagged, now)),),
}
