/* The sampled closed loop of benchmarks/pmsm.py by hand: PMSM, field-oriented control by
   the measured angle, guarded least squares from the exact start (ASLO), A-ASLO.

   Lanes are trajectories: vectors of LANES doubles, BLOCKS of them interleaved so that their
   chains of operations hide each other's latency. The loop over time is inside, the state
   stays in registers and L1. What the end of an interval knows and the next start needs
   again (sine, cosine, currents, rows, the solution) is kept. The 2 x 2 system is solved in
   closed form, in which the scaling of the certificate cancels but for its comparison.
   Names and numbers of equations are those of docs/theory.md. */

#include "vectors.h"

/* The noise of every block by Threefry-2x32 and Box-Muller, as in aslo_jax/random.py. */
INLINE void normal(const words *k0, const words *k1, uint32_t index, vec *a, vec *b) {
  static const int by[2][4] = {{13, 15, 26, 6}, {17, 29, 16, 24}};
  union { words all[BLOCKS / PAIR]; part of[BLOCKS]; } x0, x1;
  for (int i = 0; i < BLOCKS / PAIR; i++) {
    const words keys[3] = {k0[i], k1[i], k0[i] ^ k1[i] ^ 0x1BD11BDAu};
    words w0 = keys[0] + index, w1 = keys[1];
#pragma GCC unroll 5
    for (int g = 0; g < 5; g++) {
#pragma GCC unroll 4
      for (int j = 0; j < 4; j++) {
        const int r = by[g % 2][j];
        w0 += w1;
        w1 = ((w1 << r) | (w1 >> (32 - r))) ^ w0;
      }
      w0 += keys[(g + 1) % 3];
      w1 += keys[(g + 2) % 3] + (uint32_t)(g + 1);
    }
    x0.all[i] = w0;
    x1.all[i] = w1;
  }
  for (int i = 0; i < BLOCKS; i++) {
    vec sine, cosine, radius = root(-2.0 * logarithm(real_and_half(x0.of[i]) * 0x1p-32));
    circle(real_and_half(x1.of[i]) * (0x1p-32 * 2.0 * M_PI), &sine, &cosine);
    a[i] = radius * cosine;
    b[i] = radius * sine;
  }
}

/* ---- the loop ------------------------------------------------------------------------ */

typedef struct {
  double interval, resistance, inductance, magnet_flux, pole_pairs, inertia, load;
  double current_limit, voltage_limit, current_bandwidth, speed_bandwidth;
  double rate, decay, left, right;                     /* F: first-order hold */
  double gain, smooth_decay, smooth_left, smooth_right;/* A-ASLO: the same, times gain */
  double threshold, deviation;                         /* guard; current noise */
} settings;

#define FOR for (int i = 0; i < BLOCKS; i++)
#define V(name) vec name[BLOCKS]
#define AT(array) (*(const vec *)((array) + lane + LANES * i))
#define LIFT(array, value) (*(vec *)((array) + lane + LANES * i) = (value))

/* `out`: 6 rows of `lanes`: final flux, ASLO, A-ASLO. `reference`: the speed (rad/s) at
   each of the samples, steps + 1 of them. `keys`: two rows of words, or null for no noise.
   `lanes` is a multiple of LANES BLOCKS. */
