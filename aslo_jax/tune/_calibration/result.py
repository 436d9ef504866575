"""What a calibration found, how surely, and what the record cannot say."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from .adequacy import Finding, named
from .imperfections import Imperfections
from .information import Information
from .parameters import Parameters
from .problem import Problem
from .profile import Profile
from .whiten import Noise

SETTLED, UNSETTLED = "it settled", "the rounds are used up"
NEGLIGIBLE = 0.1  # a share of a direction that is not worth its name
DOUBTFUL = 0.3  # of a correlation
UNEXPLAINED = 5e-3  # of the derivatives' rms, by which they are disturbed
HARMLESS = 0.3  # of a half width, by which an error of the record may move a parameter
TINY = 1e-4  # of a parameter: so small a move is known to first order, and only widens


@dataclasses.dataclass(frozen=True)
class Undetermined:
    """A direction in the parameters along which the record says too little.

    - `parts`: by parameter, its relative share, the largest of size one;
    - `deviation`: standard deviation along it, relative; infinite where it is flat.
    """

    parts: Mapping[str, float]
    deviation: float

    def __str__(self) -> str:
        return " ".join(
            f"{'-' if share < 0 else '+' if k else ''}{'' if not k else ' '}"
            f"{'' if abs(share) > 0.995 else f'{abs(share):.2g} '}{name}"
            for k, (name, share) in enumerate(self.parts.items())
        )


@dataclasses.dataclass(frozen=True)
class Calibration:
    """The outcome of [`calibrate`][].

    - `model`: what was calibrated, with the parameters that are determined; the others
      stay where they were;
    - `before`, `estimate`: by name, in the units of the parameters, and of the errors of
      the record that were fitted;
    - `after`: the estimate, and NaN for one that is not determined;
    - `interval`: by name, (low, high), which holds the true value with the `confidence`;
      NaN where the record says nothing, and where the intervals are `withdrawn`;
    - `imperfections`: the errors of the record as they were found, none where none were
      asked for: called with a log they correct it;
    - `withdrawn`: why no interval can be trusted, empty where they can;
    - `findings`: errors of the record that were not fitted, that it shows beyond doubt, and
      that are large enough to matter beside the intervals; for others these allow;
    - `allowed`: by name, the errors of the record that it does not rule out and that make
      the interval wider: where a parameter enters nonlinearly they are fitted, one by one;
    - `undetermined`: directions that the record does not determine;
    - `output_noise`: standard deviation of the noise of every output, in its units, shape
      `(p,)`; `drift_noise`: of what disturbs the known derivatives, held from sample to
      sample, in their units, shape `(w,)`;
    - `correlation`: of prediction errors one sample apart: near zero where the model
      explains the record;
    - `profiles`: by name, `(values, deviance)`, each of shape `(n,)`: the least sum of
      squares over a parameter with all others free, above the least of all, in variances
      of the errors;
    - `t` (s), `errors`: the instants and the prediction errors that are left, of each
      relation or output, white and of unit size where the model is right, shapes `(r,)`
      and `(r, g)`;
    - `rounds`: of the search; `reason`: why it stopped.
    """

    model: Any
    before: dict[str, float]
    estimate: dict[str, float]
    after: dict[str, float]
    interval: dict[str, tuple[float, float]]
    imperfections: Imperfections
    withdrawn: str
    findings: tuple[Finding, ...]
    allowed: dict[str, tuple[str, ...]]
    undetermined: tuple[Undetermined, ...]
    confidence: float
    output_noise: Float[np.ndarray, " p"]
    drift_noise: Float[np.ndarray, " w"]
    correlation: float
    profiles: dict[str, tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]
    t: Float[np.ndarray, " r"]
    errors: Float[np.ndarray, "r g"]
    rounds: int
    reason: str

    def determined(self, name: str) -> bool:
        """Whether the interval of a parameter is narrow and can be trusted."""
        return bool(np.isfinite(self.after[name]))

    def half_width(self, name: str) -> float:
        """The distance from the estimate to the further end of its interval, in the units
        of the parameter; NaN where there is none."""
        low, high = self.interval[name]
        return max(high - self.estimate[name], self.estimate[name] - low)

    def beside(self, name: str, value: float) -> "Calibration":
        """With one more number, that is zero in a right record and has no interval."""
        nan = float("nan")
        changed: dict[str, Any] = {
            "before": self.before | {name: 0.0},
            "estimate": self.estimate | {name: value},
            "after": self.after | {name: nan},
            "interval": self.interval | {name: (nan, nan)},
            "allowed": self.allowed | {name: ()},
            "profiles": self.profiles | {name: (np.array([value]), np.zeros(1))},
        }
        return dataclasses.replace(self, **changed)

    def rows(self) -> list[tuple[str, str, str, str]]:
        """A table: parameter, before, after, and its interval, with the errors of the
        record that it allows for, or why there is none."""
        found = []
        for name, before in self.before.items():
            value, half = self.estimate[name], self.half_width(name)
            size = f"+- {half:.2g}"
            if value and np.isfinite(half):
                size += f" ({100 * half / abs(value):.2g} %)"
            allowed = named(self.allowed[name])
            if self.determined(name):
                size += f"; allows for {allowed}" if allowed else ""
                found.append((name, f"{before:.6g}", f"{value:.6g}", size))
                continue
            along = [str(d) for d in self.undetermined if name in d.parts]
            flat = f" (flat: {'; '.join(along)})" if along else ""
            if self.withdrawn or (self.reason != SETTLED and not along):
                why = f"about {value:.3g}, without an interval: not trusted"
            elif np.isfinite(half):
                why = f"about {value:.3g} {size}: too wide, not determined{flat}"
                why += f" ({allowed} not ruled out)" if allowed else ""
            elif self.profiles[name][0].size == 1:
                why = f"about {value:.3g}, without an interval"
            else:
                why = f"not determined by this record{flat}"
            found.append((name, f"{before:.6g}", "", why))
        return found

    def __str__(self) -> str:
        head = ("parameter", "before", "after", f"interval ({100 * self.confidence:g} %)")
        table = [head, *self.rows()]
        widths = [max(len(row[k]) for row in table) for k in range(3)]
        lines = []
        for row in table:
            cells = [row[0].ljust(widths[0])]
            cells += [row[k].rjust(widths[k]) for k in (1, 2)]
            lines.append("  ".join([*cells, row[3]]).rstrip())
        return "\n".join(lines)


def summed_up(
    *,
    problem: Problem,
    v: Float[np.ndarray, " v"],
    known: Information,
    profiles: Sequence[Profile],
    findings: tuple[Finding, ...],
    factor: float,
    confidence: float,
    resolution: float,
    noise: Noise,
    disturbance: float,
    t: Float[np.ndarray, " N"],
    errors: Float[np.ndarray, "N g"],
    rounds: int,
    settled: bool,
) -> Calibration:
    """What a search has found, by name."""
    parameters = problem.parameters
    names, k = problem.found, len(problem.found)

    def values(j: int, places: Any) -> np.ndarray:
        """Of parameter `j`, at places relative to its start."""
        every = np.tile(v[: k + problem.tested], (np.size(places), 1))
        every[:, j] = places
        return np.array([parameters.entries(q)[j] for q in every])

    estimate = {n: float(values(j, v[j])[0]) for j, n in enumerate(names)}
    interval, half = {}, {}
    for j, (name, found) in enumerate(zip(names, profiles, strict=True)):
        ends = np.sort(values(j, [found.low, found.high]))
        if not np.isfinite([found.low, found.high]).all():
            ends = np.full(2, np.nan)
        half[name] = float(np.max(np.abs(ends - estimate[name])))
        # First and second order say about as much: an interval that wide holds too seldom.
        if not found.parabolic and not half[name] < resolution * abs(estimate[name]):
            ends, half[name] = np.full(2, np.nan), np.nan
        interval[name] = (float(ends[0]), float(ends[1]))
    moved = lambda finding, j: abs(finding.shift[j] * _slope(parameters, v, j))

    def matters(finding: Finding) -> bool:
        most = [max(HARMLESS * half[n], TINY * abs(estimate[n])) for n in names]
        return any(not moved(finding, j) < most[j] for j in range(k))

    blamed = [finding for finding in findings if matters(finding)]
    harmless = [finding for finding in findings if not matters(finding)]
    withdrawn = _reason(blamed) if blamed else ""
    for j, name in enumerate(names):
        more = sum(moved(finding, j) for finding in harmless)
        interval[name] = interval[name][0] - more, interval[name][1] + more
        half[name] += more
    e = errors - np.mean(errors, axis=0)
    correlation = float(np.sum(e[1:] * e[:-1]) / np.sum(e * e))
    if abs(correlation) > DOUBTFUL and disturbance > UNEXPLAINED and not withdrawn:
        withdrawn = (
            f"an unknown error: derivatives disturbed by {100 * disturbance:.2g} % of "
            f"their size, and prediction errors that are correlated ({correlation:.2g})"
        )
    after, q = {}, np.zeros(k + problem.tested)
    for j, name in enumerate(names):
        size = abs(estimate[name])
        if parameters.signed[j]:
            size = max(size, float(parameters.scale[j]))
        narrow = half[name] < resolution * size
        sure = settled and not withdrawn and narrow
        after[name] = estimate[name] if sure else np.nan
        q[j] = v[j] if sure else 0.0
        if withdrawn or not settled:
            interval[name] = (np.nan, np.nan)
    return Calibration(
        model=parameters.place(q).model,
        before=dict(zip(names, parameters.value[:k].tolist(), strict=True)),
        estimate=estimate,
        after=after,
        interval=interval,
        imperfections=problem.recorded(v).imperfections,
        withdrawn=withdrawn,
        findings=tuple(blamed),
        allowed={n: found.allowed for n, found in zip(names, profiles, strict=True)},
        undetermined=_flat(known, names, resolution / factor),
        confidence=confidence,
        output_noise=np.asarray(noise.output),
        drift_noise=np.asarray(noise.drift),
        correlation=correlation,
        profiles={
            n: (values(j, found.place), found.deviance)
            for j, (n, found) in enumerate(zip(names, profiles, strict=True))
        },
        t=t,
        errors=errors,
        rounds=rounds,
        reason=SETTLED if settled else UNSETTLED,
    )


def _slope(parameters: Parameters, v: np.ndarray, j: int) -> float:
    """Of the value of parameter `j` in its place."""
    if parameters.signed[j]:
        return float(parameters.scale[j])
    return float(parameters.value[j] * np.exp(v[j]))


def _flat(known: Information, names: tuple[str, ...], wide: float):
    found = []
    for direction in known.flat(wide).T:
        largest = direction[np.argmax(np.abs(direction))]
        parts = dict(zip(names, (direction / largest).tolist(), strict=True))
        parts = {name: x for name, x in parts.items() if abs(x) > NEGLIGIBLE}
        curvature = float(direction @ known.curvature @ direction)
        deviation = 1.0 / np.sqrt(curvature) if curvature > 0 else np.inf
        found.append(Undetermined(parts, float(deviation)))
    return tuple(found)


def _reason(blamed: Sequence[Finding]) -> str:
    likely = [f for f in blamed if f.share > 0.5 * blamed[0].share]
    return " or ".join(str(f) for f in likely)
