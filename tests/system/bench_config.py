"""A small gateway of its own for tests of the daemon: one message with an alive counter, told in every way."""

from pathlib import Path

DBC = """VERSION ""
NS_ :
BS_:
BU_: Ecu Gateway
BO_ 768 Beat: 8 Ecu
 SG_ FrameCnt : 0|8@1+ (1,0) [0|255] "" Gateway
 SG_ Value : 8|16@1+ (0.1,0) [0|6553] "V" Gateway
BO_ 769 Other: 8 Ecu
 SG_ FrameCnt : 0|8@1+ (1,0) [0|255] "" Gateway
"""

BUS = """
[[bus]]
name = "{name}"
uri = "{uri}"
database = ["beat.dbc"]

[[bus.check]]
message = "Beat"
timeout_ms = {timeout_ms}
counter = {{ signal = "FrameCnt" }}
"""

#: The faults of another bus have DTCs of their own.
OTHER = """

[fault."{name}.Beat.timeout"]
dtc = "U0140-87"
[fault."{name}.Beat.counter"]
dtc = "U0422-82"
[fault."{name}.Beat.length"]
dtc = "U0422-81"
"""


def write_config(folder, *, buses=(("chassis", "loopback:127.0.0.1:29536"),), timeout_ms=300.0, more=""):
    """Write a configuration and its database; returns its path."""
    (Path(folder) / "beat.dbc").write_text(DBC)
    path = Path(folder) / "beat.toml"
    text = 'name = "beat"\n' + more
    for name, uri in buses:
        part = BUS.format(name=name, uri=uri, timeout_ms=timeout_ms)
        text += part + (OTHER.format(name=name) if name != "chassis" else "")
    text += f'\n[output.dtc_frame]\nbus = "{buses[0][0]}"\ncycle_ms = 500.0\n'
    path.write_text(text)
    return path


def beat(count):
    """Return the payload of one frame of the message Beat."""
    return bytes([count % 256]) + (120 + count % 7).to_bytes(2, "little") + bytes(5)
