/* The sampled closed loop of benchmarks/pmsm.py by hand: PMSM, field-oriented control by
   the measured angle, guarded least squares from the exact start (ASLO), A-ASLO.

   Lanes are trajectories: vectors of 8 doubles, BLOCKS of them interleaved so that their
   chains of operations hide each other's latency. The loop over time is inside, the state
   stays in registers and L1. What the end of an interval knows and the next start needs
   again (sine, cosine, currents, rows, the solution) is kept. The 2 x 2 system is solved in
   closed form, in which the scaling of the certificate cancels but for its comparison.
   Names and numbers of equations are those of docs/theory.md. */

#include <math.h>
#include <stdint.h>
#ifdef __AVX512F__
#include <immintrin.h>
#endif

#ifndef BLOCKS
#define BLOCKS 2
#endif

typedef double v8 __attribute__((vector_size(64), aligned(8), may_alias));
typedef int64_t i8 __attribute__((vector_size(64)));
typedef uint32_t w8 __attribute__((vector_size(32), aligned(4), may_alias));

/* ---- the few operations that vectors of GCC lack in C --------------------------------- */

#ifdef __AVX512F__
typedef __mmask8 mask;
static inline mask more(v8 a, v8 b) {
  return _mm512_cmp_pd_mask((__m512d)a, (__m512d)b, _CMP_GT_OQ);
}
static inline mask odd(i8 n) {
  return _mm512_test_epi64_mask((__m512i)n, _mm512_set1_epi64(1));
}
static inline v8 pick(mask m, v8 a, v8 b) {
  return (v8)_mm512_mask_blend_pd(m, (__m512d)b, (__m512d)a);
}
static inline v8 least(v8 a, v8 b) { return (v8)_mm512_min_pd((__m512d)a, (__m512d)b); }
static inline v8 most(v8 a, v8 b) { return (v8)_mm512_max_pd((__m512d)a, (__m512d)b); }
static inline v8 root(v8 a) { return (v8)_mm512_sqrt_pd((__m512d)a); }
static inline v8 real(w8 a) { return (v8)_mm512_cvtepu32_pd((__m256i)a); }
#else
typedef i8 mask;
static inline mask more(v8 a, v8 b) { return a > b; }
static inline mask odd(i8 n) { return -(n & 1); }
static inline v8 pick(mask m, v8 a, v8 b) { return (v8)(((i8)a & m) | ((i8)b & ~m)); }
static inline v8 least(v8 a, v8 b) { return pick(a < b, a, b); }
static inline v8 most(v8 a, v8 b) { return pick(a > b, a, b); }
static inline v8 root(v8 a) {
  for (int i = 0; i < 8; i++) a[i] = __builtin_sqrt(a[i]);
  return a;
}
static inline v8 real(w8 a) { return __builtin_convertvector(a, v8); }
#endif

static inline v8 size(v8 a) { return (v8)((i8)a & INT64_MAX); }

/* Sine and cosine of up to some 1e5 rad: Cody and Waite's reduction, polynomials after
   fdlibm. The multiple of pi/2 is in the low bits of t. */
static inline void circle(v8 x, v8 *sine, v8 *cosine) {
  const double magic = 0x1.8p52;
  v8 t = x * 0x1.45f306dc9c883p-1 + magic, n = t - magic;
  v8 r = x - n * 0x1.921fb54442d18p+0;
  r = r - n * 0x1.1a62633145c07p-54;
  v8 z = r * r;
  v8 s = z * 1.58969099521155010221e-10 - 2.50507602534068634195e-08;
  s = s * z + 2.75573137070700676789e-06;
  s = s * z - 1.98412698298579493134e-04;
  s = s * z + 8.33333333332248946124e-03;
  s = s * z - 1.66666666666666324348e-01;
  s = s * (z * r) + r;
  v8 c = z * -1.13596475577881948265e-11 + 2.08757232129817482790e-09;
  c = c * z - 2.75573143513906633035e-07;
  c = c * z + 2.48015872894767294178e-05;
  c = c * z - 1.38888888888741095749e-03;
  c = c * z + 4.16666666666666019037e-02;
  c = c * z - 0.5;
  c = c * z + 1.0;
  i8 quadrant = (i8)t;
  mask swap = odd(quadrant);
  *sine = (v8)((i8)pick(swap, c, s) ^ ((quadrant & 2) << 62));
  *cosine = (v8)((i8)pick(swap, s, c) ^ (((quadrant + 1) & 2) << 62));
}

/* The logarithm of a positive normal number, after fdlibm. */
static inline v8 logarithm(v8 x) {
  const int64_t sqrt_half = 0x3FE6A09E667F3BCD, one = 0x3FF0000000000000;
  i8 k = ((i8)x + (one - sqrt_half)) >> 52;
  v8 m = (v8)((i8)x - ((k - 1023) << 52));
  v8 n = (v8)(k + 0x4330000000000000) - (0x1p52 + 1023.0);
  v8 f = m - 1.0, s = f / (f + 2.0), z = s * s, half = 0.5 * f * f;
  v8 p = z * 1.479819860511658591e-01 + 1.531383769920937332e-01;
  p = p * z + 1.818357216161805012e-01;
  p = p * z + 2.222219843214978396e-01;
  p = p * z + 2.857142874366239149e-01;
  p = p * z + 3.999999999940941908e-01;
  p = p * z + 6.666666666666735130e-01;
  v8 tail = s * (half + z * p) + n * 1.90821492927058770002e-10;
  return n * 6.93147180369123816490e-01 - ((half - tail) - f);
}

