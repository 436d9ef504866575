/* The replay of benchmarks/replay.py by hand: one log of a PMSM, least squares from the exact
   start, with certificate and coasting. Nothing but the recursion, in the order of
   tests/oracles.py; `dec` weighs a filter's state over an interval, `lam lef` and `lam rig` the
   ends of its input. Samples depend on each other, so there is nothing for vectors. */

#include <math.h>

void replay(long samples, double h, double R, double L, double lam, double dec, double lef,
            double rig, double threshold, const double (*u)[2], const double (*y)[2],
            double (*flux)[2], double *certificate) {
  const double lefl = lef * lam, rigl = rig * lam, perlamL = 1.0 / (lam * L);
  double H = 0, K0 = 0, K1 = 0, W = 0, r0 = 0, r1 = 0, b = 0, n0 = 0, n1 = 0;
  double M00 = 0, M01 = 0, M11 = 0, v0 = 0, v1 = 0, s0 = 0, s1 = 0, x0 = 0, x1 = 0;
  flux[0][0] = flux[0][1] = certificate[0] = 0.0;
  for (long k = 1; k < samples; k++) {
    const double y0 = y[k - 1][0], y1 = y[k - 1][1], i0 = y[k][0], i1 = y[k][1];
    const double u0 = u[k - 1][0], u1 = u[k - 1][1], H0 = H;
    const double z00 = u0 - R * y0, z01 = u1 - R * y1, z10 = u0 - R * i0, z11 = u1 - R * i1;
    const double d0 = -0.5 * L * (y0 * y0 + y1 * y1), d1 = -0.5 * L * (i0 * i0 + i1 * i1);
    H = dec * H + lefl + rigl;
    const double left = K0 * z00 + K1 * z01 - lam * d0;
    K0 = dec * K0 + lefl * (y0 + H0 * perlamL * z00) + rigl * (i0 + H * perlamL * z10);
    K1 = dec * K1 + lefl * (y1 + H0 * perlamL * z01) + rigl * (i1 + H * perlamL * z11);
    W = dec * W + lef * left + rig * (K0 * z10 + K1 * z11 - lam * d1);
    const double g0 = H * i0, g1 = H * i1, R0 = K0 - g0, R1 = K1 - g1, B = H * d1 + W;
    const double N0 = fabs(K0) + fabs(g0), N1 = fabs(K1) + fabs(g1);
    s0 = dec * s0 + lefl * n0 * n0 + rigl * N0 * N0;
    s1 = dec * s1 + lefl * n1 * n1 + rigl * N1 * N1;
    const double l0 = lam * r0 * b + M00 * z00 + M01 * z01;
    const double l1 = lam * r1 * b + M01 * z00 + M11 * z01;
    M00 = dec * M00 + lefl * r0 * r0 + rigl * R0 * R0;
    M01 = dec * M01 + lefl * r0 * r1 + rigl * R0 * R1;
    M11 = dec * M11 + lefl * r1 * r1 + rigl * R1 * R1;
    v0 = dec * v0 + lef * l0 + rig * (lam * R0 * B + M00 * z10 + M01 * z11);
    v1 = dec * v1 + lef * l1 + rig * (lam * R1 * B + M01 * z10 + M11 * z11);
    r0 = R0; r1 = R1; b = B; n0 = N0; n1 = N1;
    const double det = M00 * M11 - M01 * M01, size = M00 * s1 + M11 * s0;
    const double sure = size > 0.0 && det > 0.0 ? 2.0 * det / size : 0.0;
    if (sure > threshold) {
      x0 = (M11 * v0 - M01 * v1) / det;
      x1 = (M00 * v1 - M01 * v0) / det;
    } else {
      x0 += 0.5 * h * (z00 + z10);
      x1 += 0.5 * h * (z01 + z11);
    }
    flux[k][0] = x0;
    flux[k][1] = x1;
    certificate[k] = sure;
  }
}
