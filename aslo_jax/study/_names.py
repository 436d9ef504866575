"""Names of what a study stores: an array each, in a folder of its own, read by xarray."""

from collections.abc import Iterable

RESERVED = ("sample", "observer", "entry", "time", "done", "chunk", "error")
LONGEST = 100  # characters; file systems have 255 bytes


def check_names(
    observers: Iterable[str], metrics: Iterable[str], parameters: Iterable[str]
) -> None:
    """Refuse names that a store, a table or a figure cannot hold, and those of two arrays
    that would be one. `parameters` are stored as `parameter_<name>`.

    **Raises:** `ValueError` that names the key, `metrics.NAME` for instance.
    """
    for name in observers:
        _plain(f"observers.{name}", name, "/\\")
    taken = {name: f"`{name}` of every study" for name in RESERVED}
    metrics = list(metrics)
    for table, names in (("metrics", metrics), ("spread", parameters)):
        for name in names:
            key = f"{table}.{name}"
            _plain(key, name, "/\\.")
            stored = name if table == "metrics" else f"parameter_{name}"
            # Some file systems have one folder for names that differ in their case.
            folded = stored.casefold()
            if folded in taken:
                raise ValueError(
                    f"`{key}` would be stored under the name of {taken[folded]}; choose "
                    "another name."
                )
            taken[folded] = f"`{key}`"
            if table == "metrics":
                taken[f"{folded}_entry"] = f"the entries of `{key}`"


def _plain(key: str, name: str, without: str) -> None:
    bad = next((c for c in name if c in without or not c.isprintable()), None)
    if not name or name != name.strip() or len(name) > LONGEST or name.startswith("__"):
        fault = f"is {name!r}" if len(name) <= LONGEST else f"has {len(name)}"
    elif name in (".", ".."):
        fault = f"is {name!r}"
    elif bad is not None:
        fault = f"has {bad!r}"
    else:
        return
    signs = " ".join(without)
    raise ValueError(
        f"`{key}` must have a name of 1 to {LONGEST} characters that can be printed, "
        f"without {signs}, spaces at its ends and `__` before it, but it {fault}."
    )
