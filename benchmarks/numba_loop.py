"""The sampled closed loop of the benchmark `pmsm` by hand in Numba: the equations of
`pmsm.c`, one trajectory after another as plain scalar code, trajectories shared among
threads. Numbers of equations and names are those of `docs/theory.md`."""

import importlib.util
import math

import numpy as np

from .by_hand import settings
from .motor_loop import INTERVAL

# As LLVM may for the fused engine: contract, no signed zeros, reciprocals.
FAST = {"contract", "nsz", "arcp"}


def available() -> bool:
    return importlib.util.find_spec("numba") is not None


def sampled(batch, steps: int, threads: int, noisy: bool = False):
    """A function without arguments: final flux, ASLO and A-ASLO, shape `(N, 3, 2)`."""
    import numba  # pyright: ignore[reportMissingImports]  of an optional peer

    resistance, magnet, keys = (np.ascontiguousarray(x) for x in batch)
    loop = _compiled()
    reference = 20.0 + 5.0 * np.sin(INTERVAL * np.arange(steps + 1))
    given = tuple(settings().values())

    def run():
        numba.set_num_threads(threads)
        return loop(given, steps, reference, resistance, magnet, keys, noisy)

    return run


def _compiled():
    """The loop: Numba is imported where it is asked for, and compiles at the first call."""
    from numba import njit, prange, uint32  # pyright: ignore[reportMissingImports]

    sin, cos, sqrt, log = math.sin, math.cos, math.sqrt, math.log

    @njit(fastmath=FAST)
    def rotate(x, r):
        return uint32(uint32(x << uint32(r)) | uint32(x >> uint32(32 - r)))

    @njit(fastmath=FAST)
    def mixed(x0, x1, by):
        for r in by:
            x0 = uint32(x0 + x1)
            x1 = uint32(rotate(x1, r) ^ x0)
        return x0, x1

    @njit(fastmath=FAST)
    def normal(k0, k1, index):
        """Two normal numbers by Threefry-2x32 and Box-Muller, as in aslo_jax/random.py."""
        k2 = uint32(k0 ^ k1 ^ uint32(0x1BD11BDA))
        even, odd = (13, 15, 26, 6), (17, 29, 16, 24)
        x0, x1 = mixed(uint32(k0 + uint32(index)), k1, even)
        x0, x1 = mixed(uint32(x0 + k1), uint32(x1 + k2 + uint32(1)), odd)
        x0, x1 = mixed(uint32(x0 + k2), uint32(x1 + k0 + uint32(2)), even)
        x0, x1 = mixed(uint32(x0 + k0), uint32(x1 + k1 + uint32(3)), odd)
        x0, x1 = mixed(uint32(x0 + k1), uint32(x1 + k2 + uint32(4)), even)
        x0, x1 = uint32(x0 + k2), uint32(x1 + k0 + uint32(5))
        radius = sqrt(-2.0 * log((x0 + 0.5) * 2.0**-32))
        angle = (x1 + 0.5) * (2.0**-32 * 2.0 * math.pi)
        return radius * cos(angle), radius * sin(angle)

    @njit(fastmath=FAST, parallel=True)
    def loop(given, steps, reference, resistances, magnets, keys, noisy):
        (
            h, R, L, m, n, J, load, current_limit, voltage_limit, bc, bs,
            lam, dec, lef, rig, _, smooth_decay, smooth_left, smooth_right,
            threshold, deviation,
        ) = given  # fmt: skip
        kt = 1.5 * n * m
        limit, bsJ = current_limit * kt, bs * J
        lefl, rigl = lef * lam, rig * lam
        mm = 0.5 * m * m / L
        out = np.empty((len(magnets), 3, 2))
        for lane in prange(len(magnets)):
            mag, RL = magnets[lane], resistances[lane] / L
            k0, k1 = keys[lane, 0], keys[lane, 1]
            kJ = 1.5 * n * mag / (L * J)
            f0, f1, w, th, c, s = mag, 0.0, 0.0, 0.0, 1.0, 0.0
            tq = q0 = q1 = y0 = y1 = H = 0.0
            K0 = K1 = W = r0 = r1 = b = N0 = 0.0
            M00 = M01 = M11 = v0 = v1 = size = 0.0
            x0 = x1 = a0 = a1 = weight = 0.0
            ok = False
            if noisy:
                y0, y1 = normal(k0, k1, 0)
                y0, y1 = deviation * y0, deviation * y1
            for k in range(steps):
                # Control: speed to torque, torque to current, current to voltage.
                error = reference[k] - w
                wanted = tq + bsJ * error
                torque = min(max(wanted, -limit), limit)
                tq += h * bs * bsJ / 4.0 * error + h * bs * (torque - wanted)
                iq, emf, turn = torque / kt, n * m * w, h * n * w
                e0, e1 = -s * iq - y0, c * iq - y1
                w0 = bc * L * e0 + q0 - s * emf
                w1 = bc * L * e1 + q1 + c * emf
                length = sqrt(w0 * w0 + w1 * w1 + 2.2250738585072014e-308)
                scale = min(1.0, voltage_limit / length)
                u0, u1 = w0 * scale, w1 * scale
                q0, q1 = (
                    q0 + h * bc * R * e0 - turn * q1 + h * bc * (u0 - w0),
                    q1 + h * bc * R * e1 + turn * q0 + h * bc * (u1 - w1),
                )
                # The plant, by Runge and Kutta.
                d0 = d1 = dw = dth = 0.0
                F0, F1, S, C, w2 = f0, f1, s, c, w
                for stage in range(4):
                    g0 = u0 - RL * (F0 - mag * C)
                    g1 = u1 - RL * (F1 - mag * S)
                    gw = kJ * (C * F1 - S * F0) - load / J
                    share = 2.0 if stage in (1, 2) else 1.0
                    d0, d1 = d0 + share * g0, d1 + share * g1
                    dw, dth = dw + share * gw, dth + share * w2
                    if stage < 3:
                        to = h if stage == 2 else 0.5 * h
                        angle = th + to * n * w2
                        S, C = sin(angle), cos(angle)
                        F0, F1, w2 = f0 + to * g0, f1 + to * g1, w + to * gw
                f0, f1, w = f0 + h / 6.0 * d0, f1 + h / 6.0 * d1, w + h / 6.0 * dw
                th += h * n / 6.0 * dth
                s, c = sin(th), cos(th)
                # Measure and observe.
                i0, i1 = (f0 - mag * c) / L, (f1 - mag * s) / L
                if noisy:
                    e0, e1 = normal(k0, k1, k + 1)
                    i0, i1 = i0 + deviation * e0, i1 + deviation * e1
                H0 = H
                H = dec * H + lefl + rigl
                m0, m1 = h * (u0 - 0.5 * R * (y0 + i0)), h * (u1 - 0.5 * R * (y1 + i1))
                p0, p1 = 0.5 * m0 / L, 0.5 * m1 / L
                D0 = mm - 0.5 * L * (y0 * y0 + y1 * y1)
                D1 = mm - 0.5 * L * (i0 * i0 + i1 * i1)
                W = dec * (W + (K0 + H0 * p0) * m0 + (K1 + H0 * p1) * m1) - rigl * D1
                W += lefl * ((y0 + p0) * m0 + (y1 + p1) * m1 - D0)
                K0 = dec * (K0 + 2.0 * H0 * p0) + lefl * (y0 + 2.0 * p0) + rigl * i0
                K1 = dec * (K1 + 2.0 * H0 * p1) + lefl * (y1 + 2.0 * p1) + rigl * i1
                g0, g1 = H * i0, H * i1
                R0, R1, b1 = K0 - g0, K1 - g1, H * D1 + W
                N1 = sqrt(K0 * K0 + K1 * K1) + sqrt(g0 * g0 + g1 * g1)
                size = dec * size + 0.5 * (lefl * (N0 * N0) + rigl * (N1 * N1))
                seen = lefl * (b + r0 * m0 + r1 * m1)
                v0 = dec * (v0 + M00 * m0 + M01 * m1) + seen * r0 + rigl * (R0 * b1)
                v1 = dec * (v1 + M01 * m0 + M11 * m1) + seen * r1 + rigl * (R1 * b1)
                M00 = dec * M00 + lefl * (r0 * r0) + rigl * (R0 * R0)
                M01 = dec * M01 + lefl * (r0 * r1) + rigl * (R0 * R1)
                M11 = dec * M11 + lefl * (r1 * r1) + rigl * (R1 * R1)
                r0, r1, b, N0 = R0, R1, b1, N1
                det = M00 * M11 - M01 * M01
                sure = 2.0 * det > threshold * size * (M00 + M11)
                X0, X1, A0, A1 = x0 + m0, x1 + m1, a0 + m0, a1 + m1
                if sure:
                    X0, X1 = (M11 * v0 - M01 * v1) / det, (M00 * v1 - M01 * v0) / det
                    # A-ASLO: along the model, then towards the estimate.
                    e0, e1 = X0 - A0, X1 - A1
                    o0, o1 = (x0 - a0, x1 - a1) if ok else (e0, e1)
                    weight = smooth_decay * weight + (1.0 - smooth_decay)
                    A0 += (smooth_left * o0 + smooth_right * e0) / weight
                    A1 += (smooth_left * o1 + smooth_right * e1) / weight
                x0, x1, a0, a1, ok = X0, X1, A0, A1, sure
                y0, y1 = i0, i1
            out[lane, 0] = f0, f1
            out[lane, 1] = x0, x1
            out[lane, 2] = (a0, a1) if weight > 0.0 else (x0, x1)
        return out

    return loop
