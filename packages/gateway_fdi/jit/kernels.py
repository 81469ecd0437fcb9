"""The decorator of kernels, and their calls.

Every numeric kernel of the gateway is decorated with :func:`kernel`. Called from Python it is an entry: the forms of
its arguments (:mod:`gateway_fdi.jit.forms`) choose the machine code, which is shipped with the package, or was compiled
before, or is compiled now. With ``NUMBA_DISABLE_JIT=1`` the same code runs as plain Python.
"""

from __future__ import annotations

import _thread
import ctypes
import hashlib
import inspect
import struct
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar, cast, overload

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.common import progress
from gateway_fdi.errors import KernelError
from gateway_fdi.jit import cache, shipped
from gateway_fdi.jit.addresses import address_of_array
from gateway_fdi.jit.closure import NOT_INLINED, Closure
from gateway_fdi.jit.forms import (
    INT,
    Arr,
    Form,
    Rec,
    Tup,
    code_of,
    form_of,
    parse_results,
    put,
    take,
    text_of,
)
from gateway_fdi.jit.intrinsics import PYTHON_ENTRIES, call_entry
from gateway_fdi.jit.records import record_at
from gateway_fdi.jit.settings import BOUNDSCHECK, BUILDING, COMPILED, MAY_COMPILE, USE_SHIPPED
from gateway_fdi.jit.unsupported_code import refuse

F = TypeVar("F", bound=Callable[..., Any])

#: Raised whenever the way in which code is made changes: keys of compiled code depend on it.
VERSION = 1

_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_char_p, ctypes.c_void_p)
_QUICK = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p)
_CALLED = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.POINTER(ctypes.c_int64), ctypes.c_void_p)
#: C functions of Python's, which live as long as the process.
_python: list[Any] = []

#: One thread compiles at a time.
_lock = threading.RLock()


class Bound(NamedTuple):
    """Cells of a function that :func:`bound` has made, for a kernel that calls it (``jit.system.call_bound``).

    Attributes:
        address: of its C function.
        arguments: cells of its arguments, int64.
        results: cells of its results, int64.
        places: of each remaining argument: its first cell, and of an array the first cells of those that are the same.
    """

    address: int
    arguments: NDArray[np.int64]
    results: NDArray[np.int64]
    places: tuple[tuple[int, tuple[int, ...]], ...]


class Entry:
    """Machine code of a kernel for one signature.

    Attributes:
        address: of its C function.
    """

    def __init__(self, name: str, arguments: tuple[Form, ...], address: int, results: str) -> None:
        self._name = name
        self._forms = arguments
        self._codes = [code_of(form) for form in arguments]
        self._codes_of_cells = "".join(self._codes)
        self._pack = struct.Struct("=" + self._codes_of_cells).pack
        self._result = parse_results(results)
        self._unpack = struct.Struct("=" + code_of(self._result))
        self.address = address
        self._function = _ENTRY(address)
        self._quick = _QUICK(address)

    def __call__(self, arguments: tuple[Any, ...]) -> Any:
        """Call it with arguments of its forms."""
        cells: list[Any] = []
        for form, value in zip(self._forms, arguments, strict=True):
            put(form, value, cells)
        return self._run(self._pack(*cells))

    def _run(self, cells: bytes) -> Any:
        unpack = self._unpack
        if not unpack.size:
            self._check(self._function(cells, None))
            return None
        room = ctypes.create_string_buffer(unpack.size)
        self._check(self._function(cells, ctypes.addressof(room)))
        return take(self._result, unpack.unpack(room))[0]

    def _check(self, status: int) -> None:
        if status:
            raise KernelError(
                f"the kernel {self._name} failed (status {status}): an index out of bounds, or a value that it"
                " refuses; NUMBA_DISABLE_JIT=1 runs it as plain Python and shows where"
            )

    def bound(self, first: tuple[Any, ...], rest: tuple[Any, ...]) -> Callable[..., Any]:
        """Return a function of the remaining arguments (see :func:`bound`)."""
        cells: list[Any] = []
        for form, value in zip(self._forms, (*first, *(_example(each) for each in rest)), strict=True):
            put(form, value, cells)
        room = ctypes.create_string_buffer(max(8 * len(self._codes_of_cells), 8))
        struct.pack_into("=" + self._codes_of_cells, room, 0, *cells)
        view = memoryview(room).cast("B").cast("q")
        found = ctypes.create_string_buffer(max(self._unpack.size, 8))
        numbers = memoryview(found).cast("B").cast("q")
        places = _places(self._forms[len(first) :], rest, sum(map(len, self._codes[: len(first)])))
        function, check, result, unpack = self._quick, self._check, self._result, self._unpack
        integers = isinstance(result, Tup) and all(item == INT for item in result.items)
        several = numbers[: len(result.items)] if integers else None
        arguments_at, results_at = ctypes.addressof(room), ctypes.addressof(found)
        passed = len(places)

        def call(*values: Any) -> Any:
            if len(values) != passed:
                raise TypeError(f"{passed} arguments, not {len(values)}")
            for (at, same), value in zip(places, values):  # noqa: B905 - told above, in a tenth of the time
                if same is None:
                    view[at] = value
                    continue
                view[at] = address = address_of_array(value)
                view[at + 1] = count = len(value)
                for other in same:
                    view[other], view[other + 1] = address, count
            status = function(arguments_at, results_at)
            if status:
                check(status)
            if several is not None:
                return tuple(several)
            return numbers[0] if result == INT else take(result, unpack.unpack_from(found))[0]

        call.__dict__["kept"] = first, room, found
        call.__dict__["cells"] = Bound(
            self.address,
            np.frombuffer(memoryview(room), np.int64),
            np.frombuffer(memoryview(found), np.int64),
            tuple((at, tuple(same or ())) for at, same in places),
        )
        return call


