"""Relations between signals: the machine beside Python's own arithmetic, times, units, and what is refused."""

import math
import random

import numpy as np
import pytest
from amount import amount
from car import Car, write

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_checks.rule.machine import Code, Machine, load, run
from gateway_checks.rule.text import compile_text
from gateway_fdi.errors import InputError, InputErrors

MS = 1_000_000
NAMES = ("A.x", "A.y", "B.z")


class Evaluated:
    """A program, and what it makes of values over time."""

    def __init__(self, text):
        program = compile_text(text, lambda _name: "")
        self.code, self.machine = np.zeros(1, Code.dtype), np.zeros(1, Machine.dtype)
        load(self.machine[0], self.code[0], program, program.signals)
        self.signals = program.signals

    def __call__(self, values, t_ns=0, tolerance=0.0):
        given = np.asarray([values[name] for name in self.signals] or [0.0])
        machine = self.machine.view(np.recarray)[0]
        result = run(machine, self.code.view(np.recarray)[0], t_ns, given, tolerance)
        return None if machine.unknown else result


def expression(rng, depth):
    """Return a random expression, in parentheses."""
    if depth == 0:
        return rng.choice([*NAMES, repr(round(rng.uniform(-5, 5), 2)), str(rng.randint(0, 4))])
    kind = rng.randrange(4)
    inner = [expression(rng, depth - 1) for _ in range(2)]
    if kind == 0:
        return f"({inner[0]} {rng.choice(['+', '-', '*', '/', '%', '**'])} {inner[1]})"
    if kind == 1:
        return f"{rng.choice(['abs', 'sqrt', 'sin', 'cos', 'tan', 'exp', 'log', 'floor', 'sign'])}({inner[0]})"
    return f"{rng.choice(['min', 'max'])}({inner[0]}, {inner[1]})" if kind == 2 else f"(-{inner[0]})"


def oracle(text, values):
    """Evaluate a text by Python; None where it has no real value."""
    for name, value in values.items():
        text = text.replace(name, f"({value!r})")
    functions = {name: getattr(math, name) for name in ("sqrt", "sin", "cos", "tan", "exp", "log", "floor")}
    functions |= {"abs": abs, "min": min, "max": max, "sign": lambda x: (x > 0) - (x < 0)}
    try:
        found = eval(text, {"__builtins__": {}}, functions)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):  # TypeError: complex numbers
        return None
    return None if isinstance(found, complex) or not math.isfinite(found) or abs(found) > 1e12 else float(found)


def test_random_expressions_are_what_python_makes_of_them():
    rng, tried = random.Random(24), 0
    for _ in range(amount(3000, 600, 200)):
        text = expression(rng, rng.randint(1, 3))
        if not any(name in text for name in NAMES):
            continue
        values = {name: round(rng.uniform(-4, 4), 2) for name in NAMES}
        wanted = oracle(text, values)
        if wanted is None:
            continue
        tried += 1
        evaluated = Evaluated(f"{text} == {wanted!r}")
        tolerance = 1e-7 * max(1.0, abs(wanted))
        assert evaluated(values, tolerance=tolerance) == 1.0, f"{text} with {values} is {wanted}"
        assert evaluated(values | {"": 0}, tolerance=tolerance) == 1.0
        beyond = Evaluated(f"{text} > {wanted + 2 * tolerance!r}")
        assert beyond(values) == 0.0
    assert tried > 60


@pytest.mark.parametrize(
    ("text", "values", "holds"),
    [
        ("A.x < A.y", (1, 2, 0), True),
        ("A.x < A.y", (2, 2, 0), False),
        ("A.x > A.y", (2, 2, 0), False),
        ("A.x < A.y < B.z", (1, 2, 3), True),
        ("A.x < A.y < B.z", (1, 2, 2), False),
        ("not A.x == 1", (1, 0, 0), False),
        ("A.x > 0 and A.y > 0", (1, 0, 0), False),
        ("A.x > 0 or A.y > 0", (1, 0, 0), True),
        ("max(A.x, A.y, B.z) <= 3", (1, 2, 3), True),
        ("A.x != A.y", (1, 1, 0), False),
        ("A.x >= 1", (1, 0, 0), True),
    ],
)
def test_comparisons_and_logic(text, values, holds):
    assert Evaluated(text)(dict(zip(NAMES, values, strict=True))) == holds


