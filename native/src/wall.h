/* The wall: pressure as a function of a = A/A0, and what follows from it.
 *
 *   linear   p = K (sqrt(a) - 1),        K = 4/3 chi            (eq. 3.3)
 *   tangent  p = K tan(theta (a - 1)),   K = k chi, theta = pi/gamma   (eq. 3.4)
 *
 * Every function is inlined into the loops of the scheme with `wall` a
 * constant, so that the compiler makes a vector loop for each law.
 */
#ifndef ZOO_WALL_H
#define ZOO_WALL_H

#include <math.h>

#include "../include/zoo.h"

#define ZOO_INLINE static inline __attribute__((always_inline))
#define ZOO_PI 3.14159265358979323846

/* 1/sqrt(x) and 1/x: a single-precision seed, which is several times cheaper
 * than the double-precision instruction, and one Newton step in double
 * (relative error about 2e-14).  The loops of the scheme are bound by square
 * roots and divisions, so this is where their time goes. */
ZOO_INLINE double wall_rsqrt(double x)
{
    double y = 1.0f / sqrtf((float)x);
    return y * (1.5 - 0.5 * x * y * y);
}

ZOO_INLINE double wall_reciprocal(double x)
{
    double y = 1.0f / (float)x;
    return y * (2.0 - x * y);
}

/* tan(x) for |x| < pi/2 by Lambert's continued fraction for tan(x/2), cut at
 * its eighth term (relative error 5e-16), then the double-angle formula with the
 * reciprocal above (2e-14; more within 1e-3 of the asymptotes, where rounding
 * of x counts).  No branch, so that loops over it vectorise. */
ZOO_INLINE double wall_tan(double x)
{
    double y = 0.5 * x, z = y * y;
    double n = y * (2027025.0 + z * (-270270.0 + z * (6930.0 - 36.0 * z)));
    double d = 2027025.0 + z * (-945945.0 + z * (51975.0 + z * (-630.0 + z)));
    return 2.0 * n * d * wall_reciprocal((d - n) * (d + n));
}

/* K from the stiffness chi (dyn/cm^2). */
ZOO_INLINE double wall_scale(int wall, double wall_factor, double stiffness)
{
    return wall == ZOO_WALL_LINEAR ? 4.0 / 3.0 * stiffness : wall_factor * stiffness;
}

/* K of a wall whose stiffness is `stiff` times its own, and which resists fast stretching:
 * kappa is the relaxing part's own stiffness over the lasting one's, `later` how much of it is left. */
ZOO_INLINE double wall_stiffened(double K, double stiff, double later, double kappa)
{
    return (1.0 + later * kappa) * stiff * K;
}

/* theta from gamma; the linear wall has none. */
ZOO_INLINE double wall_theta(int wall, double gamma)
{
    return wall == ZOO_WALL_LINEAR ? 0.0 : ZOO_PI / gamma;
}

/* p (dyn/cm^2) at a = A/A0; s = sqrt(a). */
ZOO_INLINE double wall_p(int wall, double K, double theta, double a, double s)
{
    return wall == ZOO_WALL_LINEAR ? K * (s - 1.0) : K * wall_tan(theta * (a - 1.0));
}

/* dp/da where the pressure p is already known; s = sqrt(a). */
ZOO_INLINE double wall_slope(int wall, double K, double theta, double p, double s)
{
    double t = p / K;
    return wall == ZOO_WALL_LINEAR ? 0.5 * K / s : K * theta * (1.0 + t * t);
}

/* Largest a the law allows. */
ZOO_INLINE double wall_limit(int wall, double theta)
{
    return wall == ZOO_WALL_LINEAR ? INFINITY : 1.0 + 0.5 * ZOO_PI / theta;
}

/* Smallest a the law allows: the tangent's other asymptote, if it lies above 0. */
ZOO_INLINE double wall_floor(int wall, double theta)
{
    double a = wall == ZOO_WALL_LINEAR ? 0.0 : 1.0 - 0.5 * ZOO_PI / theta;
    return a > 0.0 ? a : 0.0;
}

/* Whether the law has a pressure at a; false for NaN. */
ZOO_INLINE int wall_holds(int wall, double theta, double a)
{
    return a > wall_floor(wall, theta) && a < wall_limit(wall, theta);
}

/* a at pressure p; used to set a run up, not inside it. */
ZOO_INLINE double wall_area_ratio(int wall, double K, double theta, double p)
{
    double s = 1.0 + p / K;
    return wall == ZOO_WALL_LINEAR ? s * s : 1.0 + atan(p / K) / theta;
}

#endif