class Kernel:
    """A function that runs compiled; made by :func:`kernel`.

    Attributes:
        py_func: the function of plain Python.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.py_func = function
        self.__wrapped__ = function
        self.__name__ = function.__name__
        self.__qualname__ = function.__qualname__
        self.__module__ = function.__module__
        self.__doc__ = function.__doc__
        self._entries: dict[tuple[Form, ...], Entry] = {}
        self._checked: dict[tuple[Form, ...], Entry] = {}
        self._callees: dict[bool, Any] = {}
        self._closure: Closure | None = None

    def __repr__(self) -> str:
        return f"<kernel {self.__module__}.{self.__qualname__}>"

    @property
    def _numba_type_(self) -> Any:
        """Type by which numba knows a kernel that a kernel calls."""
        from numba.core import types  # noqa: PLC0415 - only when compiling

        from gateway_fdi.jit.frontend import callee, checking  # noqa: PLC0415

        checked = checking()
        if checked not in self._callees:
            self._callees[checked] = callee(self.py_func, checked=checked)
        return types.Dispatcher(self._callees[checked])

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Run the kernel's machine code."""
        try:
            return self._entries[tuple(map(form_of, args))](args)
        except KeyError:
            pass
        if kwargs or len(args) != self.py_func.__code__.co_argcount:
            bound = inspect.signature(self.py_func).bind(*args, **kwargs)
            bound.apply_defaults()
            args = bound.args
        return self.entry(tuple(map(form_of, args)))(args)

    @property
    def id(self) -> str:
        """Its name on every machine: ``module:name``."""
        return f"{self.__module__}:{self.__qualname__}"

    @property
    def closure(self) -> Closure:
        """Source of its code."""
        if self._closure is None:
            self._closure = Closure(cast(Any, self.py_func))
        return self._closure

    def entry(self, arguments: tuple[Form, ...], *, checked: bool = BOUNDSCHECK) -> Entry:
        """Return its machine code for a signature: shipped, kept from before, or compiled now.

        Args:
            arguments: their forms.
            checked: whether each index is checked, here and in all that it calls; such code is never shipped.

        Raises:
            KernelError: it cannot be compiled.
        """
        entries = self._checked if checked and not BOUNDSCHECK else self._entries
        with _lock:
            if arguments not in entries:
                entries[arguments] = self._ready(arguments, checked=checked)
            return entries[arguments]

    @property
    def keys(self) -> dict[str, str]:
        """Digest of each signature that has code in this process -> the key of that code, from the sources."""
        return {signature: self._key(signature) for signature in map(_signature, self._entries)}

    def _ready(self, arguments: tuple[Form, ...], *, checked: bool) -> Entry:
        from gateway_fdi.jit import machine  # noqa: PLC0415 - not where nothing is compiled

        signature = _signature(arguments)
        code = None if checked else self._shipped(signature)
        if code is None:
            code = self._made(arguments, signature, checked=checked)
        address = machine.load(code.symbol, code.needs, code.code)
        return Entry(self.__qualname__, arguments, address, code.results)

    def _key(self, signature: str, *, checked: bool = False) -> str:
        text = f"{VERSION} {self.id} {signature} {self.closure.digest}"
        if checked:  # it tells the lines of its exceptions
            codes = [function.__code__ for function in self.closure.kernels]
            lines = [f"{code.co_filename}:{code.co_firstlineno}:{code.co_linetable.hex()}" for code in codes]
            text = " ".join([text, "checked", *lines])
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def _shipped(self, signature: str) -> cache.Code | None:
        """Return shipped code that was made from the kernel as it is, if there is any."""
        from gateway_fdi.jit import machine  # noqa: PLC0415

        found = shipped.entry(self.id, signature) if USE_SHIPPED else None
        if found is None:
            return None
        if not shipped.unchanged(found) and self._key(signature) != found["key"]:
            return None
        for level in machine.levels():
            code = shipped.code(found, level)
            if code is not None:
                return code
        name, key = self._file(), f"{found['key'][:16]}-{machine.levels()[0]}"
        code = cache.read(name, key)
        if code is None:
            code = shipped.bitcode(found)
            if code is not None:
                made = machine.translate(code.code)
                code = cache.Code(code.symbol, code.results, code.needs, made)
                cache.write(name, key, code)
        return code

    def _file(self) -> str:
        return f"{self.__module__.removeprefix('gateway.')}.{self.__qualname__}".replace("<", "_")

    def _made(self, arguments: tuple[Form, ...], signature: str, *, checked: bool) -> cache.Code:
        """Return code that was compiled here, before or now."""
        from importlib.metadata import version  # noqa: PLC0415

        from gateway_fdi.jit import machine  # noqa: PLC0415

        key = self._key(signature, checked=checked)
        tools = f"{version('numba')} {version('llvmlite')} {machine.levels()[0]} {checked}"
        full = hashlib.blake2b(f"{key} {tools}".encode(), digest_size=8).hexdigest()
        name = self._file()
        code = cache.read(name, full)
        if code is None:
            if not MAY_COMPILE:
                raise KernelError(f"{self.id} is not shipped, and nothing may be compiled")
            bitcode, results = self.compile(arguments, key, checked=checked)
            needs = machine.externals(bitcode)
            origin = {"kernel": self.id, "signature": signature, "key": key}
            made = machine.translate(bitcode)
            code = cache.Code(symbol_of(key), results, needs, made, origin)
            cache.write(name, full, code, bitcode if BUILDING else b"")
        return code

    def compile(self, arguments: tuple[Form, ...], key: str, *, checked: bool = BOUNDSCHECK) -> tuple[bytes, str]:
        """Compile for a signature; returns optimised bitcode and the form of the result as text."""
        from gateway_fdi.jit import machine  # noqa: PLC0415
        from gateway_fdi.jit.frontend import lower  # noqa: PLC0415 - imports numba

        with progress.compiling(self._file(), len(self.closure.kernels)) as lowered:
            module, result = lower(self, arguments, symbol_of(key), lowered, checked=checked)
            return machine.optimise(module, checked=checked), text_of(result)


