"""Whether the tests of the core notice a change of its lines: a seeded sample of the
mutants that Cosmic Ray makes of it, each run against the tests of its module.

    python -m benchmarks.mutation --count 300 --seed 0 --work DIR

The checkout is copied to DIR, so that it stays as it is; a run that was stopped goes on
there. First the tests run once on what is not changed, to tell which run a line and in what
time. Then every mutant meets the quick tests of one file that run its line, those that are
left the quick ones of the other files of its module, and the last ones the rest."""

import argparse
import difflib
import fcntl
import json
import os
import random
import re
import shutil
import sys
from collections import Counter
from itertools import accumulate, chain
from pathlib import Path

from cosmic_ray.commands import init
from cosmic_ray.mutating import use_mutation
from cosmic_ray.plugins import get_operator
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import (
    MutationSpec,
    TestOutcome,
    WorkerOutcome,
    WorkItem,
    WorkResult,
)

from .warm_tests import NONE_COLLECTED, Chosen, Record, Recorder, forked, pytest_in

ROOT = Path(__file__).parents[1]
COPIED = ("aslo_jax", "tests", "pyproject.toml", "README.md", "LICENSE")
# The tests that speak of a module, the quick ones first.
TESTS = {
    "_filters": "filters oracle sampled small realise step relations refused_values",
    "_realise": "realise oracle once step filters sampled schedules hidden_errors missing",
    "_relations": "oracle certificate relations rows sampled once refused_values refusals"
    " gradients",
    "_swapped": "swapped oracle relations sampled rows limits paced_rates",
    "_completions": "oracle certificate rows guard sampled two_rates refused_values errors"
    " missing docstrings",
    "_guard": "guard oracle refused_values sampled missing",
    "_replay": "oracle once sampled step fused_replay estimate_pieces errors refusals"
    " hidden_errors missing",
}
# Not in the sample, since anything kills them: bitwise operators, which floating-point
# numbers refuse, the changes of `X | None` in an annotation, and of the `*` before what is
# given by name, most of which are no Python. Nor, since nothing runs them, the stubs of
# `overload`, which are for pyright.
TRIVIAL = re.compile(r"BinaryOperator_(BitOr_|BitAnd_|.*_(Bit|RShift|LShift))")
STUB = re.compile(r"^@overload\n(.*\n)+?.*\.\.\.$", re.MULTILINE)
# Seconds of processor that the quick tests of the first file, and those of every other one,
# take together where nothing is changed.
QUICK = 3.0, 3.0
PARTS = 3
LATEST = 1200.0  # seconds for tests where nothing is known of them
# Of a mutant one may loop for ever, as integrators do without a number: seconds for them,
# and for each that they take of the processor where nothing is changed.
LEAST, EACH = 120.0, 10.0


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=300, help="mutants in the sample")
    parser.add_argument("--first", type=int, default=1, help="of these to run, from 1 on")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--work", type=Path, default=Path("mutation"), help="where to work")
    parser.add_argument("--quick", action="store_true", help="without what takes long")
    asked = parser.parse_args(argv)
    work = asked.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    lock = (work / "lock").open("w")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        sys.exit(f"Another run works in {work}.")
    tree = work / "tree"
    if not tree.exists():
        copied(ROOT, tree)
        copied(ROOT, work / "unchanged")
    for name in TESTS:  # of a run that was stopped amid a mutant
        shutil.copy(work / "unchanged" / path_of(name), tree / path_of(name))
    if not (work / "record.json").exists():
        baseline(work)
    record = Record.read(work / "record.json")
    with use_db(work / "session.sqlite") as db:
        if not db.num_work_items:
            init([tree / path_of(name) for name in TESTS], db, {})
        chosen = sample(db, asked.count, asked.seed)[max(asked.first, 1) - 1 :]
        for part in range(PARTS - asked.quick):
            done = {item.job_id for item, _ in db.completed_work_items}
            for item in chosen:
                if item.job_id not in done:
                    tested(item, db, work, record, part)
        return report(db, chosen)


