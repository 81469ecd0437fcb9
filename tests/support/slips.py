"""The slips of authors of monitors: what each writes into the example's monitor, and the line that it is to get.

``REFUSED`` are told before anything runs, ``RUNNING`` while it runs. A step that does not return:
tests/system/test_watchdog.py.
"""

from __future__ import annotations

from typing import NamedTuple

from gateway_fdi.common.resources import shipped

STEP = "    s.lowest = min(s.lowest, u.volts)\n"
STATE = '    lowest: f8 = means("lowest voltage so far", "V")\n'
CONNECT = '    return {"volts": Signal(p.signal, unit="V", triggers=True)}\n'
PREPARE = "    c.low, c.high, c.hysteresis = p.low, p.high, p.hysteresis\n"
DEBOUNCE = "    debounce = Debounce(failed_after=5, passed_after=5)\n"
LAST = '    capabilities=(Readout(("lowest",)),),\n'
PARAMS = '    low: float = Field(11.0, description="below it the battery is too low [V]")\n'
FAULTS = "    return (\n        Fault("
FIRST = "from collections.abc import Mapping\n"


class Slip(NamedTuple):
    """A slip.

    Attributes:
        told: of the line that names it.
        edits: text of the example -> what stands there; "": the whole file.
        at: a text on the line that is named with the file; "": no line is.
        of: a text of the key, where it is the configuration's: what fits the monitor does not fit the database.
    """

    told: str
    edits: dict[str, str]
    at: str = ""
    of: str = ""

    def source(self, type_: str) -> str:
        """Return the monitor's file, its type named so."""
        text = (shipped("examples/battery_voltage") / "battery_voltage.py").read_text()
        text = text.replace('"battery_voltage"', f'"{type_}"')
        for old, new in self.edits.items():
            assert old in text, old
            text = text.replace(old, new) if old else new
        return text


def _able(kind: str, what: str, function: str, at: str) -> Slip:
    """Return a slip in a capability."""
    edits = {"    Readout,\n": f"    {kind},\n    Readout,\n", LAST: LAST.replace("),),", f"), {kind}({function})),")}
    return Slip(f"{what}: fails: ", edits, at)


def _step(told: str, *lines: str) -> Slip:
    """Return a slip in the step's first lines."""
    return Slip(told, {STEP: "".join(f"    {line}\n" for line in lines) + STEP})


