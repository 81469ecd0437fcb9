"""ODX and PDX files as layouts, by odxtools: services that read an identifier, and whose answer has fixed places.

A parameter's bits are those of ISO 22901-1, 7.3.6: bytes from its byte position on, in their order, shifted by its bit
position. Parameters without a fixed place, or with a conversion other than linear or a table of texts, are left out.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from gateway.bus.frames import EXTENDED
from gateway.common.archives import members_of, refuse_large_xml
from gateway.common.extras import need
from gateway.config.ecu import TWO_BYTES
from gateway_ask.answers.model import (
    LONGEST_SIGNAL,
    Address,
    AnswerLayout,
    Layouts,
    LeftOut,
    message_of,
    signal_of,
)
from gateway_fdi.errors import InputError

#: Services that read one identifier.
READS = (0x01, 0x09, 0x1A, 0x21, 0x22)
#: ODX's types of numbers -> whether they have a sign, whether they are floating-point ones.
_KINDS = {"A_UINT32": (False, False), "A_INT32": (True, False), "A_FLOAT32": (False, True), "A_FLOAT64": (False, True)}
#: Texts of a range of numbers: a text for each, up to this many.
_MOST_TEXTS = 256


class _Left(Exception):
    """A parameter that has no layout; says why."""


class _Data(NamedTuple):
    """A parameter with a fixed place: its byte from the service's on, and its data object."""

    name: str
    byte: int
    bit: int
    dop: Any


def read(path: Path, _year: int | None) -> Layouts:
    """Read the ECUs of a file.

    Raises:
        InputError: odxtools is not installed, the file cannot be read, or no service reads an identifier.
    """
    need("odx", "ODX and PDX files", file=path)
    from odxtools.database import Database  # noqa: PLC0415 - an extra, and slow to load

    document = Database()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for root in _documents(path):
                document.add_odx_xml_tree(root)
            document.refresh()
            return _of_ecus(_ecus(document), path)
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    except InputError:
        raise
    except Exception as error:  # the reader lets any exception of its own through
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"not a good {path.suffix} file: {text}", file=path) from error


def _documents(path: Path) -> Iterator[Any]:
    """Yield the ODX documents of a file; odxtools would open a PDX file itself, whatever it unpacks to."""
    from xml.etree import ElementTree  # noqa: PLC0415 - beside its parser

    packed = path.suffix.lower() == ".pdx"
    for name, data in members_of(path, ".odx") if packed else [("", path.read_bytes())]:
        refuse_large_xml(data, path, name)
        yield ElementTree.fromstring(data)  # noqa: S314 - expat refuses entities that grow, and external ones


def _ecus(document: Any) -> list[Any]:
    """Return the ECU variants, and base variants that have none."""
    variants = list(document.ecus)
    parents = {ref.layer.short_name for ecu in variants for ref in ecu.ecu_variant_raw.parent_refs}
    return variants + [base for base in document.base_variants if base.short_name not in parents]


def _of_ecus(ecus: list[Any], path: Path) -> Layouts:
    found: dict[tuple[Any, int, int], AnswerLayout] = {}
    left: list[LeftOut] = []
    for ecu in ecus:
        address = _address(ecu)
        for service in ecu.services:
            where = f"{ecu.short_name}.{service.short_name}"
            try:
                layout = _layout(service, where, address, left)
            except _Left as why:
                left.append(LeftOut(where, str(why)))
                continue
            if layout is None:
                continue
            key = (address, layout.service, layout.identifier)
            known = found.setdefault(key, layout)
            if known is not layout and known.message.signals != layout.message.signals:
                left.append(LeftOut(where, f"another variant reads {layout.name} at the same address"))
    if not found:
        raise InputError("no service reads an identifier with an answer of fixed places", file=path)
    return Layouts(tuple(found.values()), tuple(left))


def _address(ecu: Any) -> Address | None:
    """Return the CAN identifiers of an ECU."""
    request, response = ecu.get_can_receive_id(), ecu.get_can_send_id()
    if request is None:
        return None
    wide = max(request, response or 0) > 0x7FF
    flag = EXTENDED if wide else 0
    return Address(request | flag, None if response is None else response | flag)


