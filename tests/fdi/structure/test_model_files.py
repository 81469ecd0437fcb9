"""Model files: what is read, and what is said of mistakes."""

from itertools import pairwise

import numpy as np
import pytest
import sympy
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway_fdi import Residual
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors
from gateway_fdi.jit import zeros
from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.generator.loading import residual_generator
from gateway_fdi.structure.generator.solver import solve
from gateway_fdi.structure.generator.symbols import Symbols
from gateway_fdi.structure.model import Equation, Loop, Model, ResidualChoice, Solvable
from gateway_fdi.structure.relation import Expression, Relation
from gateway_fdi.structure.sequence import Kind, Step, Structure

GOOD = """
text = "a model"
[unknown]
x = { unit = "V", start = 1.0 }
y = {}
[known]
u = {}
m = {}
[fault]
f = {}
[parameter]
R = { value = 2.0 }
[table.g]
x = [0, 1]
y = [1.0, 3.0]
[equation.e1]
relation = "der(x) = -x / R + g(u) + f"
unique = ["der(x)"]
[equation.e2]
relation = "y = x**2 if u > 0 and not u > 5 else abs(x)"
unique = ["y"]
multiple = ["x"]
solution = { x = ["sqrt(y)", "-sqrt(y)"] }
[equation.e3]
relation = "m = y"
unique = ["y"]
[[loop]]
equations = ["e1", "e2"]
unknowns = ["x", "y"]
solvable = "none"
[residual.r]
equations = ["e1", "e2", "e3"]
consistency = "e3"
"""


def write(tmp_path, text):
    path = tmp_path / "model.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_is_read(tmp_path):
    model = load_model(write(tmp_path, GOOD))
    assert (model.name, model.text) == ("model", "a model")
    e1, e2, e3 = model.equations
    assert (e1.variables, e1.knowns, e1.faults) == (("der(x)", "x"), ("u",), ("f",))
    assert (e2.solvable, len(e2.solutions["x"])) == (
        {"x": Solvable.MULTIPLE, "y": Solvable.UNIQUE},
        2,
    )
    assert (e3.variables, e3.knowns) == (("y",), ("m",))
    assert model.states == ("x",)
    assert model.lumped_states == ("x",)
    assert model.full_variables == ("x", "y", "der(x)")
    assert model.quantities["R"].value == 2.0
    assert model.tables["g"].y == (1.0, 3.0)


def test_without_an_equation_what_needs_it_is_gone(tmp_path):
    text = GOOD + '[equation.e4]\nrelation = "k = u"\n[residual.s]\nequations = ["e4"]\nconsistency = "e4"\n'
    model = load_model(write(tmp_path, text.replace("m = {}", "m = {}\nk = {}", 1)))
    left = model.without(["e3"])
    assert ([e.name for e in left.equations], left.knowns, left.faults) == (["e1", "e2", "e4"], ("u", "k"), ("f",))
    assert (list(left.residuals), len(left.loops)) == (["s"], 1)
    left = model.without(["e1", "e4"])
    assert ([e.name for e in left.equations], left.knowns, left.faults) == (["e2", "e3"], ("u", "m"), ())
    assert (list(left.residuals), len(left.loops)) == ([], 0)