#: Nothing runs: the command ends with one line.
REFUSED = {
    # the file
    "another module is missing": Slip("cannot be imported: ModuleNotFoundError: No module named 'scypi'",
                                      {FIRST: FIRST + "import scypi\n"}),
    "it is no Python": Slip("cannot be imported: SyntaxError", {DEBOUNCE: "    debounce = = 3\n"}),
    "it fails when imported": Slip("cannot be imported: ZeroDivisionError", {FIRST: FIRST + "1 / 0\n"}),
    "it leaves when imported": Slip("cannot be imported: SystemExit: 3", {FIRST: FIRST + "import sys\nsys.exit(3)\n"}),
    "there is no monitor in it": Slip("has no MONITOR", {"MONITOR = Monitor(": "MONITER = Monitor("}),
    "it is no monitor": Slip("this is no Monitor, but dict", {"MONITOR = Monitor(": "MONITOR = dict("}),
    "another version": Slip("written for version 1 of the contract", {"api=2": "api=1"}),
    # the monitor
    "an argument too few": Slip("step takes (s, c, u, out)",
                                {"def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Record])":
                                 "def step(s: State, c: Const, u: Inputs)"}),
    "a record is no record": Slip("a class that derives from Record", {"    state=State": "    state=dict"}),
    "a readout that is not there": Slip("the state has no field 'lowets'; did you mean lowest?",
                                        {'Readout(("lowest",))': 'Readout(("lowets",))'}),
    "a signal that is not there": Slip("did you mean Voltage?", {'"BATT.Voltage"': '"BATT.Voltgae"'},
                                       of='monitor[0].signals."BATT.Voltgae"'),
    "another unit": Slip('its unit is "V" in the database', {'unit="V", triggers': 'unit="mV", triggers'},
                         of='monitor[0].signals."BATT.Voltage"'),
    "an input that is not there": Slip("there is no such input; did you mean volts?",
                                       {'{"volts": Signal(': '{"vlots": Signal('}),
    "nothing triggers": Slip("no signal triggers", {", triggers=True": ""}),
    "a debounce that nothing ends": Slip("failed_after = 0: at least 1", {"failed_after=5": "failed_after=0"}),
    "a debounce that is no number": Slip("failed_after = nan", {"failed_after=5": 'failed_after=float("nan")'}),
    "a name that is taken": Slip("this name is taken", {'Fault("high"': 'Fault("low"'}),
    "a code that is none": Slip("P05-17", {'"P0563-17"': '"P05-17"'}),
    "more evidence than room": Slip("names of evidence; a result has room for",
                                    {"labels(Evidence), debounce, tested": '("a",) * 9, debounce, tested'}),
    "a step that is none": Slip("its step is no kernel, but NoneType", {"    step=step": "    step=None"}),
    "capabilities that are none": Slip("a tuple of what it can do beside", {
        LAST: '    capabilities=Readout(("lowest",)),\n'}),
    "a capability's class": Slip("a tuple of what it can do beside", {LAST: "    capabilities=(Readout,),\n"}),
    "a debounce beyond all numbers": Slip("at most 32767", {"failed_after=5": "failed_after=10**30"}),
    "a name that is none": Slip("a name of letters and digits", {'Fault("high"': 'Fault(""'}),
    "a name of two lines": Slip("a name of letters and digits", {'Fault("high"': 'Fault("hi\\ngh"'}),
    "a description that is none": Slip("description: a text", {'"battery voltage above its limit"': "None"}),
    "a message that is no tuple": Slip("names of messages, a tuple of texts, not str",
                                       {"    faults=faults": '    triggers=lambda _: "BATT",\n    faults=faults'}),
    # its functions
    "prepare fails": Slip("fails: AttributeError", {PREPARE: "    c.low = p.lwo\n"}, "p.lwo"),
    "prepare leaves": Slip("fails: SystemExit: 4", {PREPARE: "    raise SystemExit(4)\n"}, "raise SystemExit"),
    "faults fails": Slip("fails: NameError", {"debounce = Debounce(": "debounce = Debuonce("}, "Debuonce"),
    "faults gives none": Slip("this is no Fault, but NoneType", {FAULTS: "    return None\n" + FAULTS}),
    "faults gives texts": Slip("this is no Fault, but str", {FAULTS: '    return ("low",)\n' + FAULTS}),
    "connect fails": Slip("fails: AttributeError", {CONNECT: CONNECT.replace("p.signal", "p.singal")}, "p.singal"),
    "connect gives no name": Slip("a Signal(", {"Signal(p.signal, ": "Signal(None, "}),
    "emits gives none": Slip("this is no Emission, but NoneType", {
        "    faults=faults": "    outputs=Evidence,\n    emits=lambda _: None,\n    faults=faults"}),
    "emits gives no signals": Slip("fields of the outputs and their signals, not NoneType", {
        "    Fault,\n": "    Emission,\n    Fault,\n",
        "    faults=faults": '    outputs=Evidence,\n    emits=lambda _: Emission("A", None),\n    faults=faults'}),
    "connect gives none": Slip("not NoneType", {CONNECT: "    return None\n"}),
    "parameters fail": Slip("RuntimeError: no battery", {
        FIRST: f"{FIRST}from pydantic import model_validator\n",
        PARAMS: PARAMS + '    @model_validator(mode="after")\n    def _look(self):\n'
                         '        raise RuntimeError("no battery")\n'}, "no battery"),
    # what else it can do
    "notes fail": _able("Notes", "Notes.of", 'lambda p: (p.lwo,)', "p.lwo"),
    "warnings fail": _able("Warnings", "Warnings.of", 'lambda p: (f"{1 / 0}",)', "1 / 0"),
    "warnings are none": Slip("Warnings.of: lines, a tuple of texts, not NoneType", _able(
        "Warnings", "", "lambda p: None", "").edits),
    "notes are one text": Slip("Notes.of: lines, a tuple of texts, not str", _able(
        "Notes", "", "lambda p: 'abc'", "").edits),
    "parts fail": _able("Parts", "Parts.of", 'lambda p, find, codes: {"": find(p.lwo)}', "p.lwo"),
    # its kernel
    "no @kernel": Slip("step is no kernel: it needs @kernel", {"@kernel\ndef step": "def step"}),
    "a field that is not there": _step("lowets", "s.lowets = 1.0"),
    "print": _step("a kernel prints nothing", "print(u.volts)"),
    "recursion": _step("calls itself", "step(s, c, u, out)"),
    "a list": _step("a list: a kernel allocates nothing", "many = [u.volts]", "s.lowest = many[0]"),
    "an array": Slip("zeros: a kernel allocates nothing", {
        FIRST: FIRST + "import numpy as np\n", STEP: "    s.lowest = np.zeros(3)[0]\n" + STEP}),
    "Python in a kernel": Slip("objmode: a kernel calls no Python", {
        FIRST: FIRST + "import numba\n", STEP: "    with numba.objmode():\n        s.lowest = 1.0\n" + STEP}),
    "a function of Python's": _step("cannot be compiled", "s.lowest = connect(u.volts)"),
}  # fmt: skip


class Running(NamedTuple):
    """A slip of a step, while the voltage is above the parameter ``above``, 20 V.

    Attributes:
        line: of the kernel.
        off: of the reason for which the monitor is switched off; "": it is not.
        said: of the line that names what is put right; "": it harms nobody, and there is nothing to be said.
        check: of what ``gateway check`` says; "": it finds it good.
    """

    line: str
    off: str = ""
    said: str = ""
    check: str = ""


