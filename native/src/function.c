/* Functions that are given by their values at evenly spaced knots, function.h: the cubic spline through them.
 *
 * Its slopes m at the knots make the second derivative continuous,
 *
 *   m_(i-1) + 4 m_i + m_(i+1) = 3 (v_(i+1) - v_(i-1))/h,
 *
 * and those at the ends are of the cubic through the four values there, so that the spline of a smooth function misses
 * it by O(h^4) up to its ends, and that of a cubic not at all. */
#include <math.h>
#include <stddef.h>

#include "function.h"
#include "values.h"

int zoo_function_bad(const zoo_function *f, double lowest, double least, double most)
{
    if (f->n_knots == 0)
        return 0;
    return f->n_knots < ZOO_FEWEST_KNOTS || f->n_knots > ZOO_MOST_KNOTS || !f->values ||
           !(f->low >= lowest) || !(f->high <= ZOO_MOST_VALUE) ||
           !(f->high - f->low > 1e-9 * (fabs(f->low) + fabs(f->high)) && f->high - f->low > 1e-30) ||
           values_outside(f->values, f->n_knots, least, most);
}

int64_t zoo_function_size(const zoo_function *f)
{
    return 4 * ((int64_t)f->n_knots + 1);
}

/* Slopes at the knots, in units of 1/h, into c1 of the pieces that start there. */
static void set_slopes(const double *v, int n, double *piece)
{
    double *m = piece + 5, *scale = piece + 6; /* knot i at 4*i */
    m[0] = (-11.0 * v[0] + 18.0 * v[1] - 9.0 * v[2] + 2.0 * v[3]) / 6.0;
    m[4 * (n - 1)] = (11.0 * v[n - 1] - 18.0 * v[n - 2] + 9.0 * v[n - 3] - 2.0 * v[n - 4]) / 6.0;
    scale[0] = 0.0;
    for (int i = 1; i < n - 1; i++) {
        double right = 3.0 * (v[i + 1] - v[i - 1]) - (i == n - 2 ? m[4 * (n - 1)] : 0.0);
        scale[4 * i] = 1.0 / (4.0 - scale[4 * (i - 1)]);
        m[4 * i] = (right - m[4 * (i - 1)]) * scale[4 * i];
    }
    for (int i = n - 3; i > 0; i--)
        m[4 * i] -= scale[4 * i] * m[4 * (i + 1)];
}

zoo_spline zoo_function_spline(const zoo_function *f, zoo_beyond beyond, double otherwise, double *piece)
{
    const int n = f->n_knots;
    zoo_spline made = {.low = 0.0, .per_step = 1.0, .last = 0.0, .piece = piece};
    if (n == 0) {
        piece[0] = otherwise;
        piece[1] = piece[2] = piece[3] = 0.0;
        return made;
    }
    const double *v = f->values, h = (f->high - f->low) / (n - 1);
    made.low = f->low;
    made.per_step = 1.0 / h;
    made.last = n;
    set_slopes(v, n, piece);
    for (int i = 0; i < n - 1; i++) {
        double *c = piece + 4 * (i + 1), rise = v[i + 1] - v[i], from = c[1], to = c[5];
        c[0] = v[i];
        c[2] = 3.0 * rise - 2.0 * from - to;
        c[3] = from + to - 2.0 * rise;
    }
    double *below = piece, *above = piece + 4 * n, slope = piece[5];
    above[0] = v[n - 1];
    above[1] = beyond == ZOO_BEYOND_CONSTANT ? 0.0 : above[1];
    above[2] = above[3] = 0.0;
    /* with t = 1 at the first knot */
    const double down = beyond == ZOO_BEYOND_CONSTANT ? 0.0 : slope;
    const double bend = beyond == ZOO_BEYOND_WALL ? 0.5 * down * h / f->low : 0.0;
    below[0] = v[0] - down + bend;
    below[1] = down - 2.0 * bend;
    below[2] = bend;
    below[3] = 0.0;
    return made;
}

double zoo_function_curvature(zoo_spline f)
{
    double most = 0.0;
    for (int i = 1; i < (int)f.last; i++) {
        const double *c = f.piece + 4 * (ptrdiff_t)i;
        most = fmax(most, fmax(fabs(2.0 * c[2]), fabs(2.0 * c[2] + 6.0 * c[3])));
    }
    return most * f.per_step * f.per_step;
}
