"""A residual generator as self-contained C99, with a test of itself.

It is the source of the kernel, and of those of :mod:`.runtime` that it calls, translated statement by statement: names,
order and arithmetic are the same. The file needs <math.h> alone, has no global state and allocates nothing:

    void   NAME_reset(NAME_state *s, const NAME_const *c)
    void   NAME_start(NAME_state *s, const NAME_const *c, const NAME_input *u)
    double NAME_step(NAME_state *s, const NAME_const *c, const NAME_input *u, double dt)

``NAME_default`` are the model's parameters. Compiled with ``-DNAME_TEST`` it is a program that runs the samples below
it and ends with 0 if the residuals are those of the gateway.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from gateway_fdi.jit import zeros
from gateway_fdi.structure.generator import runtime
from gateway_fdi.structure.generator.loading import Loaded
from gateway_fdi.structure.sequence import shown

#: Samples of the test, and the allowed difference of residuals, of their size or of one.
SAMPLES, TOLERANCE = 50, 1e-12
#: Sets of inputs that are tried: the one with the most numbers among its residuals is taken.
SEEDS = 10
#: Between two samples of the test [s].
PERIOD_S = 0.01

#: Words of C and names that this file uses itself: a name of the model that is one of them gets a "_".
_WORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
NAN INFINITY pow fabs isfinite isnan interpolate incline
advance multiply exponentials root sign smaller larger main printf size_t NULL EOF
"""
_RESERVED = frozenset(_WORDS.split())
_CALLS = {"abs": "fabs", "min": "smaller", "max": "larger"}
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_WHOLE = {ast.Mod: "%", ast.FloorDiv: "/"}
_COMPARED = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_NAMES = {"nan": "NAN", "pi": repr(math.pi)}
#: Kinds of arguments, by their annotation; {} is the prefix.
_KINDS = {
    "State": "{}_state *", "Const": "const {}_const *", "Any": "const {}_input *", "float": "double ", "int": "int ",
}  # fmt: skip
_RETURNED = {"float": "double", "None": "void"}

_BUILT_IN = {
    "smaller": """static double smaller(double a, double b)
{
    return b < a ? b : a;
}
""",
    "larger": """static double larger(double a, double b)
{
    return b > a ? b : a;
}
""",
}


def _functions(source: str) -> dict[str, ast.FunctionDef]:
    """Return the functions of a module by their names, in its order."""
    return {node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)}


def _called(node: ast.AST) -> set[str]:
    """Return the names of what is called in a tree."""
    return {x.func.id for x in ast.walk(node) if isinstance(x, ast.Call) and isinstance(x.func, ast.Name)}


def _c_name(name: str) -> str:
    return f"{name}_" if name in _RESERVED else name