_BEYOND = "IndexError: index is out of bounds"
_COUNTS = "it changes out.n or out.overflow itself"
_NUMBER, _NONE = "no number (NaN)", "a number that is none of its faults"
_NOT_THERE = "its faults are 0 to 1"

#: It runs; a step fails, or reports what it must not.
RUNNING = {
    "an exception": Running('raise ValueError("too much")', "ValueError: too much (", check="ValueError: too much ("),
    "an exception of its own": Running('raise TooMuch("by far")', "TooMuch: by far (", check="TooMuch: by far ("),
    "an assertion": Running("assert u.volts < 20.0", "AssertionError", check="AssertionError"),
    "an index beyond": Running("s.cells[3 + int(u.volts)] = 1.0", _BEYOND, check=_BEYOND),
    "an index far below": Running("s.cells[-3 - int(u.volts)] = 1.0", _BEYOND, check=_BEYOND),
    "an index that is no number": Running("s.cells[int(c.nan)] = 1.0", _BEYOND, check=_BEYOND),
    "a result beyond its room": Running("out.results[5000].fault = 1", _BEYOND, check=_BEYOND),
    "a count of its own": Running("out.n = 1_000_000_000", _COUNTS, check=_COUNTS),
    "a count below zero": Running("out.n = -1_000_000_000", _BEYOND, check=_BEYOND),
    "a count of what is lost": Running("out.overflow = -1_000_000_000", _COUNTS, check=_COUNTS),
    "a value that is no number": Running("report(out, 0, True, c.nan, c.low)", said=_NUMBER),
    "a threshold that is no number": Running("report(out, 0, True, u.volts, c.nan)", said=_NUMBER),
    "a number above its faults": Running("report(out, 7, True, u.volts, c.low)", said=_NONE, check=_NOT_THERE),
    "a number below its faults": Running("report(out, -1, True, u.volts, c.low)", said=_NONE, check=_NOT_THERE),
    "more results than room": Running(
        "for _ in range(500):\n            report(out, 0, False, 1.0, 2.0)",
        said="more than 128 results in one step", check="results too many in one step",
    ),
    "wakes itself at once": Running(
        "out.wake_ns = u.t_ns + 1", said="it wakes itself at once", check="wakes itself at once"
    ),
    "wakes itself before": Running(
        "out.wake_ns = u.t_ns - 1_000_000", said="it wakes itself at once", check="wakes itself at once"
    ),
    "wakes itself never": Running("out.wake_ns = 1 << 62"),
    "wakes itself below zero": Running("out.wake_ns = -(1 << 62)"),
    "an infinity": Running("report(out, 0, True, c.inf, c.low)"),
    "an infinite threshold": Running("report(out, 0, True, u.volts, -c.inf)"),
    "evidence that is no number": Running("report(out, 0, True, u.volts, c.low).volts = c.nan"),
    "infinite evidence": Running("report(out, 0, True, u.volts, c.low).volts = c.inf"),
    "a division by zero": Running("s.lowest = u.volts / s.nothing"),
    "a whole division by zero": Running("s.count = s.count // s.nothing"),
    "sends what it has not": Running("out.send = 1"),
    "a time of its own": Running("u.t_ns = 1 << 62"),
    "a cause of its own": Running("u.trigger = 1 << 40"),
    "a count without end": Running("s.count += 1 << 62"),
    "state that is no number": Running("s.lowest = c.nan"),
}  # fmt: skip


def running_source(type_: str, *, loops: bool = False) -> str:
    """Return the file of a monitor whose parameter ``slip`` is the number of a slip above; -1: none.

    Args:
        type_: its type.
        loops: whether its step does not return above 40 V.
    """
    branches = "".join(
        f"    {'if' if k == 0 else 'elif'} slips and c.slip == {k}:\n        {slip.line}\n"
        for k, slip in enumerate(RUNNING.values())
    )
    if loops:
        branches += "    while u.volts > 40.0:\n        s.count += 1\n"
    edits = {
        FIRST: f"{FIRST}from typing import Annotated\n\nfrom gateway_fdi.jit import f8s, i8\n",
        "class State(Record):": "class TooMuch(Exception):\n    pass\n\n\nclass State(Record):",
        STATE: f"{STATE}    cells: Annotated[f8s, 3]\n    count: i8\n    nothing: i8\n",
        "    hysteresis: f8": "    nan: f8\n    inf: f8\n    above: f8\n    slip: i8\n    hysteresis: f8",
        PARAMS: f"{PARAMS}    slip: int = -1\n    above: float = 20.0\n",
        PREPARE: f'{PREPARE}    c.slip, c.above, c.nan, c.inf = p.slip, p.above, float("nan"), float("inf")\n',
        "    if u.trigger == TIMER:\n        return\n": (
            f"    slips = u.volts > c.above\n{branches}    if u.trigger == TIMER:\n        return\n"
        ),
    }
    return Slip("", edits).source(type_)
