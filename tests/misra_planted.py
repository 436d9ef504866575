"""A violation of every rule of MISRA C:2012 that cppcheck's addon can find, in
`data/misra_planted.txt`: what the check of exported C is known to see. Numbers only, since
the texts are licensed."""

import json
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

PLANTED = Path(__file__).parent / "data" / "misra_planted.txt"


def planted() -> dict[str, list[str]]:
    """The files with a violation by the rule, whose names no other has."""
    found = {}
    for part in re.split("^== ", PLANTED.read_text("utf-8"), flags=re.MULTILINE)[1:]:
        rule, _, text = part.partition("\n")
        own = rule.replace(".", "_")
        text = re.sub(r"\b(f|same|planted)\b", rf"\1_{own}", text)
        found[rule] = text.split("-- and\n")
    return found


def violated(folder: Path, names: Sequence[str]) -> dict[str, set[str]]:
    """The numbers of the rules that files violate, by file."""
    rules = "".join(f"Rule {rule} Required\nNumber {rule}.\n" for rule in planted())
    # With texts of their own: of two violations at one place that read alike, cppcheck
    # tells the first only.
    texts = folder / "texts.txt"
    texts.write_text(f"Appendix A Summary of guidelines\n{rules}")
    addon = {"script": "misra.py", "args": [f"--rule-texts={texts}"]}
    (folder / "misra.json").write_text(json.dumps(addon))
    check = ["cppcheck", f"--addon={folder}/misra.json", "--std=c99", "--enable=style"]
    done = subprocess.run(
        [*check, "--quiet", *names], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = {name: set[str]() for name in names}
    pattern = r"^(\S+):\d+:\d+: .*\[misra-c2012-(\d+\.\d+)\]$"
    for name, rule in re.findall(pattern, done.stderr, re.MULTILINE):
        found.setdefault(name, set()).add(rule)
    return found
