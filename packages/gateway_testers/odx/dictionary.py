"""The data dictionary of a layer: parameters, data objects, structures, units (ISO 22901-1, 7.3.6)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element

from gateway_testers.odx.xml import free, group, named, node, short

#: struct's codes of numbers -> ODX's type.
_TYPES = {**dict.fromkeys("BHI", "A_UINT32"), **dict.fromkeys("bhi", "A_INT32"), "f": "A_FLOAT32", "d": "A_FLOAT64"}
#: The groups of a dictionary, in the order of the schema.
_GROUPS = (
    "DTC-DOP", "ENV-DATA-DESC", "DATA-OBJECT-PROP", "STRUCTURE", "DYNAMIC-LENGTH-FIELD", "END-OF-PDU-FIELD", "MUX",
    "ENV-DATA",
)  # fmt: skip


class Dop(NamedTuple):
    """A data object of a layer: its id, and its bytes (None: they vary)."""

    id: str
    size: int | None


class Param(NamedTuple):
    """A parameter of a request, a response or a structure.

    Attributes:
        name: short name.
        kind: its type in ODX.
        size: bytes; None: they vary.
        content: elements of its type.
        semantic: meaning for testers.
        long: name for people.
        bit: (byte of the structure, bit of it), where it is no whole number of bytes.
    """

    name: str
    kind: str
    size: int | None
    content: tuple[Element, ...]
    semantic: str = "DATA"
    long: str = ""
    bit: tuple[int, int] | None = None


def const(name: str, number: int, size: int = 1, semantic: str = "DATA") -> Param:
    """Return a parameter that is always the same number."""
    coded = node(
        "DIAG-CODED-TYPE", node("BIT-LENGTH", str(8 * size)), BASE_DATA_TYPE="A_UINT32", type="STANDARD-LENGTH-TYPE"
    )
    return Param(name, "CODED-CONST", size, (node("CODED-VALUE", str(number)), coded), semantic)


def value(
    name: str,
    dop: Dop,
    *,
    default: int | None = None,
    semantic: str = "DATA",
    long: str = "",
    bit: tuple[int, int] | None = None,
) -> Param:
    """Return a parameter with a data object."""
    usual = () if default is None else (node("PHYSICAL-DEFAULT-VALUE", str(default)),)
    return Param(name, "VALUE", dop.size, (*usual, node("DOP-REF", ID_REF=dop.id)), semantic, long, bit)


def echo(name: str, at: int, size: int = 1, semantic: str = "DATA") -> Param:
    """Return a parameter of a response that is that of the request at a byte."""
    return Param(
        name,
        "MATCHING-REQUEST-PARAM",
        size,
        (node("REQUEST-BYTE-POS", str(at)), node("BYTE-LENGTH", str(size))),
        semantic,
    )


def params_of(params: Sequence[Param]) -> Element:
    """Return the parameters with their places, as far as these are fixed."""
    made, at, fixed = [], 0, True
    taken: set[str] = set()
    for param in params:
        name = free(param.name, taken)
        byte = at if param.bit is None else param.bit[0]
        places = [node("BYTE-POSITION", str(byte))] if fixed else []
        if param.bit is not None:
            places.append(node("BIT-POSITION", str(param.bit[1])))
        made.append(
            named("PARAM", name, *places, *param.content, long=param.long, SEMANTIC=param.semantic, type=param.kind)
        )
        if param.bit is None:
            at, fixed = at + (param.size or 0), fixed and param.size is not None
    return node("PARAMS", *made)


class Dictionary:
    """A data dictionary that is being made.

    Args:
        name: beginning of the ids.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._groups: dict[str, list[Element]] = {tag: [] for tag in _GROUPS}
        self._known: dict[object, Dop] = {}
        self._units: dict[str, Element] = {}
        self._taken: set[str] = set()

    def content(self) -> Element:
        """Return it as an element."""
        units = group("UNITS", list(self._units.values()))
        return node(
            "DIAG-DATA-DICTIONARY-SPEC",
            *(group(f"{tag}S", self._groups[tag]) for tag in _GROUPS),
            None if units is None else node("UNIT-SPEC", units),
        )

    def _add(self, tag: str, name: str, *content: Element | None, size: int | None) -> Dop:
        name = free(name, self._taken)
        made = Dop(f"{self.name}.{tag}.{name}", size)
        self._groups[tag].append(named(tag, name, *content, ID=made.id))
        return made

    # Data objects

    def number(
        self,
        code: str,
        *,
        scale: float = 1.0,
        offset: float = 0.0,
        unit: str = "",
        texts: Mapping[int, str] | None = None,
        bits: int = 0,
        unknown: int | None = None,
    ) -> Dop:
        """Return the data object of a number.

        Args:
            code: of struct.
            scale: unit for one step.
            offset: value of a coded 0.
            unit: of the value.
            texts: of the numbers, if it has any; others have none.
            bits: length, where it is not that of the code.
            unknown: number that says that there is no value; None: there is none.
        """
        key = code, scale, offset, unit, tuple((texts or {}).items()), bits, unknown
        if key in self._known:
            return self._known[key]
        length, kind = bits or 8 * struct.calcsize(f">{code}"), _TYPES[code]
        linear = (scale, offset) != (1, 0)
        seen = "A_UNICODE2STRING" if texts else "A_FLOAT64" if linear else kind
        coded = node(
            "DIAG-CODED-TYPE", node("BIT-LENGTH", str(length)), BASE_DATA_TYPE=kind, type="STANDARD-LENGTH-TYPE"
        )
        made = self._add(
            "DATA-OBJECT-PROP",
            f"{kind[2:].lower()}_{length}",
            _texts(texts) if texts else _linear(scale, offset) if linear else _identical(),
            coded,
            node("PHYSICAL-TYPE", BASE_DATA_TYPE=seen),
            None if unknown is None else _unknown(unknown),
            node("UNIT-REF", ID_REF=self._unit(unit)) if unit else None,
            size=length // 8 if length % 8 == 0 else 0,
        )
        return self._known.setdefault(key, made)

    def _unit(self, name: str) -> str:
        made = f"{self.name}.UNIT.{len(self._units)}"
        entry = self._units.setdefault(
            name, named("UNIT", f"unit_{len(self._units)}", node("DISPLAY-NAME", name), ID=made)
        )
        return entry.attrib["ID"]

    def data(self, size: int | None, *, text: bool = False, length_bits: int = 0) -> Dop:
        """Return the data object of bytes, or of a text.

        Args:
            size: how many; None: all that follow, or as many as the number before them says.
            text: whether they are a text: UTF-8 where its length is before it, else ISO-8859-1.
            length_bits: bits of the number before them, 0: there is none.
        """
        key = "data", size, text, length_bits
        if key in self._known:
            return self._known[key]
        base = ("A_UTF8STRING" if length_bits else "A_ASCIISTRING") if text else "A_BYTEFIELD"
        encoding = {"BASE_TYPE_ENCODING": "UTF-8" if length_bits else "ISO-8859-1"} if text else {}
        if size is not None or length_bits:
            kind = "LEADING-LENGTH-INFO-TYPE" if length_bits else "STANDARD-LENGTH-TYPE"
            children = [node("BIT-LENGTH", str(length_bits or 8 * (size or 0)))]
            more: dict[str, str] = {}
        else:
            kind, children, more = "MIN-MAX-LENGTH-TYPE", [node("MIN-LENGTH", "0")], {"TERMINATION": "END-OF-PDU"}
        made = self._add(
            "DATA-OBJECT-PROP",
            "text" if text else "bytes",
            _identical(),
            node("DIAG-CODED-TYPE", *children, BASE_DATA_TYPE=base, **encoding, **more, type=kind),
            node("PHYSICAL-TYPE", BASE_DATA_TYPE="A_UNICODE2STRING" if text else base),
            size=size,
        )
        return self._known.setdefault(key, made)

    def dtcs(self, name: str, dtcs: Iterable[tuple[int, str, str]]) -> Dop:
        """Return the data object of DTCs: number, as people write it, text."""
        made = [
            named(
                "DTC",
                short(shown),
                node("TROUBLE-CODE", str(number)),
                node("DISPLAY-TROUBLE-CODE", shown),
                node("TEXT", text),
                ID=f"{self.name}.{name}.{short(shown)}",
            )
            for number, shown, text in dtcs
        ]
        coded = node(
            "DIAG-CODED-TYPE", node("BIT-LENGTH", "24"), BASE_DATA_TYPE="A_UINT32", type="STANDARD-LENGTH-TYPE"
        )
        seen = node("PHYSICAL-TYPE", BASE_DATA_TYPE="A_UINT32", DISPLAY_RADIX="HEX")
        return self._add("DTC-DOP", name, coded, seen, _identical(), node("DTCS", *made), size=3)

    # Structures

    def structure(self, name: str, params: Sequence[Param], size: int | None = None) -> Dop:
        """Return a structure; ``size``: bytes, where its parameters are bits."""
        sizes = [param.size for param in params]
        whole = size or (None if None in sizes else sum(each or 0 for each in sizes))
        return self._add(
            "STRUCTURE", name, None if size is None else node("BYTE-SIZE", str(size)), params_of(params), size=whole
        )

    def rest(self, name: str, params: Sequence[Param]) -> Dop:
        """Return a structure that is repeated to the end of the message."""
        ref = node("BASIC-STRUCTURE-REF", ID_REF=self.structure(f"{name}_entry", params).id)
        return self._add("END-OF-PDU-FIELD", name, ref, size=None)

    def counted(self, name: str, params: Sequence[Param]) -> Dop:
        """Return a structure that is repeated as often as the byte before says."""
        ref = node("BASIC-STRUCTURE-REF", ID_REF=self.structure(f"{name}_entry", params).id)
        count = node(
            "DETERMINE-NUMBER-OF-ITEMS",
            node("BYTE-POSITION", "0"),
            node("DATA-OBJECT-PROP-REF", ID_REF=self.number("B").id),
        )
        return self._add("DYNAMIC-LENGTH-FIELD", name, ref, node("OFFSET", "1"), count, size=None)

    def choice(self, name: str, code: str, cases: Mapping[int, tuple[str, Dop]]) -> Dop:
        """Return what a number decides about that stands before it: number -> name and structure."""
        key = self.number(code)
        made = [
            named(
                "CASE",
                short(label),
                node("STRUCTURE-REF", ID_REF=structure.id),
                node("LOWER-LIMIT", str(number)),
                node("UPPER-LIMIT", str(number)),
            )
            for number, (label, structure) in cases.items()
        ]
        switch = node("SWITCH-KEY", node("BYTE-POSITION", "0"), node("DATA-OBJECT-PROP-REF", ID_REF=key.id))
        return self._add("MUX", name, node("BYTE-POSITION", str(key.size)), switch, node("CASES", *made), size=None)

    def by_dtc(self, name: str, params: Mapping[int, Sequence[Param]]) -> Dop:
        """Return data whose parameters depend on the parameter DTC before them; without any, bytes."""
        alike: dict[tuple[str, ...], list[int]] = {}
        for dtc, own in params.items():
            if own:
                alike.setdefault(tuple(param.long for param in own), []).append(dtc)
        if not alike:
            return self.data(None)
        refs = []
        for dtcs in alike.values():
            values = node("DTC-VALUES", *(node("DTC-VALUE", str(dtc)) for dtc in dtcs))
            made = self._add("ENV-DATA", name, params_of(params[dtcs[0]]), values, size=None)
            refs.append(node("ENV-DATA-REF", ID_REF=made.id))
        of = node("PARAM-SNREF", SHORT_NAME="DTC")
        return self._add("ENV-DATA-DESC", f"{name}_by_DTC", of, node("ENV-DATA-REFS", *refs), size=None)


