"""Counter-based random numbers: keyed by sample, counted by time index and stream.

Every number is a function of (key, index, stream), so that results depend neither on the
order of evaluation nor on how a batch is cut into chunks. It is plain `jax.numpy` on
uint32, the same in every engine. Bits: Threefry-2x32 with 20 rounds (Salmon et al. 2011,
doi:10.1145/2063384.2063405), equal to JAX's own.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int, UInt32

__all__ = [
    "Key",
    "KeyLike",
    "as_key",
    "fold",
    "key",
    "normal",
    "seed_of",
    "threefry",
    "uniform",
]

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))

Key = UInt32[Array, " 2"]

# What is taken for a key: one of `jax.random.key`, of `jax.random.PRNGKey`, or of `key`.
if TYPE_CHECKING:
    KeyLike: TypeAlias = Array | np.ndarray
else:  # what is none is refused by `as_key`
    KeyLike = Any


def _rotate(x: Array, by: int) -> Array:
    return (x << np.uint32(by)) | (x >> np.uint32(32 - by))


def threefry(key: Key, c0: UInt32[Array, "..."], c1: UInt32[Array, "..."]):
    """Two words of 32 random bits for each pair of the counters `c0` and `c1`, both of one
    shape, from the two words of a `key`.
    """
    k0, k1 = key[0], key[1]
    ks = (k0, k1, k0 ^ k1 ^ np.uint32(0x1BD11BDA))
    x0, x1 = c0 + ks[0], c1 + ks[1]
    for group in range(5):
        for by in _ROTATIONS[group % 2]:
            x0 = x0 + x1
            x1 = _rotate(x1, by) ^ x0
        x0 = x0 + ks[(group + 1) % 3]
        x1 = x1 + ks[(group + 2) % 3] + np.uint32(group + 1)
    return x0, x1


def key(seed: int | Int[Array, ""]) -> Key:
    """The key of a study, from a `seed`, a non-negative integer below 2**64.

    **Raises:** `ValueError` for an integer out of that range.
    """
    if isinstance(seed, int):
        if not 0 <= seed < 2**64:
            raise ValueError(
                f"Argument `seed` must be an integer in [0, 2**64), but got {seed}."
            )
        return jnp.array([seed >> 32, seed & 0xFFFFFFFF], jnp.uint32)
    return jnp.stack([jnp.zeros((), jnp.uint32), jnp.asarray(seed).astype(jnp.uint32)])


def as_key(key: Any) -> UInt32[Array, "*batch 2"]:
    """The two words of a `key` of JAX or of this module; what is no key is refused.

    **Raises:** `ValueError` for an integer, which is a seed, and for keys of another
    generator than JAX's default one.
    """
    dtype = getattr(key, "dtype", None)
    if dtype is not None and jnp.issubdtype(dtype, jax.dtypes.prng_key):
        key = jax.random.key_data(key)
        if key.shape[-1] != 2:
            raise ValueError(
                'Argument `key` must be a key of the generator "threefry2x32", JAX\'s '
                f"default, but its data has the shape {key.shape}."
            )
        return key
    if isinstance(key, int | float | np.integer | np.floating | str) or (
        dtype is not None and key.ndim == 0
    ):
        raise ValueError(
            "Argument `key` must be a key of random numbers such as `jax.random.key(0)`, "
            f"but got {key!r}, which is a seed."
        )
    return key


def seed_of(key: KeyLike | None) -> int:
    """The integer below 2**64 that stands for a key: the seed n of `jax.random.key(n)`.
    0 for `None`.

    **Raises:** `ValueError` as [`as_key`][], and for a key that is traced, or several."""
    if key is None:
        return 0
    words = as_key(key)
    if isinstance(words, jax.core.Tracer):
        raise ValueError("Argument `key` must be known here, but is traced.")
    if getattr(words, "shape", None) != (2,):
        raise ValueError(
            "Argument `key` must be one key of random numbers such as `jax.random.key(0)`, "
            f"but got {key!r}."
        )
    high, low = np.asarray(words, np.uint32).tolist()
    return (high << 32) | low


def fold(key: Key, sample: int | Int[Array, ""]) -> Key:
    """The key of one `sample`, counted from 0, of a study with this `key`; map it over
    `jnp.arange(samples)`.
    """
    sample = jnp.asarray(sample).astype(jnp.uint32)
    return jnp.stack(threefry(key, sample, jnp.zeros_like(sample)))


def _counters(index, stream: int, count: int) -> tuple[Array, Array]:
    if not 0 <= stream < 2**16:
        raise ValueError(
            f"Argument `stream` must be an integer in [0, 2**16), but got {stream}."
        )
    if count > 2**16:
        raise ValueError(
            f"Argument `shape` must hold at most 2**17 numbers, but got {2 * count}."
        )
    block = jnp.arange(count, dtype=jnp.uint32) + np.uint32(stream << 16)
    return jnp.broadcast_to(jnp.asarray(index).astype(jnp.uint32), block.shape), block


def _unit(bits: UInt32[Array, "..."], dtype) -> Float[Array, "..."]:
    # Centred in its bin, so that neither 0 nor 1 occurs. 24 bits fill float32.
    if jnp.finfo(dtype).bits > 32:
        return (bits.astype(dtype) + 0.5) * 2.0**-32
    return ((bits >> np.uint32(8)).astype(dtype) + 0.5) * 2.0**-24


def uniform(
    key: Key,
    index: int | Int[Array, ""],
    stream: int = 0,
    shape: tuple[int, ...] = (),
    dtype: DTypeLike = float,
) -> Float[Array, "..."]:
    """Uniform numbers in (0, 1), for time `index` and `stream`.

    - `key`: of a study or a sample; `index`, `stream`: the counters, so that other ones
      give independent numbers;
    - `shape`, `dtype`: of what is returned, by default one number in JAX's precision.
    """
    return _drawn(key, index, stream, shape, dtype, lambda a, b: (a, b))


def normal(
    key: Key,
    index: int | Int[Array, ""],
    stream: int = 0,
    shape: tuple[int, ...] = (),
    dtype: DTypeLike = float,
) -> Float[Array, "..."]:
    """Standard normal numbers, for time `index` and `stream`, by Box and Muller.

    - `key`: of a study or a sample; `index`, `stream`: the counters, so that other ones
      give independent numbers;
    - `shape`, `dtype`: of what is returned, by default one number in JAX's precision.
    """
    return _drawn(key, index, stream, shape, dtype, _box_muller)


def _box_muller(a: Array, b: Array) -> tuple[Array, Array]:
    radius, turn = jnp.sqrt(-2.0 * jnp.log(a)), 2.0 * jnp.pi * b
    return radius * jnp.cos(turn), radius * jnp.sin(turn)


def _drawn(
    key: Key,
    index: int | Int[Array, ""],
    stream: int,
    shape: tuple[int, ...],
    dtype: DTypeLike,
    law: Callable[[Array, Array], tuple[Array, Array]],
) -> Float[Array, "..."]:
    """Numbers of a `law`, which makes two of two that are uniform in (0, 1)."""
    dtype = jax.dtypes.canonicalize_dtype(dtype)
    size = int(np.prod(shape))
    words = threefry(key, *_counters(index, stream, -(-size // 2)))
    pairs = jnp.stack(law(*(_unit(word, dtype) for word in words)), -1)
    return pairs.reshape(-1)[:size].reshape(shape)
