/* Functions that are given by their values at evenly spaced knots, as the loops read them: cubics in t = y - i on
 * the pieces i of y = 1 + (x - low)/h,
 *
 *   f(x) = c0 + c1 t + c2 t^2 + c3 t^3,   i = 0 below the first knot, 1 to n - 1 between knots, n above the last.
 *
 * No branch, and NaN stays NaN, so that loops over it vectorise.  function.c makes the cubics. */
#ifndef ZOO_FUNCTION_H
#define ZOO_FUNCTION_H

#include "../include/zoo.h"
#include "arithmetic.h"

/* Knots and values are far from the ends of the range of doubles, so that the cubics are numbers. */
#define ZOO_MOST_VALUE 1e30

enum { ZOO_FEWEST_KNOTS = 4, ZOO_MOST_KNOTS = 4096 };

/* A copy of it in a loop's function, not a pointer to it, lets the compiler keep it in registers. */
typedef struct {
    double low, per_step, last; /* of x; 1/h; n */
    const double *piece;        /* [n + 1][4] */
} zoo_spline;

/* How it goes on beyond its knots. */
typedef enum {
    ZOO_BEYOND_CONSTANT, /* its values at the ends */
    ZOO_BEYOND_LINEAR,   /* straight on */
    ZOO_BEYOND_WALL      /* below linear in x^2 (the area, where x is the stretch), above linear in x */
} zoo_beyond;

/* f(x), and df/dx into slope. */
ZOO_INLINE double spline_at(zoo_spline f, double x, double *slope)
{
    const double y = (x - f.low) * f.per_step + 1.0;
    const double up = y > 0.0 ? y : 0.0, in = up < f.last ? up : f.last;
    const int i = (int)in, c = 4 * i; /* an index, since loops over a pointer to the piece would not vectorise */
    const double t = y - i, c1 = f.piece[c + 1], c2 = f.piece[c + 2], c3 = f.piece[c + 3];
    *slope = (c1 + t * (2.0 * c2 + 3.0 * t * c3)) * f.per_step;
    return f.piece[c] + t * (c1 + t * (c2 + t * c3));
}

ZOO_INLINE double spline_value(zoo_spline f, double x)
{
    double slope;
    return spline_at(f, x, &slope);
}

/* function.c: 1 where a function that is there has a knot below lowest or a value outside least .. most. */
int zoo_function_bad(const zoo_function *function, double lowest, double least, double most);

/* function.c: the cubics of a function into piece, which has room for zoo_function_size numbers; that of one that is
 * not there (no knots) is `otherwise` everywhere. */
int64_t zoo_function_size(const zoo_function *function);
zoo_spline zoo_function_spline(const zoo_function *function, zoo_beyond beyond, double otherwise, double *piece);

/* function.c: the largest |f''| between knots, 0 beyond. */
double zoo_function_curvature(zoo_spline function);

#endif
