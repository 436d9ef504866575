"""The sampled least-squares flux observer of the PMSM, written without JAX: sample by
sample, to be checked by eye, and as a cascade of filters over whole arrays, to be fast.

All in the paper's F[x], the low-pass filter lam/(p + lam), every one started from zero:

    rho = F[1]
    w   = F[i + rho z / (lam L)]               z = u - R i, the derivative of the flux
    r   = w - rho i
    b   = rho d + F[w'z / lam - d]             d = -(L/2) |i|^2
    M   = F[r r'],   v = F[r b + M z / lam]    flux = M^-1 v

F filters a sequence of samples, as if they were joined by lines. What is multiplied by the
flux at the left end of an interval is carried to the flux at its right end, D more:

    D = h (z0 + z1) / 2           the voltage is held, and the current is a line
    q = D / L                     the change of the current that the flux alone would make

so that r'flux = b holds at every sample, but for the error of D.
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
    scale = 0.0
    memory = np.zeros(2)
    flux, certificate, coasting = [memory], [0.0], [True]

    def row(i, rho, w, f):
        """The row, and what it is measured against: what it is the difference of."""
        d = -0.5 * L * (i @ i)
        size = np.linalg.norm(w) + np.linalg.norm(rho * i)
        return w - rho * i, rho * d + f, 0.5 * size**2

    for k in range(1, len(t)):
        h = (t[k] - t[k - 1]) / substeps
        a, left, right = hold_weights(lam, h)
        for j in range(substeps):
            i0 = y[k - 1] + j / substeps * (y[k] - y[k - 1])
            i1 = y[k - 1] + (j + 1) / substeps * (y[k] - y[k - 1])
            z0, z1 = u[k - 1] - R * i0, u[k - 1] - R * i1
            D = 0.5 * h * (z0 + z1)
            q, (r0, b0, size0) = D / L, row(i0, rho, w, f)
            f = a * (f + (w + 0.5 * rho * q) @ D) + left * (i0 + 0.5 * q) @ D
            f += 0.5 * L * (left * i0 @ i0 + right * i1 @ i1)
            w = a * (w + rho * q) + left * (i0 + q) + right * i1
            rho = a * rho + left + right
            r1, b1, size1 = row(i1, rho, w, f)
            v = a * (v + M @ D) + left * r0 * (b0 + r0 @ D) + right * r1 * b1
            M = a * M + left * np.outer(r0, r0) + right * np.outer(r1, r1)
            scale = a * scale + left * size0 + right * size1
            unit = 1.0 / np.sqrt(scale)
            information = M * unit**2
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
    h = (t[-1] - t[0]) / (len(t) - 1)
    a, left, right = hold_weights(lam, h)

    def F(x0, x1, carried=0.0):
        """F of a signal given at the left and at the right end of every interval, with what
        its own state is carried by."""
        steps = left * x0 + right * x1 + a * carried
        out = scipy.signal.lfilter([1.0], [1.0, -a], steps)
        return np.concatenate([[0.0], out])

    ia, ib = y.T
    Da, Db = h * (u[:-1] - 0.5 * R * (y[:-1] + y[1:])).T
    qa, qb = Da / L, Db / L
    first, last = slice(None, -1), slice(1, None)
    rho = F(np.ones(len(t) - 1), np.ones(len(t) - 1))
    wa = F(ia[first] + qa, ia[last], rho[first] * qa)
    wb = F(ib[first] + qb, ib[last], rho[first] * qb)
    d = -0.5 * L * (ia * ia + ib * ib)
    half = 0.5 * (qa * Da + qb * Db)
    f = F(
        ia[first] * Da + ib[first] * Db + half - d[first],
        -d[last],
        wa[first] * Da + wb[first] * Db + rho[first] * half,
    )
    ra, rb, b = wa - rho * ia, wb - rho * ib, rho * d + f
    Maa, Mab, Mbb = (F(s[first], s[last]) for s in (ra * ra, ra * rb, rb * rb))
    seen = b[first] + ra[first] * Da + rb[first] * Db
    va = F(ra[first] * seen, ra[last] * b[last], Maa[first] * Da + Mab[first] * Db)
    vb = F(rb[first] * seen, rb[last] * b[last], Mab[first] * Da + Mbb[first] * Db)
    # Cholesky: the determinant as a product would lose digits to cancellation first.
    slope = np.divide(Mab, Maa, out=np.zeros_like(Maa), where=Maa > 0)
    rest = Mbb - slope * Mab
    xb = np.divide(vb - slope * va, rest, out=np.full_like(rest, np.nan), where=rest > 0)
    xa = np.divide(va - Mab * xb, Maa, out=np.full_like(rest, np.nan), where=Maa > 0)
    return np.stack([xa, xb], axis=1)
