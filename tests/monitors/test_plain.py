"""Monitors of plain Python (``@monitor``): as strangers write them, their slips, and their limit of time."""

import subprocess
import sys
import textwrap
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from stepping import failures

from gateway.bus.frames import empty, put
from gateway.common import trust
from gateway.config.load import load_config
from gateway.config.model import MonitorConfig
from gateway.monitors.plain import Result, calls, monitor
from gateway.monitors.plain.signature import OWN_KEYS
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway_fdi import jit
from gateway_fdi.errors import GatewayError, InputError
from gateway_replay.replay import replay

DBC = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 256 ECM: 8 ECU
 SG_ Speed : 0|16@1+ (0.25,0) [0|16000] "rpm" X
 SG_ Coolant : 16|8@1+ (1,-40) [-40|214] "degC" X
BO_ 257 BOX: 8 ECU
 SG_ Oil : 0|8@1+ (1,-40) [-40|214] "degC" X
"""
_names = count()


@pytest.fixture
def car(tmp_path, monkeypatch):
    """Return a function that writes a monitor's file, and returns the path of a configuration with it."""
    monkeypatch.setenv(trust.VARIABLE, trust.ALL)
    (tmp_path / "car.dbc").write_text(DBC)

    def write(text, name="Mine", keys=""):
        module = f"plain_{next(_names)}"
        head = "from gateway.monitors.plain import Result, monitor\nfrom gateway.monitors.contract import Debounce\n"
        (tmp_path / f"{module}.py").write_text(head + textwrap.dedent(text))
        path = tmp_path / "gateway.toml"
        path.write_text(
            f'[[bus]]\nname = "can"\nuri = "virtual:car"\ndatabase = ["car.dbc"]\n'
            f'[[monitor]]\nname = "mine"\ntype = "{module}:{name}"\n{keys}\n'
        )
        return path

    return write


