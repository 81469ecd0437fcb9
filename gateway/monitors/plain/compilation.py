"""``@monitor(..., compiled=True)``: the same function or class, compiled.

Attributes of the object become fields of the state's record, so ``self`` is that record in the compiled ``update``.
Whether a step returns a yes or no, a ratio or a :class:`Result` is read from its ``return``: compiled code has one
type for all.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Annotated, Any, NoReturn

import numpy as np

from gateway.monitors.contract import MonitorParams
from gateway.monitors.plain.signature import TIMES, Written
from gateway_fdi.errors import InputError
from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_fdi.structure.generator.sources import load_source

#: Result that a step returns -> how a result of it is reported.
_REPORTS = {
    "result": "e = report(out, 0, found.failed, found.value, found.limit)",
    "bool": "e = report(out, 0, found, 1.0 if found else 0.0, 0.5)",
    "ratio": "e = report(out, 0, found > 1.0, found, 1.0)",
}
_SOURCE = """\
from gateway.monitors.contract import TIMER, report
from gateway.monitors.plain.compilation import kernel_of
from gateway_fdi.jit import kernel

update = kernel_of({number})


@kernel
def step(s, c, u, out):
    if u.trigger == TIMER:
        return
    dt_s = (u.t_ns - s.at_ns_) * 1e-9 if s.steps_ > 0 else 0.0
    s.at_ns_, s.steps_ = u.t_ns, s.steps_ + 1
    found = update({arguments})
    if {tested}:
        {report}
"""
#: Kinds of arrays that a record can keep, as NumPy calls them: those of floats first.
_NUMBERS = "fiub"
_kernels: list[Callable[..., Any]] = []


def kernel_of(number: int) -> Callable[..., Any]:
    """Return a compiled author's function, for generated code."""
    return _kernels[number]


class Compiled:
    """Compiled form of what an author wrote.

    Args:
        written: function or class.

    Raises:
        InputError: its returns do not say of what type they are.
    """

    def __init__(self, written: Written) -> None:
        self._written = written
        made = written.made
        self._function = made.update if isinstance(made, type) and hasattr(made, "update") else made
        self._returns, self._optional = self._kind()
        self._number = len(_kernels)
        _kernels.append(kernel(_positional(self._function)))

    def refuse(self, text: str, line: int | None = None) -> NoReturn:
        """Raise what is wrong with it."""
        line = self._written.line if line is None else line
        raise InputError(text, file=self._written.file, line=line, key=f"@monitor {self._written.name}, compiled=True")

    def _kind(self) -> tuple[str, bool]:
        """Return what a step returns, of :data:`_REPORTS`, and whether it may return None."""
        lines, first = inspect.getsourcelines(self._function)
        tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        kinds: dict[str, int] = {}
        optional = not isinstance(tree.body[-1], ast.Return)
        for one in _returns(tree):
            if one.value is None or (isinstance(one.value, ast.Constant) and one.value.value is None):
                optional = True
                continue
            kind = _kind_of(one.value)
            line = first + one.lineno - 1
            if not kind:
                self.refuse("say what this returns: bool(...), float(...) or Result(...)", line)
            kinds.setdefault(kind, line)
        if len(kinds) != 1:
            text = f"it returns {' and '.join(kinds)}: one of them" if kinds else "it returns nothing"
            self.refuse(text, max(kinds.values(), default=None))
        return next(iter(kinds)), optional

    def source(self) -> Callable[..., None]:
        """Return the kernel of its monitor."""
        written = self._written
        places = {name: f"u.value[{k}]" for k, name in enumerate(written.inputs)}
        places |= dict(zip(TIMES, ("u.t_ns * 1e-9", "dt_s"), strict=True))
        code = self._function.__code__
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        given = [places.get(name, f"c.{name}") for name in names]
        if isinstance(written.made, type):
            given[0] = "s"
        count = min(len(written.inputs), 8)
        reported = [_REPORTS[self._returns], *(f"e.value[{k}] = u.value[{k}]" for k in range(count))]
        text = _SOURCE.format(
            number=self._number,
            arguments=", ".join(given),
            tested="found is not None" if self._optional else "True",
            report="\n        ".join(reported),
        )
        found: Callable[..., None] = load_source(written.name, text).step
        return found

    def records(self, params: MonitorParams) -> tuple[type[Record], type[Record], Callable[[Any, Any], None]]:
        """Return the records of state and constants, and what fills them.

        Raises:
            InputError: an attribute or a parameter is neither a number nor an array of numbers.
        """
        values = {name: getattr(params, name) for name in self._written.params.model_fields}
        kept: dict[str, Any] = {}
        if isinstance(self._written.made, type):
            kept = dict(vars(self._written.made(**values)))
            values = {}
        state, const = self._record("State", kept), self._record("Const", values)

        def fill(s: Any, c: Any) -> None:
            for record, some in ((s, kept), (c, values)):
                for name, value in some.items():
                    record[name] = value

        return state, const, fill

    def _record(self, name: str, values: dict[str, Any]) -> type[Record]:
        own = {"at_ns_": i8, "steps_": i8} if name == "State" else {"none_": i8}
        fields = own | {key: self._form(key, value) for key, value in values.items()}
        try:
            made = type(name, (Record,), {"__annotations__": fields} | dict.fromkeys(own, means("of the gateway")))
        except ValueError as error:
            self.refuse(f"another name is needed: {error}")
        return made

    def _form(self, name: str, value: Any) -> Any:
        if isinstance(value, bool | int | np.integer | np.bool_):
            return i8
        if isinstance(value, float | np.floating):
            return f8
        if isinstance(value, np.ndarray) and value.dtype.kind in _NUMBERS and value.ndim and value.size:
            return Annotated[(f8s if value.dtype.kind == _NUMBERS[0] else i8s, *value.shape)]
        hint = "; give it a number, math.nan for none" if value is None else ""
        return self.refuse(f"{name!r} is {value!r}: compiled code keeps numbers and arrays of numbers{hint}")


def _positional(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that takes by its place what it took by name only: compiled code knows no names."""
    code = function.__code__
    count = code.co_argcount + code.co_kwonlyargcount
    made = FunctionType(
        code.replace(co_argcount=count, co_kwonlyargcount=0),
        function.__globals__,
        function.__name__,
        None,
        function.__closure__,
    )
    made.__module__, made.__qualname__ = function.__module__, function.__qualname__
    return made


def _returns(tree: ast.FunctionDef) -> Iterator[ast.Return]:
    return (one for one in ast.walk(tree) if isinstance(one, ast.Return))


def _kind_of(value: ast.expr) -> str:
    """Return what an expression is, by its form: one of :data:`_REPORTS`; "": that cannot be seen."""
    called = value.func.id if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) else ""
    if called in ("Result", "bool", "float"):
        return {"Result": "result", "float": "ratio"}.get(called, called)
    if isinstance(value, ast.Compare) or (isinstance(value, ast.UnaryOp) and isinstance(value.op, ast.Not)):
        return "bool"
    if isinstance(value, ast.BoolOp):
        return "bool" if all(_kind_of(one) == "bool" for one in value.values) else ""
    if isinstance(value, ast.BinOp) and not isinstance(value.op, ast.BitAnd | ast.BitOr | ast.BitXor):
        return "ratio"
    if isinstance(value, ast.Constant):
        return "bool" if isinstance(value.value, bool) else "ratio" if isinstance(value.value, int | float) else ""
    return ""
