"""Every test runs in float64 with warnings as errors (pyproject.toml) and fixed seeds.

Compilation takes most of the time of the tests, which is why XLA is set as below. The
settings reach the processes that a test starts through the environment.

`aslo_jax` must not be imported here: the checks of its annotations are installed first.
"""

import gc
import os
import shutil
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

# Before JAX is imported. The programs of the tests are small and run once: LLVM on every
# fusion by itself, through MLIR, its optimisation, and a program in parts for threads cost
# more than they bring, about half of the time of a test. Set it to nothing for code that
# users run. XLA aborts on a flag that it does not know: these are known to every version
# from 0.7.2 to 0.12, but that of the emitters only to 0.10.
if (0, 10) < tuple(map(int, version("jaxlib").split(".")[:2])) <= (0, 12):
    os.environ.setdefault(
        "XLA_FLAGS",
        "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1",
    )
if tuple(map(int, version("jaxlib").split(".")[:2])) <= (0, 10):
    os.environ.setdefault(
        "XLA_FLAGS",
        "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0 "
        "--xla_cpu_parallel_codegen_split_count=1",
    )

# Two workers fill two processors: a second thread of NumPy's linear algebra only spins.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hypothesis
import jax
import pytest
from jaxtyping import install_import_hook

# Shapes and types of annotations are checked while the tests run, in the modules that
# annotate arrays. The others are for pyright: a checked call takes 30 microseconds, and the
# fused engine makes a million of them on single numbers.
ROOT = Path(__file__).parents[1]
install_import_hook(
    [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in sorted((ROOT / "aslo_jax").rglob("*.py"))
        if "jaxtyping" in path.read_text()
    ],
    "beartype.beartype",
)

jax.config.update("jax_enable_x64", True)

hypothesis.settings.register_profile(
    "fixed", derandomize=True, deadline=None, database=None
)
hypothesis.settings.load_profile("fixed")

# Tracing makes objects by the million and hardly a cycle: looking for one after every 700
# takes a tenth of the time.
gc.set_threshold(100_000)


def pytest_configure(config: pytest.Config) -> None:
    """Programs that were compiled for one module are loaded by the next, and by the
    processes of its tests. Each worker has its own folder, since JAX writes to it without
    a lock; `ASLO_JAX_TEST_CACHE` is one that is kept, for a run in one process."""
    folder = os.environ.get("ASLO_JAX_TEST_CACHE", "")
    if not folder:
        folder = tempfile.mkdtemp(prefix="aslo_jax_compiled_")
        config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))
    settings = {
        "jax_compilation_cache_dir": folder,
        "jax_persistent_cache_min_compile_time_secs": 0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    for name, value in settings.items():
        jax.config.update(name, value)
        os.environ[name.upper()] = str(value)


# The modules that take longest, in this order and before all others, so that the workers,
# which take a module at a time (--dist=loadfile), end together.
LONGEST = (
    "test_battery",
    "test_docs",
    "test_velocity",
    "test_engines",
    "test_identity",
    "test_random_programs",
    "test_paper_section4",
    "test_calibrate",
    "test_tune",
    "test_paper_section2",
    "test_paper_section3",
    "test_interior_pmsm",
    "test_gradients",
    "test_tune_study",
    "test_study",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))


def pytest_collection_finish() -> None:
    """What has been imported stays, and is not looked through again."""
    gc.freeze()


@pytest.fixture(autouse=True, scope="module")
def forget_compiled_code() -> Iterator[None]:
    """A worker that keeps the compiled code of every test ends with more than 4 GB."""
    yield
    jax.clear_caches()


@pytest.fixture(autouse=True, scope="session")
def verified_loops() -> Iterator[None]:
    """Every loop that is optimised in this process is checked after each of its passes."""
    from aslo_jax._ir.verifier import verify
    from aslo_jax.engines import _passes as passes

    before, passes.CHECK = passes.CHECK, lambda name, loop: verify(loop)
    yield
    passes.CHECK = before


# Of the study of `studies`, which must not be imported before the checks of annotations
# are installed.


@pytest.fixture(scope="session")
def whole():
    """A study in one piece, in memory."""
    import studies

    return studies.run_study()


@pytest.fixture(scope="session")
def stored(tmp_path_factory):
    """The path of the same in a store, chunk by chunk, by one thread: to be copied."""
    import studies

    path = tmp_path_factory.mktemp("study") / "run.zarr"
    studies.run_study(store=path, chunk=1, threads=1)
    return path
