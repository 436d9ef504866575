"""Tests of a copy of the package in a fork of this process, which has imported what they
need but the package: a run begins in a second, and ends with the first test that fails."""

import importlib
import json
import os
import signal
import sys
import time
import traceback
import warnings
from collections import defaultdict
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, NamedTuple

import coverage
import pytest

# Nothing of this asks JAX for a device: its threads would not survive a fork.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
for _name in (
    "beartype",
    "coverage",
    "diffrax",
    "equinox",
    "hypothesis",
    "jax",
    "jaxtyping",
    "llvmlite.binding",
    "numpy",
    "optax",
    "pydantic",
    "scipy.integrate",
    "scipy.linalg",
    "tomlkit",
):
    importlib.import_module(_name)

NONE_COLLECTED = pytest.ExitCode.NO_TESTS_COLLECTED


class Record(NamedTuple):
    """What the tests do where nothing is changed: their processor time (s), in the order in
    which they run, and the tests that run a line, by the names of file and test; `None`
    for the lines that an import runs."""

    times: dict[str, float]
    lines: dict[str, dict[int, list[str] | None]]

    @classmethod
    def read(cls, path: Path) -> "Record":
        found = json.loads(path.read_text())
        lines = {
            name: {int(row): tests for row, tests in rows.items()}
            for name, rows in found["lines"].items()
        }
        return cls(found["times"], lines)

    def tests(self, module: str, row: int, file: str) -> list[str]:
        """The tests of a file, those first that run a line, and the quick ones of them;
        none where no test does. A line that no test is known to run may be a part of a
        longer one, and is for all of them."""
        known = self.lines.get(module, {}).get(row)
        every = [test for test in self.times if test.split("::")[0] == file]
        running = {*every} if known is None else {*every} & {*known}
        order = lambda test: (test not in running, self.times[test])
        return sorted(every, key=order) if running else []


class Recorder:
    """A plug-in of pytest that writes a [`Record`][] of `modules` to a file."""

    def __init__(self, path: Path, modules: list[Path]) -> None:
        self.path, self.modules = path, modules
        self.times: dict[str, float] = {}
        self.current = ""
        # Of fixtures that tests share, with what they take (s) and the tests that ask for
        # them: each of these runs what such a one runs, whoever is the first.
        self.shared: dict[str, float] = {}
        self.users: dict[str, list[str]] = defaultdict(list)
        include = [str(module) for module in modules]
        self.coverage = coverage.Coverage(None, include=include, config_file=False)
        self.coverage.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Generator[None]:
        if fixturedef.scope == "function":
            return (yield)
        key = f"{fixturedef.argname} {getattr(request, 'param_index', 0)}"
        begun = time.process_time()
        self.coverage.switch_context(key)
        result = yield
        self.coverage.switch_context(self.current)
        self.shared[key] = time.process_time() - begun
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Generator[None]:
        self.current = item.nodeid
        self.coverage.switch_context(self.current)
        indices = item.callspec.indices if hasattr(item, "callspec") else {}
        keys = [f"{name} {indices.get(name, 0)}" for name in item.fixturenames]
        begun, known = time.process_time(), sum(self.shared.get(key, 0.0) for key in keys)
        result = yield
        self.times[item.nodeid] = known + time.process_time() - begun
        for key in keys:
            self.users[key].append(item.nodeid)
        self.coverage.switch_context("")
        return result

    def pytest_sessionfinish(self) -> None:
        self.coverage.stop()
        data, lines = self.coverage.get_data(), defaultdict(dict)
        for module in self.modules:
            for row, contexts in data.contexts_by_lineno(str(module)).items():
                tests = (test for each in contexts for test in self.users.get(each, [each]))
                lines[module.stem][row] = (
                    None if "" in contexts else [*dict.fromkeys(tests)]
                )
        found = {"times": self.times, "lines": lines}
        self.path.write_text(json.dumps(found))


class Chosen:
    """A plug-in of pytest that runs these `tests` in this order, and names in `failed` the
    ones that fail."""

    def __init__(self, tests: list[str], failed: Path) -> None:
        self.rank = {test: k for k, test in enumerate(tests)}
        self.failed = failed

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        items[:] = [item for item in items if item.nodeid in self.rank]
        items.sort(key=lambda item: self.rank[item.nodeid])

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            with self.failed.open("a") as file:
                file.write(f"{report.nodeid}\n")


def pytest_in(
    tree: Path, files: list[str], cache: Path, plugin: Callable[[], object], *, keep: bool
) -> int:
    """What pytest gives for `files` of the `tree`, in this process, which is to end then;
    `keep`: whether what Python compiles is written beside it."""
    os.chdir(tree)
    sys.dont_write_bytecode = not keep
    sys.path.insert(0, str(tree))
    os.environ.update(PYTHONPATH=str(tree), ASLO_JAX_TEST_CACHE=str(cache))
    if not keep:
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    settings = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--rootdir", str(tree)]
    settings += ["-W", "ignore:Module already imported:pytest.PytestAssertRewriteWarning"]
    return int(pytest.main([*settings, *files], plugins=[plugin()]))


def forked(run: Callable[[], int], output: Path, latest: float) -> int | None:
    """The exit status of `run` in a fork, which writes to `output`; `None` where it takes
    longer than `latest` (s), and is killed then with all that it started."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of forks where JAX has threads: it has none yet
        child = os.fork()
    if not child:
        status = 1
        try:
            os.setsid()
            file = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(file, 1)
            os.dup2(file, 2)
            status = run()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    end = time.monotonic() + latest
    while time.monotonic() < end:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None