def _signature(arguments: tuple[Form, ...]) -> str:
    """Return the digest of the forms of a kernel's arguments."""
    return hashlib.blake2b(",".join(map(text_of, arguments)).encode(), digest_size=8).hexdigest()


class Same(NamedTuple):
    """A remaining argument of :func:`bound` that is not passed: the memory of another one, as another kind of array.

    Attributes:
        place: of the other one among the remaining arguments.
        example: array of its dtype; its trailing dimensions are those of the example.
    """

    place: int
    example: Any

    def of(self, value: Any) -> Any:
        """Return the array that it is for a value of the other one."""
        return value.view(self.example.dtype).reshape(len(value), *self.example.shape[1:])


def _example(argument: Any) -> Any:
    return argument.example if isinstance(argument, Same) else argument


def _places(forms: tuple[Form, ...], rest: tuple[Any, ...], at: int) -> list[tuple[int, list[int] | None]]:
    """Return, for each argument that is passed, its first cell, and of an array the cells of those that are the same.

    Raises:
        TypeError: one is neither an array that lies in one piece nor an integer.
    """
    firsts = []
    for form in forms:
        if form != INT and not (isinstance(form, Arr) and form.contiguous):
            raise TypeError("the remaining arguments must be integers, and arrays that lie in one piece")
        firsts.append(at)
        at += len(code_of(form))
    same: dict[int, list[int]] = {}
    for first, each in zip(firsts, rest, strict=True):
        if isinstance(each, Same):
            same.setdefault(each.place, []).append(first)
    return [
        (first, same.get(k, []) if isinstance(form, Arr) else None)
        for k, (first, form, each) in enumerate(zip(firsts, forms, rest, strict=True))
        if not isinstance(each, Same)
    ]


