"""From a kernel of Python to LLVM: numba types and lowers it and what it calls; nothing is translated here.

A kernel that kernels call is typed and lowered only, once for each signature. An entry - a kernel that Python or the
engine calls - is linked with all of these, and only that is optimised and translated (:mod:`gateway_fdi.jit.machine`).
Left to itself numba optimises, translates and caches each callee as well, again in each of its callers: five times the
work. Numbers are handed down as int64 and float64, so that a callee has one signature; nothing is reference-counted,
for a kernel allocates nothing.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
import numba
from llvmlite import ir
from numba.core import codegen, compiler, sigutils, typing
from numba.core import types as _types
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher, cpu_target
from numba.np import arrayobj

from gateway_fdi.errors import KernelError
from gateway_fdi.jit import forms
from gateway_fdi.jit.closure import NOT_INLINED
from gateway_fdi.jit.forms import Form

types: Any = _types

#: Called with each function that was lowered.
OnLowered = Callable[[str], None]

_OPTIONS = {
    "nopython": True,
    "nogil": True,
    "error_model": "numpy",  # division by zero as in NumPy
    "forceinline": True,  # so that tables handed down in a tuple cost nothing
    "_nrt": False,
}

_on_lowered: list[OnLowered] = []


class _Library(codegen.JITCodeLibrary):
    """Code of a kernel that was lowered: linked into entries as it is."""

    _shared_module: Any

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            for function in self._final_module.functions:
                if not function.is_declaration and function.linkage == llvm.Linkage.external:
                    function.linkage = "linkonce_odr"
            self._shared_module = self._final_module
        return self._shared_module


def _widened(kind: Any) -> Any:
    """Return the type in which a number is handed to a kernel."""
    kind = types.unliteral(kind)
    if isinstance(kind, types.Integer) and kind != types.uint64:
        return types.int64
    return types.float64 if isinstance(kind, types.Float) else kind


class Callee(CPUDispatcher):
    """A kernel as kernels call it."""

    def __repr__(self) -> str:
        """Return its name: it comes into code by the types of tuples with kernels in them; an address must not."""
        return f"Callee({self.py_func.__module__}.{self.py_func.__qualname__})"

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return how numba types a call (see its Dispatcher)."""
        python_signature, args = self._compiler.fold_argument_types(args, kws)
        args = tuple(_widened(kind) for kind in args)
        self.compile(args)
        template = typing.make_concrete_template(
            f"CallTemplate({self.py_func.__name__})",
            key=self.py_func.__name__,
            signatures=[self.overloads[args].signature],
        )
        return template, python_signature, args, {}

    def compile(self, sig: Any) -> Any:
        """Type and lower the kernel for one signature; returns the key by which numba finds its code."""
        args = tuple(sigutils.normalize_signature(sig)[0])
        if args not in self.overloads:
            context = self.targetdescr.target_context
            flags = compiler.Flags()
            self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
            flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
            library = _Library(context.codegen(), self.py_func.__qualname__)
            with self._compiling_counter:
                result = compiler.compile_extra(
                    self.targetdescr.typing_context, context, self.py_func, args=args,
                    return_type=None, flags=flags, locals={}, library=library,
                )  # fmt: skip
            key = object()
            context.insert_user_function(key, result.fndesc, [library])
            self.overloads[args] = result._replace(entry_point=key)
            for tell in _on_lowered:
                tell(self.py_func.__name__)
        return self.overloads[args].entry_point

    def get_overload(self, sig: Any) -> Any:
        """Return the key of a signature that was compiled."""
        return self.overloads[tuple(sigutils.normalize_signature(sig)[0])].entry_point


#: Whether what is lowered now has its indices checked; one entry is lowered at a time.
_checked: list[bool] = []


def checking() -> bool:
    """Return whether the entry that is lowered now has its indices checked, with all that it calls."""
    return bool(_checked) and _checked[-1]


def callee(function: Any, *, checked: bool) -> Any:
    """Return a kernel as kernels call it.

    Args:
        function: of plain Python.
        checked: whether each index is checked against its array's length.
    """
    inlined = NOT_INLINED not in vars(function) and not checked
    return Callee(function, targetoptions=_OPTIONS | {"boundscheck": checked, "forceinline": inlined})


