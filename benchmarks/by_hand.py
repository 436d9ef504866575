"""The peers of the benchmark `pmsm` without the library: C, and SciPy's `solve_ivp`."""

import ctypes
import itertools
import math
import re
import shutil
import subprocess
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from aslo_jax.filters import LowPass

from .motor_loop import (
    CURRENT_LIMIT,
    GAIN,
    INTERVAL,
    LOAD,
    MOTOR,
    NOISE,
    RATE,
    THRESHOLD,
    VOLTAGE_LIMIT,
)

SOURCE = Path(__file__).with_name("pmsm.c")
FLAGS = ["-O3", "-march=native", "-fno-math-errno", "-fopenmp", "-shared", "-fPIC"]
# What GCC leaves out at -O3: with it, operations of the interleaved vectors take turns.
SCHEDULED = ["-fschedule-insns", "-fsched-pressure"]
NARROW = ["-mno-avx512f"]  # registers of 32 bytes on a host that has wider ones
WIDEST = 4  # vectors that are interleaved: 1, 2 or 4, the fastest counts


def settings() -> dict[str, float]:
    """What the C source and the equations below call the parameters."""
    decay, left, right = (float(x) for x in LowPass(RATE).discretise(INTERVAL)[:3])
    smooth = [float(x) for x in LowPass(GAIN).discretise(INTERVAL)[:3]]
    return {
        "interval": INTERVAL,
        "resistance": float(MOTOR.resistance),
        "inductance": float(MOTOR.inductance),
        "magnet_flux": float(MOTOR.magnet_flux),
        "pole_pairs": MOTOR.pole_pairs,
        "inertia": float(MOTOR.inertia),
        "load": LOAD,
        "current_limit": CURRENT_LIMIT,
        "voltage_limit": VOLTAGE_LIMIT,
        "current_bandwidth": 2000.0,
        "speed_bandwidth": 300.0,
        "rate": RATE,
        "decay": decay,
        "left": left,
        "right": right,
        "gain": GAIN,
        "smooth_decay": smooth[0],
        "smooth_left": GAIN * smooth[1],
        "smooth_right": GAIN * smooth[2],
        "threshold": THRESHOLD,
        "deviation": NOISE,
    }


class _Settings(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in settings()]


