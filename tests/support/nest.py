"""The process that has imported the gateway, and whose copies are processes of it (:mod:`warm`).

Arguments: the socket of whoever orders copies, and the modules to import. An order is JSON, with standard input, output
and error, and a pipe in which the copy's end is told; the answer is the copy's number.
"""

import gc
import importlib
import json
import os
import signal
import socket
import struct
import sys


def serve():
    """Make copies until the other end is closed; returns in each copy, with the code that it is to run."""
    line = socket.socket(fileno=int(sys.argv[1]))
    importlib.import_module("gateway.common.lazy_modules").postpone()  # as the command line does
    for name in sys.argv[2:]:
        importlib.import_module(name)
    gc.collect()
    gc.freeze()
    ends = {}

    def tell_ends(*_):
        while ends:
            number, status = os.waitpid(-1, os.WNOHANG)
            if not number:
                return
            told = ends.pop(number)
            os.write(told, struct.pack("=i", status))
            os.close(told)

    signal.signal(signal.SIGCHLD, tell_ends)
    while True:
        data, files, _, _ = socket.recv_fds(line, 1 << 20, 4)
        if not data:
            os._exit(0)
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})
        number = os.fork()
        if not number:
            break
        ends[number] = files[3]
        for file in files[:3]:
            os.close(file)
        line.send(struct.pack("=q", number))
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
    line.close()
    for place, file in enumerate(files[:3]):
        os.dup2(file, place)
    for file in (*files, *ends.values()):
        os.close(file)
    return become(json.loads(data))


def become(order):
    """Be what was ordered; returns its code."""
    os.environ.clear()
    os.environ.update(order["environment"])
    os.chdir(order["cwd"])
    sys.argv = ["-c", *order["arguments"]]
    return compile(order["code"], "<string>", "exec")


exec(serve(), {"__name__": "__main__"})