class _Translator:
    """Kernels of a residual generator to C.

    Args:
        name: prefix of all that the file gives to others.
        tables: length of each array of the constants, and of the state (of each of its rows).
    """

    def __init__(self, name: str, tables: Mapping[str, int]) -> None:
        self.name, self.tables = name, tables
        self.runtime = _functions(inspect.getsource(runtime))

    def expression(self, node: ast.expr) -> str:
        """Return an expression; all in parentheses that is not one word."""
        if isinstance(node, ast.Constant):
            return repr(int(node.value) if isinstance(node.value, bool) else node.value)
        if isinstance(node, ast.Name):
            constant = vars(runtime).get(node.id)
            return repr(constant) if isinstance(constant, int) else _NAMES.get(node.id) or _c_name(node.id)
        if isinstance(node, ast.Attribute):
            assert isinstance(node.value, ast.Name)
            if node.value.id == "math":
                return _NAMES.get(node.attr) or node.attr
            return f"{node.value.id}->{_c_name(node.attr)}"
        if isinstance(node, ast.Subscript):
            if isinstance(node.slice, ast.Slice):
                low = "0" if node.slice.lower is None else self.expression(node.slice.lower)
                return f"({self.expression(node.value)} + {low})"
            return f"{self.expression(node.value)}[{self.expression(node.slice)}]"
        if isinstance(node, ast.BinOp):
            return self.binary(node)
        if isinstance(node, ast.UnaryOp):
            mark = "!" if isinstance(node.op, ast.Not) else "-"
            return f"({mark}{self.expression(node.operand)})"
        if isinstance(node, ast.BoolOp):
            join = " && " if isinstance(node.op, ast.And) else " || "
            return f"({join.join(self.expression(value) for value in node.values)})"
        if isinstance(node, ast.Compare):
            sides = [self.expression(side) for side in (node.left, *node.comparators)]
            pairs = zip(sides, node.ops, sides[1:], strict=False)
            return f"({' && '.join(f'({a} {_COMPARED[type(op)]} {b})' for a, op, b in pairs)})"
        if isinstance(node, ast.IfExp):
            parts = (self.expression(part) for part in (node.test, node.body, node.orelse))
            return "({} ? {} : {})".format(*parts)
        assert isinstance(node, ast.Call)
        return self.call(node)

    def binary(self, node: ast.BinOp) -> str:
        left, right = self.expression(node.left), self.expression(node.right)
        if isinstance(node.op, ast.Pow):
            return f"pow({left}, {right})"
        return f"({left} {(_OPERATORS | _WHOLE)[type(node.op)]} {right})"

    def call(self, node: ast.Call) -> str:
        name = ast.unparse(node.func).removeprefix("math.")
        if name == "len":
            return self.length(node.args[0])
        arguments = [self.expression(argument) for argument in node.args]
        if name == "float":
            return arguments[0]
        if name in self.runtime:
            parameters = [arg.arg for arg in self.runtime[name].args.args]
            arguments += [self.length(node.args[parameters.index(each)]) for each in _measured(self.runtime[name])]
        return f"{_CALLS.get(name, name).lstrip('_')}({', '.join(arguments)})"

    def length(self, node: ast.expr) -> str:
        """Return the length of an array: a field's (of a row of it), or that of an argument, which is one more."""
        array = node.value if isinstance(node, ast.Subscript) else node
        return str(self.tables[array.attr]) if isinstance(array, ast.Attribute) else f"{self.expression(array)}_length"

    def kind(self, node: ast.expr, known: Mapping[str, str]) -> str:
        """Return the type of an expression: int, double or double *."""
        if isinstance(node, ast.Name):
            return known.get(node.id, "double")
        if isinstance(node, ast.Subscript):
            return "double *" if isinstance(node.slice, ast.Slice) else "double"
        if isinstance(node, ast.BinOp) and not isinstance(node.op, ast.Div):
            kinds = {self.kind(node.left, known), self.kind(node.right, known)}
            return "int" if kinds == {"int"} else "double"
        whole = isinstance(node, ast.Compare) or (isinstance(node, ast.Constant) and isinstance(node.value, int))
        return "int" if whole or (isinstance(node, ast.Call) and ast.unparse(node.func) == "len") else "double"

    def locals(self, node: ast.FunctionDef) -> dict[str, str]:
        """Return the types of a kernel's local names."""
        arguments = {arg.arg: _annotated(arg.annotation) for arg in node.args.args}
        known = {name: text for name, text in arguments.items() if text in ("int", "double")}
        for one in ast.walk(node):
            if isinstance(one, ast.For):
                known[self.expression(one.target)] = "int"
            elif isinstance(one, ast.Assign):
                known |= {x.id: self.kind(value, known) for x, value in _pairs(one) if isinstance(x, ast.Name)}
        return {name: kind for name, kind in known.items() if name not in arguments}

    def statements(self, nodes: Iterable[ast.stmt], comments: Mapping[int, str], depth: int = 1) -> list[str]:
        """Return statements as lines."""
        lines: list[str] = []
        for node in nodes:
            pad, note = "    " * depth, comments.get(node.lineno, "")
            if isinstance(node, ast.Assign):
                for target, value in _pairs(node):
                    lines.append(f"{pad}{self.expression(target)} = {_bare(self.expression(value))};{note}")
            elif isinstance(node, ast.AugAssign):
                value_text = _bare(self.expression(node.value))
                lines.append(f"{pad}{self.expression(node.target)} {_OPERATORS[type(node.op)]}= {value_text};{note}")
            elif isinstance(node, ast.Return):
                assert node.value is not None
                lines.append(f"{pad}return {self.expression(node.value)};")
            elif isinstance(node, ast.Expr):
                lines.append(f"{pad}{self.expression(node.value)};")
            elif isinstance(node, ast.If):
                lines.append(f"{pad}if ({_bare(self.expression(node.test))}) {{")
                lines += self.statements(node.body, comments, depth + 1)
                if node.orelse:
                    lines += [f"{pad}}} else {{", *self.statements(node.orelse, comments, depth + 1)]
                lines.append(f"{pad}}}")
            elif isinstance(node, ast.While):
                lines.append(f"{pad}while ({_bare(self.expression(node.test))}) {{")
                lines += [*self.statements(node.body, comments, depth + 1), f"{pad}}}"]
            elif isinstance(node, ast.For):
                lines.append(f"{pad}for ({self.counted(node)}) {{")
                lines += [*self.statements(node.body, comments, depth + 1), f"{pad}}}"]
        return lines

    def counted(self, node: ast.For) -> str:
        """Return the head of a loop over a range."""
        assert isinstance(node.iter, ast.Call)
        name, bounds = self.expression(node.target), [self.expression(argument) for argument in node.iter.args]
        first, last = bounds[:2] if len(bounds) > 1 else ("0", bounds[0])
        compared, on = (">", "--") if len(bounds) > 2 else ("<", "++")
        return f"{name} = {first}; {name} {compared} {last}; {name}{on}"

    def argument(self, node: ast.FunctionDef, arg: ast.arg) -> str:
        """Return an argument of a kernel; an array that is not written to is constant."""
        kind = _KINDS.get(ast.unparse(arg.annotation or ast.Name("Any")))
        if kind is not None:
            return f"{kind.format(self.name)}{_c_name(arg.arg)}"
        used = [x for x in ast.walk(node) if isinstance(x, ast.Subscript) and ast.unparse(x.value) == arg.arg]
        written = any(isinstance(x.ctx, ast.Store) or isinstance(x.slice, ast.Slice) for x in used)
        return f"{'' if written else 'const '}double *{_c_name(arg.arg)}"

    def function(self, node: ast.FunctionDef, comments: Mapping[int, str]) -> list[str]:
        """Return a kernel: one of the three, or of the runtime's."""
        arguments = [self.argument(node, arg) for arg in node.args.args]
        arguments += [f"int {name}_length" for name in _measured(node)]
        returned, own = _RETURNED[ast.unparse(node.returns or ast.Constant(None))], node.name in self.runtime
        text = re.sub(r":\w+:`\.?(\w+)`", r"\1", (ast.get_docstring(node) or "").partition("\n")[0])
        body = [n for n in node.body[1:] if not isinstance(n, ast.Pass)]
        local = self.locals(node)
        name = f"static {returned} {node.name.lstrip('_')}" if own else f"{returned} {self.name}_{node.name}"
        lines = [f"/* {text} */", f"{name}({', '.join(arguments)})", "{"]
        lines += [f"    {kind.strip(' *')} {'*' * ('*' in kind)}{_c_name(x)} = 0;" for x, kind in local.items()]
        unused = () if own else (*(arg.arg for arg in node.args.args), *local)
        lines += ["", *(f"    (void)({_c_name(name)});" for name in unused), *self.statements(body, comments)]
        return [*lines, "}", ""]

    def called(self, nodes: Iterable[ast.FunctionDef]) -> list[str]:
        """Return the functions that kernels call: those that C lacks, and the runtime's, each before its callers."""
        found: set[str] = set()
        todo = {name for node in nodes for name in _called(node)}
        while todo - found:
            found |= todo
            todo = {each for name in todo & self.runtime.keys() for each in _called(self.runtime[name])}
        lines = [text for name, text in _BUILT_IN.items() if name in {_CALLS.get(each) for each in found}]
        return lines + ["\n".join(self.function(node, {})) for name, node in self.runtime.items() if name in found]


