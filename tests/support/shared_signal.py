"""A car in which three ECUs send what a fourth one sends, too: a value of that one that is wrong breaks three rules."""

from gateway.bus.frames import empty, put
from gateway.config.load import load_config

MS = 1_000_000
#: Period of each message [ms].
PERIOD = 20
OTHERS = ("A", "B", "C")

_DBC = 'VERSION ""\nBS_:\nBU_: Speed A B C\n' + "".join(
    f'BO_ {256 + k} {name}: 8 {sender}\n SG_ V : 0|16@1- (0.1,0) [0|0] "km/h" Vector__XXX\n'
    for k, (name, sender) in enumerate([("Speed", "Speed"), *((name, name) for name in OTHERS)])
)

_TOML = """
name = "shared"
[[bus]]
name = "can0"
uri = "loopback:127.0.0.1:0"
database = ["car.dbc"]
codes = "own"
{checks}
[[monitor]]
name = "rules"
type = "rule"
rule = [
{rules}]
[memory]
{memory}
{more}
"""


def rule(name, condition="", tolerance=3, holds="{0}.V == Speed.V"):
    """Return a rule: what an ECU sends is what Speed sends."""
    return f'    {{ name = "{name}", holds = "{holds.format(name)}", tolerance = {tolerance}{condition} }},\n'


def write(folder, memory="", more="", rules=OTHERS, checks=("Speed", *OTHERS), **text_of_rule):
    """Write database and configuration; returns its path."""
    (folder / "car.dbc").write_text(_DBC)
    checked = "".join(f'[[bus.check]]\nmessage = "{name}"\ntimeout_ms = 100.0\n' for name in checks)
    written = "".join(rule(name, **text_of_rule) for name in rules)
    text = _TOML.format(memory=memory, more=more, rules=written, checks=checked)
    (folder / "car.toml").write_text(text)
    return folder / "car.toml"


def frames(begin_s, end_s, **off):
    """Return the frames of a time: all senders say 50 km/h, and what is off [km/h]; None: silent."""
    times = range(round(begin_s * 1000) // PERIOD * PERIOD, round(end_s * 1000), PERIOD)
    senders = [(k, name) for k, name in enumerate(("Speed", *OTHERS)) if off.get(name, 0) is not None]
    made = empty(len(times) * len(senders))
    place = 0
    for t_ms in times:
        for k, name in senders:
            value = round(10 * (50 + off.get(name, 0)))
            put(made, place, (t_ms + 2 * k) * MS, 256 + k, value.to_bytes(2, "little", signed=True) + bytes(6))
            place += 1
    return made


def config(folder, **more):
    """Return the configuration that is written."""
    return load_config(write(folder, **more))
