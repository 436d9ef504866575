/* The replay of benchmarks/replay.py by hand: one log of a PMSM, least squares from the exact
   start, with certificate and coasting. Nothing but the recursion, in the order of
   tests/oracles.py; `dec` weighs a filter's state over an interval, `lam lef` and `lam rig` the
   ends of its input. Samples depend on each other, so there is nothing for vectors. */

#include <math.h>

void replay(long samples, double h, double R, double L, double lam, double dec, double lef,
            double rig, double threshold, const double (*u)[2], const double (*y)[2],
            double (*flux)[2], double *certificate) {
  const double lefl = lef * lam, rigl = rig * lam, perL = 1.0 / L;
  double H = 0, K0 = 0, K1 = 0, W = 0, r0 = 0, r1 = 0, b = 0, N0 = 0;
  double M00 = 0, M01 = 0, M11 = 0, v0 = 0, v1 = 0, size = 0, x0 = 0, x1 = 0;
  flux[0][0] = flux[0][1] = certificate[0] = 0.0;
  for (long k = 1; k < samples; k++) {
    const double y0 = y[k - 1][0], y1 = y[k - 1][1], i0 = y[k][0], i1 = y[k][1];
    const double u0 = u[k - 1][0], u1 = u[k - 1][1], H0 = H;
    const double m0 = h * (u0 - 0.5 * R * (y0 + i0)), m1 = h * (u1 - 0.5 * R * (y1 + i1));
    const double q0 = perL * m0, q1 = perL * m1, p0 = 0.5 * q0, p1 = 0.5 * q1;
    const double d0 = -0.5 * L * (y0 * y0 + y1 * y1), d1 = -0.5 * L * (i0 * i0 + i1 * i1);
    H = dec * H + lefl + rigl;
    W = dec * (W + (K0 + H0 * p0) * m0 + (K1 + H0 * p1) * m1)
      + lefl * ((y0 + p0) * m0 + (y1 + p1) * m1 - d0) - rigl * d1;
    K0 = dec * (K0 + H0 * q0) + lefl * (y0 + q0) + rigl * i0;
    K1 = dec * (K1 + H0 * q1) + lefl * (y1 + q1) + rigl * i1;
    const double g0 = H * i0, g1 = H * i1, R0 = K0 - g0, R1 = K1 - g1, B = H * d1 + W;
    const double N1 = sqrt(K0 * K0 + K1 * K1) + sqrt(g0 * g0 + g1 * g1);
    size = dec * size + 0.5 * (lefl * N0 * N0 + rigl * N1 * N1);
    const double seen = lefl * (b + r0 * m0 + r1 * m1);
    v0 = dec * (v0 + M00 * m0 + M01 * m1) + seen * r0 + rigl * R0 * B;
    v1 = dec * (v1 + M01 * m0 + M11 * m1) + seen * r1 + rigl * R1 * B;
    M00 = dec * M00 + lefl * r0 * r0 + rigl * R0 * R0;
    M01 = dec * M01 + lefl * r0 * r1 + rigl * R0 * R1;
    M11 = dec * M11 + lefl * r1 * r1 + rigl * R1 * R1;
    r0 = R0; r1 = R1; b = B; N0 = N1;
    const double det = M00 * M11 - M01 * M01, whole = size * (M00 + M11);
    const double sure = whole > 0.0 && det > 0.0 ? 2.0 * det / whole : 0.0;
    if (sure > threshold) {
      x0 = (M11 * v0 - M01 * v1) / det;
      x1 = (M00 * v1 - M01 * v0) / det;
    } else {
      x0 += m0;
      x1 += m1;
    }
    flux[k][0] = x0;
    flux[k][1] = x1;
    certificate[k] = sure;
  }
}