def _identical() -> Element:
    return node("COMPU-METHOD", node("CATEGORY", "IDENTICAL"))


def _computed(category: str, scales: Iterable[Element]) -> Element:
    return node(
        "COMPU-METHOD",
        node("CATEGORY", category),
        node("COMPU-INTERNAL-TO-PHYS", node("COMPU-SCALES", *scales)),
    )


def _linear(scale: float, offset: float) -> Element:
    top = node("COMPU-NUMERATOR", node("V", repr(offset)), node("V", repr(scale)))
    below = node("COMPU-DENOMINATOR", node("V", "1.0"))
    return _computed("LINEAR", [node("COMPU-SCALE", node("COMPU-RATIONAL-COEFFS", top, below))])


def _texts(texts: Mapping[int, str]) -> Element:
    return _computed(
        "TEXTTABLE",
        (
            node(
                "COMPU-SCALE",
                node("LOWER-LIMIT", str(number)),
                node("UPPER-LIMIT", str(number)),
                node("COMPU-CONST", node("VT", text)),
            )
            for number, text in sorted(texts.items())
        ),
    )


def _unknown(number: int) -> Element:
    constraint = node(
        "SCALE-CONSTR",
        node("SHORT-LABEL", "unknown"),
        node("LOWER-LIMIT", str(number)),
        node("UPPER-LIMIT", str(number)),
        VALIDITY="NOT-AVAILABLE",
    )
    return node("INTERNAL-CONSTR", node("SCALE-CONSTRS", constraint))