def _annotated(annotation: ast.expr | None) -> str:
    """Return the type of an argument that is a number; another one's annotation."""
    text = ast.unparse(annotation or ast.Name("Any"))
    return "double" if text == "float" else text


def _pairs(node: ast.Assign) -> list[tuple[ast.expr, ast.expr]]:
    """Return targets and values of an assignment."""
    target, value = node.targets[0], node.value
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        return list(zip(target.elts, value.elts, strict=True))
    return [(target, value)]


def _measured(node: ast.FunctionDef) -> list[str]:
    """Return the arguments whose length a kernel asks for."""
    calls = [x for x in ast.walk(node) if isinstance(x, ast.Call) and ast.unparse(x.func) == "len"]
    return list(dict.fromkeys(ast.unparse(x.args[0]) for x in calls))


def _bare(text: str) -> str:
    """Return an expression without the parentheses around all of it."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for k, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and k < len(text) - 1:
            return text
    return text[1:-1]


def _plain(text: str) -> str:
    """Return what can stand in a comment."""
    return text.replace("*/", "* /").replace("/*", "/ *")


def _number(value: float) -> str:
    """Return a number as C has it, so that it is read as the same."""
    if math.isnan(value):
        return "NAN"
    return repr(float(value)) if math.isfinite(value) else ("INFINITY" if value > 0 else "-INFINITY")


def _record(name: str, dtype: np.dtype[np.void]) -> list[str]:
    lines = ["typedef struct {"]
    for field in dtype.names or ():
        size = "".join(f"[{length}]" for length in dtype[field].shape)
        lines.append(f"    double {_c_name(field)}{size};")
    return [*lines, f"}} {name};", ""]


def _constants(name: str, c: np.void) -> list[str]:
    lines = [f"const {name}_const {name}_default = {{"]
    for field in c.dtype.names or ():
        value = np.asarray(c[field])
        text = f"{{{', '.join(map(_number, value.tolist()))}}}" if value.shape else _number(float(value))
        lines.append(f"    .{_c_name(field)} = {text},")
    return [*lines, "};", ""]


def _samples(loaded: Loaded, c: np.void, fields: list[str], seed: int) -> tuple[np.ndarray[Any, Any], list[float]]:
    """Return inputs that move around what they are drawn at, shape (SAMPLES, inputs), and the kernel's residuals."""
    s, u = zeros(1, loaded.state), zeros(1, loaded.inputs)
    rng = np.random.default_rng(seed)
    begin = rng.uniform(0.5, 1.5, len(fields)) * 3.0 ** rng.integers(-2, 3, len(fields))
    rows = np.abs(begin * (1.0 + np.cumsum(rng.normal(0.0, 0.02, (SAMPLES, len(fields))), 0)))
    found = []
    with np.errstate(all="ignore"):
        for k, row in enumerate(rows):
            for field, value in zip(fields, row, strict=True):
                u[0][field] = value
            if k == 0:
                loaded.reset(s[0], c)
                loaded.start(s[0], c, u[0])
            found.append(float(loaded.step(s[0], c, u[0], PERIOD_S if k else 0.0)))
    return rows, found


