"""Circles through the windows of a log, under many hypotheses at once."""

import dataclasses

import numpy as np
from jaxtyping import Complex, Float

ITERATIONS = 10
TRUST = 0.1  # what a radius that is wrong by a factor e costs, as a relative residual


@dataclasses.dataclass(frozen=True)
class Fit:
    """Circles of `H` hypotheses in `W` windows.

    - `cost`: the rms of the residual over the radius that fits, without the noise, and with
      the price of a radius that is not the one given;
    - `residual`: the same without that price; `noise`: that of a sample;
    - `radius`: the one that fits; `centre`: the flux at the start of every window;
    - `values` of the free parameters.
    """

    cost: Float[np.ndarray, " H"]
    residual: Float[np.ndarray, " H"]
    noise: Float[np.ndarray, " H"]
    radius: Float[np.ndarray, " H"]
    centre: Complex[np.ndarray, "H W"]
    values: Float[np.ndarray, "H p"]


def fit(
    g: Complex[np.ndarray, "H W n"],
    basis: Complex[np.ndarray, "H p W n"],
    start: Float[np.ndarray, "H p"],
    y: Complex[np.ndarray, "H W n"],
    shape: Float[np.ndarray, "W n"],
    radius: float | None,
    saliency: Float[np.ndarray, " H"],
) -> Fit:
    """Gauss-Newton on `|x + g + basis p| - saliency i_d - m shape` over the centres x, the
    radius m and the free parameters p. The centres are eliminated window by window."""
    values = start.copy()
    moved = lambda values: g + np.einsum("hp,hpwn->hwn", values, basis)
    centre, m = _algebraic(moved(values), shape, radius)
    best: Fit | None = None
    across = saliency[:, None, None]
    for _ in range(ITERATIONS + 1):
        x = centre[..., None] + moved(values)
        size = np.maximum(np.abs(x), 1e-300)
        n = x / size
        r = size - m[:, None, None] * shape
        slope = n
        if saliency.any():
            direct = (n.conj() * y).real
            r = r - across * direct
            slope = n - across * (y - n * direct) / size
        found = _fit(r, m, shape, radius, centre, values)
        best = found if best is None else _better(best, found)
        centre, m, values = _step(slope, basis, shape, r, radius, m, centre, values)
    assert best is not None
    return best


def _fit(r, m, shape, radius, centre, values) -> Fit:
    scale = np.maximum(np.abs(m) * np.sqrt(np.mean(shape**2)), 1e-300)
    square = np.mean(r**2, axis=(1, 2)) / scale**2
    wild = r[..., 2:] - 2.0 * r[..., 1:-1] + r[..., :-2]
    noise = np.mean(wild**2, axis=(1, 2)) / 6.0 / scale**2
    residual = np.maximum(square - noise, 0.0)
    off = 0.0 if radius is None else np.log(np.maximum(np.abs(m), 1e-300) / radius)
    cost = np.sqrt(residual + (TRUST * off) ** 2)
    bad = ~np.isfinite(cost) | (m <= 0)
    cost = np.where(bad, np.inf, cost)
    return Fit(cost, np.sqrt(residual), np.sqrt(noise), m, centre, values)


def _better(a: Fit, b: Fit) -> Fit:
    take = b.cost < a.cost
    pick = lambda x, y: np.where(take.reshape(-1, *[1] * (x.ndim - 1)), y, x)
    names = [field.name for field in dataclasses.fields(Fit)]
    return Fit(*(pick(getattr(a, name), getattr(b, name)) for name in names))


def _algebraic(g, shape, radius):
    """The circles that a linear equation gives, `2 Re(conj(x) g) + c = m^2 shape^2 - |g|^2`
    with x, c and, where the radius varies, m unknown."""
    middle = g.mean(axis=-1, keepdims=True)
    d = g - middle
    size = np.sqrt(np.mean(np.abs(d) ** 2, axis=-1)) + 1e-300
    d = d / size[..., None]
    ones = np.ones_like(d.real)
    varying = np.ptp(shape) > 1e-9 * np.max(shape)
    square = np.abs(d) ** 2
    target = -square
    if varying and radius is not None:
        target = target + (radius * shape) ** 2 / size[..., None] ** 2
    A = np.stack([2.0 * d.real, 2.0 * d.imag, ones], axis=-1)
    M = np.einsum("hwni,hwnj->hwij", A, A) / d.shape[-1]
    M = M + 1e-9 * np.eye(3)
    v = np.einsum("hwni,hwn->hwi", A, target) / d.shape[-1]
    x = np.linalg.solve(M, v[..., None])[..., 0]
    local = x[..., 0] + 1j * x[..., 1]
    radii = size * np.sqrt(np.maximum(np.abs(local) ** 2 - x[..., 2], 0.0))
    if varying:
        m = np.full(g.shape[0], radius if radius is not None else 1.0)
    else:
        m = np.median(radii, axis=1)
    return size * local - middle[..., 0], m


def _step(slope, basis, shape, r, radius, m, centre, values):
    _, W, n = r.shape
    J = np.stack([slope.real, slope.imag], axis=-1)
    K = np.concatenate(
        [
            -np.broadcast_to(shape, r.shape)[:, None],
            (slope.conj()[:, None] * basis).real,
        ],
        axis=1,
    )
    scale = np.sqrt(np.mean(K**2, axis=(2, 3))) + 1e-300
    K = K / scale[:, :, None, None]
    A = np.einsum("hwni,hwnj->hwij", J, J) + 1e-6 * n * np.eye(2)
    B = np.einsum("hwni,hqwn->hwiq", J, K)
    a = -np.einsum("hwni,hwn->hwi", J, r)
    C = np.einsum("hqwn,hpwn->hqp", K, K)
    c = -np.einsum("hqwn,hwn->hq", K, r)
    AB = np.linalg.solve(A, B)
    Aa = np.linalg.solve(A, a[..., None])[..., 0]
    S = C - np.einsum("hwiq,hwip->hqp", B, AB)
    s = c - np.einsum("hwiq,hwi->hq", B, Aa)
    S = S + 1e-9 * W * n * np.eye(S.shape[-1])
    if radius is not None:  # the radius that is given, taken as one more measurement
        weight = W * n * (TRUST / scale[:, 0]) ** 2 * np.mean(shape**2)
        S[:, 0, 0] += weight
        s[:, 0] += weight * scale[:, 0] * (radius - m)
    q = np.linalg.solve(S, s[..., None])[..., 0]
    p = Aa - np.einsum("hwiq,hq->hwi", AB, q)
    q = q / scale
    return centre + p[..., 0] + 1j * p[..., 1], m + q[:, 0], values + q[:, 1:]
