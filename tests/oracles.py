"""The sampled least-squares flux observer of the PMSM, written without JAX: sample by
sample, to be checked by eye, and as a cascade of filters over whole arrays, to be fast.

All in the paper's F[x], the low-pass filter lam/(p + lam), every one started from zero:

    rho = F[1]
    w   = F[i + rho z / (lam L)]               z = u - R i, the derivative of the flux
    r   = w - rho i
    b   = rho d + F[w'z / lam - d]             d = -(L/2) |i|^2
    M   = F[r r'],   v = F[r b + M z / lam]    flux = M^-1 v

Over an interval the current is a line and the voltage is held. So z, and every product,
has one value at the left end of the interval and another at its right end.
"""

import math
from typing import NamedTuple

import numpy as np
import scipy.signal


class Oracle(NamedTuple):
    """Flux (Wb), shape (N, 2); the certificate and whether the flux coasts, shape (N,)."""

    flux: np.ndarray
    certificate: np.ndarray
    coasting: np.ndarray


def hold_weights(lam: float, h: float) -> tuple[float, float, float]:
    """The weights of F over an interval of h seconds: of its own state, and of its input
    at the left end and at the right end.

    With v = lam h and p = (1 - exp(-v))/v these are exp(-v), p - exp(-v) and 1 - p, here
    as series in v that lose no digits to cancellation.
    """
    v = lam * h
    phi1 = sum((-v) ** k / math.factorial(k + 1) for k in range(20))
    phi2 = sum((-v) ** k / math.factorial(k + 2) for k in range(20))
    return math.exp(-v), v * (phi1 - phi2), v * phi2


def replay_loop(
    t: np.ndarray,
    u: np.ndarray,
    y: np.ndarray,
    *,
    resistance: float,
    inductance: float,
    lam: float,
    substeps: int = 1,
    threshold: float = np.finfo(float).eps ** 0.75,
) -> Oracle:
    """One sample at a time; `substeps` cut each interval, with the current on its line."""
    R, L = resistance, inductance
    rho, w, f, M, v = 0.0, np.zeros(2), 0.0, np.zeros((2, 2)), np.zeros(2)
    scale = np.zeros(2)
    memory = np.zeros(2)
    flux, certificate, coasting = [memory], [0.0], [True]

    def inputs(z, i, rho, w, f, M):
        """What each filter filters, from the outputs of the ones before it."""
        d = -0.5 * L * (i @ i)
        r, b = w - rho * i, rho * d + f
        size = np.abs(w) + np.abs(rho * i)
        return (
            1.0,
            i + rho * z / (lam * L),
            w @ z / lam - d,
            np.outer(r, r),
            r * b + M @ z / lam,
            size**2,
        )

    for k in range(1, len(t)):
        h = (t[k] - t[k - 1]) / substeps
        a, left, right = hold_weights(lam, h)
        for j in range(substeps):
            i0 = y[k - 1] + j / substeps * (y[k] - y[k - 1])
            i1 = y[k - 1] + (j + 1) / substeps * (y[k] - y[k - 1])
            z0, z1 = u[k - 1] - R * i0, u[k - 1] - R * i1
            x0 = inputs(z0, i0, rho, w, f, M)
            # Inner filters first: the right end of an input needs them at that end.
            rho = a * rho + left * x0[0] + right * 1.0
            w = a * w + left * x0[1] + right * inputs(z1, i1, rho, w, f, M)[1]
            f = a * f + left * x0[2] + right * inputs(z1, i1, rho, w, f, M)[2]
            x1 = inputs(z1, i1, rho, w, f, M)
            M = a * M + left * x0[3] + right * x1[3]
            x1 = inputs(z1, i1, rho, w, f, M)
            v = a * v + left * x0[4] + right * x1[4]
            scale = a * scale + left * x0[5] + right * x1[5]
            unit = 1.0 / np.sqrt(scale)
            information = M * np.outer(unit, unit)
            # The harmonic mean of its eigenvalues; zero where rounding made it singular.
            eigenvalues = np.linalg.eigvalsh(information)
            mean = 2.0 / np.sum(1.0 / eigenvalues) if eigenvalues[0] > 0 else 0.0
            if mean > threshold:
                memory = unit * np.linalg.solve(information, unit * v)
            else:
                memory = memory + 0.5 * h * (z0 + z1)
        flux.append(memory)
        certificate.append(mean)
        coasting.append(not mean > threshold)
    return Oracle(np.array(flux), np.array(certificate), np.array(coasting))


def replay_cascade(
    t: np.ndarray,
    u: np.ndarray,
    y: np.ndarray,
    *,
    resistance: float,
    inductance: float,
    lam: float,
) -> np.ndarray:
    """The flux for evenly spaced samples, one `scipy.signal.lfilter` for each filter of
    the cascade; without certificate and coasting, so not a number at the first sample."""
    R, L = resistance, inductance
    a, left, right = hold_weights(lam, (t[-1] - t[0]) / (len(t) - 1))

    def F(x0, x1):
        """F of a signal given at the left and at the right end of every interval."""
        steps = left * x0 + right * x1
        out = scipy.signal.lfilter([1.0], [1.0, -a], steps)
        return np.concatenate([[0.0], out])

    ia, ib = y.T
    za0, zb0 = (u[:-1] - R * y[:-1]).T
    za1, zb1 = (u[:-1] - R * y[1:]).T
    ends = slice(None, -1), slice(1, None)
    first, last = ends
    rho = F(np.ones(len(t) - 1), np.ones(len(t) - 1))
    g = rho / (lam * L)
    wa = F(ia[first] + g[first] * za0, ia[last] + g[last] * za1)
    wb = F(ib[first] + g[first] * zb0, ib[last] + g[last] * zb1)
    d = -0.5 * L * (ia * ia + ib * ib)
    f = F(
        (wa[first] * za0 + wb[first] * zb0) / lam - d[first],
        (wa[last] * za1 + wb[last] * zb1) / lam - d[last],
    )
    ra, rb, b = wa - rho * ia, wb - rho * ib, rho * d + f
    Maa, Mab, Mbb = (F(s[first], s[last]) for s in (ra * ra, ra * rb, rb * rb))
    va = F(
        ra[first] * b[first] + (Maa[first] * za0 + Mab[first] * zb0) / lam,
        ra[last] * b[last] + (Maa[last] * za1 + Mab[last] * zb1) / lam,
    )
    vb = F(
        rb[first] * b[first] + (Mab[first] * za0 + Mbb[first] * zb0) / lam,
        rb[last] * b[last] + (Mab[last] * za1 + Mbb[last] * zb1) / lam,
    )
    # Cholesky: the determinant as a product would lose digits to cancellation first.
    slope = np.divide(Mab, Maa, out=np.zeros_like(Maa), where=Maa > 0)
    rest = Mbb - slope * Mab
    xb = np.divide(vb - slope * va, rest, out=np.full_like(rest, np.nan), where=rest > 0)
    xa = np.divide(va - Mab * xb, Maa, out=np.full_like(rest, np.nan), where=Maa > 0)
    return np.stack([xa, xb], axis=1)