def _test(name: str, loaded: Loaded, c: np.void) -> list[str]:
    """Return the program that tests it, with inputs that move around what they are drawn at."""
    fields = list(loaded.inputs.names or ())
    tried = [_samples(loaded, c, fields, seed) for seed in range(SEEDS)]
    rows, expected = max(tried, key=lambda one: np.isfinite(one[1]).sum())
    inputs = ",\n    ".join("{" + ", ".join(map(_number, row)) + "}" for row in rows.tolist())
    wanted = ",\n    ".join(map(_number, expected))
    takes = [f"        u.{_c_name(field)} = inputs[k][{i}];" for i, field in enumerate(fields)]
    return [
        f"#ifdef {name.upper()}_TEST",
        "#include <stdio.h>",
        "",
        f"static const double inputs[{SAMPLES}][{len(fields)}] = {{",
        f"    {inputs}",
        "};",
        f"static const double expected[{SAMPLES}] = {{",
        f"    {wanted}",
        "};",
        "",
        "int main(void)",
        "{",
        f"    {name}_state s = {{0}};",
        f"    {name}_input u;",
        "    double worst = 0.0;",
        "    int k, wrong = 0;",
        "",
        f"    for (k = 0; k < {SAMPLES}; k++) {{",
        "        double r, off;",
        *takes,
        "        if (k == 0) {",
        f"            {name}_reset(&s, &{name}_default);",
        f"            {name}_start(&s, &{name}_default, &u);",
        "        }",
        f"        r = {name}_step(&s, &{name}_default, &u, k ? {PERIOD_S} : 0.0);",
        "        if (isnan(expected[k]) || isnan(r)) {",
        "            wrong += isnan(expected[k]) != isnan(r);",
        "            continue;",
        "        }",
        "        off = fabs(r - expected[k]) / (fabs(expected[k]) > 1.0 ? fabs(expected[k]) : 1.0);",
        "        if (off > worst)",
        "            worst = off;",
        f"        wrong += !(off <= {TOLERANCE!r});",
        "    }",
        f'    printf("{name}: {SAMPLES} samples, %d wrong, off by %.3g at most\\n", wrong, worst);',
        "    return wrong != 0;",
        "}",
        "#endif",
        "",
    ]