INLINE void block(
    const settings *p, long lane, long lanes, long steps, const double *reference,
    const double *resistance, const double *magnet_flux, const uint32_t *keys, double *out,
    const int noisy) {
  const double h = p->interval, L = p->inductance, perL = 1.0 / L, R = p->resistance;
  const double m = p->magnet_flux, np = p->pole_pairs, perJ = 1.0 / p->inertia;
  const double kt = 1.5 * np * m, perkt = 1.0 / kt, limit = p->current_limit * kt;
  const double bs = p->speed_bandwidth, bc = p->current_bandwidth;
  const double bsJ = bs * p->inertia, hbs = h * bs, hI = h * bs * bsJ / 4.0;
  const double bcL = bc * L, hbcR = h * bc * R, hbc = h * bc, hnp = h * np;
  const double lam = p->rate, dec = p->decay, lef = p->left, rig = p->right;
  const double lefl = lef * lam, rigl = rig * lam, ones = (lef + rig) * lam;
  const double loadJ = p->load * perJ, mm = 0.5 * m * m * perL;
  const vec zero = {0};

  V(RL); V(mag); V(kJ);                        /* of each trajectory */
  V(f0); V(f1); V(w); V(th); V(c); V(s);       /* flux, speed, electrical angle */
  V(tq); V(q0); V(q1); V(u0); V(u1);           /* controller, held voltage */
  V(y0); V(y1);                                /* measured current */
  V(K0); V(K1); V(W); V(r0); V(r1); V(b); V(N);
  V(M00); V(M01); V(M11); V(v0); V(v1); V(whole);
  V(x0); V(x1); V(a0); V(a1); V(weight);       /* ASLO, A-ASLO and its weight */
  mask ok[BLOCKS];
  words k0[BLOCKS / PAIR], k1[BLOCKS / PAIR];
  double H = 0.0;

  FOR {
    mag[i] = AT(magnet_flux);
    RL[i] = AT(resistance) * perL;
    kJ[i] = 1.5 * np * perL * perJ * mag[i];
    f0[i] = mag[i];
    f1[i] = w[i] = th[i] = s[i] = zero;
    c[i] = zero + 1.0;
    tq[i] = q0[i] = q1[i] = y0[i] = y1[i] = zero;
    K0[i] = K1[i] = W[i] = r0[i] = r1[i] = b[i] = N[i] = zero;
    M00[i] = M01[i] = M11[i] = v0[i] = v1[i] = whole[i] = zero;
    x0[i] = x1[i] = a0[i] = a1[i] = weight[i] = zero;
    ok[i] = more(zero, zero);
  }
  if (noisy)
    for (int i = 0; i < BLOCKS / PAIR; i++) {
      k0[i] = *(const words *)(keys + lane + PAIR * LANES * i);
      k1[i] = *(const words *)(keys + lanes + lane + PAIR * LANES * i);
    }

  V(e0); V(e1);
#define MEASURE \
  vec i0 = (f0[i] - mag[i] * c[i]) * perL, i1 = (f1[i] - mag[i] * s[i]) * perL; \
  if (noisy) { \
    i0 += p->deviation * e0[i]; \
    i1 += p->deviation * e1[i]; \
  }

  if (noisy) normal(k0, k1, 0, e0, e1);
  FOR {
    MEASURE
    y0[i] = i0; y1[i] = i1;
  }
  for (long k = 0; k < steps; k++) {
    const double speed = reference[k];
    asm volatile("# step begins");
    /* Control: speed to torque, torque to current, current to voltage. */
    FOR {
      vec error = speed - w[i], wanted = tq[i] + bsJ * error;
      vec torque = least(most(wanted, zero - limit), zero + limit);
      tq[i] += hI * error + hbs * (torque - wanted);
      vec iq = torque * perkt, emf = (np * m) * w[i];
      vec e0 = -s[i] * iq - y0[i], e1 = c[i] * iq - y1[i];
      vec w0 = bcL * e0 + q0[i] - s[i] * emf, w1 = bcL * e1 + q1[i] + c[i] * emf;
      vec length = root(w0 * w0 + w1 * w1 + 2.2250738585072014e-308);
      vec scale = least(zero + 1.0, p->voltage_limit / length);
      u0[i] = w0 * scale;
      u1[i] = w1 * scale;
      vec turn = hnp * w[i], Q0 = q0[i], Q1 = q1[i];
      q0[i] = Q0 + hbcR * e0 - turn * Q1 + hbc * (u0[i] - w0);
      q1[i] = Q1 + hbcR * e1 + turn * Q0 + hbc * (u1[i] - w1);
    }
    /* The plant, by Runge and Kutta; block by block in every stage. */
    V(d0); V(d1); V(dw); V(dth); V(F0); V(F1); V(S); V(C); V(w2);
#define RATES(F0, F1, S, C) \
  vec g0 = u0[i] - RL[i] * (F0 - mag[i] * C), g1 = u1[i] - RL[i] * (F1 - mag[i] * S); \
  vec gw = kJ[i] * (C * F1 - S * F0) - loadJ;
#define STAGE(to, weight_now) \
  FOR { \
    RATES(F0[i], F1[i], S[i], C[i]) \
    d0[i] += weight_now * g0; d1[i] += weight_now * g1; \
    dw[i] += weight_now * gw; dth[i] += weight_now * w2[i]; \
    circle(th[i] + (to * np) * w2[i], &S[i], &C[i]); \
    F0[i] = f0[i] + to * g0; F1[i] = f1[i] + to * g1; \
    w2[i] = w[i] + to * gw; \
  }
    FOR {
      F0[i] = f0[i]; F1[i] = f1[i]; S[i] = s[i]; C[i] = c[i]; w2[i] = w[i];
      d0[i] = d1[i] = dw[i] = dth[i] = zero;
    }
    STAGE(0.5 * h, 1.0)
    STAGE(0.5 * h, 2.0)
    STAGE(h, 2.0)
    FOR {
      RATES(F0[i], F1[i], S[i], C[i])
      f0[i] += (h / 6.0) * (d0[i] + g0);
      f1[i] += (h / 6.0) * (d1[i] + g1);
      th[i] += (h * np / 6.0) * (dth[i] + w2[i]);
      w[i] += (h / 6.0) * (dw[i] + gw);
      circle(th[i], &s[i], &c[i]);
    }
    /* Measure and observe. */
    const double H0 = H;
    H = dec * H + ones;
    if (noisy) normal(k0, k1, (uint32_t)(k + 1), e0, e1);
    FOR {
      MEASURE
      vec m0 = h * u0[i] - (0.5 * h * R) * (y0[i] + i0), p0 = (0.5 * perL) * m0;
      vec m1 = h * u1[i] - (0.5 * h * R) * (y1[i] + i1), p1 = (0.5 * perL) * m1;
      vec d0 = mm - 0.5 * L * (y0[i] * y0[i] + y1[i] * y1[i]);
      vec d1 = mm - 0.5 * L * (i0 * i0 + i1 * i1);
      vec a0i = H0 * p0, a1i = H0 * p1, c0 = y0[i] + p0, c1 = y1[i] + p1;
      W[i] = dec * (W[i] + (K0[i] + a0i) * m0 + (K1[i] + a1i) * m1)
           + lefl * (c0 * m0 + c1 * m1 - d0) - rigl * d1;
      K0[i] = dec * (K0[i] + 2.0 * a0i) + lefl * (c0 + p0) + rigl * i0;
      K1[i] = dec * (K1[i] + 2.0 * a1i) + lefl * (c1 + p1) + rigl * i1;
      vec g0 = H * i0, g1 = H * i1;
      vec R0 = K0[i] - g0, R1 = K1[i] - g1, B = H * d1 + W[i];
      vec N1 = root(K0[i] * K0[i] + K1[i] * K1[i]) + root(g0 * g0 + g1 * g1);
      whole[i] = dec * whole[i] + (0.5 * lefl) * (N[i] * N[i]) + (0.5 * rigl) * (N1 * N1);
      vec seen = lefl * (b[i] + r0[i] * m0 + r1[i] * m1);
      v0[i] = dec * (v0[i] + M00[i] * m0 + M01[i] * m1) + seen * r0[i] + rigl * (R0 * B);
      v1[i] = dec * (v1[i] + M01[i] * m0 + M11[i] * m1) + seen * r1[i] + rigl * (R1 * B);
      M00[i] = dec * M00[i] + lefl * (r0[i] * r0[i]) + rigl * (R0 * R0);
      M01[i] = dec * M01[i] + lefl * (r0[i] * r1[i]) + rigl * (R0 * R1);
      M11[i] = dec * M11[i] + lefl * (r1[i] * r1[i]) + rigl * (R1 * R1);
      r0[i] = R0; r1[i] = R1; b[i] = B; N[i] = N1;
      vec det = M00[i] * M11[i] - M01[i] * M01[i], per = 1.0 / det;
      mask sure = more(2.0 * det, p->threshold * (whole[i] * (M00[i] + M11[i])));
      vec X0 = pick(sure, (M11[i] * v0[i] - M01[i] * v1[i]) * per, x0[i] + m0);
      vec X1 = pick(sure, (M00[i] * v1[i] - M01[i] * v0[i]) * per, x1[i] + m1);
      /* A-ASLO: along the model, then towards the estimate. */
      vec A0 = a0[i] + m0, A1 = a1[i] + m1, e0 = X0 - A0, e1 = X1 - A1;
      vec o0 = pick(ok[i], x0[i] - a0[i], e0), o1 = pick(ok[i], x1[i] - a1[i], e1);
      vec more_weight = p->smooth_decay * weight[i] + (1.0 - p->smooth_decay);
      vec share = 1.0 / more_weight;
      vec t0 = p->smooth_left * o0 + p->smooth_right * e0;
      vec t1 = p->smooth_left * o1 + p->smooth_right * e1;
      a0[i] = pick(sure, A0 + t0 * share, A0);
      a1[i] = pick(sure, A1 + t1 * share, A1);
      weight[i] = pick(sure, more_weight, weight[i]);
      x0[i] = X0; x1[i] = X1; ok[i] = sure;
      y0[i] = i0; y1[i] = i1;
    }
    asm volatile("# step ends");
  }

  FOR {
    mask begun = more(weight[i], zero);
    LIFT(out, f0[i]);
    LIFT(out + lanes, f1[i]);
    LIFT(out + 2 * lanes, x0[i]);
    LIFT(out + 3 * lanes, x1[i]);
    LIFT(out + 4 * lanes, pick(begun, a0[i], x0[i]));
    LIFT(out + 5 * lanes, pick(begun, a1[i], x1[i]));
  }
}

#define ARGUMENTS \
  const settings *p, long lane, long lanes, long steps, const double *reference, \
      const double *resistance, const double *magnet_flux, const uint32_t *keys, double *out
#define GIVEN p, lane, lanes, steps, reference, resistance, magnet_flux, keys, out

__attribute__((noinline)) void quiet(ARGUMENTS) { block(GIVEN, 0); }
__attribute__((noinline)) void noisy(ARGUMENTS) { block(GIVEN, 1); }

void run(const settings *p, long lanes, long steps, const double *reference,
         const double *resistance, const double *magnet_flux, const uint32_t *keys,
         double *out, int threads) {
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (long lane = 0; lane < lanes; lane += LANES * BLOCKS) {
    if (keys) noisy(GIVEN);
    else quiet(GIVEN);
  }
}
