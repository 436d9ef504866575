"""What other projects simulate per second, of their own models: not the same work, since
none has the observers, but the same motor.

They want other versions of what this library depends on. `python -m benchmarks peers
--install` makes each a virtual environment in the folder of temporary files, with pip;
without it those that are there already are measured, each in a process of its own."""

import json
import subprocess
import tempfile
import venv
from pathlib import Path
from typing import Any

from ..results import save

FOLDER = Path(tempfile.gettempdir()) / "aslo-jax-peers"
PEERS = {
    "exciting-environments": ("exciting.py", ["exciting-environments", "diffrax==0.5.1"]),
    "jaxonomy": ("jaxonomy_batch.py", ["jaxonomy>=3"]),
    "motulator": ("motulator_drive.py", ["motulator"]),
}
LONGEST = 600  # s, of one peer


def _python(name: str) -> Path:
    return FOLDER / name / "bin" / "python"


def install(name: str) -> None:
    """Its environment, if there is none yet."""
    done = FOLDER / name / "installed"
    if done.exists():
        return
    venv.create(FOLDER / name, with_pip=True, clear=True)
    command = [str(_python(name)), "-m", "pip", "install", "--quiet", *PEERS[name][1]]
    print(f"  {name}: installing")
    subprocess.run(command, check=True, stderr=subprocess.PIPE, text=True)
    done.touch()


def measure(name: str) -> dict[str, Any]:
    """Its figures; or why there are none."""
    if not (FOLDER / name / "installed").exists():
        return {"why": "not installed: python -m benchmarks peers --install"}
    script = Path(__file__).with_name(PEERS[name][0])
    done = subprocess.run(
        [str(_python(name)), "-W", "ignore", str(script)],
        capture_output=True,
        text=True,
        cwd=FOLDER,
        timeout=LONGEST,
    )
    if done.returncode:
        return {"why": "fails: " + (done.stderr.strip().splitlines() or ["silently"])[-1]}
    return json.loads(done.stdout.splitlines()[-1])


def measure_all(wanted: bool = False) -> dict[str, dict[str, Any]]:
    """Of every peer; if `wanted`, after installing it."""
    found = {}
    for name in PEERS:
        try:
            if wanted:
                install(name)
            found[name] = measure(name)
        except subprocess.TimeoutExpired:
            found[name] = {"why": f"takes more than {LONGEST} s"}
        except subprocess.CalledProcessError as error:
            last = (error.stderr or "").strip().splitlines() or ["pip fails"]
            found[name] = {"why": "does not install: " + last[-1]}
    return found


def report(found: dict[str, dict[str, Any]], fused: float | None = None) -> None:
    """Print the table; beside `fused`, our million steps per second with observers."""
    print("Other projects, the plant of their own model, without observers")
    for name, f in found.items():
        if "why" in f:
            print(f"  {name:<23}{f['why']}")
            continue
        ratio = "" if fused is None else f"{fused / f['speed']:>11.4g}"
        print(f"  {name:<23}{f['speed']:>10.3g} M steps/s{ratio}  {f['what']}")
    if fused is not None:
        print("  (the ratio: of fused, with controller and observers, over theirs)")


def main(wanted: bool = False) -> list[str]:
    found = measure_all(wanted)
    report(found)
    save("peers", found)
    return []
