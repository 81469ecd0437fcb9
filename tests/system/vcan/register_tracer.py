"""Reads, writes and reads again the beginning of a stopped process's registers; prints what came of it as JSON.

Run by test_guest.py with and without ptrace_xsave.c.
"""

import ctypes
import json
import os
import signal

TRACEME, KILL, GETREGSET, SETREGSET, NT_X86_XSTATE = 0, 8, 0x4204, 0x4205, 0x202
KNOWN = 576  # bytes: the image of FXSAVE and the header of XSAVE
XMM0 = slice(160, 176)
NEW = b"as it is written"

libc = ctypes.CDLL(None, use_errno=True)
libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
libc.ptrace.restype = ctypes.c_long


class Vector(ctypes.Structure):
    """struct iovec."""

    _fields_ = [("base", ctypes.c_void_p), ("length", ctypes.c_size_t)]


child = os.fork()
if not child:
    libc.ptrace(TRACEME, 0, None, None)
    os.kill(os.getpid(), signal.SIGSTOP)
    os._exit(0)
os.waitpid(child, 0)
known = ctypes.create_string_buffer(KNOWN)


def ask(request: int) -> int:
    """Return the error number of a request, 0 if there is none."""
    vector = Vector(ctypes.addressof(known), KNOWN)
    return ctypes.get_errno() if libc.ptrace(request, child, NT_X86_XSTATE, ctypes.addressof(vector)) < 0 else 0


read = ask(GETREGSET)
known[XMM0] = NEW
write = ask(SETREGSET)
known[XMM0] = bytes(16)
ask(GETREGSET)
libc.ptrace(KILL, child, None, None)
os.waitpid(child, 0)
print(json.dumps({"read": read, "write": write, "kept": known[XMM0] == NEW}))
