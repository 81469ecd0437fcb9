"""Communication parameters: subsets with no more than what this gateway says of itself (ISO 22900-2, ISO 22901-1).

Names, order and types are those of the standards' own subsets, which are not free to copy. Times are in microseconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element

from gateway.bus.frames import EXTENDED
from gateway.servers.uds.params import UdsParams
from gateway_testers.doip.params import DoipParams
from gateway_testers.odx.xml import named, node

#: Bytes of an answer's frame.
_FD, _CLASSIC = "TX_DL=64 (CANFD)", "TX_DL=8"
_TABLE = "CP_UniqueRespIdTable"
_NOT_USED = str(0xFFFFFFFF)
#: Parameters of other classes than those of transports.
_CLASSES = {"CP_P2Max": "TIMING", "CP_P2Star": "TIMING", "CP_TesterPresentTime": "TESTER_PRESENT"}


#: Parameters of a subset with the gateway's values; those of a table in the order of its columns.
Values = Mapping[str, str | Mapping[str, str]]


class Protocol(NamedTuple):
    """A protocol: its stack, and the values of each subset."""

    name: str
    kind: str
    link: str
    values: Mapping[str, Values]


def _times(uds: UdsParams) -> dict[str, str]:
    return {
        "CP_P2Max": str(uds.p2_ms * 1000),
        "CP_P2Star": str(uds.p2_star_ms * 1000),
        "CP_TesterPresentTime": str(uds.s3_ms * 400),  # two fit into S3
    }


def protocols_of(uds: UdsParams, doip: DoipParams | None, name: str) -> list[Protocol]:
    """Return how testers reach the gateway.

    Args:
        uds: the server's first address.
        doip: the DoIP server; None: there is none.
        name: of its layer.
    """
    bits = 29 if uds.flags & EXTENDED else 11
    kind = f"normal segmented {bits}-bit transmit with FC"
    table = {
        "CP_CanPhysReqExtAddr": "0",
        "CP_CanPhysReqFormat": kind,
        "CP_CanPhysReqId": str(uds.request),
        "CP_CanRespUSDTExtAddr": "0",
        "CP_CanRespUSDTFormat": f"normal segmented {bits}-bit receive with FC",
        "CP_CanRespUSDTId": str(uds.response),
        "CP_CanRespUUDTExtAddr": "0",
        "CP_CanRespUUDTFormat": f"normal unsegmented {bits}-bit receive",
        "CP_CanRespUUDTId": _NOT_USED,
        "CP_ECULayerShortName": name,
    }
    can: dict[str, str | Mapping[str, str]] = {"CP_CANFDTxMaxDataLength": _FD if uds.fd else _CLASSIC}
    if uds.functional is not None:
        can |= {"CP_CanFuncReqFormat": kind, "CP_CanFuncReqId": str(uds.functional)}
    values: dict[str, Values] = {"ISO_15765_3": _times(uds), "ISO_15765_2": can | {_TABLE: table}}
    made = [Protocol("UDS_on_CAN", "ISO_15765_3_on_ISO_15765_2", "ISO_11898_2_DWCAN", values)]
    if doip is not None:
        ip: dict[str, str | Mapping[str, str]] = {
            "CP_DoIPLogicalGatewayAddress": str(doip.address),
            "CP_DoIPLogicalTesterAddress": str(doip.tester[0].address),
            "CP_DoIPLogicalFunctionalAddress": str(doip.functional),
            "CP_DoIPRoutingActivationType": "0",
            "CP_DoIPRoutingActivationTimeout": "2000000",
            _TABLE: {"CP_DoIPLogicalEcuAddress": str(doip.address), "CP_ECULayerShortName": name},
        }
        values = {"ISO_14229_5": _times(uds), "ISO_13400_2": ip}
        made.append(Protocol("UDS_on_DoIP", "ISO_14229_5_on_ISO_13400_2", "IEEE_802_3", values))
    return made


def subsets(protocols: Sequence[Protocol]) -> dict[str, Element]:
    """Return the files of subsets and specifications: name -> content."""
    known = {name: values for protocol in protocols for name, values in protocol.values.items()}
    made = {f"{name}.odx-cs": _subset(name, values) for name, values in known.items()}
    for protocol in protocols:
        refs = [_outside("COMPARAM-SUBSET", name, name) for name in protocol.values]
        stack = named(
            "PROT-STACK",
            protocol.kind,
            node("PDU-PROTOCOL-TYPE", protocol.kind),
            node("PHYSICAL-LINK-TYPE", protocol.link),
            node("COMPARAM-SUBSET-REFS", *refs),
            ID=f"{protocol.name}.STACK",
        )
        spec = named("COMPARAM-SPEC", protocol.name, node("PROT-STACKS", stack), ID=f"{protocol.name}.SPEC")
        made[f"{protocol.name}.odx-c"] = spec
    return made


def _outside(kind: str, document: str, target: str, tag: str = "") -> Element:
    """Return a reference into another document."""
    return node(tag or f"{kind}-REF", ID_REF=target, DOCREF=document, DOCTYPE=kind)


def _subset(name: str, values: Values) -> Element:
    numbers, texts = f"{name}.number", f"{name}.text"

    def parameter(owner: str, key: str, default: str) -> Element:
        return named(
            "COMPARAM",
            key,
            node("PHYSICAL-DEFAULT-VALUE", default),
            node("DATA-OBJECT-PROP-REF", ID_REF=numbers if default.isdigit() else texts),
            ID=f"{owner}.{key}",
            PARAM_CLASS=_CLASSES.get(key, "COM" if owner == name else "UNIQUE_ID"),
            CPTYPE="STANDARD",
            CPUSAGE="ECU-COMM",
        )

    simple = [parameter(name, key, each) for key, each in values.items() if isinstance(each, str)]
    tables = [
        named(
            "COMPLEX-COMPARAM",
            key,
            *(parameter(f"{name}.{key}", column, default) for column, default in each.items()),
            ID=f"{name}.{key}",
            PARAM_CLASS="UNIQUE_ID",
            CPTYPE="STANDARD",
            CPUSAGE="ECU-COMM",
            ALLOW_MULTIPLE_VALUES="true",
        )
        for key, each in values.items()
        if not isinstance(each, str)
    ]
    dops = [
        named(
            "DATA-OBJECT-PROP",
            key.rpartition(".")[2],
            node("COMPU-METHOD", node("CATEGORY", "IDENTICAL")),
            node("DIAG-CODED-TYPE", *length, BASE_DATA_TYPE=base, **more),
            node("PHYSICAL-TYPE", BASE_DATA_TYPE=base),
            ID=key,
        )
        for key, base, length, more in (
            (numbers, "A_UINT32", [node("BIT-LENGTH", "32")], {"type": "STANDARD-LENGTH-TYPE"}),
            (
                texts,
                "A_UNICODE2STRING",
                [node("MIN-LENGTH", "0")],
                {"TERMINATION": "END-OF-PDU", "type": "MIN-MAX-LENGTH-TYPE"},
            ),
        )
    ]
    return named(
        "COMPARAM-SUBSET",
        name,
        node("COMPARAMS", *simple),
        node("COMPLEX-COMPARAMS", *tables) if tables else None,
        node("DATA-OBJECT-PROPS", *dops),
        ID=name,
        CATEGORY="APPLICATION" if "CP_P2Max" in values else "TRANSPORT",
    )


def layer_of(protocol: Protocol) -> Element:
    """Return the layer of a protocol."""
    return named(
        "PROTOCOL",
        protocol.name,
        _outside("COMPARAM-SPEC", protocol.name, f"{protocol.name}.SPEC"),
        node("PROT-STACK-SNREF", SHORT_NAME=protocol.kind),
        ID=f"{protocol.name}.PROTOCOL",
    )


def refs(protocols: Sequence[Protocol]) -> Element:
    """Return the gateway's values of all parameters."""
    made = []
    for protocol in protocols:
        for subset, values in protocol.values.items():
            for key, given in values.items():
                simple = isinstance(given, str)
                ref = _outside("COMPARAM-SUBSET", subset, f"{subset}.{key}", "COMPARAM-REF")
                cells = [given] if isinstance(given, str) else list(given.values())
                content = [node("SIMPLE-VALUE", cell) for cell in cells]
                ref.extend(content if simple else [node("COMPLEX-VALUE", *content)])
                ref.append(node("PROTOCOL-SNREF", SHORT_NAME=protocol.name))
                made.append(ref)
    return node("COMPARAM-REFS", *made)


def parents(protocols: Sequence[Protocol]) -> Element:
    """Return the references of the gateway's layer to its protocols."""
    return node(
        "PARENT-REFS",
        *(node("PARENT-REF", ID_REF=f"{each.name}.PROTOCOL", type="PROTOCOL-REF") for each in protocols),
    )