def test_structure_alone(tmp_path):
    text = """
    [unknown]
    x = {}
    [known]
    u = {}
    [equation.e1]
    unknowns = ["der(x)", "x"]
    knowns = ["u"]
    unique = ["der(x)"]
    [equation.e2]
    unknowns = ["x"]
    """
    model = load_model(write(tmp_path, text))
    assert model.equations[0].relation is None
    assert model.equations[0].derivatives == ("x",)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"m = y"', '"m = z"', r'equation.e3.relation.*"z" is no unknown, known, fault or parameter'),
        ('"m = y"', '"m == y"', "an equation is \"left = right\""),
        ('"m = y"', '"m = y ="', "an equation is"),
        ('"m = y"', '"m = y +"', "is no expression"),
        ('"m = y"', '"m = y.real"', r"cannot contain this \(y.real\)"),
        ('"m = y"', "\"m = __import__('os')\"", "no function or table|not a number"),
        ('"m = y"', '"m = h(y)"', 'no function or table "h"'),
        ('"m = y"', '"m = sqrt(y, y)"', "sqrt takes 1 argument"),
        ('"m = y"', '"m = der(y + 1)"', "der takes the name of a state"),
        ('"m = y"', '"m = der(u)"', '"u" is no unknown'),
        ('"m = y"', '"m = y % 2"', "an equation has"),
        ('"m = y"', '"m = [y]"', "cannot contain this"),
        ('"m = y"', '"m = True"', "not a number"),
        ('"m = y"', '"m = (lambda: y)()"', "only a function by its name"),
        ('unique = ["y"]\n[[loop]]', 'unique = ["x"]\n[[loop]]',
         r'equation.e3.unique.*does not contain the unknown "x"'),
        ('multiple = ["x"]', 'multiple = ["x", "y"]', '"y" is unique already'),
        ('multiple = ["x"]', "", "2 solutions, but none is declared"),
        ('["sqrt(y)", "-sqrt(y)"]', '["sqrt(y)", "-sqrt(q)"]', r'equation.e2.solution.x.*"q" is no'),
        ('["sqrt(y)", "-sqrt(y)"]', '"sqrt(y)"', "1 solutions, but multiple is declared"),
        ('"none"', '"never"', '"never" is not unique, multiple or none'),
        ('unknowns = ["x", "y"]', 'unknowns = ["x"]', "2 equations for 1 unknowns"),
        ('unknowns = ["x", "y"]', 'unknowns = ["x", "q"]', '"q" is no unknown of the model'),
        ('equations = ["e1", "e2"]', 'equations = ["e1", "e9"]', 'loop e1, e9: there is no equation "e9"'),
        ('consistency = "e3"', 'consistency = "e9"', 'residual r: there is no equation "e9"'),
        ('equations = ["e1", "e2", "e3"]', 'equations = ["e1", "e2"]', "residual r: e3 is not in its set"),
        ("x = [0, 1]", "x = [1, 0]", r"table.g.x.*x must rise"),
        ("x = [0, 1]", "x = [0, 1, 2]", r"table.g.y.*3 x for 2 y"),
        ("[known]\nu = {}", "[known]\nu = {}\nx = {}", r"known.x.*unknown.x has the same name"),
        ("y = {}\n", "y = {}\nmax = {}\n", r"unknown.max.*has a meaning in equations"),
        ("y = {}\n", 'y = {}\n"a b" = {}\n', r'unknown."a b"|a name is letters'),
        ("y = {}\n", "y = {}\nlambda = {}\n", "no word of Python"),
        ('R = { value = 2.0 }', "R = { }", r"parameter.R.value.*missing"),
        ('text = "a model"', 'txt = "a model"', r"txt.*unknown key"),
        ("[equation.e3]\n", '[equation.e3]\nunknowns = ["x"]\n', r"equation.e3.unknowns.*the relation contains y"),
        ('relation = "m = y"\n', "", r"equation.e3.*give \"relation\", or \"unknowns\""),
        ('relation = "m = y"\nunique = ["y"]', 'relation = "m = der(x)"', r"der\(x\) stands in e1, e3"),
        ('relation = "m = y"\n', 'differential = "q"\n', r"equation.e3.differential.*no unknown"),
    ],
)  # fmt: skip
def test_mistakes_are_named(tmp_path, old, new, said):
    assert old in GOOD
    path = write(tmp_path, GOOD.replace(old, new))
    with pytest.raises((InputError, InputErrors), match=said) as error:
        load_model(path)
    assert str(path) in str(error.value)


def test_all_mistakes_at_once(tmp_path):
    bad = GOOD.replace('"m = y"', '"m = z"').replace("x = [0, 1]", "x = [1, 0]").replace('"none"', '"never"')
    with pytest.raises(InputErrors) as error:
        load_model(write(tmp_path, bad))
    assert len(error.value.errors) == 3


def test_explicit_states_by_file(load):
    model = load("machine")
    assert model.explicit_states == {"omega"}
    assert model.lumped_states == ()
    assert model.explicit() == model
    lumped = model.lumped()
    assert len(lumped.equations) == len(model.equations) - 1
    assert "e5" not in lumped.residuals["unique"].equations
    assert Structure(lumped).sequence(lumped.residuals["unique"].equations, "e2")


