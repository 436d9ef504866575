"""Runs random programs in a process of their own, since a fault of a compiled loop ends the
one that it runs in.

    python tests/many_programs.py --count 300 --seed 1000    as many, from that seed on
    python tests/many_programs.py --seed 1234 --reduce       one, made as short as it fails
"""

import argparse
import dataclasses
import json
import os
import select
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import jax
from program_checks import Outcome, outcome
from random_programs import Code, Line, generate, reduced, source

SECONDS = 120.0  # for one program; the longest takes a tenth of them


def outcomes(codes: list[Code]) -> Iterator[Outcome]:
    """Of each program: a process that dies, hangs or raises is what is wrong with it, and
    the next one goes on in another."""
    child = None
    for code in codes:
        child = _started() if child is None else child
        assert child.stdin and child.stdout
        child.stdin.write(json.dumps(code) + "\n")
        child.stdin.flush()
        ready, _, _ = select.select([child.stdout], [], [], SECONDS)
        answer = child.stdout.readline() if ready else ""
        if answer:
            yield Outcome(**json.loads(answer))
            continue
        child.kill()
        ended = f"exit status {child.wait()}" if ready else f"no end in {SECONDS:.0f} s"
        yield Outcome(code.seed, wrong=f"the process of the program: {ended}\n")
        child = None
    if child is not None:
        child.communicate()


def _started() -> subprocess.Popen:
    command = [sys.executable, __file__, "--child"]
    folder = str(Path(__file__).parents[1])
    paths = [*filter(None, [os.environ.get("PYTHONPATH")]), folder]
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
        | {"PYTHONPATH": os.pathsep.join(paths), "JAX_ENABLE_X64": "true"}
        # The oracle is compiled for a few lanes and steps.
        | {"JAX_DISABLE_MOST_OPTIMIZATIONS": "true"},
    )


def _child() -> None:
    """A program a line in, an outcome a line out."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what anything else prints
    for line in sys.stdin:
        *head, lines, ends, kept = json.loads(line)
        made = [tuple(Line(*each[:3], tuple(each[3])) for each in x) for x in (lines, ends)]
        code = Code(*head, *made, tuple(map(tuple, kept)))
        try:
            found = outcome(code)
        except Exception as error:
            found = Outcome(code.seed, wrong=f"{type(error).__name__}: {error}\n")
        print(json.dumps(dataclasses.asdict(found)), file=out, flush=True)
        jax.clear_caches()


def report(code: Code, found: Outcome) -> str:
    return f"{found.wrong}{source(code)}"


def shortest(code: Code) -> Code:
    """Of those that fail."""
    return reduced(code, lambda smaller: bool(next(outcomes([smaller])).wrong))


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reduce", action="store_true")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.child:
        _child()
        return 0
    codes = [generate(chosen.seed + n) for n in range(chosen.count)]
    refused = compared = unsettled = 0
    failed = []
    for code, found in zip(codes, outcomes(codes), strict=True):
        compared, unsettled = compared + found.compared, unsettled + found.unsettled
        if found.refused:
            refused += 1
            print(f"refused {code.seed}: {found.refused}", flush=True)
        if found.wrong:
            failed.append(code.seed)
            print(
                f"WRONG {report(shortest(code) if chosen.reduce else code, found)}",
                flush=True,
            )
    print(
        f"{chosen.count} programs, {refused} refused, wrong: {failed or 'none'}; "
        f"{compared} numbers compared, {unsettled} not settled"
    )
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
