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
 *   power_area_ratio(K, g, p)          a at pressure p, the inverse of power_p; used to set a run up
 *   power_limit(g), power_floor(g)     largest and smallest a that the law allows
 *   power_inside(g, a)                 whether a lies between them, in the loops: cheap, without a branch
 *
 * in which shape(given, m) is shape parameter m and shape(g, m) coefficient m of the node.  Every function
 * is inlined into the loops of the scheme with the law a constant, so that the compiler makes a vector loop
 * for each law.
 */
#ifndef ZOO_WALL_H
#define ZOO_WALL_H

#include <stddef.h>

#include "../include/zoo.h"
#include "arithmetic.h"

/* Shape parameters of a law, or coefficients at one node and lane: number m is at[m*stride]. */
typedef struct {
    const double *at;
    ptrdiff_t stride;
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
#define ZOO_WALLS(LAW, ...)          \
    LAW(LINEAR, linear, __VA_ARGS__) \
    LAW(TANGENT, tangent, __VA_ARGS__)

#define WALL_NUMBER(NAME, name, ...) ZOO_WALL_##NAME,
#define WALL_CASE(NAME, name, function, ...) \
    case ZOO_WALL_##NAME:                    \
        return name##_##function(__VA_ARGS__);
/* What the law's own function returns; `otherwise` for a number that is not in the list. */
#define WALL_RETURN(law, otherwise, ...)    \
    switch (law) {                          \
        ZOO_WALLS(WALL_CASE, __VA_ARGS__)   \
    default:                                \
        return otherwise;                   \
    }

#define WALL_ROOM(NAME, name, ...) char name[sizeof name##_shapes];

enum {
    ZOO_WALLS(WALL_NUMBER, )
    ZOO_N_WALLS,
    ZOO_MOST_SHAPES = sizeof(union { ZOO_WALLS(WALL_ROOM, ) }) / sizeof(wall_parameter) /* room for those of any law */
};

#define WALL_SHAPES(NAME, name, ...)                             \
    case ZOO_WALL_##NAME:                                        \
        return (int)(sizeof name##_shapes / sizeof *name##_shapes) - 1;

/* How many shape parameters the law has. */
ZOO_INLINE int wall_shapes(int law)
{
    switch (law) {
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
    switch (law) {
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
    switch (law) {
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

/* p (dyn/cm^2) at a = A/A0; root = sqrt(a). */
ZOO_INLINE double wall_p(int law, double K, wall_shape g, double a, double root)
{
    WALL_RETURN(law, NAN, p, K, g, a, root)
}

/* dp/da where the pressure p is already known; root = sqrt(a). */
ZOO_INLINE double wall_slope(int law, double K, wall_shape g, double p, double a, double root)
{
    WALL_RETURN(law, NAN, slope, K, g, p, a, root)
}

/* dp/dA where the pressure p is already known, from 1/A and 1/A0. */
ZOO_INLINE double wall_slope_area(int law, double K, wall_shape g, double p, double root, double per_area,
                                  double inv_A0)
{
    WALL_RETURN(law, NAN, slope_area, K, g, p, root, per_area, inv_A0)
}

/* a at pressure p; used to set a run up, not inside it. */
ZOO_INLINE double wall_area_ratio(int law, double K, wall_shape g, double p)
{
    WALL_RETURN(law, NAN, area_ratio, K, g, p)
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

#endif
