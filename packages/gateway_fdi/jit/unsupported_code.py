"""Code that must not be in a kernel from outside: it would stop the process, or numba's message would be unclear.

Printing can wait for Python's lock for ever; the depth of recursion is unknown; a kernel allocates nothing.
"""

from __future__ import annotations

import dis
from collections.abc import Iterator
from types import FunctionType
from typing import Any, cast

import numpy as np

from gateway_fdi.errors import KernelError
from gateway_fdi.jit.closure import Closure

_SAID = {
    "print": "a kernel prints nothing; gateway replay --trace shows each step, NUMBA_DISABLE_JIT=1 runs it as Python",
    "objmode": "a kernel calls no Python",
}
_ALLOCATES = "a kernel allocates nothing; an array is a field of the state: Annotated[f8s, 3]"
_BUILDS = {"BUILD_LIST": "a list", "BUILD_SET": "a set", "BUILD_MAP": "a dict"}
_MAKERS = ("zeros", "ones", "empty", "full", "array", "arange", "linspace", "zeros_like", "ones_like", "empty_like")


def refuse(step: Any) -> None:
    """Refuse a kernel that could stop the process it is in.

    Raises:
        KernelError: such code, with file and line.
    """
    kernels = Closure(cast(Any, step.py_func)).kernels
    calls = {function: set(_called(function, kernels)) for function in kernels}
    for function in kernels:
        name, code = function.__qualname__, function.__code__
        for instruction in dis.get_instructions(code):
            told = _told_of(instruction, function)
            if told:
                raise KernelError(f"{name} ({code.co_filename}:{_line(function, instruction.offset)}): {told}")
        if _reaches(function, function, calls):
            where = f"{code.co_filename}:{code.co_firstlineno}"
            raise KernelError(f"{name} ({where}) calls itself: recursion has no bound that is known")


def _told_of(instruction: dis.Instruction, function: FunctionType) -> str:
    """Return what is wrong with an instruction; "": nothing."""
    opname, argval = instruction.opname, instruction.argval
    if opname in _BUILDS:
        return f"{_BUILDS[opname]}: {_ALLOCATES}"
    attribute = opname in ("LOAD_ATTR", "LOAD_METHOD")
    if argval in _SAID and (opname == "LOAD_GLOBAL" or (attribute and argval == "objmode")):
        return f"{argval}: {_SAID[argval]}"
    if (
        argval in _MAKERS
        and attribute
        and any(function.__globals__.get(name) is np for name in function.__code__.co_names)
    ):
        return f"{argval}: {_ALLOCATES}"
    return ""


def _line(function: FunctionType, offset: int) -> int:
    """Return the line of an instruction."""
    found = function.__code__.co_firstlineno
    for start, line in dis.findlinestarts(function.__code__):
        if start <= offset and line is not None:
            found = line
    return found


def _called(function: FunctionType, kernels: list[FunctionType]) -> Iterator[FunctionType]:
    """Yield the kernels that a kernel reads."""
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    names = {each.argval for each in dis.get_instructions(function) if each.opname == "LOAD_GLOBAL"}
    read = [function.__globals__.get(name) for name in sorted(names)] + cells
    for value in read:
        plain = getattr(value, "py_func", value)
        if isinstance(plain, FunctionType) and plain in kernels:
            yield plain


def _reaches(start: FunctionType, goal: FunctionType, calls: dict[FunctionType, set[FunctionType]]) -> bool:
    todo, seen = list(calls[start]), set()
    while todo:
        function = todo.pop()
        if function is goal:
            return True
        if function not in seen:
            seen.add(function)
            todo += calls.get(function, ())
    return False
