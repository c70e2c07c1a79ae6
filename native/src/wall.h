/* The wall laws: pressure as a function of a = A/A0, and what follows from it.
 *
 * A law is a header wall_NAME.h, included below, and an entry in ZOO_WALLS; its number is its place
 * there.  It has a scale K (dyn/cm^2), which is made of the stiffness chi, and any number of shape
 * parameters, of which its coefficients are made once, as many as there are parameters.  The header holds,
 * for a law called `power`,
 *
 *   power_shapes[]                     the shape parameters, each with its name and a typical value for the
 *                                      tests, and {NULL, 0} as the last
 *   power_in_root                      1 if p = K (sqrt(a) - 1), for which junctions and outlets have closed
 *                                      forms; 0 for any other law: they use Newton's method
 *   power_usable(given)                whether the shape parameters are in range
 *   power_scale(factor, stiffness, given)   K, with the convention's factor
 *   power_coefficient(given, m)        coefficient m from the shape parameters
 *   power_p(K, g, a, root)             pressure; root = sqrt(a)
 *   power_slope(K, g, p, a, root)      dp/da where the pressure p is known already
 *   power_slope_area(K, g, p, root, per_area, inv_A0)   dp/dA from 1/A and 1/A0: without a division
 *   power_by(K, g, p, a, root, m)      dp/d(coefficient m), for the derivatives of a run
 *   power_area_ratio(K, g, p)          a at pressure p, the inverse of power_p; used to set a run up
 *   power_limit(g), power_floor(g)     largest and smallest a that the law allows
 *   power_inside(g, a)                 whether a lies between them, in the loops: cheap, without a branch
 *
 * in which shape(given, m) is shape parameter m and shape(g, m) coefficient m of the node.  Every function
 * is inlined into the loops of the scheme with the law a constant, so that the compiler makes a vector loop
 * for each law.
 *
 * Of every law there is a second one, to which a function of the stretch is added (zoo_wall's, function.h),
 *
 *   p = K (law(a) + delta(s)),   s = sqrt(a),
 *
 * and which has the number ZOO_N_WALLS + that of the law.  It needs nothing of a header.
 */
#ifndef ZOO_WALL_H
#define ZOO_WALL_H

#include <stddef.h>

#include "../include/zoo.h"
#include "arithmetic.h"
#include "function.h"

/* Shape parameters of a law, or coefficients at one node: number m is at[m*stride]; and the function that is
 * added to the law, where there is one. */
typedef struct {
    const double *at;
    ptrdiff_t stride;
    zoo_spline function;
} wall_shape;

ZOO_INLINE double shape(wall_shape g, int m)
{
    return g.at[m * g.stride];
}

typedef struct {
    const char *name;
    double typical;
} wall_parameter;

#include "wall_linear.h"
#include "wall_tangent.h"
#include "wall_olufsen.h"
#define ZOO_WALLS(LAW, ...)            \
    LAW(LINEAR, linear, __VA_ARGS__)   \
    LAW(TANGENT, tangent, __VA_ARGS__) \
    LAW(OLUFSEN, olufsen, __VA_ARGS__)

#define WALL_NUMBER(NAME, name, ...) ZOO_WALL_##NAME,
#define WALL_CASE(NAME, name, function, ...) \
    case ZOO_WALL_##NAME:                    \
        return name##_##function(__VA_ARGS__);
/* What the law's own function returns; `otherwise` for a number that is not in the list. */
#define WALL_RETURN(law, otherwise, ...)    \
    switch (wall_base(law)) {               \
        ZOO_WALLS(WALL_CASE, __VA_ARGS__)   \
    default:                                \
        return otherwise;                   \
    }

#define WALL_ROOM(NAME, name, ...) char name[sizeof name##_shapes];

#define ZOO_LEAST_STRETCH 1e-3 /* of a function's first knot */

enum {
    ZOO_WALLS(WALL_NUMBER, )
    ZOO_N_WALLS,
    ZOO_MOST_SHAPES = sizeof(union { ZOO_WALLS(WALL_ROOM, ) }) / sizeof(wall_parameter) /* room for those of any law */
};