def bound(function: Callable[..., Any], *first: Any, rest: tuple[Any, ...]) -> Callable[..., Any]:
    """Return a function of a kernel's remaining arguments, for calls that must be short; for one thread.

    Args:
        function: the kernel.
        first: its leading arguments; their arrays must stay where they are.
        rest: examples of the remaining ones, integers and arrays in one piece: each call must have arguments of these
            forms, arrays of another length at most. One that is :class:`Same` is not passed.
    """
    if COMPILED:
        examples = tuple(_example(each) for each in rest)
        return cast(Kernel, function).entry(tuple(map(form_of, (*first, *examples)))).bound(first, rest)

    def call(*values: Any) -> Any:
        passed = iter(values)
        given: list[Any] = [None if isinstance(each, Same) else next(passed) for each in rest]
        given = [each.of(given[each.place]) if isinstance(each, Same) else one for each, one in zip(rest, given)]  # noqa: B905
        return function(*first, *given)

    return call


def cells_of(function: Callable[..., Any]) -> Bound | None:
    """Return the cells of a function that :func:`bound` has made; None: it is plain Python."""
    return vars(function).get("cells")


def symbol_of(key: str) -> str:
    """Return the name of the C function of an entry."""
    return f"gateway_{key[:16]}"


@overload
def kernel(function: F) -> F: ...
@overload
def kernel(*, inlined: bool) -> Callable[[F], F]: ...
def kernel(function: F | None = None, *, inlined: bool = True) -> F | Callable[[F], F]:
    """Compile a scalar kernel: no GIL, IEEE arithmetic, division by zero as in NumPy.

    A kernel allocates nothing, reads no clock, and returns numbers or tuples of them. Kernels that it calls are
    inlined, so that tables handed down in a tuple cost nothing.

    Args:
        function: the kernel.
        inlined: copied into each kernel that calls it, at each call. A long one that is called in several places is
            better not: copies of copies multiply, in size and in time to compile. LLVM then decides.
    """
    if function is None:
        return partial(_kernel, inlined=inlined)
    return _kernel(function, inlined=inlined)


def _kernel(function: F, *, inlined: bool) -> F:
    if not inlined:
        vars(function)[NOT_INLINED] = True
    return cast(F, Kernel(function)) if COMPILED else function


def entry_point(step: Callable[..., None], records: tuple[np.dtype[np.void], ...], *, checked: bool = False) -> int:
    """Give a kernel of four records an address that :func:`gateway_fdi.jit.call_entry` can jump to.

    Args:
        step: a kernel ``step(a, b, c, d)`` over four records.
        records: the dtypes of the four.
        checked: whether each index is checked; an index out of bounds, or an exception, is a failure then
            (:func:`gateway_fdi.jit.failure_of`), and nothing beyond an array is touched.

    Raises:
        KernelError: it is no kernel, or cannot be compiled.

    Returns:
        the address; the compiled code lives as long as the process.
    """
    if not COMPILED:
        PYTHON_ENTRIES.append((step, records))
        return len(PYTHON_ENTRIES)
    if not isinstance(step, Kernel):
        raise KernelError(f"{getattr(step, '__qualname__', step)} is no kernel: it needs @kernel before its def")
    if checked:
        refuse(step)
    return step.entry(tuple(map(Rec, records)), checked=checked or BOUNDSCHECK).address


def python_entry(function: Callable[..., None], records: tuple[np.dtype[np.void] | None, ...]) -> int:
    """Give a function of plain Python an address that :func:`gateway_fdi.jit.call_entry` can jump to.

    It takes Python's lock, so it is for the few kernels that cannot do without. The call gives a status if the function
    raises; an interrupt is raised where Python goes on.

    Args:
        function: of four records or numbers.
        records: their dtypes, None: the number as it is given to :func:`gateway_fdi.jit.call_entry`.

    Returns:
        the address; it stays as long as the process.
    """
    if not COMPILED:
        PYTHON_ENTRIES.append((function, records))
        return len(PYTHON_ENTRIES)

    def called(cells: Any, _: Any) -> int:
        try:
            function(*(cells[k] if dtype is None else record_at(cells[k], dtype) for k, dtype in enumerate(records)))
        except KeyboardInterrupt:
            _thread.interrupt_main()
            return 1
        except Exception:
            return 1
        return 0

    _python.append(_CALLED(called))
    return ctypes.cast(_python[-1], ctypes.c_void_p).value or 0


def run_entry(address: int, records: Sequence[NDArray[np.void]]) -> int:
    """Call an entry point from Python; returns 0, or what went wrong: for :func:`gateway_fdi.jit.failure_of`.

    Args:
        address: of :func:`entry_point`.
        records: its four, each of shape (1,).
    """
    places = [address_of_array(record) for record in records]
    if not COMPILED:
        return call_entry(address, *places)
    cells = struct.pack("=4q", *places)
    reason = ctypes.c_int64(0)
    status = int(_ENTRY(address)(cells, ctypes.addressof(reason)))
    return (reason.value or status) if status else 0
