/* Olufsen's wall, which softens as it is stretched and bears no more than K,
 *
 *   p = K (1 - 1/sqrt(a)),   K = 4/3 chi,   chi = E h/r0,   a = A/A0      (Olufsen 1999,
 *                                                            doi 10.1152/ajpheart.1999.276.1.H257).
 *
 * wall.h says what each function is for. */
#ifndef ZOO_WALL_OLUFSEN_H
#define ZOO_WALL_OLUFSEN_H

static const wall_parameter olufsen_shapes[] = {{NULL, 0.0}}; /* none beside chi */
enum { olufsen_in_root = 0 };

ZOO_INLINE int olufsen_usable(wall_shape given)
{
    (void)given;
    return 1;
}

ZOO_INLINE double olufsen_scale(double factor, double stiffness, wall_shape given)
{
    (void)factor, (void)given;
    return 4.0 / 3.0 * stiffness;
}

ZOO_INLINE double olufsen_coefficient(wall_shape given, int m)
{
    (void)given, (void)m;
    return 0.0;
}

ZOO_INLINE double olufsen_p(double K, wall_shape g, double a, double root)
{
    (void)g;
    return K * (1.0 - root / a);
}

ZOO_INLINE double olufsen_slope(double K, wall_shape g, double p, double a, double root)
{
    (void)g, (void)p;
    return 0.5 * K / (a * root);
}

ZOO_INLINE double olufsen_slope_area(double K, wall_shape g, double p, double root, double per_area, double inv_A0)
{
    (void)g, (void)p, (void)inv_A0;
    return 0.5 * K * per_area / root;
}

ZOO_INLINE double olufsen_by(double K, wall_shape g, double p, double a, double root, int m)
{
    (void)K, (void)g, (void)p, (void)a, (void)root, (void)m;
    return 0.0;
}

/* Infinite at a pressure that the wall does not bear. */
ZOO_INLINE double olufsen_area_ratio(double K, wall_shape g, double p)
{
    (void)g;
    double inverse = 1.0 - p / K;
    return inverse > 0.0 ? 1.0 / (inverse * inverse) : INFINITY;
}

ZOO_INLINE double olufsen_limit(wall_shape g)
{
    (void)g;
    return INFINITY;
}

ZOO_INLINE double olufsen_floor(wall_shape g)
{
    (void)g;
    return 0.0;
}

ZOO_INLINE int olufsen_inside(wall_shape g, double a)
{
    (void)g, (void)a;
    return 1;
}

#endif
