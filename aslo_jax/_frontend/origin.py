"""Where an equation comes from, as its user sees it: their line, and the public function of
JAX that they called there."""

import os
import sysconfig
import traceback
from pathlib import Path
from typing import Any, NamedTuple

import equinox
import jax
import jaxtyping
import numpy as np

# Where functions of a file of JAX are public: parts of its path, and modules.
PUBLIC = (
    (("numpy", "linalg"), "jnp.linalg", jax.numpy.linalg),
    (("numpy", "fft"), "jnp.fft", jax.numpy.fft),
    (("numpy",), "jnp", jax.numpy),
    (("ops",), "jax.ops", jax.ops),
    (("scipy", "linalg"), "jax.scipy.linalg", jax.scipy.linalg),
    (("scipy", "special"), "jax.scipy.special", jax.scipy.special),
    (("scipy",), "jax.scipy.special", jax.scipy.special),
    (("nn",), "jax.nn", jax.nn),
    (("random",), "jax.random", jax.random),
    (("lax", "linalg"), "jax.lax.linalg", jax.lax.linalg),
    (("lax",), "jax.lax", jax.lax),
    (("callback",), "jax", jax),
)
# Functions that are public by another name than their own.
RENAMED = {
    "debug_callback": "jax.debug.callback",
    "debug_print": "jax.debug.print",
    "io_callback": "jax.experimental.io_callback",
}
UPDATES = ("set", "add", "subtract", "multiply", "divide", "power", "min", "max", "apply")


class Origin(NamedTuple):
    """`line` is "file:number", `function` a public name, each empty if unknown; `ours` says
    that the line is one of this library's."""

    line: str = ""
    function: str = ""
    ours: bool = True


def _plain(path: str | Path) -> str:
    return os.path.normcase(os.path.normpath(str(path)))


def _folder(path: str | Path) -> str:
    return _plain(path) + os.sep


def _of(module: Any) -> str:
    return _folder(Path(module.__file__).parent)


LIBRARY = _folder(Path(__file__).parents[1])
JAX = _of(jax)
SITE = tuple(_folder(sysconfig.get_path(kind)) for kind in ("purelib", "platlib"))
EQUINOX = _of(equinox)
FOREIGN = (JAX, EQUINOX, _of(jaxtyping), _of(np))
STANDARD = _folder(sysconfig.get_path("stdlib"))
TYPED = ("<stdin>", "<ipython")  # what people type has no file


def is_foreign(file: str) -> bool:
    """Whether a file is of JAX, of what it is used through, or of Python itself."""
    if file.startswith("<"):
        return not file.startswith(TYPED)
    path = _plain(file)
    if path.startswith(FOREIGN):
        return True
    return path.startswith(STANDARD) and not path.startswith(SITE)


def public(name: str, file: str) -> str:
    """The public name of a function of a file of JAX or Equinox, if it has one."""
    path = _plain(file)
    name = name.rpartition(".")[2].lstrip("_")
    if path.startswith(EQUINOX) and name == "error_if":
        return "eqx.error_if"
    if not path.startswith(JAX):
        return ""
    parts = Path(path[len(JAX) :]).with_suffix("").parts
    if name in RENAMED:
        return RENAMED[name]
    if parts[-1] == "array_methods" and name in UPDATES:
        return f".at[...].{name}"
    for wanted, module, where in PUBLIC:
        if all(part in parts for part in wanted) and hasattr(where, name):
            return f"{module}.{name}"
    return ""


def origin(frames: list[tuple[str, str, int]]) -> Origin:
    """Of a traceback, innermost frame first: function, file and line of each."""
    callers = [k for k, (_, file, _) in enumerate(frames) if not is_foreign(file)]
    last = callers[0] if callers else len(frames)
    names = (public(name, file) for name, file, _ in reversed(frames[:last]))
    function = next(filter(None, names), "")
    theirs = [k for k in callers if not _plain(frames[k][1]).startswith(LIBRARY)]
    for k in (*theirs, *callers):
        _, file, line = frames[k]
        return Origin(f"{file}:{line}", function, not theirs)
    return Origin("", function)


def _called(params: dict[str, Any]) -> list[tuple[str, str]]:
    """The names and files of the functions that an equation calls."""
    found = []
    for value in params.values():
        for inner in value if isinstance(value, list | tuple) else (value,):
            jaxpr = getattr(inner, "jaxpr", inner)
            info = getattr(getattr(jaxpr, "debug_info", None), "func_src_info", None)
            if info:
                name, _, place = str(info).partition(" at ")
                found.append((name, place.rpartition(":")[0]))
    return found


def located(found: Origin, equation: Any) -> Origin:
    """What is known of a failure within an equation, with what the equation itself says.

    JAX keeps what it has traced: a line within one of its own functions may be that of an
    earlier call, so the call's own line is preferred."""
    trace = equation.source_info.traceback
    frames = [] if trace is None else trace.frames
    here = origin([(f.function_name, f.file_name, f.line_num) for f in frames])
    called = _called(equation.params)
    of_jax = bool(called) and all(_plain(file).startswith(JAX) for _, file in called)
    names = (public(name, file) for name, file in called)
    function = here.function or (next(filter(None, names), "") if of_jax else "")
    if not found.line or (of_jax and here.line):
        return Origin(here.line, function or found.function, here.ours)
    if found.ours and here.line and not here.ours:
        return here._replace(function=found.function or function)
    return found if found.function else found._replace(function=function)


def with_caller(found: Origin) -> Origin:
    """With the line at which a user now calls this library, where their own is not known:
    JAX leaves out what was called before it began to trace."""
    if found.line and not found.ours:
        return found
    stack = traceback.walk_stack(None)
    frames = [(f.f_code.co_name, f.f_code.co_filename, line) for f, line in stack]
    caller = origin(frames)
    return found if caller.ours else caller._replace(function=found.function)


def described(primitive: str, found: Origin) -> str:
    place = f" of {found.line}" if found.line else ""
    if found.function:
        return f"`{found.function}` (primitive `{primitive}`){place}"
    return f"the primitive `{primitive}`{place}"