def _layout(service: Any, where: str, address: Address | None, left: list[LeftOut]) -> AnswerLayout | None:
    """Return the layout of the answers to a service; None: it reads no identifier.

    Raises:
        _Left: it reads one, but has no layout.
    """
    request = None if service.request is None else bytes(service.request.coded_const_prefix())
    if not request or request[0] not in READS:
        return None
    size = 2 if request[0] in TWO_BYTES else 1
    if len(request) != 1 + size:
        raise _Left("its request is not service and identifier: a table, or several")
    if not service.positive_responses:
        raise _Left("no positive response")
    response = service.positive_responses[0]
    if bytes(response.coded_const_prefix(request))[: 1 + size] != bytes([request[0] + 0x40]) + request[1:]:
        raise _Left("its answer does not begin with service and identifier")
    signals: dict[str, Any] = {}
    for data in _flat(response.parameters, 0, "", where, left):
        if data.byte <= size:
            continue
        try:
            if data.name in signals:
                raise _Left("the answer has the name twice")
            signals[data.name] = _signal(data, 1 + size)
        except _Left as why:
            left.append(LeftOut(f"{where}.{data.name}", str(why)))
    if not signals:
        raise _Left("its answer has no numbers at fixed places")
    identifier = int.from_bytes(request[1:], "big")
    message = message_of(request[0], identifier, list(signals.values()), name=service.short_name)
    return AnswerLayout(request[0], identifier, message, address)


def _flat(parameters: Any, base: int, prefix: str, where: str, left: list[LeftOut]) -> Iterator[_Data]:
    """Yield the parameters with a data object, those of structures one by one; the first without a place ends it."""
    cursor = base
    for parameter in parameters:
        name = prefix + parameter.short_name
        byte = cursor if parameter.byte_position is None else base + parameter.byte_position
        dop, bit = getattr(parameter, "dop", None), parameter.bit_position or 0
        if dop is not None and hasattr(dop, "parameters"):
            yield from _flat(dop.parameters, byte, f"{name}_", where, left)
        elif dop is not None:
            yield _Data(name, byte, bit, dop)
        length = parameter.get_static_bit_length()
        if length is None:
            left.append(LeftOut(f"{where}.{name}", "its length varies: what follows has no fixed place"))
            return
        cursor = max(cursor, byte + -(-(bit + length) // 8))


def _signal(data: _Data, skipped: int) -> Any:
    """Return the signal of a parameter.

    Raises:
        _Left: it has none.
    """
    coded, method = getattr(data.dop, "diag_coded_type", None), getattr(data.dop, "compu_method", None)
    length = None if coded is None else coded.get_static_bit_length()
    if coded is None or method is None or length is None:
        raise _Left("no number of a fixed length")
    kind = _KINDS.get(coded.base_data_type.name)
    if kind is None or not 0 < length <= LONGEST_SIGNAL:
        raise _Left(f"{coded.base_data_type.name} of {length} bits is no number of at most {LONGEST_SIGNAL}")
    mask = getattr(coded, "bit_mask", None)
    if mask is not None and mask != (1 << length) - 1:
        raise _Left("a bit mask")
    encoding = coded.base_type_encoding
    if encoding is not None and encoding.name not in ("NONE", "TWOC"):
        raise _Left(f"encoding {encoding.name}")
    scale, offset, texts = _conversion(method)
    byte, big = data.byte - skipped, bool(coded.is_highlow_byte_order)
    first = 8 * byte + 8 * (-(-(data.bit + length) // 8)) - data.bit - length
    unit = data.dop.unit
    return signal_of(
        data.name,
        8 * (first // 8) + 7 - first % 8 if big else 8 * byte + data.bit,
        length,
        big=big,
        signed=kind[0],
        real=kind[1],
        scale=scale,
        offset=offset,
        texts=texts,
        unit=None if unit is None else unit.display_name,
    )


def _conversion(method: Any) -> tuple[float, float, dict[int, str]]:
    """Return factor, offset and texts of a conversion."""
    category = method.category.name
    if category == "IDENTICAL":
        return 1, 0, {}
    scales = method.compu_internal_to_phys.compu_scales
    if category == "LINEAR":
        ratio = scales[0].compu_rational_coeffs
        below = ratio.denominators[0] if ratio.denominators else 1
        offset, factor = (*ratio.numerators, 0)[:2]
        if not factor or not below:
            raise _Left("a constant")
        return factor / below, offset / below, {}
    if category == "TEXTTABLE":
        texts: dict[int, str] = {}
        for scale in scales:
            low, high = (None if end is None else end.value for end in (scale.lower_limit, scale.upper_limit))
            high = low if high is None else high
            if not isinstance(low, int) or not isinstance(high, int) or high - low >= _MOST_TEXTS:
                continue
            texts |= dict.fromkeys(range(low, high + 1), str(scale.compu_const.value))
        return 1, 0, texts
    raise _Left(f"a conversion {category}")
