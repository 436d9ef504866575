"""Leaves of an experiment by name, and experiments with some of them changed."""

import dataclasses
import difflib
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import random
from .._continuous import AnyExperiment
from .._module import Module

Where = str | Callable[[AnyExperiment], Any]


class Place(NamedTuple):
    """A leaf of an experiment by its number, and an entry of it, or all of it."""

    leaf: int
    entry: tuple[int, ...] = ()


class Layout:
    """The leaves of an experiment, by path: fields and keys joined by dots, such as
    `plant.resistance` or `observers.ASLO.filter.rate`.

    Where the experiment starts at the plant's default state, that state has paths too.
    """

    def __init__(self, experiment: AnyExperiment) -> None:
        self.experiment = experiment
        self.default_start = experiment.initial is None
        if self.default_start:
            experiment = started(experiment)
        pairs, self.tree = jax.tree_util.tree_flatten_with_path(experiment)
        self.paths = [".".join(_name(key) for key in path) for path, _ in pairs]
        self.ways = [way for way, _ in pairs]
        self.leaves = [leaf for _, leaf in pairs]

    def __reduce__(self):
        # Made again in another process: the structure of a module is not to be sent, since
        # Equinox keeps marks in it that are told by their identity.
        return Layout, (self.experiment,)

    def real(self) -> list[str]:
        """The paths of the leaves that can be spread."""
        return [p for p, x in zip(self.paths, self.leaves, strict=True) if _is_real(x)]

    def random_keys(self) -> list[int]:
        """The leaves that are keys of random numbers, by number."""
        return [
            i
            for i, (path, leaf) in enumerate(zip(self.paths, self.leaves, strict=True))
            if path.rpartition(".")[2] == "key"
            and getattr(leaf, "dtype", None) == jnp.uint32
            and leaf.shape == (2,)
        ]

    def places(self, where: Where) -> tuple[Place, ...]:
        """What `where` names: a path, in which `*` stands for one or more names and a last
        number for an entry of an array, or a function of the experiment that returns
        leaves of it, or entries of leaves."""
        found = self._by_path(where) if isinstance(where, str) else self._by_call(where)
        for place in found:
            leaf = self.leaves[place.leaf]
            if not _is_real(leaf):
                raise ValueError(
                    f"Argument `where` must name real parameters, but "
                    f"`{self.paths[place.leaf]}` is {_kind(leaf)}; it could be "
                    f"{self._listed()}."
                )
            shape = leaf.shape
            if len(place.entry) > len(shape) or any(
                not 0 <= k < n for k, n in zip(place.entry, shape, strict=False)
            ):
                raise ValueError(
                    f"Argument `where` must name an entry of "
                    f"`{self.paths[place.leaf]}`, whose shape is {shape}, but got the "
                    f"entry {list(place.entry)}."
                )
        return found

    def _by_path(self, pattern: str) -> tuple[Place, ...]:
        parts = [
            re.escape(p) if p != "*" else r"[^.]+(?:\.[^.]+)*" for p in _split(pattern)
        ]
        expression = re.compile(r"\.".join(parts))
        found = [Place(i) for i, p in enumerate(self.paths) if expression.fullmatch(p)]
        if found:
            return tuple(found)
        stem, _, last = pattern.rpartition(".")
        if stem and last.isdigit() and (outer := self._by_path_or_none(stem)):
            return tuple(Place(leaf, (*entry, int(last))) for leaf, entry in outer)
        close = difflib.get_close_matches(pattern, self.real(), n=1)
        hint = f" Did you mean `{close[0]}`?" if close else ""
        raise ValueError(
            f"Argument `where` must name leaves of the experiment, but there is no "
            f"`{pattern}`.{hint} It could be {self._listed()}."
        )

    def _by_path_or_none(self, pattern: str) -> tuple[Place, ...]:
        try:
            return self._by_path(pattern)
        except ValueError:
            return ()

    def _by_call(self, where: Callable[[AnyExperiment], Any]) -> tuple[Place, ...]:
        marks = [_Mark(i, ()) for i in range(len(self.leaves))]
        found = where(jax.tree_util.tree_unflatten(self.tree, marks))
        found = found if isinstance(found, tuple | list) else (found,)
        if not found or not all(isinstance(mark, _Mark) for mark in found):
            raise ValueError(
                "Argument `where` must return leaves of the experiment, or entries of "
                f"them, but got {', '.join(type(x).__name__ for x in found) or 'nothing'}; "
                f"they are {self._listed()}."
            )
        return tuple(Place(mark.leaf, mark.entry) for mark in found)

    def _listed(self) -> str:
        return ", ".join(f"`{path}`" for path in self.real())

    def shape(self, place: Place) -> tuple[int, ...]:
        return self.leaves[place.leaf].shape[len(place.entry) :]


