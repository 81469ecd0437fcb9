"""Source of compiled code: a kernel, the kernels that it calls, and the constants that they use.

The digest of this closure is the key of compiled code. It sees the syntax of each function without comments, docstrings
and annotations, and the values of the globals that it reads: so a comment compiles nothing, an edit compiles the
kernels that reach it, wherever their files lie, and a changed constant is a changed kernel.
"""

from __future__ import annotations

import ast
import enum
import hashlib
import linecache
import types
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np

from gateway_fdi.jit.forms import dtype_text

#: Fields of syntax trees that say nothing of what is computed, or that differ between versions of Python.
_IGNORED = frozenset(
    {"ctx", "kind", "type_comment", "type_params", "type_ignores", "returns", "annotation", "decorator_list"}
)  # fmt: skip

#: Attribute of a function that is called, not copied into what calls it: it makes other code.
NOT_INLINED = "gateway_not_inlined"


def _syntax(node: Any, parts: list[str]) -> None:
    """Append the text of a syntax tree; the same in each version of Python that has these nodes."""
    if isinstance(node, ast.AST):
        parts.append(type(node).__name__)
        parts.append("(")
        for name in node._fields:
            value = getattr(node, name, None)
            if name in _IGNORED or value is None or value == []:
                continue
            parts.append(name)
            parts.append("=")
            _syntax(value, parts)
        parts.append(")")
    elif isinstance(node, list):
        parts.append("[")
        for item in node:
            _syntax(item, parts)
            parts.append(",")
        parts.append("]")
    else:
        parts.append(repr(node))


@cache
def _functions(filename: str) -> dict[int, ast.FunctionDef]:
    """Return the functions of a file by the line that their code object gives as its first."""
    source = "".join(linecache.getlines(filename))
    found = {}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
            found[first] = node
    return found


def _text(function: types.FunctionType) -> str:
    """Return the syntax of a function, without its docstring; of one without source, its bytecode."""
    code = function.__code__
    try:
        node = _functions(code.co_filename).get(code.co_firstlineno)
    except (OSError, SyntaxError):
        node = None
    if node is None or node.name != function.__name__:
        return f"{code.co_code.hex()}{code.co_consts!r}{code.co_names!r}"
    body = node.body
    first = body[0]
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
        body = body[1:]
    parts: list[str] = []
    _syntax(node.args, parts)
    _syntax(body, parts)
    return "".join(parts)


def _names(code: types.CodeType) -> Iterator[str]:
    """Yield the global names and attributes that a code object, and those in it, read."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def _reads(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield what a function reads from outside: names, and their values."""
    scope = function.__globals__
    for name in sorted(set(_names(function.__code__))):
        if name in scope:
            yield name, scope[name]
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        yield name, cell.cell_contents


class Closure:
    """The closure of one kernel.

    Attributes:
        kernels: the functions in it, the kernel's own first.
        digest: hexadecimal, 32 digits.
    """

    def __init__(self, function: types.FunctionType) -> None:
        self.kernels: list[types.FunctionType] = []
        self._parts: list[str] = []
        self._modules: list[types.ModuleType] = []  # that are looked at now
        self._add(function)
        text = "\n".join(self._parts)
        self.digest = hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def _add(self, function: types.FunctionType) -> str:
        """Add a function, once; returns how others name it."""
        name = f"{function.__module__}:{function.__qualname__}"
        if function in self.kernels:
            return name
        self.kernels.append(function)
        lines = [f"def {name} {_text(function)}"]
        if NOT_INLINED in vars(function):
            lines.append(NOT_INLINED)
        used = set(_names(function.__code__))
        lines += [f"{key} = {self._value(value, used)}" for key, value in _reads(function)]
        defaults = function.__defaults__ or ()
        lines += [self._value(value, used) for value in defaults]
        self._parts.append("\n".join(lines))
        return name

    def _value(self, value: Any, used: set[str]) -> str:
        """Return a global as text; the objects that it leads to are added."""
        function = getattr(value, "py_func", None)
        if function is not None:
            return self._add(function)
        if isinstance(value, types.FunctionType):
            return self._add(value)
        for kind, text in _TEXTS:
            if isinstance(value, kind):
                return text(value)
        if isinstance(value, tuple):
            return f"({','.join(self._value(item, used) for item in value)})"
        if isinstance(value, types.ModuleType):
            return self._module(value, used)
        if isinstance(value, type):
            return f"{value.__module__}.{value.__qualname__}{getattr(value, '_fields', '')}"
        return f"{type(value).__module__}.{type(value).__qualname__} {getattr(value, '__name__', '')}"

    def _module(self, module: types.ModuleType, used: set[str]) -> str:
        """Return what a function may read of a module: of NumPy and the standard library the name says it."""
        name = module.__name__
        if name.partition(".")[0] in ("numpy", "math", "cmath", "operator", "numba") or module in self._modules:
            return name  # a module may contain itself
        scope = vars(module)
        self._modules.append(module)
        read = [f"{key}={self._value(scope[key], used)}" for key in sorted(used) if key in scope]
        self._modules.pop()
        return f"{name}({','.join(read)})"


def _enumeration(value: Any) -> str:
    return f"{value.__qualname__}({[(item.name, item.value) for item in value]})"


def _array(value: Any) -> str:
    digest = hashlib.blake2b(np.ascontiguousarray(value).tobytes(), digest_size=8).hexdigest()
    return f"{dtype_text(value.dtype)}{value.shape}{digest}"


#: How values are written, by their kind; the first that fits.
_TEXTS: tuple[tuple[Any, Callable[[Any], str]], ...] = (
    (enum.EnumMeta, _enumeration),
    (enum.Enum, lambda value: f"{value!r}"),
    ((bool, int, float, complex, str, bytes, type(None)), repr),
    (np.dtype, dtype_text),
    (np.generic, lambda value: f"{value.dtype.str}{value.item()!r}"),
    (np.ndarray, _array),
)