def _type_of(form: Form) -> Any:
    """Return numba's type of a form."""
    if isinstance(form, str):
        return {
            forms.INT: types.int64,
            forms.UINT: types.uint64,
            forms.FLOAT: types.float64,
            forms.BOOL: types.boolean,
            forms.NONE: types.none,
        }[form]
    if isinstance(form, forms.Arr):
        layout = "C" if form.contiguous else "A"
        item = numba.from_dtype(form.dtype)
        return types.Array(item, form.ndim, layout, readonly=not form.writable)
    if isinstance(form, forms.Rec):
        return numba.from_dtype(form.dtype)
    if isinstance(form, forms.Tup):
        items = [_type_of(item) for item in form.items]
        if form.cls is tuple:
            return types.Tuple(items)
        uniform = bool(items) and all(item == items[0] for item in items)
        if uniform:
            return types.NamedUniTuple(items[0], len(items), form.cls)
        return types.NamedTuple(items, form.cls)
    return form.kernel._numba_type_


class _Cells:
    """The cells of arguments, read one after the other."""

    def __init__(self, context: Any, builder: Any, pointer: Any) -> None:
        self._context, self._builder, self._pointer = context, builder, pointer
        self._at = 0

    def word(self) -> Any:
        place = self._builder.gep(self._pointer, [ir.Constant(ir.IntType(64), self._at)])
        self._at += 1
        return self._builder.load(place)

    def value(self, form: Form, kind: Any) -> Any:
        """Read one argument; an array has no reference count."""
        context, builder = self._context, self._builder
        if isinstance(form, forms.Tup):
            values = [self.value(*each) for each in zip(form.items, kind.types, strict=True)]
            return context.make_tuple(builder, kind, values)
        if isinstance(form, forms.Rec):
            return builder.inttoptr(self.word(), context.get_value_type(kind))
        if isinstance(form, forms.Arr):
            return self._array(form, kind)
        if isinstance(form, forms.Fun) or form == forms.NONE:
            return context.get_dummy_value()
        word = self.word()
        if form == forms.FLOAT:
            return builder.bitcast(word, ir.DoubleType())
        if form == forms.BOOL:
            return builder.icmp_unsigned("!=", word, ir.Constant(word.type, 0))
        return word

    def _array(self, form: forms.Arr, kind: Any) -> Any:
        context, builder = self._context, self._builder
        make: Any = arrayobj.make_array
        made = make(kind)(context, builder)
        item = ir.Constant(ir.IntType(64), form.dtype.itemsize)
        data = builder.inttoptr(self.word(), context.get_data_type(kind.dtype).as_pointer())
        shape = [self.word() for _ in range(form.ndim)]
        strides = [self.word() for _ in range(form.ndim)]
        if form.contiguous and form.ndim:
            strides[-1] = item
        arrayobj.populate_array(made, data=data, shape=shape, strides=strides, itemsize=item, meminfo=None)
        return made._getvalue()


def _result_form(kind: Any, name: str) -> Form:
    """Return the form of a kernel's result."""
    if isinstance(kind, types.BaseTuple):
        return forms.Tup(tuple, tuple(_result_form(item, name) for item in kind.types))
    if isinstance(kind, types.Boolean):
        return forms.BOOL
    if kind == types.uint64:
        return forms.UINT
    for known, form in (
        (types.Integer, forms.INT),
        (types.Float, forms.FLOAT),
        (types.NoneType, forms.NONE),
    ):
        if isinstance(kind, known):
            return form
    raise KernelError(f"{name} returns {kind}: a kernel returns numbers, or fills its arguments")


def _store(context: Any, builder: Any, pointer: Any, kind: Any, value: Any, at: int) -> int:
    """Store a result in its cells; returns the next."""
    if isinstance(kind, types.BaseTuple):
        for k, item in enumerate(kind.types):
            part = builder.extract_value(value, k)
            at = _store(context, builder, pointer, item, part, at)
        return at
    if isinstance(kind, types.NoneType):
        return at
    word = ir.IntType(64)
    if isinstance(kind, types.Float):
        value = context.cast(builder, value, kind, types.float64)
        value = builder.bitcast(value, word)
    elif isinstance(kind, types.Boolean):
        value = builder.zext(value, word)
    else:
        value = context.cast(builder, value, kind, types.uint64 if kind == types.uint64 else types.int64)
    builder.store(value, builder.gep(pointer, [ir.Constant(word, at)]))
    return at + 1