def test_what_has_no_value_is_not_tested():
    assert Evaluated("sqrt(A.x) < 1")({"A.x": -1.0}) is None
    assert Evaluated("1 / A.x < 1")({"A.x": 0.0}) is None


def test_delay_rate_and_lowpass():
    delay, rate = Evaluated("delay(A.x, 100) == A.x - 10"), Evaluated("rate(A.x) == 100")
    lowpass = Evaluated("lowpass(A.x, 1000) > 50")
    told = []
    for k in range(300):
        values = {"A.x": float(k)}
        told.append((delay(values, k * 10 * MS, 0.2), rate(values, k * 10 * MS, 1e-6)))
    assert [d for d, _ in told[:10]] == [None] * 10
    assert all(d == 1.0 for d, _ in told[11:])
    assert told[0][1] is None
    assert all(r == 1.0 for _, r in told[1:])
    assert Evaluated("rate(A.x) == 0")({"A.x": 1.0}, 0) is None
    stepped = [lowpass({"A.x": 0.0 if k < 1 else 100.0}, k * 10 * MS) for k in range(200)]
    assert stepped.index(1.0) == pytest.approx(1 + math.log(2) * 100, abs=1.1), "half of it after ln 2 time constants"


def test_a_held_signal_does_not_stop_its_rate():
    rate = Evaluated("rate(A.x) == 50")
    for k in range(1, 200):
        told = rate({"A.x": float(k // 4 * 2)}, k * 10 * MS, 1e-6)  # it comes each 40 ms, the rule steps each 10 ms
        assert told in ((None,) if k < 4 else (None, 1.0, 0.0) if k < 9 else (1.0,)), k
    stopped = [Evaluated("rate(A.x) == 0")] * 1
    machine = stopped[0]
    for k in range(100):
        last = machine({"A.x": float(min(k, 20))}, k * 10 * MS)
    assert last == 1.0


DBC = (
    'BO_ 256 Wheels: 8 A\n SG_ FL : 0|16@1- (0.01,0) [0|0] "km/h" B\n SG_ FR : 16|16@1- (0.01,0) [0|0] "km/h" B\n'
    'BO_ 257 Vehicle: 8 A\n SG_ Speed : 0|16@1- (0.01,0) [0|0] "km/h" B\n SG_ Temp : 16|8@1+ (1,-40) [0|0] "degC" B\n'
)
NOW = "failed_ms = 5.0, passed_ms = 5.0"


def rules(*lines):
    listed = "".join(f"    {{ {line} }},\n" for line in lines)
    return f'[[monitor]]\nname = "r"\ntype = "rule"\nrule = [\n{listed}]\n'


def two(first, second=0.0):
    return b"".join(round(v * 100).to_bytes(2, "little", signed=True) for v in (first, second)) + bytes(4)


def test_a_rule_is_a_fault_with_its_operands_in_the_evidence(tmp_path):
    text = rules(f'name = "wheels", holds = "abs(Wheels.FL - Wheels.FR) < 3 + 0.1 * Vehicle.Speed", {NOW}')
    made = Car(write(tmp_path, DBC, text))
    made.feed([two(50)], can_id=0x101)
    made.feed([two(50, 51)] * 5 + [two(50, 59)] * 3)
    assert made.failed() == ["wheels"]
    (dtc,) = [e for e in made.of("dtc") if e["status"] & 1]
    assert dtc["dtc"].endswith("-64")
    assert dtc["evidence"]["value"] == 9.0
    assert dtc["evidence"]["threshold"] == 8.0
    assert dtc["evidence"]["Wheels.FR [km/h]"] == 59.0
    made.feed([two(50, 51)] * 3)
    assert not made.of("dtc")[-1]["status"] & 1


@pytest.mark.parametrize(
    ("holds", "pair", "value", "limit"),
    [
        ("Wheels.FL == Wheels.FR", (50, 59), 9.0, 8.0),
        ("Wheels.FL < Wheels.FR", (59, 50), 59.0, 58.0),
        ("Wheels.FL > Wheels.FR", (50, 59), 50.0, 51.0),
    ],
)
def test_value_and_threshold_say_how_near_a_rule_is_to_its_limit(tmp_path, holds, pair, value, limit):
    """The healthiest equality had a ratio of one: both sides were told, without the tolerance."""
    made = Car(write(tmp_path, DBC, rules(f'name = "w", holds = "{holds}", tolerance = 8, {NOW}')))
    made.feed([two(50, 50)] * 5 + [two(*pair)] * 3)
    (dtc,) = [e for e in made.of("dtc") if e["status"] & 1]
    assert (dtc["evidence"]["value"], dtc["evidence"]["threshold"]) == (value, limit)


def test_when_and_signals_that_never_came(tmp_path):
    text = rules(f'name = "w", holds = "Wheels.FL == Wheels.FR", when = "Vehicle.Speed > 5", tolerance = 1, {NOW}')
    made = Car(write(tmp_path, DBC, text))
    made.feed([two(10, 20)] * 10)
    assert made.failed() == [], "the vehicle's speed never came"
    made.feed([two(2)], can_id=0x101).feed([two(10, 20)] * 10)
    assert made.failed() == []
    made.feed([two(10, 11)]).feed([two(20)], can_id=0x101).feed([two(10, 11)] * 10)
    assert made.failed() == []
    assert made.feed([two(10, 20)] * 3).failed() == ["w"]


@pytest.mark.parametrize(
    ("rule", "frames_until_tested"),
    [
        ('holds = "delay(Wheels.FL, 100) > 1000"', 11),
        ('holds = "Wheels.FL > 1000", when = "not delay(Wheels.FR, 100) > 1000"', 11),
        ('holds = "Wheels.FL > 1000", when = "sqrt(Wheels.FR) < 5"', None),
    ],
)
def test_what_has_no_value_yet_accuses_nobody(tmp_path, rule, frames_until_tested):
    made = Car(write(tmp_path, DBC, rules(f'name = "w", {rule}, {NOW}')))
    found = None
    for k in range(1, 30):
        made.feed([two(10, -20 if frames_until_tested is None else 20)])
        made.gateway.advance(made.t_ns + 6 * MS)
        if found is None and made.failed():
            found = k
    assert found == frames_until_tested


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        ('name = "a", holds = "Wheels.FL < Wheel.FR"', "did you mean Wheels"),
        ('name = "a", holds = "Wheels.FL < Vehicle.Temp"', '"km/h" and "degC" do not go together'),
        ('name = "a", holds = "Wheels.FL + Vehicle.Temp < 3"', '"km/h" and "degC" do not go together'),
        ('name = "a", holds = "Wheels.FL + 3"', "compare it with something"),
        ('name = "a", holds = "Wheels.FL <"', "this is no expression"),
        ("name = \"a\", holds = \"__import__('os').system('x') < 3\"", "the functions are"),
        ('name = "a", holds = "abbs(Wheels.FL) < 3"', "did you mean abs"),
        ('name = "a", holds = "delay(Wheels.FL) < 3"', "delay has 2 arguments"),
        ('name = "a", holds = "delay(Wheels.FL, -1) < 3"', "milliseconds above 0"),
        ('name = "a", holds = "[x for x in Wheels.FL] < 3"', "this is no part of a rule"),
        ('name = "a", holds = "3 < 4"', "there is no signal in it"),
        ('name = "a", holds = "' + "+".join(["Wheels.FL"] * 60) + ' < 3"', "a rule has room for 96"),
        ('name = "a", holds = "Wheels.FL < 3", wen = "Wheels.FL > 1"', "did you mean when"),
    ],
)
def test_mistakes_are_one_line(tmp_path, rule, said):
    with pytest.raises((InputError, InputErrors)) as told:
        Gateway(load_config(write(tmp_path, DBC, rules(rule))), file=tmp_path / "gateway.toml")
    (line,) = str(told.value).splitlines()
    assert said in line
    assert "gateway.toml" in line
    assert "rule[0]" in line