/* The number of a law to which a function is added, p = K (law(a) + delta(sqrt(a))), and of the law alone. */
ZOO_INLINE int wall_with_function(int law)
{
    return law + ZOO_N_WALLS;
}

ZOO_INLINE int wall_has_function(int law)
{
    return law >= ZOO_N_WALLS && law < 2 * ZOO_N_WALLS;
}

ZOO_INLINE int wall_base(int law)
{
    return wall_has_function(law) ? law - ZOO_N_WALLS : law;
}

#define WALL_SHAPES(NAME, name, ...)                             \
    case ZOO_WALL_##NAME:                                        \
        return (int)(sizeof name##_shapes / sizeof *name##_shapes) - 1;

/* How many shape parameters the law has. */
ZOO_INLINE int wall_shapes(int law)
{
    switch (wall_base(law)) {
        ZOO_WALLS(WALL_SHAPES, )
    default:
        return -1;
    }
}

#define WALL_SHAPE(NAME, name, m) \
    case ZOO_WALL_##NAME:         \
        return name##_shapes[m];

/* One of them, 0 <= m < wall_shapes(law). */
static inline wall_parameter wall_shape_parameter(int law, int m)
{
    switch (wall_base(law)) {
        ZOO_WALLS(WALL_SHAPE, m)
    default:
        return (wall_parameter){NULL, 0.0};
    }
}

#define WALL_IN_ROOT(NAME, name, ...) \
    case ZOO_WALL_##NAME:             \
        return name##_in_root;

ZOO_INLINE int wall_in_root(int law)
{
    if (wall_has_function(law))
        return 0;
    switch (wall_base(law)) {
        ZOO_WALLS(WALL_IN_ROOT, )
    default:
        return 0;
    }
}

ZOO_INLINE int wall_usable(int law, wall_shape given)
{
    WALL_RETURN(law, 0, usable, given)
}

/* K (dyn/cm^2) from the stiffness chi (dyn/cm^2). */
ZOO_INLINE double wall_scale(int law, double factor, double stiffness, wall_shape given)
{
    WALL_RETURN(law, NAN, scale, factor, stiffness, given)
}

ZOO_INLINE double wall_coefficient(int law, wall_shape given, int m)
{
    WALL_RETURN(law, NAN, coefficient, given, m)
}

/* K of a wall whose stiffness is `stiff` times its own, and which resists fast stretching:
 * kappa is the relaxing part's own stiffness over the lasting one's, `later` how much of it is left. */
ZOO_INLINE double wall_stiffened(double K, double stiff, double later, double kappa)
{
    return (1.0 + later * kappa) * stiff * K;
}

/* Those of the law alone. */
ZOO_INLINE double wall_base_p(int law, double K, wall_shape g, double a, double root)
{
    WALL_RETURN(law, NAN, p, K, g, a, root)
}

ZOO_INLINE double wall_base_slope(int law, double K, wall_shape g, double p, double a, double root)
{
    WALL_RETURN(law, NAN, slope, K, g, p, a, root)
}

ZOO_INLINE double wall_base_slope_area(int law, double K, wall_shape g, double p, double root, double per_area,
                                       double inv_A0)
{
    WALL_RETURN(law, NAN, slope_area, K, g, p, root, per_area, inv_A0)
}

static inline double wall_base_area_ratio(int law, double K, wall_shape g, double p)
{
    WALL_RETURN(law, NAN, area_ratio, K, g, p)
}

/* p (dyn/cm^2) at a = A/A0; root = sqrt(a). */
ZOO_INLINE double wall_p(int law, double K, wall_shape g, double a, double root)
{
    const double p = wall_base_p(law, K, g, a, root);
    return wall_has_function(law) ? p + K * spline_value(g.function, root) : p;
}

/* dp/da where the pressure p is already known; root = sqrt(a). */
ZOO_INLINE double wall_slope(int law, double K, wall_shape g, double p, double a, double root)
{
    if (!wall_has_function(law))
        return wall_base_slope(law, K, g, p, a, root);
    double rise;
    const double more = K * spline_at(g.function, root, &rise);
    return wall_base_slope(law, K, g, p - more, a, root) + 0.5 * K * rise / root;
}

/* dp/dA where the pressure p is already known, from 1/A and 1/A0. */
ZOO_INLINE double wall_slope_area(int law, double K, wall_shape g, double p, double root, double per_area,
                                  double inv_A0)
{
    if (!wall_has_function(law))
        return wall_base_slope_area(law, K, g, p, root, per_area, inv_A0);
    double rise;
    const double more = K * spline_at(g.function, root, &rise);
    return wall_base_slope_area(law, K, g, p - more, root, per_area, inv_A0) + 0.5 * K * rise * root * per_area;
}

/* dp/d(coefficient m) where the pressure p is already known; root = sqrt(a). */
ZOO_INLINE double wall_by(int law, double K, wall_shape g, double p, double a, double root, int m)
{
    const double alone = wall_has_function(law) ? p - K * spline_value(g.function, root) : p;
    WALL_RETURN(law, NAN, by, K, g, alone, a, root, m)
}

/* Largest a the law allows. */
ZOO_INLINE double wall_limit(int law, wall_shape g)
{
    WALL_RETURN(law, NAN, limit, g)
}

/* Smallest a the law allows. */
ZOO_INLINE double wall_floor(int law, wall_shape g)
{
    WALL_RETURN(law, NAN, floor, g)
}

/* Whether an a above 0 lies between the law's limits; in the loops. */
ZOO_INLINE int wall_inside(int law, wall_shape g, double a)
{
    WALL_RETURN(law, 0, inside, g, a)
}

/* Whether the law has a pressure at a; false for NaN. */
ZOO_INLINE int wall_holds(int law, wall_shape g, double a)
{
    return a > wall_floor(law, g) && a < wall_limit(law, g);
}

/* a at pressure p; used to set a run up, not inside it.  With a function added: Newton's method in the stretch s, which
 * starts from the law alone and is kept between bounds, since the pressure rises with s. */
static inline double wall_area_ratio(int law, double K, wall_shape g, double p)
{
    double a = wall_base_area_ratio(law, K, g, p);
    if (!wall_has_function(law))
        return a;
    double low = sqrt(wall_floor(law, g)), high = sqrt(wall_limit(law, g)), s = sqrt(a);
    if (!(s > low && s < high && p > -K)) /* the law alone has no such pressure */
        s = 1.0;
    for (int round = 0; round < 100; round++) {
        const double now = wall_p(law, K, g, s * s, s), over = now - p;
        *(over > 0.0 ? &high : &low) = s;
        double next = s - over / (2.0 * s * wall_slope(law, K, g, now, s * s, s));
        if (!(next > low && next < high))
            next = isinf(high) ? 2.0 * s : 0.5 * (low + high);
        const double move = fabs(next - s);
        s = next;
        if (move < 1e-14 * s)
            break;
    }
    return s * s;
}

/* Whether the pressure rises with the area, at least by a hundredth of what it does without the function: looked at
 * between the knots and from there to the area at rest; beyond, it does when it does there. */
static inline int wall_rises(int law, wall_shape g)
{
    enum { PER_STEP = 16 };
    if (!wall_has_function(law))
        return 1;
    const zoo_spline f = g.function;
    const double high = f.low + (f.last - 1.0) / f.per_step, from = f.low < 1.0 ? f.low : 1.0, to = high > 1.0 ? high : 1.0;
    const int n = (int)(f.last * PER_STEP);
    for (int i = 0; i <= n; i++) {
        const double s = from + (to - from) * i / n, a = s * s, p = wall_base_p(law, 1.0, g, a, s);
        if (!wall_holds(law, g, a))
            continue;
        const double alone = wall_base_slope(law, 1.0, g, p, a, s);
        double rise;
        (void)spline_at(f, s, &rise);
        if (!(alone + 0.5 * rise / s >= 0.01 * alone))
            return 0;
    }
    return 1;
}

#endif
