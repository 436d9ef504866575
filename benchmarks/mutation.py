"""Whether the tests of the core notice a change of its lines: a seeded sample of the
mutants that Cosmic Ray makes of it, each run against the tests of its module.

    python -m benchmarks.mutation --count 300 --seed 0 --work DIR

The checkout is copied to DIR, so that it stays as it is; a run that was stopped goes on
there. It takes an hour or two of one processor."""

import argparse
import random
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

from cosmic_ray.commands import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome, WorkItem, WorkResult

ROOT = Path(__file__).parents[1]
COPIED = ("aslo_jax", "tests", "pyproject.toml", "README.md", "LICENSE")
# The tests that speak of a module, the quick ones first: the first failure ends a mutant.
TESTS = {
    "_filters": "filters oracle sampled small realise step relations refused_values",
    "_realise": "oracle realise once step filters sampled hidden_errors missing",
    "_relations": "oracle relations rows sampled once refused_values refusals gradients",
    "_swapped": "oracle sampled rows relations limits paced_rates",
    "_completions": "oracle guard rows sampled two_rates refused_values errors missing",
    "_guard": "oracle guard refused_values sampled missing",
    "_replay": "sampled once step errors refusals hidden_errors missing",
}
# Not in the sample, since anything kills them: bitwise operators, which floating-point
# numbers refuse, and the changes of `X | None` in an annotation.
TRIVIAL = re.compile(r"BinaryOperator_(BitOr_|BitAnd_|.*_(Bit|RShift|LShift))")
LATEST = 900.0  # seconds for the tests of a mutant, of which one may loop for ever


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=300, help="mutants in the sample")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--work", type=Path, default=Path("mutation"), help="where to work")
    asked = parser.parse_args(argv)
    tree = asked.work.resolve() / "tree"
    if not tree.exists():
        copied(tree)
    with use_db(asked.work / "session.sqlite") as db:
        if not db.num_work_items:
            modules = [tree / "aslo_jax" / f"{name}.py" for name in TESTS]
            init(modules, db, {})
            baseline(tree)
        done = {item.job_id for item, _ in db.completed_work_items}
        for item in sample(db, asked.count, asked.seed):
            if item.job_id not in done:
                result = tested(item, tree)
                db.set_result(item.job_id, result)
                print(line(item, result), flush=True)
        return report(db)


def copied(tree: Path) -> None:
    tree.mkdir(parents=True)
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            unwanted = shutil.ignore_patterns("__pycache__")
            shutil.copytree(source, tree / name, ignore=unwanted)
        else:
            shutil.copy(source, tree / name)


def command(tree: Path, module: str) -> str:
    tests = " ".join(f"{tree}/tests/test_{name}.py" for name in TESTS[module].split())
    # From the copy, which is then what is imported, and not the checkout.
    cache = f"ASLO_JAX_TEST_CACHE={tree.parent}/compiled"
    start = f"env -C {tree} PYTHONPATH={tree} {cache}"
    settings = f"-p no:cacheprovider -c {tree}/pyproject.toml --rootdir {tree}"
    return f"{start} {sys.executable} -m pytest -x -q -n 0 {settings} {tests}"


def baseline(tree: Path) -> None:
    """The tests pass on what is not changed, which fills the cache of compiled programs,
    and fail where a module cannot be imported, or else they do not see the copy."""
    for module in TESTS:
        asked = command(tree, module).split()
        if subprocess.run(asked, check=False).returncode:
            sys.exit(f"The tests of {module} fail without a mutation.")
        path = tree / "aslo_jax" / f"{module}.py"
        kept = path.read_text()
        path.write_text("raise ImportError\n")
        broken = subprocess.run(asked, check=False, capture_output=True).returncode
        path.write_text(kept)
        if not broken:
            sys.exit(f"The tests of {module} do not import {path}.")


def sample(db: WorkDB, count: int, seed: int) -> list[WorkItem]:
    """The same mutants for the same code, whatever their random names are."""
    items = [item for item in db.work_items if not TRIVIAL.search(operator(item))]
    items.sort(key=lambda item: (*place(item), operator(item)))
    return random.Random(seed).sample(items, min(count, len(items)))


def place(item: WorkItem) -> tuple[str, tuple[int, int]]:
    (mutation,) = item.mutations
    return mutation.module_path.stem, mutation.start_pos


def operator(item: WorkItem) -> str:
    (mutation,) = item.mutations
    return mutation.operator_name.removeprefix("core/")


def tested(item: WorkItem, tree: Path) -> WorkResult:
    return mutate_and_test(item.mutations, command(tree, place(item)[0]), LATEST)


def line(item: WorkItem, result: WorkResult) -> str:
    module, (row, _) = place(item)
    outcome = result.test_outcome.value if result.test_outcome else "not tested"
    return f"{outcome:12} {module}.py:{row:<4} {operator(item)}"


def report(db: WorkDB) -> int:
    """Survivors, with what was changed, and the share that was killed."""
    counts: Counter[tuple[str, bool]] = Counter()
    for item, result in db.completed_work_items:
        survived = result.test_outcome == TestOutcome.SURVIVED
        counts[place(item)[0], survived] += 1
        if survived:
            changed = [
                each
                for each in (result.diff or "").splitlines()
                if each[:1] in "+-" and each[:3] not in ("+++", "---")
            ]
            print(line(item, result), *changed, sep="\n    ")
    for module in TESTS:
        killed, survived = counts[module, False], counts[module, True]
        print(f"{module:14} {killed:4} of {killed + survived:4} killed")
    killed = sum(number for (_, survived), number in counts.items() if not survived)
    total = sum(counts.values())
    print(f"{'all':14} {killed:4} of {total:4} killed: {killed / max(total, 1):.1%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
