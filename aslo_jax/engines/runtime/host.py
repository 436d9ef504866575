"""What depends on the host: its processors, its vector registers, its machine code."""

import ctypes
import functools
import os
from collections.abc import Callable
from typing import Any

from ..._extras import require


def available_threads() -> int:
    """The processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def widths() -> tuple[int, ...]:
    """Lanes that a kernel may advance at a time on this host, in one register of doubles or
    in several that take turns. On AVX2 two registers run 1.2 times as fast as one, and
    three as fast as two."""
    return (8, 16, 32) if register() == 64 else (4, 8)


@functools.cache
def register() -> int:
    """Bytes of the vector registers of this host."""
    machine_target()
    llvm = require("llvmlite.binding", "study")
    return 64 if llvm.get_host_cpu_features().get("avx512f") else 32


@functools.cache
def machine_target() -> Any:
    llvm = require("llvmlite.binding", "study")
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


_SIGNATURE = ctypes.CFUNCTYPE(
    None,
    *[ctypes.c_int64] * 3,
    ctypes.c_void_p,
    ctypes.c_int64,
    ctypes.c_void_p,
)


@functools.lru_cache(maxsize=128)
def compiled(text: str) -> Callable[..., None]:
    """The machine code of a kernel; the engine that owns it lives as long as it does."""
    target = machine_target()
    llvm = require("llvmlite.binding", "study")
    module = llvm.parse_assembly(text)
    machine = target.create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        jit=True,
    )
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    function = _SIGNATURE(engine.get_function_address("kernel"))

    def call(*arguments: Any) -> None:
        function(*arguments)

    call.engine = engine  # pyright: ignore[reportFunctionMemberAccess]
    return call