/* Two normal numbers by Threefry-2x32 and Box-Muller, as in aslo_jax/random.py. */
static inline void normal(w8 k0, w8 k1, uint32_t index, v8 *a, v8 *b) {
  const w8 keys[3] = {k0, k1, k0 ^ k1 ^ 0x1BD11BDAu};
  static const int by[2][4] = {{13, 15, 26, 6}, {17, 29, 16, 24}};
  w8 x0 = keys[0] + index, x1 = keys[1];
#pragma GCC unroll 5
  for (int g = 0; g < 5; g++) {
#pragma GCC unroll 4
    for (int j = 0; j < 4; j++) {
      const int r = by[g % 2][j];
      x0 += x1;
      x1 = ((x1 << r) | (x1 >> (32 - r))) ^ x0;
    }
    x0 += keys[(g + 1) % 3];
    x1 += keys[(g + 2) % 3] + (uint32_t)(g + 1);
  }
  v8 sine, cosine, radius = root(-2.0 * logarithm((real(x0) + 0.5) * 0x1p-32));
  circle((real(x1) + 0.5) * (0x1p-32 * 2.0 * M_PI), &sine, &cosine);
  *a = radius * cosine;
  *b = radius * sine;
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
#define V(name) v8 name[BLOCKS]
#define AT(array) (*(const v8 *)((array) + lane + 8 * i))
#define LIFT(array, value) (*(v8 *)((array) + lane + 8 * i) = (value))

/* `out`: 6 rows of `lanes`: final flux, ASLO, A-ASLO. `reference`: the speed (rad/s) at
   each of the samples, steps + 1 of them. `keys`: two rows of words, or null for no noise.
   `lanes` is a multiple of 8 BLOCKS. */
static inline __attribute__((always_inline)) void block(
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
  const double perlamL = 1.0 / (lam * L);
  const double loadJ = p->load * perJ, mm = 0.5 * m * m * perL;
  const v8 zero = {0};

  V(RL); V(mag); V(kJ);                        /* of each trajectory */
  V(f0); V(f1); V(w); V(th); V(c); V(s);       /* flux, speed, electrical angle */
  V(tq); V(q0); V(q1); V(u0); V(u1);           /* controller, held voltage */
  V(y0); V(y1);                                /* measured current */
  V(K0); V(K1); V(W); V(r0); V(r1); V(b); V(n0); V(n1);
  V(M00); V(M01); V(M11); V(v0); V(v1); V(s0); V(s1);
  V(x0); V(x1); V(a0); V(a1); V(weight);       /* ASLO, A-ASLO and its weight */
  mask ok[BLOCKS];
  w8 k0[BLOCKS], k1[BLOCKS];
  double H = 0.0;

  FOR {
    mag[i] = AT(magnet_flux);
    RL[i] = AT(resistance) * perL;
    kJ[i] = 1.5 * np * perL * perJ * mag[i];
    f0[i] = mag[i];
    f1[i] = w[i] = th[i] = s[i] = zero;
    c[i] = zero + 1.0;
    tq[i] = q0[i] = q1[i] = y0[i] = y1[i] = zero;
    K0[i] = K1[i] = W[i] = r0[i] = r1[i] = b[i] = n0[i] = n1[i] = zero;
    M00[i] = M01[i] = M11[i] = v0[i] = v1[i] = s0[i] = s1[i] = zero;
    x0[i] = x1[i] = a0[i] = a1[i] = weight[i] = zero;
    ok[i] = more(zero, zero);
    if (noisy) {
      k0[i] = *(const w8 *)(keys + lane + 8 * i);
      k1[i] = *(const w8 *)(keys + lanes + lane + 8 * i);
    }
  }

#define MEASURE(k) \
  v8 i0 = (f0[i] - mag[i] * c[i]) * perL, i1 = (f1[i] - mag[i] * s[i]) * perL; \
  if (noisy) { \
    v8 e0, e1; \
    normal(k0[i], k1[i], (uint32_t)(k), &e0, &e1); \
    i0 += p->deviation * e0; \
    i1 += p->deviation * e1; \
  }

  FOR {
    MEASURE(0)
    y0[i] = i0; y1[i] = i1;
  }
  for (long k = 0; k < steps; k++) {
    const double speed = reference[k];
    asm volatile("# step begins");
    /* Control: speed to torque, torque to current, current to voltage. */
    FOR {
      v8 error = speed - w[i], wanted = tq[i] + bsJ * error;
      v8 torque = least(most(wanted, zero - limit), zero + limit);
      tq[i] += hI * error + hbs * (torque - wanted);
      v8 iq = torque * perkt, emf = (np * m) * w[i];
      v8 e0 = -s[i] * iq - y0[i], e1 = c[i] * iq - y1[i];
      v8 w0 = bcL * e0 + q0[i] - s[i] * emf, w1 = bcL * e1 + q1[i] + c[i] * emf;
      v8 length = root(w0 * w0 + w1 * w1 + 2.2250738585072014e-308);
      v8 scale = least(zero + 1.0, p->voltage_limit / length);
      u0[i] = w0 * scale;
      u1[i] = w1 * scale;
      v8 turn = hnp * w[i], Q0 = q0[i], Q1 = q1[i];
      q0[i] = Q0 + hbcR * e0 - turn * Q1 + hbc * (u0[i] - w0);
      q1[i] = Q1 + hbcR * e1 + turn * Q0 + hbc * (u1[i] - w1);
    }
    /* The plant, by Runge and Kutta; block by block in every stage. */
    V(d0); V(d1); V(dw); V(dth); V(F0); V(F1); V(S); V(C); V(w2);
#define RATES(F0, F1, S, C) \
  v8 g0 = u0[i] - RL[i] * (F0 - mag[i] * C), g1 = u1[i] - RL[i] * (F1 - mag[i] * S); \
  v8 gw = kJ[i] * (C * F1 - S * F0) - loadJ;
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
    FOR {
      MEASURE(k + 1)
      v8 z00 = u0[i] - R * y0[i], z01 = u1[i] - R * y1[i];
      v8 z10 = u0[i] - R * i0, z11 = u1[i] - R * i1;
      v8 d0 = mm - 0.5 * L * (y0[i] * y0[i] + y1[i] * y1[i]);
      v8 d1 = mm - 0.5 * L * (i0 * i0 + i1 * i1);
      v8 left = K0[i] * z00 + K1[i] * z01 - lam * d0;
      K0[i] = dec * K0[i] + lefl * (y0[i] + (H0 * perlamL) * z00)
            + rigl * (i0 + (H * perlamL) * z10);
      K1[i] = dec * K1[i] + lefl * (y1[i] + (H0 * perlamL) * z01)
            + rigl * (i1 + (H * perlamL) * z11);
      W[i] = dec * W[i] + lef * left + rig * (K0[i] * z10 + K1[i] * z11 - lam * d1);
      v8 g0 = H * i0, g1 = H * i1;
      v8 R0 = K0[i] - g0, R1 = K1[i] - g1, B = H * d1 + W[i];
      v8 N0 = size(K0[i]) + size(g0), N1 = size(K1[i]) + size(g1);
      s0[i] = dec * s0[i] + lefl * (n0[i] * n0[i]) + rigl * (N0 * N0);
      s1[i] = dec * s1[i] + lefl * (n1[i] * n1[i]) + rigl * (N1 * N1);
      v8 l0 = lam * r0[i] * b[i] + M00[i] * z00 + M01[i] * z01;
      v8 l1 = lam * r1[i] * b[i] + M01[i] * z00 + M11[i] * z01;
      M00[i] = dec * M00[i] + lefl * (r0[i] * r0[i]) + rigl * (R0 * R0);
      M01[i] = dec * M01[i] + lefl * (r0[i] * r1[i]) + rigl * (R0 * R1);
      M11[i] = dec * M11[i] + lefl * (r1[i] * r1[i]) + rigl * (R1 * R1);
      v0[i] = dec * v0[i] + lef * l0
            + rig * (lam * R0 * B + M00[i] * z10 + M01[i] * z11);
      v1[i] = dec * v1[i] + lef * l1
            + rig * (lam * R1 * B + M01[i] * z10 + M11[i] * z11);
      r0[i] = R0; r1[i] = R1; b[i] = B; n0[i] = N0; n1[i] = N1;
      v8 det = M00[i] * M11[i] - M01[i] * M01[i], per = 1.0 / det;
      mask sure = more(2.0 * det, p->threshold * (M00[i] * s1[i] + M11[i] * s0[i]));
      v8 m0 = (0.5 * h) * (z00 + z10), m1 = (0.5 * h) * (z01 + z11);
      v8 X0 = pick(sure, (M11[i] * v0[i] - M01[i] * v1[i]) * per, x0[i] + m0);
      v8 X1 = pick(sure, (M00[i] * v1[i] - M01[i] * v0[i]) * per, x1[i] + m1);
      /* A-ASLO: along the model, then towards the estimate. */
      v8 A0 = a0[i] + m0, A1 = a1[i] + m1, e0 = X0 - A0, e1 = X1 - A1;
      v8 o0 = pick(ok[i], x0[i] - a0[i], e0), o1 = pick(ok[i], x1[i] - a1[i], e1);
      v8 more_weight = p->smooth_decay * weight[i] + (1.0 - p->smooth_decay);
      v8 share = 1.0 / more_weight;
      v8 t0 = p->smooth_left * o0 + p->smooth_right * e0;
      v8 t1 = p->smooth_left * o1 + p->smooth_right * e1;
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
  for (long lane = 0; lane < lanes; lane += 8 * BLOCKS) {
    if (keys) noisy(GIVEN);
    else quiet(GIVEN);
  }
}