class Changed(Module):
    """The experiment of a sample: `places[k]` are set to `values[k]`, or multiplied by it
    where `relative[k]`; `keys` are replaced by those of the sample.

    The default state of the plant is that of the changed plant, changed in turn."""

    experiment: AnyExperiment
    layout: Layout = eqx.field(static=True)
    places: tuple[tuple[Place, ...], ...] = eqx.field(static=True)
    relative: tuple[bool, ...] = eqx.field(static=True)
    keys: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, sample: dict[str, Any]) -> AnyExperiment:
        started_here = [
            any(self._of_start(place) for place in places) for places in self.places
        ]
        late = self.layout.default_start and any(started_here)
        leaves = list(jax.tree.leaves(self._complete(self.experiment)))
        for number, key in zip(self.keys, sample["keys"], strict=True):
            leaves[number] = key
        for k, places in enumerate(self.places):
            self._set(leaves, k, sample, [p for p in places if not self._of_start(p)])
        changed = self._experiment(leaves)
        if not self.layout.default_start:
            for k, places in enumerate(self.places):
                self._set(leaves, k, sample, [p for p in places if self._of_start(p)])
            return self._experiment(leaves)
        changed = dataclasses.replace(changed, initial=None)
        if not late:
            return changed
        leaves = list(jax.tree.leaves(started(changed)))
        for k, places in enumerate(self.places):
            self._set(leaves, k, sample, [p for p in places if self._of_start(p)])
        return self._experiment(leaves)

    def _complete(self, experiment: AnyExperiment) -> AnyExperiment:
        return started(experiment) if self.layout.default_start else experiment

    def _experiment(self, leaves: list[Any]) -> AnyExperiment:
        return jax.tree_util.tree_unflatten(self.layout.tree, leaves)

    def _of_start(self, place: Place) -> bool:
        return self.layout.paths[place.leaf].partition(".")[0] == "initial"

    def _set(self, leaves: list[Any], k: int, sample: dict, places: list[Place]) -> None:
        for place in places:
            leaf = jnp.asarray(leaves[place.leaf])
            value = sample["values"][k].astype(leaf.dtype)
            part = leaf[place.entry] if place.entry else leaf
            part = part * value if self.relative[k] else jnp.broadcast_to(value, part.shape)
            leaves[place.leaf] = leaf.at[place.entry].set(part) if place.entry else part


def study_keys(layout: Layout, seed: int) -> list[np.ndarray]:
    """The key of each random part of an experiment in a study: of its own key, so that two
    parts stay independent, and of the study's `seed`."""
    word = random.key(seed)
    return [
        np.stack(_threefry(jnp.asarray(layout.leaves[i]), word[0], word[1]))
        for i in layout.random_keys()
    ]


def sample_keys(keys: Sequence[np.ndarray], index: np.ndarray) -> list[jax.Array]:
    """Those of the samples `index`, shape (N, 2) each."""
    return [_folded(jnp.asarray(key), jnp.asarray(index)) for key in keys]


# Compiled as a whole: one operation after the other takes half a second to compile.
_threefry = jax.jit(random.threefry)
_folded = jax.jit(jax.vmap(random.fold, (None, 0)))


def started(experiment: AnyExperiment) -> AnyExperiment:
    """The experiment with the plant's default state as its own."""
    state = jax.tree.map(jnp.asarray, experiment.plant.initial())
    return dataclasses.replace(experiment, initial=state)


@dataclasses.dataclass(frozen=True)
class _Mark:
    """Stands for a leaf, so that what a function of the tree returns can be told."""

    leaf: int
    entry: tuple[int, ...]

    def __getitem__(self, entry: int) -> "_Mark":
        return _Mark(self.leaf, (*self.entry, int(entry)))


def _split(pattern: str) -> list[str]:
    return pattern.split(".")


def _name(key: Any) -> str:
    for attribute in ("name", "key", "idx"):
        if hasattr(key, attribute):
            return str(getattr(key, attribute))
    return str(key)


def _is_real(leaf: Any) -> bool:
    dtype = getattr(leaf, "dtype", None)
    return dtype is not None and jnp.issubdtype(dtype, jnp.floating)


def _kind(leaf: Any) -> str:
    dtype = getattr(leaf, "dtype", None)
    return f"a {type(leaf).__name__}" if dtype is None else f"of the type {dtype}"