def copied(checkout: Path, tree: Path) -> None:
    tree.mkdir(parents=True)
    for name in COPIED:
        source = checkout / name
        if source.is_dir():
            unwanted = shutil.ignore_patterns("__pycache__")
            shutil.copytree(source, tree / name, ignore=unwanted)
        else:
            shutil.copy(source, tree / name)


def path_of(module: str) -> Path:
    return Path("aslo_jax", f"{module}.py")


def files_for(module: str) -> list[str]:
    return [f"tests/test_{name}.py" for name in TESTS[module].split()]


def baseline(work: Path) -> None:
    """The tests pass on what is not changed, which fills the cache of compiled programs,
    and fail where a module cannot be imported, or else they do not see the copy."""
    tree, cache, output = work / "tree", work / "compiled", work / "output.txt"
    modules = [tree / path_of(name) for name in TESTS]
    every = list(dict.fromkeys(file for name in TESTS for file in files_for(name)))

    def recorded() -> int:
        path = work / "record.json"
        return pytest_in(tree, every, cache, lambda: Recorder(path, modules), keep=True)

    if forked(recorded, output, 10 * LATEST):
        (work / "record.json").unlink(missing_ok=True)
        sys.exit(f"{output.read_text()}\nThe tests fail without a mutation.")
    for path in modules:
        kept = path.read_text()
        path.write_text("raise ImportError\n")
        files = files_for(path.stem)[:1]
        broken = forked(
            lambda files=files: pytest_in(tree, files, cache, object, keep=False),
            output,
            LATEST,
        )
        path.write_text(kept)
        if not broken:
            sys.exit(f"The tests of {path.stem} do not import {path}.")


def sample(db: WorkDB, count: int, seed: int) -> list[WorkItem]:
    """The same mutants for the same code, whatever their random names are."""
    items = [item for item in db.work_items if not trivial(item)]
    items.sort(key=lambda item: (*place(item), operator(item), only(item).occurrence))
    return random.Random(seed).sample(items, min(count, len(items)))


def trivial(item: WorkItem) -> bool:
    row, column = only(item).start_pos
    text = only(item).module_path.read_text()
    lines = text.splitlines()
    stubs = (
        range(text[: stub.start()].count("\n"), text[: stub.end()].count("\n") + 1)
        for stub in STUB.finditer(text)
    )
    return (
        bool(TRIVIAL.search(operator(item)))
        or lines[row - 1][column:].startswith("*, ")
        or lines[row - 1].strip() == "*,"
        or any(row - 1 in stub for stub in stubs)
    )


def only(item: WorkItem) -> MutationSpec:
    (mutation,) = item.mutations
    return mutation


def place(item: WorkItem) -> tuple[str, tuple[int, int]]:
    return only(item).module_path.stem, only(item).start_pos


def operator(item: WorkItem) -> str:
    return only(item).operator_name.removeprefix("core/")


def tested(item: WorkItem, db: WorkDB, work: Path, record: Record, part: int) -> None:
    """Against a part of its tests. What is not known after them has no result yet, and is
    told in a file."""
    path = work / "left.json"
    left = json.loads(path.read_text()) if path.exists() else {}
    if left.get(item.job_id, 0) > part:
        return
    begun = processor()
    tests = parts(item, record)[part]
    latest = LEAST + EACH * sum(record.times[test] for test in tests)
    result = mutated(item, work, tests, latest)
    taken = f"{processor() - begun:5.1f} s"
    if part < PARTS - 1 and result.test_outcome == TestOutcome.SURVIVED:
        path.write_text(json.dumps(left | {item.job_id: part + 1}))
        print(taken, "left        ", line(item), flush=True)
        return
    db.set_result(item.job_id, result)
    print(f"{taken} {said(result):12} {line(item)} {killer(result)}", flush=True)


