"""The socketcand protocol's lines, and our extension of it.

Plain (linux-can/socketcand, raw mode): ``< frame 123 1700000000.123456789 11 22 >`` style messages from
the server, ``< send 123 2 11 22 >`` from the client; identifiers have 3 hex digits, or 8 when extended.

The protocol has no CAN FD, no remote frames and no flags. A client that says ``< xmode >`` before
``< rawmode >`` gets and sends every frame as ``< x CANID T_NS FLAGS HEX >`` instead (``T_NS`` is ``-`` from
the client): identifier with the flags of ``struct can_frame`` in 8 hex digits, time in nanoseconds, our frame
flags in hex, payload as hex or ``-``. Plain clients never see such a line, nor a frame they could not express.
"""

from __future__ import annotations

from gateway.bus.frames import ERROR, EXTENDED, FD, FD_LENGTHS, ID_MASK, REMOTE, of_bus

#: Longest line accepted.
LONGEST = 512

#: A frame outside a batch: (t_ns, can_id, flags, payload).
Parts = tuple[int, int, int, bytes]

_KNOWN_BITS = EXTENDED | REMOTE | ERROR | ID_MASK


def plain_frame(parts: Parts) -> bytes | None:
    """Return a frame as a plain server line; None if the protocol cannot express it."""
    t_ns, can_id, flags, payload = parts
    if flags & FD or can_id & (REMOTE | ERROR):
        return None
    digits = 8 if can_id & EXTENDED else 3
    stamp = f"{t_ns // 10**9}.{t_ns % 10**9:09d}"
    return f"< frame {can_id & ID_MASK:0{digits}X} {stamp} {payload.hex().upper()} >".encode()


def extended_frame(parts: Parts, *, stamped: bool = True) -> bytes:
    """Return a frame as a line of the extension."""
    t_ns, can_id, flags, payload = parts
    stamp = t_ns if stamped else "-"
    return f"< x {can_id:08X} {stamp} {flags:X} {payload.hex() or '-'} >".encode()


def parse_send(words: list[str]) -> Parts:
    """Read ``send ID LEN b0 b1 ...``.

    Raises:
        ValueError: it is no frame.
    """
    digits, length = words[1], int(words[2], 16)
    payload = bytes(int(word, 16) for word in words[3:])
    can_id = int(digits, 16)
    if len(payload) != length or length > 8:
        raise ValueError("length")
    if len(digits) > 3:
        return 0, _checked(can_id | EXTENDED), 0, payload
    if can_id > 0x7FF:
        raise ValueError("identifier")
    return 0, can_id, 0, payload


def parse_extended(words: list[str]) -> Parts:
    """Read ``x CANID T_NS FLAGS HEX``.

    Raises:
        ValueError: it is no frame.
    """
    _, digits, stamp, flag_digits, data = words
    t_ns = 0 if stamp == "-" else int(stamp)
    flags = int(flag_digits, 16)
    payload = b"" if data == "-" else bytes.fromhex(data)
    if not 0 <= t_ns < 2**63 or not 0 <= flags <= 0xFF:
        raise ValueError("range")
    if len(payload) > 8 and (not flags & FD or len(payload) not in FD_LENGTHS):
        raise ValueError("length")
    return t_ns, _checked(int(digits, 16)), flags, payload


def _checked(can_id: int) -> int:
    if not 0 <= can_id <= 0xFFFFFFFF or (not can_id & (EXTENDED | ERROR) and can_id & ID_MASK > 0x7FF):
        raise ValueError("identifier")
    return int(of_bus(can_id & _KNOWN_BITS))


def split(buffer: bytearray) -> tuple[list[list[str]], int]:
    """Take the complete messages off the front of a buffer.

    Returns:
        the words of each message, and how many pieces of garbage were thrown away. The rest in the buffer is the
        beginning of the next message.
    """
    end = buffer.rfind(b">")
    garbage = 0
    messages = []
    if end >= 0:
        for piece in bytes(buffer[:end]).split(b">"):
            before, open_, inside = piece.partition(b"<")
            if not open_ or before.strip():
                garbage += 1
            if open_:
                if len(inside) > LONGEST or not inside.isascii():
                    garbage += 1
                else:
                    messages.append(inside.decode("ascii").split())
        del buffer[: end + 1]
    if len(buffer) > LONGEST:
        buffer.clear()
        garbage += 1
    return messages, garbage
