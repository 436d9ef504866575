"""The state of the explorer, which its address holds as a whole."""

import dataclasses
import math
from collections.abc import Mapping
from urllib.parse import parse_qsl, quote, urlencode

LONGEST = 6000  # characters of a query
MOST = 200  # values in one
SEEDS = 2**31
WIDEST = 3.0  # times the tolerances of the study
NOT_FINITE = ("inf", "infinity", "nan")
REQUEST = ("n", "client", "observer_name", "format")  # of a request, not of the state


class StateError(ValueError):
    """An address that holds no state: names the key and what it may be."""


@dataclasses.dataclass(frozen=True)
class State:
    """What is shown.

    - `source`: what is observed: a ready-made study, `"study"` that was opened, or `"log"`;
    - `observers`: the names of those that are shown, by default those of the source;
    - `horizon` (s): how long a simulated run is, by default that of the source;
    - `seed`: of the noise;
    - `tolerance`: by how much of the study's tolerances the runs of the band differ;
    - `values`: of every knob that is not at its default, by key: a number, or a word.

    **Raises:** [`StateError`][] for a number that is not finite, or out of range.
    """

    source: str
    observers: tuple[str, ...] = ()
    horizon: float | None = None
    seed: int = 0
    tolerance: float = 1.0
    values: Mapping[str, float | str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if not 0 <= self.seed < SEEDS:
            raise StateError(f"`seed` must be from 0 to {SEEDS - 1}, but is {self.seed}.")
        if not 0 <= self.tolerance <= WIDEST:
            raise StateError(
                f"`tolerance` must be from 0 to {WIDEST:g}, but is {self.tolerance:g}."
            )
        if self.horizon is not None and not 0 < self.horizon < math.inf:
            raise StateError(f"`horizon` must be positive (s), but is {self.horizon:g}.")
        if len(set(self.observers)) < len(self.observers):
            raise StateError("`observer` must name every observer once.")

    def query(self) -> str:
        """The state as a query, without what is at its default."""
        pairs = [("source", self.source)]
        pairs += [("observer", name) for name in self.observers]
        if self.horizon is not None:
            pairs.append(("horizon", repr(self.horizon)))
        if self.seed:
            pairs.append(("seed", str(self.seed)))
        if self.tolerance != 1.0:
            pairs.append(("tolerance", repr(self.tolerance)))
        for key, value in self.values.items():
            pairs.append((key, value if isinstance(value, str) else repr(float(value))))
        return urlencode(pairs, quote_via=quote)

    @staticmethod
    def of_query(query: str, source: str) -> "State":
        """The state of a `query`, whose `source` is that one where it names none.

        **Raises:** [`StateError`][].
        """
        if len(query) > LONGEST:
            raise StateError(f"A query must have at most {LONGEST} characters.")
        try:
            pairs = parse_qsl(query, True, errors="strict", max_num_fields=MOST)
        except ValueError:
            raise StateError(f"A query must be UTF-8 of at most {MOST} values.") from None
        observers: list[str] = []
        found: dict[str, str] = {}
        for key, value in pairs:
            if key == "observer":
                observers.append(value)
            elif key in found:
                raise StateError(f"A query must give {_shown(key)} once.")
            elif key not in REQUEST:
                found[key] = value
        values = {k: _value(k, v) for k, v in found.items() if "." in k}
        plain = {k: v for k, v in found.items() if "." not in k}
        unknown = plain.keys() - {"source", "horizon", "seed", "tolerance"}
        if unknown:
            raise StateError(
                f"A query must hold `source`, `observer`, `horizon`, `seed`, `tolerance` "
                f"and knobs, but has {_shown(min(unknown))}."
            )
        horizon = plain.get("horizon")
        return State(
            plain.get("source", source),
            tuple(observers),
            None if horizon is None else _number("horizon", horizon),
            _whole("seed", plain.get("seed", "0")),
            _number("tolerance", plain.get("tolerance", "1")),
            values,
        )


def _value(key: str, text: str) -> float | str:
    word = text.isascii() and text.replace("-", "").isalpha() and text[0] != "-"
    return text if word and text.lower() not in NOT_FINITE else _number(key, text)


def _number(key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise StateError(f"{_shown(key)} must be a finite number, but is {text[:40]!r}.")
    return value


def _whole(key: str, text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 12):
        raise StateError(f"{_shown(key)} must be a whole number, but is {text[:40]!r}.")
    return int(text)


def _shown(key: str) -> str:
    return f"`{key[:60]}`" if key.isprintable() else "a key that cannot be printed"