def _wrapper(
    context: Any, described: Any, arguments: tuple[Form, ...], kinds: Any, symbol: str, *, checked: bool
) -> Any:
    """Return the module with the entry's C function; one that is checked tells its caller why it failed."""
    module = ir.Module(symbol)
    module.triple, module.data_layout = "", ""
    cells = ir.IntType(64).as_pointer()
    function = ir.Function(module, ir.FunctionType(ir.IntType(32), [cells, cells]), symbol)
    builder = ir.IRBuilder(function.append_basic_block("entry"))
    read = _Cells(context, builder, function.args[0])
    values = [read.value(form, kind) for form, kind in zip(arguments, kinds, strict=True)]
    target = context.declare_function(module, described)
    status, result = context.call_conv.call_function(builder, target, described.restype, described.argtypes, values)
    with builder.if_then(status.is_error, likely=False):
        if checked:
            _tell_reason(builder, function.args[1], status)
        builder.ret(status.code)
    _store(context, builder, function.args[1], described.restype, result, 0)
    builder.ret(ir.Constant(ir.IntType(32), 0))
    return module


def _tell_reason(builder: Any, results: Any, status: Any) -> None:
    """Store the address of the exception's description where the result would be, if the caller wants one."""
    wanted = builder.icmp_unsigned("!=", results, ir.Constant(results.type, None))
    with builder.if_then(builder.and_(status.is_user_exc, wanted)):
        builder.store(builder.ptrtoint(status.excinfoptr, ir.IntType(64)), results)


def _linked(library: Any, module: Any) -> Any:
    """Return the module of an entry with all code that it reaches; only the entry is seen from outside."""
    whole = llvm.parse_assembly(str(module))
    whole.name = "gateway"
    kept = [function.name for function in whole.functions if not function.is_declaration]
    todo, seen = [library], set()
    while todo:
        one = todo.pop(0)
        if id(one) in seen:
            continue
        seen.add(id(one))
        whole.link_in(one._get_module_for_linking(), preserve=True)
        todo += one._linking_libraries
    inside = [s for s in (*whole.functions, *whole.global_variables) if not s.is_declaration and s.name not in kept]
    for number, symbol in enumerate(inside):
        symbol.linkage = "internal"
        # numba's names count what the process has compiled before, and inlining writes them into metadata.
        symbol.name = f"inside{number}"
    return whole


_COLOUR = re.compile(r"\x1b\[\d+m")


def _reason(error: BaseException) -> str:
    """Return what numba says, and its places, without colours and advice."""
    text = _COLOUR.sub("", str(error)).strip() or type(error).__name__
    if isinstance(error, KeyError):
        return f"no field {text}"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    lines = [line for line in lines if not line.startswith("Failed in nopython mode pipeline")]
    places = [line for line in lines if line.startswith('File "')]
    told = lines[: lines.index(places[0])] if places else lines
    return "\n  ".join([*told[:8], *places[:4]])


@global_compiler_lock
def lower(
    kernel: Any, arguments: tuple[Form, ...], symbol: str, on_lowered: OnLowered | None = None, *, checked: bool
) -> tuple[Any, Form]:
    """Return the module of an entry, linked and not optimised, and the form of its result.

    Args:
        kernel: what is called.
        arguments: their forms.
        symbol: name of the C function.
        on_lowered: called with the name of each kernel that was lowered.
        checked: whether each index is checked, in all that it calls, too.

    Raises:
        KernelError: numba cannot compile it; says which kernel, and where.
    """
    if on_lowered is not None:
        _on_lowered.append(on_lowered)
    _checked.append(checked)
    try:
        kinds = tuple(_type_of(form) for form in arguments)
        target = kernel._numba_type_.dispatcher
        target.compile(kinds)
        result = target.overloads[kinds]
        form = _result_form(result.signature.return_type, kernel.__qualname__)
        context: Any = cpu_target.target_context
        module = _wrapper(context, result.fndesc, arguments, kinds, symbol, checked=checked)
        return _linked(result.library, module), form
    except KernelError:
        raise
    except Exception as error:
        code = kernel.py_func.__code__
        where = f"{code.co_filename}:{code.co_firstlineno}"
        raise KernelError(f"the kernel {kernel.__qualname__} ({where}) cannot be compiled: {_reason(error)}") from error
    finally:
        _checked.pop()
        if on_lowered is not None:
            _on_lowered.remove(on_lowered)