def c_source(loaded: Loaded, name: str) -> str:
    """Return a residual generator as a C file.

    Args:
        loaded: the generator.
        name: prefix of its functions and types; made an identifier.

    Raises:
        ValueError: a parameter has no value.
    """
    generated, r = loaded.generated, loaded.generated.realisation
    prefix = re.sub(r"\W", "_", name).strip("_").lower() or "residual"
    prefix = prefix if prefix[0].isalpha() else f"r_{prefix}"
    constants = zeros(1, loaded.const)
    loaded.prepare(constants[0])
    tables = {f: d[f].shape[-1] for d in (loaded.state, loaded.const) for f in d.names or () if d[f].shape}
    translator = _Translator(prefix, tables)
    lines = generated.source.splitlines()
    comments = {k + 1: f"  /*{_plain(line.rpartition('#')[2])} */" for k, line in enumerate(lines) if "  # " in line}
    kernels = _functions(generated.source).values()
    text = "\n".join(line for node in kernels for line in translator.function(node, comments))
    used = translator.called(kernels)
    check = r.model.by_name[r.consistency].relation
    head = [
        "/*",
        f" * Residual generator {name} of {r.model.name}: made from its model by gateway structure --export c.",
        f" * Checks {r.consistency}" + (f": {_plain(check.text)}" if check is not None else ""),
        f" * by {_plain(shown(r.model, r.steps)) or 'nothing else'}",
        " *",
        f" * Test: cc -std=c99 -D{prefix.upper()}_TEST FILE.c -lm && ./a.out",
        " */",
        "#include <math.h>",
        "",
    ]
    body = [
        *_record(f"{prefix}_state", loaded.state), *_record(f"{prefix}_const", loaded.const),
        *_record(f"{prefix}_input", loaded.inputs), *_declared(prefix), *used, *_constants(prefix, constants[0]),
    ]  # fmt: skip
    return "\n".join([*head, *body, text, *_test(prefix, loaded, constants[0])])


def _declared(name: str) -> list[str]:
    """Return the prototypes: the part that goes into a header."""
    return [
        f"extern const {name}_const {name}_default;",
        f"void {name}_reset({name}_state *s, const {name}_const *c);",
        f"void {name}_start({name}_state *s, const {name}_const *c, const {name}_input *u);",
        f"double {name}_step({name}_state *s, const {name}_const *c, const {name}_input *u, double dt);",
        "",
    ]
