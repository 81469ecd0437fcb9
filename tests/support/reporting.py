"""A gateway to which other processes report: its configuration, and one that is served by a thread."""

import threading
import time
from contextlib import contextmanager

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_serve.report_socket import ReportSocket

CONFIG = """
name = "reported"
[[bus]]
name = "a"
uri = "virtual:a"
database = ["one.dbc"]
health = {{ watched = false }}

[report]
socket = "{socket}"
{table}
[[report.reporter]]
name = "battery"
{battery}
[[report.reporter.fault]]
name = "hot"
dtc = "P0A7E-98"
description = "a cell is too hot"
data = ["temperature [degC]", "cell"]
debounce = {{ failed_after = 3, passed_after = 2 }}
[[report.reporter.fault]]
name = "slow"
dtc = "P0A7F-00"
description = "charges slowly"
debounce = {{ failed_ms = 100, passed_ms = 200 }}

[[report.reporter]]
name = "camera"
{camera}
[[report.reporter.fault]]
name = "blind"
dtc = "B1234-00"
description = "sees nothing"
"""
DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 256 One: 8 A
 SG_ Level : 0|16@1- (0.01,0) [-300|300] "V" B
"""


def write_config(folder, *, table="", battery="", camera="", extra="", name="reported.toml"):
    (folder / "one.dbc").write_text(DBC)
    text = CONFIG.format(socket=folder / "report.sock", table=table, battery=battery, camera=camera)
    (folder / name).write_text(text + extra)
    return folder / name


@contextmanager
def served(folder, **config):
    """Yield a gateway whose report socket a thread serves; to be looked at when it is done."""
    gateway = Gateway(load_config(write_config(folder, **config)), None)
    gateway.start(0)
    gateway.advance(time.monotonic_ns())
    door = ReportSocket(gateway.config.report, gateway)
    ended = threading.Event()

    def serve():
        while not ended.wait(0.001):
            door.turn(time.monotonic())
            gateway.advance(time.monotonic_ns())

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield gateway
    finally:
        ended.set()
        thread.join()
        door.turn(time.monotonic())
        door.close()
        gateway.close()
