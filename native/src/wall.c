/* The wall law for callers outside the solver: plots, prior checks and tests. */
#include "wall.h"

double zoo_wall_pressure(int32_t wall, double wall_factor, double stiffness, double gamma,
                         double area, double rest_area)
{
    double K = wall_scale(wall, wall_factor, stiffness), theta = wall_theta(wall, gamma);
    double a = area / rest_area;
    if (!wall_holds(wall, theta, a))
        return NAN;
    return wall_p(wall, K, theta, a, sqrt(a));
}

double zoo_wave_speed(int32_t wall, double wall_factor, double stiffness, double gamma, double area,
                      double rest_area, double density)
{
    double K = wall_scale(wall, wall_factor, stiffness), theta = wall_theta(wall, gamma);
    double a = area / rest_area;
    if (!wall_holds(wall, theta, a))
        return NAN;
    double r = sqrt(a);
    return sqrt(a * wall_slope(wall, K, theta, wall_p(wall, K, theta, a, r), r) / density);
}
