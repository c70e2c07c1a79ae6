/* The tangent wall, which stiffens towards an area that it cannot pass,
 *
 *   p = K tan(theta (a - 1)),   K = k chi,   theta = pi/gamma,   a = A/A0      (eq. 3.4).
 *
 * wall.h says what each function is for. */
#ifndef ZOO_WALL_TANGENT_H
#define ZOO_WALL_TANGENT_H

static const wall_parameter tangent_shapes[] = {{"gamma", 4.0}, {NULL, 0.0}};
enum { tangent_in_root = 0 };

ZOO_INLINE int tangent_usable(wall_shape given)
{
    return shape(given, 0) > 0.0 && !isinf(shape(given, 0));
}

ZOO_INLINE double tangent_scale(double factor, double stiffness, wall_shape given)
{
    (void)given;
    return factor * stiffness;
}

/* theta */
ZOO_INLINE double tangent_coefficient(wall_shape given, int m)
{
    return ZOO_PI / shape(given, m);
}

ZOO_INLINE double tangent_p(double K, wall_shape g, double a, double root)
{
    (void)root;
    return K * fast_tan(shape(g, 0) * (a - 1.0));
}

ZOO_INLINE double tangent_slope(double K, wall_shape g, double p, double a, double root)
{
    (void)a, (void)root;
    double t = p / K;
    return K * shape(g, 0) * (1.0 + t * t);
}

ZOO_INLINE double tangent_slope_area(double K, wall_shape g, double p, double root, double per_area, double inv_A0)
{
    (void)root, (void)per_area;
    double t = p * fast_reciprocal(K);
    return K * shape(g, 0) * (1.0 + t * t) * inv_A0;
}

ZOO_INLINE double tangent_by(double K, wall_shape g, double p, double a, double root, int m)
{
    (void)g, (void)root, (void)m;
    double t = p / K;
    return K * (a - 1.0) * (1.0 + t * t);
}

ZOO_INLINE double tangent_area_ratio(double K, wall_shape g, double p)
{
    return 1.0 + atan(p / K) / shape(g, 0);
}

ZOO_INLINE double tangent_limit(wall_shape g)
{
    return 1.0 + 0.5 * ZOO_PI / shape(g, 0);
}

/* The other asymptote, if it lies above 0. */
ZOO_INLINE double tangent_floor(wall_shape g)
{
    double a = 1.0 - 0.5 * ZOO_PI / shape(g, 0);
    return a > 0.0 ? a : 0.0;
}

ZOO_INLINE int tangent_inside(wall_shape g, double a)
{
    return fabs(shape(g, 0) * (a - 1.0)) < 0.5 * ZOO_PI;
}

#endif
