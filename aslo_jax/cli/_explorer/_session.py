"""What a page asks for, and what it gets: a session of the explorer."""

import dataclasses
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ._newest import Newest
from ._panels import number
from ._programs import Programs
from ._scene import READY, ready
from ._simulated import Simulated
from ._state import State, StateError

if TYPE_CHECKING:
    from ._recorded import Recorded
    from ._results import Results

TUNED = (64, 12)  # samples, iterations
LATE = 0.25  # of a run, from where on errors count in tuning


@dataclasses.dataclass(frozen=True)
class File:
    """A file to save: its `name`, its `type` and its content."""

    name: str
    type: str
    content: bytes


class Session:
    """What one command shows.

    - `recorded`: the log that was opened, `results`: those of the study, if any;
    - `newest`: of the requests; `programs`: those that are compiled.
    """

    def __init__(
        self, recorded: "Recorded | None" = None, results: "Results | None" = None
    ) -> None:
        self.recorded, self.results = recorded, results
        self.programs, self.newest = Programs(), Newest()
        self.first = "log" if recorded else "results" if results else "pmsm"

    def source(self, state: State) -> "Recorded | Simulated":
        """What is observed in a `state`.

        **Raises:** [`StateError`][] for a source that is not there.
        """
        if state.source == "log":
            if self.recorded is None:
                raise StateError("No log was opened; run `aslo-jax explore LOG`.")
            return self.recorded
        if state.source in ("study", "results"):
            if self.results is None:
                raise StateError("No study was opened; run `aslo-jax explore STUDY`.")
            if self.results.scene is None:
                raise StateError(self.results.why)
            return Simulated(self.results.scene, self.programs)
        return Simulated(ready(state.source), self.programs)

    def about(self, state: State) -> dict[str, Any]:
        """What the page needs to show its controls: sources, observers, knobs."""
        sources = [{"id": name, "title": title} for name, title in READY.items()]
        if self.results is not None:
            title = self.results.title
            sources.insert(0, {"id": "results", "title": f"Results: {title}"})
            if self.results.scene is not None:
                sources.insert(1, {"id": "study", "title": f"Simulation: {title}"})
        if self.recorded is not None:
            title = f"Log: {self.recorded.name}"
            sources.insert(0, {"id": "log", "title": title})
        found: dict[str, Any] = {"sources": sources, "source": state.source}
        if state.source == "results" and self.results is not None:
            return found | {
                "title": self.results.title,
                "observers": [],
                "knobs": [],
                "horizons": [],
                "exports": [],
            }
        source = self.source(state)
        if not isinstance(source, Simulated):
            known = {name: _kind(machine) for name, machine in source.variants.items()}
            title, horizons, chosen = source.title, [], source.chosen(state)
            described, knobs = list(known), source.knobs(state)
        else:
            tables = source.scene.content["observers"]
            known = {name: table["kind"] for name, table in tables.items()}
            title, horizons = source.scene.title, source.scene.horizons()
            chosen, knobs = source.scene.chosen(state), source.scene.knobs(state)
            described = [n for n in chosen if self._says(source, state, n)]
        return found | {
            "title": title,
            "observers": [
                {"name": n, "kind": k, "shown": n in chosen, "described": n in described}
                for n, k in known.items()
            ],
            "knobs": [knob.described() for knob in knobs],
            "horizons": horizons,
            "horizon": _horizon(source, state) if isinstance(source, Simulated) else None,
            "tunes": isinstance(source, Simulated),
            "exports": ["toml", "python", "csv", "estimates", "c"]
            + (["study"] if isinstance(source, Simulated) else []),
        }

    def _says(self, source: Simulated, state: State, name: str) -> bool:
        try:
            source.described(state, name)
        except StateError:
            return False
        return True

    def run(self, state: State) -> dict[str, Any]:
        """One run, drawn, or the results of a study."""
        if state.source == "results" and self.results is not None:
            return self.results.drawn()
        begun = time.perf_counter()
        found = self.source(state).result(state).drawn()
        found["seconds"] = round(time.perf_counter() - begun, 4)
        return found | {"traced": self.programs.traced}

    def band(self, state: State) -> dict[str, Any]:
        """The band of a state."""
        begun = time.perf_counter()
        found = self.source(state).band(state)
        found["seconds"] = round(time.perf_counter() - begun, 4)
        return found | {"traced": self.programs.traced}

    def against(self, parameter: str | None) -> dict[str, Any]:
        """The results of the study, against a parameter."""
        if self.results is None:
            raise StateError("No study was opened; run `aslo-jax explore STUDY`.")
        return self.results.drawn(parameter)

    def sample(self, index: int) -> dict[str, Any]:
        """A sample of the study as a state."""
        if self.results is None:
            raise StateError("No study was opened; run `aslo-jax explore STUDY`.")
        state, left = self.results.sample(index)
        return {"query": state.query(), "left": left}

    def tuned(self, state: State, name: str) -> dict[str, Any]:
        """The gains of an observer, tuned by gradients from where they are, for the runs of
        the band.

        **Raises:** [`StateError`][] for one without gains, and for a log.
        """
        from ...described import tune_study
        from . import _exports as exports

        source = self.source(state)
        if not isinstance(source, Simulated):
            raise StateError(
                "A log has one run; tune in the simulation of its machine, or find its "
                "parameters with `aslo-jax calibrate`."
            )
        moved = source.scene.moved(state)
        if name not in moved.content["observers"]:
            raise StateError(f"There is no observer {name[:60]!r} here.")
        content = exports.study_content(moved, state.tolerance)
        content["observers"] = {name: content["observers"][name]}
        after = LATE * content["horizon"]
        try:
            found = tune_study(
                content,
                samples=TUNED[0],
                iterations=TUNED[1],
                after=after,
                seed=state.seed,
            )[name]
        except ValueError as error:
            raise StateError(f"{name}: {error}") from error
        known = {k.key: k for k in source.scene.knobs(state)}
        values = {}
        for key, value in found.after.items():
            knob = known.get(f"observers.{name}.{key}")
            if knob is not None:
                values[knob.key] = min(max(value, knob.low), knob.high)
        return {
            "observer": name,
            "values": values,
            "before": number(found.rms_before),
            "after": number(found.rms_after),
            "improved": bool(found.improved),
        }

    def export(self, state: State, what: str, name: str) -> File:
        """A file of a state, `what` of: toml, python, c, csv, estimates, study.

        **Raises:** [`StateError`][] for another word, and for an observer that a file of
        that kind cannot say.
        """
        from . import _exports as exports

        source = self.source(state)
        about = f"From `aslo-jax explore`: {state.query()}"
        if what == "study" and isinstance(source, Simulated):
            text = exports.study_text(source.scene.moved(state), state.tolerance, about)
            return _text("explored-study.toml", "application/toml", text)
        if what in ("csv", "estimates"):
            result = source.result(state)
            if what == "estimates":
                estimates = exports.estimates_text(result)
                return _text("estimates.csv", "text/csv", estimates)
            text = exports.log_text(result.log, result.machine)
            return _text(exports.LOG, "text/csv", text)
        makers: dict[str, Callable[[], File]] = {
            "toml": lambda: _text(
                exports.MACHINE,
                "application/toml",
                exports.machine_text(machine, substeps, about),
            ),
            "python": lambda: _text(
                "explored.py",
                "text/x-python",
                exports.python_text(machine, substeps, about),
            ),
            "c": lambda: File(
                "explored-c.zip",
                "application/zip",
                exports.c_archive(machine, interval, substeps),
            ),
        }
        if what not in makers:
            raise StateError(f"There is no export {what[:20]!r}.")
        machine = source.described(state, name)
        substeps, interval = 1, 0.0
        if not isinstance(source, Simulated):
            substeps = source.substeps(machine)
            interval = float(source.reader.interval)
        else:
            interval = source.scene.content["interval"]
        return makers[what]()


def _horizon(source: Simulated, state: State) -> float:
    return source.scene.steps(state) * source.scene.content["interval"]


def _kind(machine: Any) -> str:
    kind = getattr(machine.observer, "kind", "aslo")
    gain = getattr(machine.observer, "gain", None)
    return "a-aslo" if gain is not None else kind


def _text(name: str, type_: str, text: str) -> File:
    return File(name, f"{type_}; charset=utf-8", text.encode())
