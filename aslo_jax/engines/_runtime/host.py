"""What depends on the host: its processors, its vector registers, its machine code."""

import ctypes
import functools
import os
from collections.abc import Callable
from typing import Any

from ..._extras import require
from .._backend.target import AVX2, AVX512, Target


def available_threads() -> int:
    """The processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def target(register: int | None = None) -> Target:
    """This host, or this host as one with narrower registers of so many bytes, which it
    runs as that one would."""
    machine_target()
    llvm = require("llvmlite.binding", "study")
    features = llvm.get_host_cpu_features()
    own = AVX512 if features.get("avx512f") else AVX2
    if register in (None, own.register):
        return own
    if own is not AVX512 or register != AVX2.register:
        raise ValueError(f"This host has no registers of {register} bytes.")
    wide = sorted(f for f in features if f.startswith("avx512"))
    return AVX2._replace(features=",".join(f"-{f}" for f in wide))


def widths() -> tuple[int, ...]:
    """Lanes that a kernel may advance at a time on this host."""
    return target().widths


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
    *[ctypes.c_void_p] * 2,
)


# LLVM's level of optimisation. Kernels of 10 kB to 1 MB of text run as fast with 1 as with
# 3 (ratios of 0.97 to 1.04), since their plan is in the text, and give the same bits; large
# ones are compiled in 0.6 of the time.
LEVEL = 1


@functools.lru_cache(maxsize=128)
def compiled(text: str, features: str = "") -> Callable[..., None]:
    """The machine code of a kernel, with further features of LLVM (`Target`); the engine
    that owns it lives as long as it does."""
    llvm = require("llvmlite.binding", "study")
    module = llvm.parse_assembly(text)
    own = llvm.get_host_cpu_features().flatten()
    machine = machine_target().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=",".join(filter(None, (own, features))),
        opt=LEVEL,
        jit=True,
    )
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    function = _SIGNATURE(engine.get_function_address("kernel"))

    def call(*arguments: Any) -> None:
        function(*arguments)

    call.engine = engine  # pyright: ignore[reportFunctionMemberAccess]
    return call
