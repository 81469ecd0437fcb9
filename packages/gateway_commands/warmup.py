"""``gateway warmup``: make the kernels of the daemon ready, so that no start compiles."""

from __future__ import annotations

import socket
import time

from gateway.bus.base import Statistics
from gateway.bus.can_structs import Packer, RawReceiver
from gateway.bus.frames import empty
from gateway.bus.traffic import Traffic
from gateway.cli.present import print_json, say
from gateway.config.model import Config
from gateway.engine.buckets import nearness
from gateway.faults.journal import NO_JOURNAL
from gateway.faults.journal_steps import keep, withdraw
from gateway.host.sockets import CAN
from gateway.live.fast_path import FastPath
from gateway.live.fast_path_kernel import patience_ms
from gateway.monitors.contract import Family
from gateway.monitors.registry import MONITORS
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError
from gateway_fdi.jit import bound
from gateway_fdi.jit.cache import folder


def warmup(*, json: bool) -> int:
    """Load all kernels that a daemon uses, or compile those that changed; returns the exit code."""
    begun = time.monotonic()
    for type_, monitor in MONITORS.described().items():
        try:
            if isinstance(monitor, InputError):
                raise monitor
            if not isinstance(monitor, Family):  # its kernels depend on what a configuration says
                _ = monitor.checked_entry if monitor.outside else monitor.entry
        except InputError as error:  # of another package: the others are made ready
            say(f"monitor type {type_}: {error}")
    check = {"message": "GW_EngineSync", "timeout_ms": 500.0, "counter": {"signal": "FrameCnt"}}
    bus = {"name": "bus", "uri": "virtual:warmup", "database": [shipped("dbc/gateway.dbc")], "check": [check]}
    told = {"dtc_frame": {"bus": "bus"}}
    gateway = Gateway(Config.model_validate({"bus": [bus], "output": told}))  # it needs no plant, and no file
    gateway.start(0)
    gateway.engine.fault_detection_counters()  # signals that watchers look at
    pump = FastPath(gateway.engine, 1)
    bound(patience_ms, pump.memory, rest=(0,))  # for systems on which Python waits
    gateway.close()
    Traffic(1).write(empty(1))
    nearness(True, 1.0, 1.0)
    if CAN:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with ours, theirs:
            RawReceiver(ours, Statistics())
            Packer()
        bound(withdraw, NO_JOURNAL, rest=(0,))
        bound(keep, NO_JOURNAL, rest=())
    seconds = time.monotonic() - begun
    if json:
        print_json({"seconds": seconds, "cache": str(folder())})
    else:
        print(f"kernels ready in {seconds:.1f} s")
    return 0
