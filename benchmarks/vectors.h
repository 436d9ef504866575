/* Vectors of doubles as wide as the processor's, LANES of them; what vectors of GCC lack in
   C; elementary functions without branches. */

#include <math.h>
#include <stdint.h>
#if defined __AVX2__ || defined __AVX512F__
#include <immintrin.h>
#endif

#ifndef BLOCKS
#define BLOCKS 2
#endif
/* Of 32-bit words a vector holds twice as many lanes: it serves two blocks where it can. */
#define PAIR (BLOCKS % 2 ? 1 : 2)
#define INLINE static inline __attribute__((always_inline))

#if defined __AVX512F__ && defined __AVX512DQ__

#define LANES 8
typedef double vec __attribute__((vector_size(64), aligned(8), may_alias));
typedef int64_t ivec __attribute__((vector_size(64)));
typedef __mmask8 mask;
INLINE mask more(vec a, vec b) { return _mm512_cmp_pd_mask(a, b, _CMP_GT_OQ); }
INLINE mask odd(ivec n) { return _mm512_test_epi64_mask((__m512i)n, _mm512_set1_epi64(1)); }
INLINE vec pick(mask m, vec a, vec b) { return _mm512_mask_blend_pd(m, b, a); }
INLINE vec least(vec a, vec b) { return _mm512_min_pd(a, b); }
INLINE vec most(vec a, vec b) { return _mm512_max_pd(a, b); }
INLINE vec root(vec a) { return _mm512_sqrt_pd(a); }
INLINE vec size(vec a) { return _mm512_abs_pd(a); }

#elif defined __AVX2__

#define LANES 4
typedef double vec __attribute__((vector_size(32), aligned(8), may_alias));
typedef int64_t ivec __attribute__((vector_size(32)));
typedef __m256d mask; /* the sign bit of a lane counts */
INLINE mask more(vec a, vec b) { return _mm256_cmp_pd(a, b, _CMP_GT_OQ); }
INLINE mask odd(ivec n) { return (mask)(n << 63); }
INLINE vec pick(mask m, vec a, vec b) { return _mm256_blendv_pd(b, a, m); }
INLINE vec least(vec a, vec b) { return _mm256_min_pd(a, b); }
INLINE vec most(vec a, vec b) { return _mm256_max_pd(a, b); }
INLINE vec root(vec a) { return _mm256_sqrt_pd(a); }
INLINE vec size(vec a) { return _mm256_andnot_pd(_mm256_set1_pd(-0.0), a); }

#else

#define LANES 2
typedef double vec __attribute__((vector_size(16), aligned(8), may_alias));
typedef int64_t ivec __attribute__((vector_size(16)));
typedef ivec mask;
INLINE mask more(vec a, vec b) { return a > b; }
INLINE mask odd(ivec n) { return -(n & 1); }
INLINE vec pick(mask m, vec a, vec b) { return (vec)(((ivec)a & m) | ((ivec)b & ~m)); }
INLINE vec least(vec a, vec b) { return pick(a < b, a, b); }
INLINE vec most(vec a, vec b) { return pick(a > b, a, b); }
INLINE vec root(vec a) {
  for (int i = 0; i < LANES; i++) a[i] = __builtin_sqrt(a[i]);
  return a;
}
INLINE vec size(vec a) { return (vec)((ivec)a & INT64_MAX); }
#endif

/* Words of the lanes of PAIR blocks, and those of one block. */
typedef uint64_t uvec __attribute__((vector_size(8 * LANES)));
typedef uint32_t words __attribute__((vector_size(4 * LANES * PAIR), aligned(4), may_alias));
typedef uint32_t part __attribute__((vector_size(4 * LANES)));

/* Words as doubles plus 0.5, exactly: as the mantissa of 2^52 and more. */
INLINE vec real_and_half(part a) {
  return (vec)(__builtin_convertvector(a, uvec) | 0x4330000000000000) - (0x1p52 - 0.5);
}

/* Sine and cosine of up to some 1e5 rad: Cody and Waite's reduction, polynomials after
   fdlibm. The multiple of pi/2 is in the low bits of t. */
INLINE void circle(vec x, vec *sine, vec *cosine) {
  const double magic = 0x1.8p52;
  vec t = x * 0x1.45f306dc9c883p-1 + magic, n = t - magic;
  vec r = x - n * 0x1.921fb54442d18p+0;
  r = r - n * 0x1.1a62633145c07p-54;
  vec z = r * r;
  vec s = z * 1.58969099521155010221e-10 - 2.50507602534068634195e-08;
  s = s * z + 2.75573137070700676789e-06;
  s = s * z - 1.98412698298579493134e-04;
  s = s * z + 8.33333333332248946124e-03;
  s = s * z - 1.66666666666666324348e-01;
  s = s * (z * r) + r;
  vec c = z * -1.13596475577881948265e-11 + 2.08757232129817482790e-09;
  c = c * z - 2.75573143513906633035e-07;
  c = c * z + 2.48015872894767294178e-05;
  c = c * z - 1.38888888888741095749e-03;
  c = c * z + 4.16666666666666019037e-02;
  c = c * z - 0.5;
  c = c * z + 1.0;
  ivec quadrant = (ivec)t;
  mask swap = odd(quadrant);
  *sine = (vec)((ivec)pick(swap, c, s) ^ ((quadrant & 2) << 62));
  *cosine = (vec)((ivec)pick(swap, s, c) ^ (((quadrant + 1) & 2) << 62));
}

/* The logarithm of a positive normal number, after fdlibm. */
INLINE vec logarithm(vec x) {
  const int64_t sqrt_half = 0x3FE6A09E667F3BCD, one = 0x3FF0000000000000;
  ivec k = (ivec)((uvec)((ivec)x + (one - sqrt_half)) >> 52);
  vec m = (vec)((ivec)x - ((k - 1023) << 52));
  vec n = (vec)(k + 0x4330000000000000) - (0x1p52 + 1023.0);
  vec f = m - 1.0, s = f / (f + 2.0), z = s * s, half = 0.5 * f * f;
  vec p = z * 1.479819860511658591e-01 + 1.531383769920937332e-01;
  p = p * z + 1.818357216161805012e-01;
  p = p * z + 2.222219843214978396e-01;
  p = p * z + 2.857142874366239149e-01;
  p = p * z + 3.999999999940941908e-01;
  p = p * z + 6.666666666666735130e-01;
  vec tail = s * (half + z * p) + n * 1.90821492927058770002e-10;
  return n * 6.93147180369123816490e-01 - ((half - tail) - f);
}
