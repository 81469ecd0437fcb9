"""The bus of a rig as a recording that Wireshark's dissectors read: what was fed and what was sent."""

import struct
import subprocess
from pathlib import Path

from debian import program
from rig import Rig

from gateway.bus.frames import BRS, EXTENDED, FD, ID_MASK, empty, payload

#: LINKTYPE_CAN_SOCKETCAN: struct canfd_frame, its identifier in network order.
SOCKETCAN = 227
#: Flags of that structure (pcap's description of the link type).
CANFD_BRS, CANFD_FDF = 0x01, 0x04


class Wire(Rig):
    """A rig that keeps all frames of its bus."""

    def __init__(self, config, memory=None):
        self.frames = []
        super().__init__(config, memory)

    def feed(self, *rows, flags=0):
        made = []
        for row in rows:
            self.frames.append((self.now + 1_000_000, row[0], flags, row[1]))
            made += super().feed(row, flags=flags)
        return made

    def _keep(self, made):
        for frame in (f for batch in made for f in batch):
            self.frames.append((int(frame["t_ns"]), int(frame["can_id"]), int(frame["flags"]), payload(frame)))
        return super()._keep(made if made else [empty(0)])


def write_pcap(frames, path: Path):
    """Write frames (time [ns], identifier with EXTENDED, flags, payload) as a pcap with stamps in nanoseconds."""
    parts = [struct.pack(">IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 0xFFFF, SOCKETCAN)]
    for t_ns, can_id, flags, data in frames:
        fd = (CANFD_FDF if flags & FD else 0) | (CANFD_BRS if flags & BRS else 0)
        room = 64 if flags & FD else 8
        body = struct.pack(">IBBBB", can_id, len(data), fd, 0, 0) + data.ljust(room, b"\0")
        parts.append(struct.pack(">IIII", t_ns // 10**9, t_ns % 10**9, len(body), len(body)) + body)
    path.write_bytes(b"".join(parts))


def dissect(pcap: Path, over_isotp, identifiers, fields, only=""):
    """Return what tshark's dissectors see: for each frame a dictionary of the fields, each a list of texts.

    Args:
        pcap: a recording.
        over_isotp: the protocol in ISO-TP messages: "uds", "obd-ii".
        identifiers: of frames that carry ISO-TP, below or above 0x7FF; other extended ones are J1939.
        fields: names of fields.
        only: a display filter.
    """
    tshark = program("tshark")
    short = ",".join(f"{i:#x}" for i in identifiers if i <= 0x7FF)
    long = ",".join(f"{i & ID_MASK:#x}" for i in identifiers if i & EXTENDED)
    command = [
        tshark, "-n", "-r", str(pcap), "-o", f"iso15765.can.ids:{short}", "-o", f"iso15765.can.extended_ids:{long}",
        "-d", "can.subdissector,j1939", "-d", f"iso15765.subdissector,{over_isotp}",
        "-T", "fields", "-E", "separator=/t", "-E", "occurrence=a", "-E", "aggregator=|",
        *(part for field in fields for part in ("-e", field)), *(("-Y", only) if only else ()),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    rows = [line.split("\t") for line in done.stdout.splitlines()]
    return [{name: [t for t in text.split("|") if t] for name, text in zip(fields, row, strict=True)} for row in rows]
