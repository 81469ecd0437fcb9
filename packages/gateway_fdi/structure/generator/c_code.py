"""A residual generator as self-contained C99, with a test of itself.

It is the kernel's own source, translated statement by statement: names, order and arithmetic are the same. The file
needs <math.h> alone, has no global state and allocates nothing:

    void   NAME_reset(NAME_state *s, const NAME_const *c)
    void   NAME_start(NAME_state *s, const NAME_const *c, const NAME_input *u)
    double NAME_step(NAME_state *s, const NAME_const *c, const NAME_input *u, double dt)

``NAME_default`` are the model's parameters. Compiled with ``-DNAME_TEST`` it is a program that runs the samples below
it and ends with 0 if the residuals are those of the gateway.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from gateway_fdi.jit import zeros
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
_CALLS = {
    "abs": "fabs", "min": "smaller", "max": "larger", "root": "root", "sign": "sign", "advance": "advance",
    "isfinite": "isfinite", "incline": "incline",
    **{name: name for name in ("sin", "cos", "tan", "asin", "acos", "atan", "tanh", "exp", "log", "interpolate")},
}  # fmt: skip
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_WHOLE = {ast.Mod: "%", ast.FloorDiv: "/"}
_COMPARED = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_NAMES = {"nan": "NAN", "pi": repr(math.pi)}

_ADVANCE = """/* The product of two matrices. */
static void multiply(const double *a, const double *b, double *to, int n)
{
    int i, j, k;
    for (i = 0; i < n; i++)
        for (j = 0; j < n; j++) {
            double total = 0.0;
            for (k = 0; k < n; k++)
                total += a[i * n + k] * b[k * n + j];
            to[i * n + j] = total;
        }
}

/* phi0 = exp z, phi1 = (phi0 - 1) / z, phi2 = (phi1 - 1) / z of a matrix, one behind the other. */
static void exponentials(const double *z, double *phi0, double *a, int n)
{
    int i, j, k, size = n * n, doublings = 0;
    double *phi1 = phi0 + size, *phi2 = phi1 + size, *b = a + size;
    double largest = 0.0, scale = 1.0, factor = 1.0;
    for (i = 0; i < n; i++) {
        double row = 0.0;
        for (j = 0; j < n; j++)
            row += fabs(z[i * n + j]);
        if (row > largest)
            largest = row;
    }
    while (largest * scale > 0.5 && doublings < 64) {
        scale *= 0.5;
        doublings++;
    }
    for (k = 2; k < 16; k++)
        factor /= k;
    for (i = 0; i < size; i++) {
        a[i] = z[i] * scale;
        phi2[i] = i % (n + 1) == 0 ? factor : 0.0;
    }
    for (k = 15; k > 2; k--) {
        factor *= k;
        multiply(a, phi2, b, n);
        for (i = 0; i < size; i++)
            phi2[i] = b[i] + (i % (n + 1) == 0 ? factor : 0.0);
    }
    multiply(a, phi2, phi1, n);
    for (i = 0; i < n; i++)
        phi1[i * n + i] += 1.0;
    multiply(a, phi1, phi0, n);
    for (i = 0; i < n; i++)
        phi0[i * n + i] += 1.0;
    for (k = 0; k < doublings; k++) {
        multiply(phi0, phi2, a, n);
        multiply(phi0, phi1, b, n);
        for (i = 0; i < size; i++) {
            phi2[i] = 0.25 * (a[i] + phi1[i] + phi2[i]);
            phi1[i] = 0.5 * (b[i] + phi1[i]);
        }
        multiply(phi0, phi0, a, n);
        for (i = 0; i < size; i++)
            phi0[i] = a[i];
    }
}

/* What states move in a step: h phi1(h J) f + h phi2(h J) c, the exponential Rosenbrock-Euler method. */
static void advance(const double *jacobian, double *slopes, double *hold, double dt, int n)
{
    int i, j, size = n * n, same = hold[2 * n * n] != 0.0;
    for (i = 0; i < size; i++) {
        double z = jacobian[i] * dt;
        if (hold[i] != z) {
            hold[i] = z;
            same = 0;
        }
    }
    if (!same)
        exponentials(hold, hold + size, hold + 4 * size, n);
    for (i = 0; i < n; i++) {
        double moved = 0.0;
        for (j = 0; j < n; j++)
            moved += hold[2 * size + i * n + j] * slopes[j] + hold[3 * size + i * n + j] * slopes[n + j];
        moved *= dt;
        slopes[2 * n + i] = isfinite(moved) ? moved : 0.0;
    }
}
"""

_HELPERS = {
    "interpolate": """/* The function through n points: linear between them, constant beyond. */