def drive(rows, every_ns=10_000_000):
    """Return frames of ECM, one for each (rpm, coolant), and of BOX every tenth with an oil of 80 degC."""
    frames = empty(len(rows) + len(rows) // 10)
    place = 0
    for k, (rpm, coolant) in enumerate(rows):
        t_ns = (k + 1) * every_ns
        payload = round(rpm * 4).to_bytes(2, "little") + bytes([round(coolant) + 40, 0, 0, 0, 0, 0])
        put(frames, place, t_ns, 256, payload, bus=0)
        place += 1
        if k % 10 == 9:
            put(frames, place, t_ns + 1, 257, bytes([120, 0, 0, 0, 0, 0, 0, 0]), bus=0)
            place += 1
    return frames


#: Monitors of strangers, at most 15 lines each -> a drive, the fault, and the sample at which it fails.
STRANGERS = {
    "rate": (
        """
        @monitor(signals=["ECM.Coolant [degC]"], fault="P0116-00")
        class Mine:
            def __init__(self, most: float = 500.0):
                self.most, self.last = most, None

            def update(self, coolant, dt_s):
                before, self.last = self.last, coolant
                if before is not None:
                    return abs(coolant - before) / dt_s / self.most
        """,
        [(900, 20)] * 50 + [(900, 120)] * 51,
        "mine.fault",
        51,
    ),
    "hysteresis": (
        """
        @monitor(signals=["ECM.Coolant [degC]"], fault={"hot": "P0217-00"}, debounce=Debounce(failed_after=3))
        def Mine(coolant, high: float = 110.0, back: float = 100.0):
            if coolant > high or coolant < back:
                return Result(coolant > high, coolant, high)
        """,
        [(900, 90)] * 20 + [(900, 105)] * 20 + [(900, 115)] * 20,
        "mine.hot",
        43,
    ),
    "moving average": (
        """
        from collections import deque

        @monitor(signals=["ECM.Speed"], fault="P0219-00")
        class Mine:
            def __init__(self, samples: int = 10, limit: float = 6000.0):
                self.limit, self.past = limit, deque(maxlen=samples)

            def update(self, rpm):
                self.past.append(rpm)
                mean = sum(self.past) / len(self.past)
                return Result(mean > self.limit, mean, self.limit)
        """,
        [(3000, 90)] * 30 + [(9000, 90)] * 30,
        "mine.fault",
        36,
    ),
    "two signals": (
        """
        @monitor(signals={"oil": "BOX.Oil [degC]", "coolant": "ECM.Coolant [degC]"}, fault="P0196-00")
        def Mine(coolant, oil, *, apart: float = 30.0):
            return abs(coolant - oil) > apart
        """,
        [(900, 80)] * 40 + [(900, 120)] * 10,
        "mine.fault",
        41,
    ),
    "a class with history": (
        """
        @monitor(signals=("ECM.Speed", "ECM.Coolant"), fault={"cold": "P0128-00", "stands": "P0116-2A"})
        class Mine:
            \"\"\"The engine does not get warm, or its sensor stands.\"\"\"
            def __init__(self, warm: float = 75.0, within_s: float = 0.505):
                self.warm, self.within_s, self.run_s, self.seen = warm, within_s, 0.0, set()

            def update(self, rpm, coolant, t_s, dt_s):
                self.run_s = self.run_s + dt_s if rpm > 300 else 0.0
                self.seen.add(coolant)
                if self.run_s > self.within_s:
                    return {"cold": coolant < self.warm, "stands": self.run_s > 1.0 and len(self.seen) < 2}
        """,
        [(0, 20)] * 10 + [(900, 20)] * 60,
        "mine.cold",
        61,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", STRANGERS)
def test_monitors_of_strangers_find_their_faults_in_any_batches(name, car):
    text, rows, fault, sample = STRANGERS[name]
    lines = [line for line in textwrap.dedent(text).splitlines() if line.strip()]
    assert len(lines) <= 15
    path, frames = car(text), drive(rows)
    found = failures(path, frames)
    assert found
    assert found[0] == (fault, sample * 10_000_000)
    assert failures(path, frames, batch=1) == found == failures(path, frames, batch=len(frames))


def test_parameters_are_keys_of_the_configuration(car):
    text, rows, _, _ = STRANGERS["hysteresis"]
    assert failures(car(text, keys="high = 120.0"), drive(rows)) == []
    with pytest.raises(GatewayError, match=r"monitor\.0\.hihg.*|hihg"):
        prepare(load_config(car(text, keys="hihg = 120.0")), None)


def test_its_evidence_names_inputs_and_units(car):
    path = car(STRANGERS["two signals"][0])
    gateway = Gateway(load_config(path), file=path)
    (definition,) = [one for one in gateway.catalogue if one.id == "mine.fault"]
    assert definition.evidence[:2] == ("oil [degC]", "coolant [degC]")
    gateway.close()


@pytest.mark.parametrize(("ratio", "status"), [(0.99, 0), (1.0, 0), (1.01, 1)])
def test_a_ratio_above_one_is_a_failure(ratio, status, car):
    path = car(f"@monitor(signals=['ECM.Coolant'], fault='P0128-00')\ndef Mine(x):\n    return {ratio}\n")
    assert len(failures(path, drive([(900, 80)] * 5))) == status


def test_a_function_stays_a_function():
    @monitor(signals=["A.B"], fault="P0128-00")
    def mine(value, limit: float = 3.0):
        return Result(value > limit, value, limit)

    assert mine(4.0) == (True, 4.0, 3.0)
    assert mine(4.0, limit=5.0).failed is False


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ("1 / 0", "ZeroDivisionError"),
        ("float('nope')", "could not convert"),
        ("'yes'", "it returns True, False, a ratio, a Result or None, not 'yes'"),
        ("Result(coolant, 1, 2)", "failed is True or False"),
        ("Result(True, 'x', 2)", "could not convert string to float"),
        ("{'other': True}", "it returns True, False"),
        ("undefined", "name 'undefined' is not defined"),
        ("__import__('sys').exit(3)", "SystemExit"),
        ("coolant.missing", "no attribute 'missing'"),
        ("[][0]", "list index out of range"),
    ],
)
def test_a_step_that_fails_switches_its_monitor_off_with_the_reason(given, text, car):
    path = car(f"@monitor(signals=['ECM.Coolant'], fault='P0128-00')\ndef Mine(coolant):\n    return {given}\n")
    events = run(path)
    (off,) = [event for event in events if event["event"] == "monitor_off"]
    assert text in off["reason"]
    if "it returns" not in text and "failed is" not in text and "convert string" not in text:
        assert ".py:5" in off["reason"], "its line"
    assert off["file"].endswith(".py")
    assert off["monitor"] == "mine"


def run(path):
    gateway = Gateway(load_config(path), file=path)
    events = []
    gateway.listen(events.append)
    gateway.start(0)
    gateway.feed(drive([(900, 80)] * 20))
    gateway.close()
    return events


LOOPS = [
    "while True:\n        pass",
    "while True:\n        try:\n            len([])\n        except Exception:\n            pass",
    "try:\n        while True:\n            pass\n    except BaseException:\n        return True",
]


@pytest.mark.parametrize("loop", LOOPS)
def test_an_endless_loop_is_ended_and_the_others_go_on(loop, car, monkeypatch):
    monkeypatch.setattr(calls, "LIMIT_S", 0.2)
    path = car(f"@monitor(signals=['ECM.Coolant'], fault='P0128-00')\ndef Mine(coolant):\n    {loop}\n")
    events = run(path)
    (off,) = [event for event in events if event["event"] == "monitor_off"]
    assert "takes longer than 0.2 s" in off["reason"]
    np.zeros(10).sum()  # nothing is interrupted later
    assert not calls._this.watched.interrupted


def test_after_an_interrupt_python_looks_for_none():
    """CPython 3.11 hangs in a traced call as long as it looks for one: in the budget of algebra, and in coverage."""
    source = """
        import sys
        import numpy as np
        from gateway.monitors.plain import calls
        calls.LIMIT_S = 0.05
        def step():
            while True:
                pass
        state = np.zeros(1)
        try:
            calls.call(calls.enter(step, state))
        except RuntimeError as error:
            print(error)
        sys.settrace(lambda *_: None)
        (lambda: print("traced"))()
    """
    asked = [sys.executable, "-c", textwrap.dedent(source)]
    ended = subprocess.run(asked, capture_output=True, text=True, timeout=60, check=True)
    assert "longer" in ended.stdout
    assert ended.stdout.endswith("traced\n")


@pytest.mark.parametrize(("lasts_s", "off"), [(3.0, 0), (0.1, 1)])
def test_a_step_that_only_waits_is_ended_by_the_clock_and_later(lasts_s, off, car, monkeypatch):
    """So a busy machine, where a step waits for a processor, ends none."""
    monkeypatch.setattr(calls, "LIMIT_S", 0.1)
    monkeypatch.setattr(calls, "LASTS_S", lasts_s)
    monkeypatch.setattr(calls, "LOOKED_S", 0.01)
    path = car(
        "import time\nwaits = [0.4]\n"
        "@monitor(signals=['ECM.Coolant'], fault='P0128-00')\n"
        "def Mine(coolant):\n    time.sleep(waits.pop() if waits else 0)\n"
    )
    assert sum(event["event"] == "monitor_off" for event in run(path)) == off


def test_a_replay_has_a_monitor_off_where_its_step_took_too_long(car, monkeypatch):
    monkeypatch.setattr(calls, "LIMIT_S", 0.2)
    text = """
        import builtins
        @monitor(signals=["ECM.Speed", "ECM.Coolant"], fault="P0217-00")
        def Mine(rpm, coolant):
            while rpm > 3000 and builtins.plain_is_slow:
                pass
            return coolant > 100
    """
    path, rows = car(text), [(900, 80)] * 20 + [(3500, 120)] + [(900, 120)] * 20
    frames = drive(rows)

    def verdicts(frames, *, slow):
        monkeypatch.setattr("builtins.plain_is_slow", slow, raising=False)
        gateway = Gateway(load_config(path), file=path)
        events = []
        gateway.listen(events.append)
        replay(gateway, [frames])
        late = gateway.take_overtimes()
        gateway.close()
        return [(e["event"], e["t_ns"], e.get("fault")) for e in events if e["event"] in ("dtc", "monitor_off")], late

    live, late = verdicts(frames, slow=True)
    assert ("monitor_off", 210_000_000, None) in live
    assert not any(fault == "mine.fault" for _, _, fault in live)
    assert len(late) == 1
    recorded = np.concatenate([frames, late])  # it stands behind the batch
    again, none = verdicts(recorded, slow=False)
    assert again == live
    assert not len(none)
    without, _ = verdicts(frames, slow=False)
    assert any(fault == "mine.fault" for _, _, fault in without), "else it would find the fault"


#: Sources that can be compiled, as they are -> a drive.
COMPILED = {
    "function": """
        @monitor(signals=["ECM.Coolant"], fault="P0217-00", compiled=COMPILED)
        def Mine(coolant, high: float = 110.0, back: float = 100.0):
            if coolant > high or coolant < back:
                return Result(coolant > high, coolant, high)
        """,
    "class": """
        import math
        import numpy as np

        @monitor(signals=["ECM.Speed", "ECM.Coolant"], fault="P0116-00", compiled=COMPILED)
        class Mine:
            def __init__(self, most: float = 2.0, count: int = 7):
                self.most, self.last, self.past, self.seen = most, math.nan, np.zeros(count), 0

            def update(self, rpm, coolant, dt_s):
                before, self.last = self.last, coolant
                self.past[self.seen % 7] = abs(coolant - before)
                self.seen += 1
                if rpm < 100 or self.seen < 9:
                    return None
                return float(self.past.sum() * dt_s / 0.01 / 7 / self.most)
        """,
    "yes or no": """
        @monitor(signals=["ECM.Speed", "ECM.Coolant"], fault="P0116-00", compiled=COMPILED)
        def Mine(rpm, coolant, t_s, *, hot: int = 90):
            return coolant > hot and (rpm < 500 or t_s > 3.0)
        """,
}


def results(path, frames):
    """Return each result of the monitor: passed or failed, value, limit, evidence."""
    gateway = Gateway(load_config(path), file=path)
    found = []
    gateway.listen(lambda event: found.append(event) if event["event"] == "dtc" else None)
    gateway.start(0)
    gateway.feed(frames)
    buckets = gateway.engine.take_buckets()
    (place,) = [k for k, one in enumerate(gateway.catalogue) if one.id == "mine.fault"]
    gateway.close()
    row = buckets[place]
    return [int(row["count"]), int(row["failed"]), float(row["low"]), float(row["high"]), float(row["worst"])], found


@pytest.mark.parametrize("name", COMPILED)
def test_the_same_source_compiled_says_the_same(name, car):
    rng = np.random.default_rng(seed := 72)
    print("seed", seed)
    rows = np.column_stack([rng.integers(0, 1500, 500), 100 + 25 * np.sin(np.arange(500) / 9) + rng.normal(0, 2, 500)])
    frames, text = drive(rows.round().tolist()), COMPILED[name]
    plain = results(car(text.replace("COMPILED", "False")), frames)
    compiled = results(car(text.replace("COMPILED", "True")), frames)
    assert plain[0] == compiled[0]
    assert plain[0][0] > plain[0][1] > 0, "some of each"
    assert [(e["t_ns"], e["status"]) for e in plain[1]] == [(e["t_ns"], e["status"]) for e in compiled[1]]


HEAD = "@monitor(signals=['ECM.Coolant'], fault='P0128-00', compiled=True)\n"
CLASS = "class Mine:\n    def __init__(self):\n        self.{}\n    def update(self, x):\n        return x > 3\n"
UNCOMPILED = [
    ("def Mine(x):\n    y = x > 3\n    return y\n", 6, "say what this returns"),
    ("def Mine(x):\n    if x > 3:\n        return x > 5\n    return x / 3\n", 7, "ratio and bool"),
    ("def Mine(x):\n    pass\n", 3, "it returns nothing"),
    ("def Mine(x):\n    z = open('/dev/null')\n    return x > 3\n", 5, "'open'"),
    (CLASS.format("past = []"), 7, "'past' is []"),
    (CLASS.format("last = None"), 7, "math.nan"),
    (CLASS.format("max = 1.0"), 7, "another name"),
    ("def Mine(x, text: str = 'a'):\n    return x > 3\n", 3, "'text' is 'a'"),
]


@pytest.mark.skipif(not jit.COMPILED, reason="its types are known when it is compiled")
@pytest.mark.parametrize(("text", "line", "told"), UNCOMPILED)
def test_what_cannot_be_compiled_is_told_with_its_line(text, line, told, car):
    path = car(HEAD + text)
    with pytest.raises(GatewayError) as error:
        prepare(load_config(path), path).engine.warm()
    assert told in str(error.value)
    assert f".py:{line}" in str(error.value)


SLIPS = [
    ("@monitor(signals=['ECM.Colant'], fault='P0128-00')\ndef Mine(x):\n    return x > 1\n", "did you mean Coolant"),
    ("@monitor(signals=['ECM.Coolant [K]'], fault='P0128-00')\ndef Mine(x):\n    return x > 1\n", "degC"),
    ("@monitor(signals=['Coolant'], fault='P0128-00')\ndef Mine(x):\n    return x > 1\n", "Message.Signal"),
    ("@monitor(signals=[], fault='P0128-00')\ndef Mine(x):\n    return x > 1\n", "0 signals"),
    ("@monitor(signals=['ECM.Coolant', 'ECM.Speed'], fault='P0128-00')\ndef Mine(x):\n    return x > 1\n", "2 signals"),
    ("@monitor(signals=['ECM.Coolant'], fault='P0128-0')\ndef Mine(x):\n    return x > 1\n", "P0128-0"),
    ("@monitor(signals=['ECM.Coolant'], fault='X9')\ndef Mine(x):\n    return x > 1\n", "X9"),
    ("@monitor(signals=['ECM.Coolant'], fault='P0128-00')\ndef Mine(x, limit):\n    return x > 1\n", "needs a type"),
    ("@monitor(signals=['ECM.Coolant'], fault='P0128-00')\ndef Mine(x, limit: float):\n    return x > 1\n", "limit"),
    ("@monitor(signals=['ECM.Coolant'], fault='P0128-00')\ndef Mine(*x):\n    return x > 1\n", "no *args"),
    ("@monitor(signals={'y': 'ECM.Coolant'}, fault='P0128-00')\ndef Mine(x):\n    return x > 1\n", "no argument 'y'"),
    ("@monitor(signals=['ECM.Coolant'], fault='P0128-00')\nclass Mine:\n    pass\n", "needs a function update"),
    ("@monitor(signals=['ECM.Coolant'], fault={})\ndef Mine(x):\n    return x > 1\n", "0 faults"),
    ("@monitor(signals=['ECM.Coolant'], falt='P0128-00')\ndef Mine(x):\n    return x > 1\n", "falt"),
    ("@monitor\ndef Mine(x):\n    return x > 1\n", "monitor()"),
    ("@monitor(signals=['ECM.Coolant'], fault='P0128-00')\ndef Mine(x)\n    return x > 1\n", "SyntaxError"),
    ("import nowhere\n", "nowhere"),
    ("@monitor(signals=['ECM.Coolant'], fault='P0128-00')\ndef Other(x):\n    return x > 1\n", "has no Mine"),
    ("def Mine(x):\n    return x > 1\n", "no Monitor"),
    (
        "@monitor(signals=['ECM.Coolant'], fault='P0128-00')\nclass Mine:\n    def __init__(self):\n"
        "        self.x = 1 / 0\n    def update(self, x):\n        return True\n",
        "ZeroDivisionError",
    ),
]  # fmt: skip


FUNCTION = "def Mine(x):\n    return x > 1\n"
#: Arguments of the decorator over FUNCTION, or over another one -> what is said.
SLIPS += [
    (f"@monitor({arguments})\n{below}", told)
    for arguments, below, told in [
        ("signals='ECM.Coolant', fault='P0128-00'", FUNCTION, "signals is a list"),
        ("signals=None, fault='P0128-00'", FUNCTION, "signals is a list"),
        ("signals=['ECM.Coolant'], fault=3", FUNCTION, "fault is a DTC"),
        ("signals=['ECM.Coolant'], fault=['P0128-00']", FUNCTION, "fault is a DTC"),
        ("signals=['ECM.Coolant'], fault={'a': 5}", FUNCTION, "fault is a DTC"),
        ("signals=['ECM.Coolant'], fault={'a b!': 'P0128-00'}", FUNCTION, "a b!"),
        ("signals=['ECM.Coolant'], fault=''", FUNCTION, "DTC"),
        ("signals=['ECM.Coolant'], fault='P0128-00', debounce=5", FUNCTION, "debounce is a Debounce"),
        ("signals=['ECM.Coolant'], fault='P0128-00', debounce=Debounce(0, 1)", FUNCTION, "failed_after"),
        ("signals=['ECM.Coolant'], fault='P0128-00', debounce=Debounce(99999, 1)", FUNCTION, "failed_after"),
        ("signals=['ECN.Coolant'], fault='P0128-00'", FUNCTION, "did you mean ECM"),
        ("signals=['ECM.Coolant [degc]'], fault='P0128-00'", FUNCTION, "degC"),
        ("signals=['ECM.Coolant', 'ECM.Coolant'], fault='P0128-00'", FUNCTION, "2 signals"),
        ("signals=['ECM.Coolant'], fault='P0128-00'", "def Mine(x, type: str = 'a'):\n    return x > 1\n", "'type'"),
        ("signals=['ECM.Coolant'], fault='P0128-00'", "def Mine(x, bus: int = 1):\n    return x > 1\n", "'bus'"),
        ("signals=['ECM.Coolant'], fault='P0128-00'", "def Mine(x, a: Nope = 1):\n    return x > 1\n", "Nope"),
        ("signals=['ECM.Coolant'], fault='P0128-00'", "def Mine(x, a: 5 = 1):\n    return x > 1\n", "a"),
        ("signals=['ECM.Coolant'], fault='P0128-00'", "def Mine(x, _a: int = 1):\n    return x > 1\n", "'_a'"),
        ("signals=['ECM.Coolant'], fault='P0128-00'", "def Mine():\n    return True\n", "1 signals"),
        ("signals=['ECM.Coolant'], fault='P0128-00'", "def Mine(t_s):\n    return True\n", "1 signals"),
        ("signals=['ECM.Coolant'], fault='P0128-00'", "class Mine:\n    update = 3\n", "needs a function update"),
        (
            "signals=['ECM.Coolant'], fault='P0128-00'",
            "class Mine:\n    def update(self, x, limit: float = 1.0):\n        return True\n",
            "update has the argument 'limit'",
        ),
        (
            "signals=['ECM.Coolant'], fault='P0128-00'",
            "class Mine:\n    def update(self):\n        return True\n",
            "1 signals",
        ),
        ("signals=['ECM.Coolant'], fault='P0128-00'", "Mine = 3\n", "SyntaxError"),
        ("signals=['ECM.Coolant'] * 65, fault='P0128-00'", FUNCTION, "65 signals"),
        ("signals=['ECM.Coolant'], fault={f'f{k}': 'P0128-00' for k in range(17)}", FUNCTION, "17 faults"),
        ("signals=['ECM.Coolant'], fault={'a': 'P0128-00', 'b': 'P0128-01'}, compiled=True", FUNCTION, "one fault"),
    ]
]


def test_the_keys_of_a_table_are_no_parameters():
    assert set(OWN_KEYS) == set(MonitorConfig.model_fields)


@pytest.mark.parametrize(("text", "told"), SLIPS)
def test_a_slip_of_an_author_is_one_error_with_its_place(text, told, car):
    path = car(text)
    with pytest.raises(GatewayError) as error:
        prepare(load_config(path), path)
    assert told in str(error.value)
    assert len(str(error.value).splitlines()) <= 2


def test_a_signal_of_a_decorator_is_checked_where_it_stands():
    with pytest.raises(InputError, match="not 3") as error:
        monitor(signals=[3], fault="P0128-00")(lambda x: x)
    assert Path(str(error.value.file)) == Path(__file__)