def processor() -> float:
    """Seconds of it that the forks took."""
    times = os.times()
    return times.children_user + times.children_system


def parts(item: WorkItem, record: Record) -> tuple[list[str], ...]:
    """The tests that may notice a mutant, of every file that runs its line: the quick ones
    of the first file, the quick ones of the others, and the rest, file by file; in each
    those first that run the line, and the quick ones of them. The others of a file may look
    at what these have left: at a fixture, or at a program."""
    module, (row, _) = place(item)
    of = [record.tests(module, row, file) for file in files_for(module)]
    of = [each for each in of if each]
    quick = [within(QUICK[k > 0], each, record) for k, each in enumerate(of)]
    rest = [[test for test in a if test not in b] for a, b in zip(of, quick, strict=True)]
    return tuple([*chain(*each)] for each in (quick[:1], quick[1:], rest))


def within(limit: float, tests: list[str], record: Record) -> list[str]:
    """As many of the first `tests` as take less than the `limit` (s), and at least one."""
    taken = [*accumulate(record.times[test] for test in tests)]
    return tests[: max(1, sum(each < limit for each in taken))]


def mutated(item: WorkItem, work: Path, tests: list[str], latest: float) -> WorkResult:
    """What the `tests` say of a mutant within `latest` seconds."""
    failed, output = work / "failed.txt", work / "output.txt"
    failed.write_text("")
    files = list(dict.fromkeys(test.split("::")[0] for test in tests))
    mutation = only(item)
    changes = get_operator(mutation.operator_name)(**mutation.operator_args)
    tree, cache = work / "tree", work / "compiled"

    def run() -> int:
        plugin = lambda: Chosen(tests, failed)
        return pytest_in(tree, files, cache, plugin, keep=False)

    with use_mutation(mutation.module_path, changes, mutation.occurrence) as (old, new):
        status = forked(run, output, latest) if files else NONE_COLLECTED
    survived = status in (0, NONE_COLLECTED)
    by = failed.read_text().strip() or ("too long" if status is None else "import")
    return WorkResult(
        worker_outcome=WorkerOutcome.NORMAL,
        test_outcome=TestOutcome.SURVIVED if survived else TestOutcome.KILLED,
        output="" if survived else by,
        diff=changed(old, new or ""),
    )


def changed(old: str, new: str) -> str:
    """The lines that differ."""
    both = difflib.ndiff(old.splitlines(), new.splitlines())
    return "\n".join(each for each in both if each[:2] in ("- ", "+ "))


def said(result: WorkResult) -> str:
    return result.test_outcome.value if result.test_outcome else "not tested"


def killer(result: WorkResult) -> str:
    return "" if not result.output else f"by {result.output}"


def line(item: WorkItem) -> str:
    module, (row, column) = place(item)
    return f"{module}.py:{row}:{column} {operator(item)}"


def report(db: WorkDB, chosen: list[WorkItem]) -> int:
    """Survivors, with what was changed, and the share that was killed. With `--quick` one
    that the quick tests leave is a survivor."""
    counts: Counter[tuple[str, bool]] = Counter()
    results = {item.job_id: result for item, result in db.completed_work_items}
    for item in chosen:
        result = results.get(item.job_id)
        survived = result is None or result.test_outcome == TestOutcome.SURVIVED
        counts[place(item)[0], survived] += 1
        if survived:
            diff = "" if result is None else result.diff or ""
            print(line(item), *diff.splitlines(), sep="\n    ")
    for module in TESTS:
        killed, survived = counts[module, False], counts[module, True]
        print(f"{module:14} {killed:4} of {killed + survived:4} killed")
    killed = sum(number for (_, survived), number in counts.items() if not survived)
    total = sum(counts.values())
    print(f"{'all':14} {killed:4} of {total:4} killed: {killed / max(total, 1):.1%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
