"""The run: figures for people, and `varying.json`. What is there already is kept."""

import json
import time
from collections.abc import Callable
from typing import Any

from ..results import FOLDER, save
from .contenders import by_speed

AT_MOST = 0.7  # of the best constant rate, over the drive


def main() -> list[str]:
    """Print the tables, write `varying.json`; return what does not hold."""
    import jax

    from . import motor, others

    jax.config.update("jax_enable_x64", True)
    path = FOLDER / "varying.json"
    figures: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    for case in motor.cases():
        own = figures.setdefault(case, {})
        _kept(figures, own, "bound", lambda case=case: motor.bound(case))
        print(f"{case}: rms error of the flux (mWb), and that of each tenth of the time")
        print(f"  {'bound':<22}{_row(own['bound'])}", flush=True)
        for who in motor.contenders():
            f = _kept(figures, own, who, lambda c=case, w=who: motor.judged(c, w))
            print(f"  {who:<22}{_row(f['shares'])}  {_gains(f)}", flush=True)
    for system in others.SYSTEMS:
        own = figures.setdefault(system, {})
        print(f"{system}: median rms error over its scale")
        for who in others.contenders(system):
            f = _kept(figures, own, who, lambda s=system, w=who: others.judged(s, w))
            print(f"  {who:<22}{f['median']:.4g}  {_gains(f)}", flush=True)
    drive, reversal = figures["drive"], figures["reversal"]
    failures = []
    followers = list(by_speed())
    scheduled = min(drive[k]["rms"] for k in followers)
    if (ratio := scheduled / drive["one rate"]["rms"]) > AT_MOST:
        failures.append(f"Over the drive a schedule has {ratio:.2f} of the best rate.")
    scheduled = min(reversal[k]["rms"] for k in followers)
    if (ratio := scheduled / reversal["two rates"]["rms"]) > 1.0:
        failures.append(f"In the reversal a schedule has {ratio:.2f} of two rates.")
    return failures


def _kept(figures: Any, own: dict[str, Any], name: str, make: Callable[[], Any]) -> Any:
    if name not in own:
        start = time.perf_counter()
        own[name] = make()
        if isinstance(own[name], dict):
            own[name]["seconds"] = time.perf_counter() - start
        save("varying", figures)
    return own[name]


def _row(shares: list[float]) -> str:
    pooled = (sum(x * x for x in shares) / len(shares)) ** 0.5
    each = " ".join(f"{1e3 * x:7.3f}" for x in shares)
    return f"{1e3 * pooled:8.3f}: {each}"


def _gains(figures: dict[str, Any]) -> str:
    return ", ".join(f"{k} {v:.3g}" for k, v in figures["gains"].items())