class ByHand:
    """`pmsm.c`, compiled into `folder` for some numbers of interleaved vectors, and with
    more options of GCC."""

    def __init__(self, folder: str, more: Sequence[str] = ()):
        self.folder, self.more = Path(folder), more
        self.blocks = [1, 2, WIDEST]
        with ThreadPoolExecutor(len(self.blocks)) as pool:
            made = pool.map(self._compiled, self.blocks)
            self.libraries = dict(zip(self.blocks, made, strict=True))

    @staticmethod
    def available() -> bool:
        return shutil.which("gcc") is not None

    def _command(self, blocks: int, *more: str) -> list[str]:
        return ["gcc", *FLAGS, f"-DBLOCKS={blocks}", *more, str(SOURCE), "-lm"]

    def _compiled(self, blocks: int) -> ctypes.CDLL:
        path = self.folder / f"pmsm{blocks}{''.join(self.more)}.so"
        subprocess.run(self._command(blocks, *self.more, "-o", str(path)), check=True)
        return ctypes.CDLL(str(path))

    def sampled(self, blocks: int, batch, steps: int, threads: int, noisy: bool = False):
        """A function without arguments: final flux, ASLO and A-ASLO, shape `(N, 3, 2)`."""
        lanes = len(batch[0])
        padded = -(-lanes // (8 * WIDEST)) * 8 * WIDEST
        fill = lambda x: np.ascontiguousarray(
            np.concatenate([x, np.repeat(x[-1:], padded - lanes, axis=0)]).T
        )
        resistance, magnet, keys = (fill(np.asarray(x)) for x in batch)
        reference = 20.0 + 5.0 * np.sin(INTERVAL * np.arange(steps + 1))
        out, given = np.empty((6, padded)), _Settings(**settings())
        pointer = lambda x: ctypes.c_void_p(x.ctypes.data)
        library = self.libraries[blocks]

        def run():
            library.run(
                ctypes.byref(given),
                ctypes.c_long(padded),
                ctypes.c_long(steps),
                *map(pointer, (reference, resistance, magnet)),
                pointer(keys) if noisy else None,
                pointer(out),
                threads,
            )
            return out[:, :lanes].T.reshape(lanes, 3, 2)

        return run

    def operations(self, noisy: bool) -> int:
        """Of one step of one trajectory: the arithmetic, comparing and selecting vector
        instructions in the loop, a product with a sum counted as two."""
        path = self.folder / "pmsm.s"
        subprocess.run(self._command(1, *self.more, "-S", "-o", str(path)), check=True)
        text = path.read_text()
        name = "noisy" if noisy else "quiet"
        body = text[text.index(f"\n{name}:") :].split("# step begins", 1)[1]
        return count_operations(body.split("# step ends", 1)[0])


def count_operations(assembly: str) -> int:
    """Vector operations of x86 assembly of one block, each of all its lanes, whether words
    or doubles; 0 elsewhere."""
    total = 0
    for line in assembly.splitlines():
        match = re.match(r"\s+v(\w+)\s", line)
        if match is None or not re.search(_COUNTED, match[1]) or match[1].endswith("sd"):
            continue
        total += 2 if re.match(r"fn?m(add|sub)", match[1]) else 1
    return total


_COUNTED = (
    r"^(add|sub|mul|div|sqrt|max|min|cmp|rndscale|roundpd|blend|cvt|and|or|xor|"
    r"fn?m(add|sub)|padd|psub|psll|psrl|psra|prol|pror|pxor|por|pand|pternlog|ptest|pcmp)"
)


# ---- SciPy ---------------------------------------------------------------------------


def vector_field(resistance: float, magnet: float):
    """The loop in continuous time as plain arithmetic on 23 numbers."""
    p = settings()
    L, R, m, n = (p[k] for k in ("inductance", "resistance", "magnet_flux", "pole_pairs"))
    J, bs, bc, lam = p["inertia"], p["speed_bandwidth"], p["current_bandwidth"], RATE
    kt = 1.5 * n * m
    limit = CURRENT_LIMIT * kt
    tracking = 50.0
    sin, cos, sqrt = math.sin, math.cos, math.sqrt

    def rates(t, X):
        (
            f0, f1, w, angle, tq, q0, q1, H, K0, K1, W, M00, M01, M11, v0, v1, s0, s1,
            c0, c1, N, A0, A1,
        ) = X.tolist()  # fmt: skip
        c, s = cos(n * angle), sin(n * angle)
        y0, y1 = (f0 - magnet * c) / L, (f1 - magnet * s) / L
        torque = 1.5 * n * magnet * (c * y1 - s * y0)
        # Control.
        error = 20.0 + 5.0 * sin(t) - w
        wanted = tq + bs * J * error
        clipped = min(max(wanted, -limit), limit)
        iq, emf, speed = clipped / kt, n * w * m, n * w
        e0, e1 = -s * iq - y0, c * iq - y1
        w0, w1 = bc * L * e0 + q0 - s * emf, bc * L * e1 + q1 + c * emf
        scale = min(1.0, VOLTAGE_LIMIT / sqrt(w0 * w0 + w1 * w1 + 1e-300))
        u0, u1 = w0 * scale, w1 * scale
        # Observe.
        z0, z1 = u0 - R * y0, u1 - R * y1
        d = 0.5 * (m * m / L - L * (y0 * y0 + y1 * y1))
        r0, r1, b = K0 - H * y0, K1 - H * y1, H * d + W
        length = sqrt(K0 * K0 + K1 * K1) + H * sqrt(y0 * y0 + y1 * y1)
        n0 = n1 = sqrt(0.5) * length
        det, size = M00 * M11 - M01 * M01, M00 * s1 + M11 * s0
        certificate = 2.0 * det / size if det > 0.0 and size > 0.0 else 0.0
        x0 = (M11 * v0 - M01 * v1) / det if certificate > 0.0 else 0.0
        x1 = (M00 * v1 - M01 * v0) / det if certificate > 0.0 else 0.0
        trust = min(max((certificate - THRESHOLD) / THRESHOLD, 0.0), 1.0)
        e = tracking * trust
        g = GAIN * trust
        sure = certificate > THRESHOLD
        a0, a1 = (x0, x1) if sure else (c0, c1)
        return (
            u0 - resistance * y0, u1 - resistance * y1, (torque - LOAD) / J, w,
            bs * bs * J / 4.0 * error + bs * (clipped - wanted),
            bc * R * e0 - speed * q1 + bc * (u0 - w0),
            bc * R * e1 + speed * q0 + bc * (u1 - w1),
            lam * (1.0 - H),
            lam * (y0 - K0) + H * z0 / L, lam * (y1 - K1) + H * z1 / L,
            K0 * z0 + K1 * z1 - lam * (d + W),
            lam * (r0 * r0 - M00), lam * (r0 * r1 - M01), lam * (r1 * r1 - M11),
            lam * (r0 * b - v0) + M00 * z0 + M01 * z1,
            lam * (r1 * b - v1) + M01 * z0 + M11 * z1,
            lam * (n0 * n0 - s0), lam * (n1 * n1 - s1),
            z0 + e * (x0 - c0), z1 + e * (x1 - c1),
            g * (1.0 - N), g * (a0 - A0) + N * z0, g * (a1 - A1) + N * z1,
        )  # fmt: skip

    return rates


def solve_ivp(batch, steps: int, trajectories: int, method: str, tolerance: float):
    """A function without arguments: the first trajectories of the batch, one by one."""
    import scipy.integrate

    def one(resistance: float, magnet: float):
        start = np.zeros(23)
        start[0] = magnet
        found = scipy.integrate.solve_ivp(
            vector_field(resistance, magnet),
            (0.0, steps * INTERVAL),
            start,
            method=method,
            t_eval=[steps * INTERVAL],
            rtol=tolerance,
            atol=1e-3 * tolerance,
        ).y[:, -1]
        M00, M01, M11, v0, v1 = found[11:16]
        det = M00 * M11 - M01 * M01
        algebraic = np.array([M11 * v0 - M01 * v1, M00 * v1 - M01 * v0]) / det
        return np.stack([found[:2], algebraic, found[21:] / found[20]])

    pairs = zip(*batch[:2], strict=True)
    chosen = [(float(r), float(m)) for r, m in itertools.islice(pairs, trajectories)]
    return lambda: np.stack([one(*pair) for pair in chosen])
