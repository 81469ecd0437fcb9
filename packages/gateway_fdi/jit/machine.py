"""LLVM: modules are optimised and translated, objects are loaded.

Code is made for levels of an architecture, not for the processor at hand: the same source gives the same bytes on every
machine, and IEEE arithmetic the same results (nothing is fused or reordered, whatever the level).
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import platform
from functools import cache
from typing import Any

import llvmlite.binding as llvm

from gateway_fdi.errors import KernelError

#: Processor for which code is made, by level; those of one architecture, the best last.
LEVELS = {"x86_64": "x86-64", "x86_64_v3": "x86-64-v3", "aarch64": "generic"}

#: What a processor of level x86_64_v3 has (psABI x86-64, micro-architecture levels).
_V3 = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "sse4.2", "popcnt")

#: Symbols that numba gives to compiled code; it must be loaded before code that uses them.
_OF_NUMBA = ("numba_", "NRT_")


def architecture() -> str:
    """Return the architecture of this machine, as objects are shipped for it."""
    return platform.machine().lower()


@cache
def levels() -> tuple[str, ...]:
    """Return the levels whose code this machine can run, the best first."""
    here = architecture()
    if here != "x86_64":
        return (here,)
    features = llvm.get_host_cpu_features()
    return ("x86_64_v3", here) if all(features.get(name) for name in _V3) else (here,)


@cache
def _target(name: str) -> Any:
    """Return the target machine of a level."""
    if name.startswith(architecture()):
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        triple = llvm.get_process_triple()
    else:
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
        triple = f"{name.removesuffix('_v3')}-unknown-linux-gnu"
    return llvm.Target.from_triple(triple).create_target_machine(
        cpu=LEVELS.get(name, ""), features="", opt=3, jit=True, reloc="static",
        codemodel="jitdefault",
    )  # fmt: skip


def optimise(module: Any, *, checked: bool) -> bytes:
    """Optimise a module for this architecture, whatever the level; returns its bitcode.

    Args:
        module: linked.
        checked: whether its indices are checked: it is to be right, and to be there soon.
    """
    target = _target(architecture())
    module.triple = target.triple
    module.data_layout = str(target.target_data)
    module.verify()
    tuning = llvm.create_pipeline_tuning_options(speed_level=1 if checked else 3)
    tuning.loop_vectorization = not checked
    tuning.slp_vectorization = False  # it lengthens recurrences: their numbers go from one place to another and back
    builder = llvm.create_pass_builder(target, tuning)
    passes = builder.getModulePassManager()
    passes.add_strip_symbols_pass()  # names of what is inside count what was compiled before
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, builder)
    module.verify()
    return bytes(module.as_bitcode())


def externals(bitcode: bytes) -> tuple[str, ...]:
    """Return the names that bitcode needs from elsewhere."""
    module = llvm.parse_bitcode(bitcode)
    symbols = (*module.functions, *module.global_variables)
    names = {s.name for s in symbols if s.is_declaration and not s.name.startswith("llvm.")}
    return tuple(sorted(names))


def translate(bitcode: bytes, name: str = "") -> bytes:
    """Return the object code of bitcode for a level (this machine's best)."""
    target = _target(name or levels()[0])
    module = llvm.parse_bitcode(bitcode)
    module.triple = target.triple
    module.data_layout = str(target.target_data)
    return bytes(target.emit_object(module))


@cache
def _engine() -> Any:
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target(architecture()))


@cache
def _libraries() -> tuple[Any, ...]:
    if not hasattr(os, "uname"):  # Windows
        return (ctypes.CDLL("ucrtbase"),)
    names = [ctypes.util.find_library("m") or "libm.so.6", None]
    return tuple(ctypes.CDLL(name) for name in names)


def _resolve(symbol: str) -> None:
    """Make a symbol known to the loader: it ends the process where one is missing.

    Raises:
        KernelError: nobody has it.
    """
    if symbol.startswith(_OF_NUMBA):
        from numba.core.registry import cpu_target  # noqa: PLC0415 - few kernels want this

        _ = cpu_target.target_context
    if llvm.address_of_symbol(symbol):
        return
    for library in _libraries():
        found = getattr(library, symbol, None)
        if found is not None:
            llvm.add_symbol(symbol, ctypes.cast(found, ctypes.c_void_p).value)
            return
    raise KernelError(f"compiled code needs {symbol}, which this system does not have")


def load(symbol: str, needs: tuple[str, ...], code: bytes) -> int:
    """Load object code; returns the address of a function in it, good until the process ends.

    Args:
        symbol: the function.
        needs: symbols from elsewhere.
        code: for this machine.

    Raises:
        KernelError: a symbol that it needs is missing, or it has no such function.
    """
    for need in needs:
        _resolve(need)
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    address = int(engine.get_function_address(symbol))
    if not address:
        raise KernelError(f"compiled code has no {symbol}")
    return address