@pytest.mark.parametrize("name", ["truck", "machine", "series_machine", "example_1", "example_4"])
def test_what_is_declared_is_what_algebra_finds(load, name):
    """Each solve that a shipped model declares, with its relation: as many solutions as declared, each of them
    right.
    """
    model = load(name)
    symbols = Symbols(model)
    for e in model.equations:
        if e.relation is None:
            continue
        residual = symbols.residual(e.relation)
        for v, declared in e.solvable.items():
            found = solve(model, symbols, Step(Kind.SOLVE, (e.name,), (v,), 0))
            assert (len(found) == 1) is (declared is Solvable.UNIQUE)
            if residual.has(sympy.Piecewise) or residual.has(sympy.sign):
                continue  # e13, e19; and e1 of the machines, whose solutions depend on a sign
            for one in found:
                rest = residual.subs(symbols.of[v], one[v])
                values = {x: 0.5 + 0.1 * k for k, x in enumerate(sorted(rest.free_symbols, key=str))}
                if name == "truck" and e.name == "e3":
                    values[symbols.of["p_f"]] = 2e5
                left = rest.subs(values)
                assert abs(complex(left.evalf())) < 1e-6, (e.name, v) if not left.has(sympy.Function) else None


def test_names_that_records_have_already():
    """Variables named as attributes of records, or as what generated code uses itself."""
    unknowns = ("T", "data", "s", "r", "root", "nan", "step", "dt")
    chain = [
        Equation(
            "e0",
            ("T",),
            ("mean",),
            solvable={"T": Solvable.UNIQUE},
            relation=Relation.parse("T = mean"),
        )
    ]
    chain += [
        Equation(
            f"e{k}",
            (a, b),
            solvable={b: Solvable.UNIQUE},
            relation=Relation.parse(f"{b} = 2 * {a}"),
        )
        for k, (a, b) in enumerate(pairwise(unknowns), 1)
    ]
    chain.append(Equation("e8", ("dt",), ("c",), relation=Relation.parse("c = dt")))
    model = Model("names", tuple(chain), unknowns, ("mean", "c"))
    loaded = residual_generator(model, frozenset(e.name for e in chain), "e8")
    s, c, u = (zeros(1, d) for d in (loaded.state, loaded.const, loaded.inputs))
    u[0]["mean_"], u[0]["c"] = 3.0, 500.0
    assert loaded.step(s[0], c[0], u[0], 0.0) == 500.0 - 3.0 * 128


def test_a_loop_that_is_given_by_its_solution():
    loop = Loop(
        frozenset({"e1", "e2"}), frozenset({"a", "b"}), Solvable.UNIQUE,
        solutions=({"a": Expression.parse("u - w"), "b": Expression.parse("w")},),
    )  # fmt: skip
    equations = (
        Equation("e1", ("a", "b"), ("u",), relation=Relation.parse("a + b = u")),
        Equation("e2", ("a", "b"), ("u", "w"), relation=Relation.parse("exp(a + b - u) * b = w")),
        Equation("e3", ("a", "b"), ("y",), relation=Relation.parse("y = a * b")),
    )
    model = Model("m", equations, ("a", "b"), ("u", "w", "y"), loops=(loop,))
    loaded = residual_generator(model, frozenset(["e1", "e2", "e3"]), "e3")
    s, c, u = (zeros(1, d) for d in (loaded.state, loaded.const, loaded.inputs))
    u[0]["u"], u[0]["w"], u[0]["y"] = 5.0, 2.0, 6.0
    assert loaded.step(s[0], c[0], u[0], 0.0) == 0.0


numbers = st.floats(-4, 4).map(lambda x: round(x, 3))
names = st.sampled_from(["a", "b", "k"])


