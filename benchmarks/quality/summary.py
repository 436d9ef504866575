"""What a table says of a contender, from its runs; of motors and of mechanisms."""

from typing import TYPE_CHECKING, Any

from .contenders import Contender

if TYPE_CHECKING:
    import numpy as np


def summary(
    contender: Contender,
    gains: "np.ndarray",
    exact: dict[str, Any],
    starts: dict[str, Any],
    wrong: dict[str, Any],
    errors: int,
) -> dict[str, Any]:
    """Of the runs with exact parameters, from many starts and with wrong parameters.

    - `gains`: what it is tuned to; the first row is shown.
    - `exact`, `starts`, `wrong`: a number for each run by the name of what is measured.
    - `errors`: how many kinds of wrong parameters `wrong` has, one after the other.
    """
    import numpy as np

    pooled = lambda x: float(np.sqrt(np.mean(x**2)))
    found = {
        "gains": dict(zip(contender.gains, gains[0].tolist(), strict=False)),
        "rms": pooled(exact["rms"]),
        "median": float(np.median(exact["rms"])),
        "diverged": int(starts["diverged"].sum()),
        "starts": starts["diverged"].size,
        "wrong": pooled(wrong["rms"]),
        "by error": [pooled(x) for x in wrong["rms"].reshape(errors, -1)],
        "runs": wrong["rms"].size,
        "flagged": int((wrong["flagged"] > 0).sum()),
    }
    for name, which in (("", exact), ("wrong ", wrong)) if contender.claims else ():
        found[name + "normalised"] = float(which["normalised"].mean())
        found[name + "covered"] = float(which["covered"].mean())
    return found
