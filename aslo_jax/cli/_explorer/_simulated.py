"""A simulated source: its run, its band, and its observers as descriptions of a machine."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from ...logs import Log
from ...machines import AbstractDescription, machine_of
from ...machines._base import Columns, Rate, Rates
from .._table import Estimator
from . import _programs as programs
from ._knobs import LOOP
from ._panels import Result, band_of
from ._programs import Programs
from ._scene import Moved, Scene
from ._state import State, StateError


class _Estimate(NamedTuple):
    """An estimate, in arrays of NumPy."""

    value: np.ndarray
    certificate: np.ndarray
    coasting: np.ndarray
    covariance: None = None


@dataclasses.dataclass(frozen=True)
class Simulated:
    """A [`Scene`][] that runs in compiled `programs`."""

    scene: Scene
    programs: Programs

    def result(self, state: State) -> Result:
        """One run: plant, controller, disturbances, and the observers that are shown."""
        moved = self.scene.moved(state)
        layout = programs.layout_of(moved, state.seed)
        lanes = [x[None] for x in programs.numbers(layout)]
        every = programs.Everything()
        run = self.programs.run(layout, lanes, moved.steps, 1, every, ("run",))
        run = {k: _first(v) for k, v in run.items()}
        machine = machine_of(moved.content)
        log = _log(machine, moved, run)
        rates = self._rates(state, machine)
        estimates, chosen = run["estimates"], self.scene.chosen(state)
        tables = {n: _table(machine, rates, log, estimates[n]) for n in chosen}
        return Result(log, tables, machine, self._scale())

    def band(self, state: State) -> dict[str, Any]:
        """The errors of many runs that differ in parameters and noise."""
        moved = self.scene.moved(state)
        layout = programs.layout_of(moved, state.seed)
        lanes = programs.band_lanes(
            layout, self.scene.tolerances, state.seed, state.tolerance
        )
        every = _divisor(moved.steps, max(1, moved.steps // programs.POINTS))
        scale = self._scale()
        norms = programs.Errors(scale)
        kind = ("band", None if scale is None else tuple(scale))
        errors = self.programs.run(layout, lanes, moved.steps, every, norms, kind)
        count = moved.steps // every + 1
        t = np.arange(count) * every * moved.content["interval"]
        return band_of(t, errors)

    def described(self, state: State, name: str) -> AbstractDescription:
        """The machine and an observer of a `state` as a description of a log says them.

        **Raises:** [`StateError`][] for an observer that no description can say.
        """
        moved = self.scene.moved(state)
        if name not in moved.content["observers"]:
            raise StateError(f"There is no observer {name[:60]!r} here.")
        base = machine_of(moved.content)
        keys = dict(moved.content["observers"][name])
        kind = keys.pop("kind")
        known = type(base.observer).model_fields
        kinds = ("aslo", "a-aslo", "lifted_kalman", "adaptive")
        options = getattr(known.get("kind"), "annotation", None)
        if kind in kinds[2:]:
            keys["kind"] = kind
        defaults = {"velocity_cutoff": 200.0, "completion": "least-squares"}
        keys = {
            k: v
            for k, v in keys.items()
            if v is not None
            and (k in known or v != defaults.get(k))
            and not (k == "start" and v == "exact" and k not in known)
        }
        refused = [k for k in keys if k not in known]
        allowed = kind in kinds[:2] or kind in getattr(options, "__args__", ())
        if not allowed or refused:
            why = f"`{refused[0]}`" if allowed else f'an observer of the kind "{kind}"'
            raise StateError(
                f'A machine description of the kind "{base.kind}" cannot say {why}, as '
                f"{name} has it; export the study instead, which can."
            )
        if LOOP in state.values:
            keys["pll_bandwidth"] = state.values[LOOP]
        elif "pll_bandwidth" in known:
            keys["pll_bandwidth"] = float(_loop(self.scene, state))
        content = {"machine": base.machine.model_dump(), "observer": keys}
        try:
            return type(base).model_validate(content)
        except ValueError as error:
            raise StateError(str(error)) from error

    def _rates(self, state: State, machine: AbstractDescription) -> Rates:
        """Those of the phase-locked loop; the observers have their own."""
        known = type(machine.observer).model_fields
        if "pll_bandwidth" not in known:
            return {}
        return {"pll_bandwidth": Rate(float(_loop(self.scene, state)))}

    def _scale(self) -> np.ndarray | None:
        scale = self.scene.content.get("scale")
        return None if scale is None else np.asarray(scale, float)


def _loop(scene: Scene, state: State) -> float | str:
    default = next(k.default for k in scene.knobs(state) if k.key == LOOP)
    return state.values.get(LOOP, default)


def _first(tree: Any) -> Any:
    """Of the one run."""
    if isinstance(tree, dict):
        return {k: _first(v) for k, v in tree.items()}
    if isinstance(tree, tuple):
        return tuple(map(_first, tree))
    return None if tree is None else tree[0]


def _log(machine: AbstractDescription, moved: Moved, run: dict[str, Any]) -> Log:
    """The run as a log of the machine, with truth."""
    t = np.arange(moved.steps + 1) * moved.content["interval"]
    known, names = machine.signals.truth, _entries(machine)
    told = [n if n in known else f"{n}_true" for n in names]
    truth = dict(zip(told, run["hidden"].T, strict=True))
    if run["angle"] is not None and "theta_electrical" in known:
        angle, speed = run["angle"]
        pairs = machine.pole_pairs or 1
        truth |= {"theta_electrical": pairs * angle, "omega_electrical": pairs * speed}
    return Log(t, run["u"], run["y"], truth)


def _entries(machine: AbstractDescription) -> list[str]:
    """The columns of what is estimated, in the order of the states of the plant."""
    return [
        name
        for quantity in machine.quantities
        if not quantity.angle and quantity.tracks is None
        for name in quantity.columns
    ]


def _table(
    machine: AbstractDescription, rates: Rates, log: Log, estimate: dict[str, Any]
) -> Columns:
    """The table of estimates of an observer: that of `aslo-jax estimate` for a motor, whose
    angle and speed follow from the flux."""
    alike = {
        "certificate": estimate["certificate"],
        "coasting": estimate["coasting"].astype(np.uint8),
    }
    if not rates:
        names = _entries(machine)
        return dict(zip(names, estimate["value"].T, strict=True)) | alike
    found = _Estimate(estimate["value"], estimate["certificate"], estimate["coasting"])
    observed = lambda t, u, y: found
    estimator = Estimator(machine, rates, log.t, observed=observed)
    columns = estimator(log).columns
    if estimator.complete:
        return columns
    again = Estimator(machine, rates, log.t, first=0, observed=observed)
    return again(log).columns


def _divisor(steps: int, about: int) -> int:
    """The largest divisor of `steps` that is at most `about`."""
    return next(k for k in range(about, 0, -1) if steps % k == 0)
