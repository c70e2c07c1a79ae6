/* Reciprocals, inverse roots and tangents that vectorise, each with a relative error of about 2e-14.
 *
 * The loops of the scheme are bound by square roots and divisions, so this is where their time goes. */
#ifndef ZOO_ARITHMETIC_H
#define ZOO_ARITHMETIC_H

#include <math.h>

#define ZOO_INLINE static inline __attribute__((always_inline))
#define ZOO_PI 3.14159265358979323846

/* 1/sqrt(x): a single-precision seed, which is several times cheaper than the
 * double-precision instruction, and one Newton step in double. */
ZOO_INLINE double fast_rsqrt(double x)
{
    double y = 1.0f / sqrtf((float)x);
    return y * (1.5 - 0.5 * x * y * y);
}

/* 1/x in the same way. */
ZOO_INLINE double fast_reciprocal(double x)
{
    double y = 1.0f / (float)x;
    return y * (2.0 - x * y);
}

/* tan(x) for |x| < pi/2 by Lambert's continued fraction for tan(x/2), cut at
 * its eighth term (relative error 5e-16), then the double-angle formula with the
 * reciprocal above (2e-14; more within 1e-3 of the asymptotes, where rounding
 * of x counts).  No branch, so that loops over it vectorise. */
ZOO_INLINE double fast_tan(double x)
{
    double y = 0.5 * x, z = y * y;
    double n = y * (2027025.0 + z * (-270270.0 + z * (6930.0 - 36.0 * z)));
    double d = 2027025.0 + z * (-945945.0 + z * (51975.0 + z * (-630.0 + z)));
    return 2.0 * n * d * fast_reciprocal((d - n) * (d + n));
}

#endif