static double interpolate(const double *x, const double *y, int n, double at)
{
    int low = 0, high = n - 1;
    if (!(at > x[0]))
        return at <= x[0] ? y[0] : NAN;
    if (at >= x[high])
        return y[high];
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (x[middle] <= at)
            low = middle;
        else
            high = middle;
    }
    return y[low] + (y[high] - y[low]) * (at - x[low]) / (x[high] - x[low]);
}
""",
    "incline": """/* The slope of that function, 0 beyond its points. */
static double incline(const double *x, const double *y, int n, double at)
{
    int k;
    for (k = 0; k < n - 1; k++)
        if (x[k] <= at && at < x[k + 1])
            return (y[k + 1] - y[k]) / (x[k + 1] - x[k]);
    return 0.0;
}
""",
    "advance": _ADVANCE,
    "root": """static double root(double value)
{
    return value >= 0.0 ? sqrt(value) : NAN;
}
""",
    "sign": """static double sign(double value)
{
    return value > 0.0 ? 1.0 : value < 0.0 ? -1.0 : 0.0;
}
""",
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

    def expression(self, node: ast.expr) -> str:
        """Return an expression; all in parentheses that is not one word."""
        if isinstance(node, ast.Constant):
            return repr(node.value)
        if isinstance(node, ast.Name):
            return _NAMES.get(node.id) or _c_name(node.id)
        if isinstance(node, ast.Attribute):
            assert isinstance(node.value, ast.Name)
            return f"{node.value.id}->{_c_name(node.attr)}"
        if isinstance(node, ast.Subscript):
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
        assert isinstance(node.func, ast.Name)
        arguments = [self.expression(argument) for argument in node.args]
        if node.func.id == "float":
            return arguments[0]
        if node.func.id == "advance":
            slopes = node.args[1].value if isinstance(node.args[1], ast.Subscript) else node.args[1]
            assert isinstance(slopes, ast.Attribute)
            arguments.append(str(self.tables[slopes.attr] // 3))
        if node.func.id in ("interpolate", "incline"):
            table = node.args[0]
            assert isinstance(table, ast.Attribute)
            arguments.insert(2, str(self.tables[table.attr]))
        return f"{_CALLS[node.func.id]}({', '.join(arguments)})"

    def statements(self, nodes: Iterable[ast.stmt], comments: Mapping[int, str], depth: int = 1) -> list[str]:
        """Return statements as lines."""
        lines: list[str] = []
        for node in nodes:
            pad, note = "    " * depth, comments.get(node.lineno, "")
            if isinstance(node, ast.Assign | ast.AugAssign):
                target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                operator = "=" if isinstance(node, ast.Assign) else f"{_OPERATORS[type(node.op)]}="
                value = self.expression(node.value)
                lines.append(f"{pad}{self.expression(target)} {operator} {_bare(value)};{note}")
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
            elif isinstance(node, ast.For):
                assert isinstance(node.iter, ast.Call)
                count = self.expression(node.iter.args[0])
                lines.append(f"{pad}for (j = 0; j < {count}; j++) {{")
                lines += [*self.statements(node.body, comments, depth + 1), f"{pad}}}"]
        return lines

    def function(self, node: ast.FunctionDef, comments: Mapping[int, str]) -> list[str]:
        """Return one of the three kernels."""
        kinds = {"s": f"{self.name}_state *s", "c": f"const {self.name}_const *c", "u": f"const {self.name}_input *u"}
        arguments = [arg.arg for arg in node.args.args]
        returned = "double" if node.name == "step" else "void"
        text = ast.get_docstring(node) or ""
        body = [n for n in node.body[1:] if not isinstance(n, ast.Pass)]
        names = [x for n in body for x in ast.walk(n) if isinstance(x, ast.Name) and isinstance(x.ctx, ast.Store)]
        local = list(dict.fromkeys(_c_name(x.id) for x in names if x.id not in (*arguments, "j")))
        lines = [
            f"/* {text} */",
            f"{returned} {self.name}_{node.name}({', '.join(kinds.get(a, f'double {a}') for a in arguments)})",
            "{",
        ]
        lines += [f"    double {name} = 0.0;" for name in local]
        if any(isinstance(x, ast.For) for n in body for x in ast.walk(n)):
            lines.append("    int j;")
        written = self.statements(body, comments)
        lines += ["", *(f"    (void)({name});" for name in (*arguments, *local)), *written]
        return [*lines, "}", ""]


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
    functions: list[str] = []
    for node in ast.parse(generated.source).body:
        if isinstance(node, ast.FunctionDef):
            functions += translator.function(node, comments)
    text = "\n".join(functions)
    used = [helper for call, helper in _HELPERS.items() if f"{call}(" in text]
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