def expressions():
    leaf = st.one_of(numbers.map(lambda x: f"({x!r})"), names)

    def extend(inner):
        pair = st.tuples(inner, inner)
        return st.one_of(
            st.tuples(pair, st.sampled_from("+-*")).map(lambda x: f"({x[0][0]} {x[1]} {x[0][1]})"),
            pair.map(lambda x: f"({x[0]} / (2 + abs({x[1]})))"),
            pair.map(lambda x: f"min({x[0]}, {x[1]})"),
            pair.map(lambda x: f"max({x[0]}, {x[1]})"),
            inner.map(lambda x: f"sqrt(1 + ({x})**2)"),
            inner.map(lambda x: f"tanh({x})"),
            inner.map(lambda x: f"sign({x})"),
            inner.map(lambda x: f"exp(-abs({x}))"),
            inner.map(lambda x: f"f({x})"),
            st.tuples(pair, pair, st.sampled_from(["<", ">="])).map(
                lambda x: f"({x[0][0]} if {x[1][0]} {x[2]} {x[1][1]} else {x[0][1]})"
            ),
        )

    return st.recursive(leaf, extend, max_leaves=6)


@settings(max_examples=examples(40), deadline=None)
@given(expressions(), st.tuples(numbers, numbers, numbers))
def test_generated_code_computes_what_is_written(text, values):
    """An equation through algebra and code generation against Python's own evaluation of the text."""
    from gateway_fdi.structure.generator import code, realisation
    from gateway_fdi.structure.model import Quantity, Table

    model = Model(
        "random",
        (
            Equation("e1", ("x",), tuple(n for n in ("a", "b") if n in Expression.parse(text).names),
                     solvable={"x": Solvable.UNIQUE}, relation=Relation.parse(f"x = {text}")),
            Equation("e2", ("x",), ("y",), relation=Relation.parse("x = y")),
        ),
        ("x",), ("a", "b", "y"), parameters=("k",), tables={"f": Table((-2.0, 0.0, 3.0), (1.0, -1.0, 2.0))},
        quantities={"k": Quantity(value=values[2])},
    )  # fmt: skip
    generated = code.write("e2", realisation.realise(model, frozenset(["e1", "e2"]), "e2"))
    space = {}
    exec(generated.source.replace("@kernel\n", ""), space)

    class Record:
        def __init__(self, **fields):
            self.__dict__.update(fields)

    a, b, k = values
    c = Record(k=k, f_x=np.array([-2.0, 0.0, 3.0]), f_y=np.array([1.0, -1.0, 2.0]))
    mathematics = {
        "sqrt": np.sqrt, "tanh": np.tanh, "exp": np.exp, "abs": abs, "min": min, "max": max,
        "sign": lambda x: float(np.sign(x)), "f": lambda x: np.interp(x, c.f_x, c.f_y),
    }  # fmt: skip
    expected = eval(text, {}, {**mathematics, "a": a, "b": b, "k": k})
    found = space["step"](Record(), c, Record(a=a, b=b, y=0.0), 0.0)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_shipped_models_are_found():
    for name in ("truck", "example_1"):
        assert shipped(f"models/{name}.toml").exists()


@settings(max_examples=examples(300), deadline=None)
@given(
    st.one_of(
        st.text(max_size=30),
        st.text("ab=+-*/()<>.,_ 0123456789[]{}if else not and der sqrt", max_size=40),
        st.builds(lambda n: "-" * n + "a = b", st.integers(0, 40)),
    )
)
def test_any_text_is_read_or_refused(text):
    for parse in (Relation.parse, Expression.parse):
        try:
            found = parse(text)
        except ValueError:
            continue
        assert all(isinstance(name, str) for name in found.names)


def test_depth_is_refused():
    for text in ("-" * 100_000 + "a", "(" * 500 + "a" + ")" * 500, "a" + "**a" * 50_000, "\0"):
        with pytest.raises(ValueError, match="is no expression"):
            Expression.parse(text)


def test_a_parameter_may_be_called_as_a_type_of_records():
    """The benchmark DAMADICS has faults f1 to f19."""
    written = {
        "unknown": {"x": {}},
        "known": {"y": {}, "z": {}},
        "parameter": {"f8": {"value": 2.0}, "means": {"value": 1.0}},
        "equation": {
            "e1": {"relation": "z = f8 * x", "unique": ["x"]},
            "e2": {"relation": "y = means * x", "unique": ["x"]},
        },
    }
    residual = Residual(load_model(written), ResidualChoice(("e1", "e2"), "e2"))
    assert residual.run([0.0, 1.0], {"y": [3.0, 3.0], "z": [4.0, 6.0]}) == pytest.approx([1.0, 0.0], abs=1e-12)
