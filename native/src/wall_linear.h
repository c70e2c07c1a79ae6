/* The linear wall,
 *
 *   p = K (sqrt(a) - 1),   K = 4/3 chi,   a = A/A0                  (eq. 3.3).
 *
 * wall.h says what each function is for. */
#ifndef ZOO_WALL_LINEAR_H
#define ZOO_WALL_LINEAR_H

static const wall_parameter linear_shapes[] = {{NULL, 0.0}}; /* none beside chi */
enum { linear_in_root = 1 };

ZOO_INLINE int linear_usable(wall_shape given)
{
    (void)given;
    return 1;
}

ZOO_INLINE double linear_scale(double factor, double stiffness, wall_shape given)
{
    (void)factor, (void)given;
    return 4.0 / 3.0 * stiffness;
}

ZOO_INLINE double linear_coefficient(wall_shape given, int m)
{
    (void)given, (void)m;
    return 0.0;
}

ZOO_INLINE double linear_p(double K, wall_shape g, double a, double root)
{
    (void)g, (void)a;
    return K * (root - 1.0);
}

ZOO_INLINE double linear_slope(double K, wall_shape g, double p, double a, double root)
{
    (void)g, (void)p, (void)a;
    return 0.5 * K / root;
}

ZOO_INLINE double linear_slope_area(double K, wall_shape g, double p, double root, double per_area, double inv_A0)
{
    (void)g, (void)p, (void)inv_A0;
    return 0.5 * K * root * per_area;
}

ZOO_INLINE double linear_by(double K, wall_shape g, double p, double a, double root, int m)
{
    (void)K, (void)g, (void)p, (void)a, (void)root, (void)m;
    return 0.0;
}

ZOO_INLINE double linear_area_ratio(double K, wall_shape g, double p)
{
    (void)g;
    double s = 1.0 + p / K;
    return s * s;
}

ZOO_INLINE double linear_limit(wall_shape g)
{
    (void)g;
    return INFINITY;
}

ZOO_INLINE double linear_floor(wall_shape g)
{
    (void)g;
    return 0.0;
}

ZOO_INLINE int linear_inside(wall_shape g, double a)
{
    (void)g, (void)a;
    return 1;
}

#endif
