/* The wall laws for callers outside the solver: their names, plots, prior checks and tests. */
#include "values.h"
#include "wall.h"

#define WALL_NAME(NAME, name, ...) \
    case ZOO_WALL_##NAME:          \
        return #name;

const char *zoo_wall_name(int32_t law)
{
    switch (law) { /* of a law alone */
        ZOO_WALLS(WALL_NAME, )
    default:
        return NULL;
    }
}

int32_t zoo_wall_shapes(int32_t law)
{
    return law < ZOO_N_WALLS ? wall_shapes(law) : -1;
}

const char *zoo_wall_shape_name(int32_t law, int32_t shape)
{
    return shape >= 0 && shape < zoo_wall_shapes(law) ? wall_shape_parameter(law, shape).name : NULL;
}

/* A point of a wall: scale and coefficients from the parameters, area ratio; 0 where the law has no pressure. */
typedef struct {
    double K, coefficient[ZOO_MOST_SHAPES], a;
} point;

static int point_of(point *x, int law, double factor, double stiffness, const double *shape, double area,
                    double rest_area)
{
    const wall_shape given = {.at = shape, .stride = 1}, g = {.at = x->coefficient, .stride = 1};
    if (value_bad(stiffness) || value_bad(factor) || value_bad(rest_area) || law < 0 || law >= ZOO_N_WALLS || (wall_shapes(law) > 0 && shape == NULL) || !wall_usable(law, given))
        return 0;
    x->K = wall_scale(law, factor, stiffness, given);
    x->a = area / rest_area;
    for (int m = 0; m < wall_shapes(law); m++)
        x->coefficient[m] = wall_coefficient(law, given, m);
    return wall_holds(law, g, x->a);
}

double zoo_wall_pressure(int32_t law, double factor, double stiffness, const double *shape, double area,
                         double rest_area)
{
    point x;
    if (!point_of(&x, law, factor, stiffness, shape, area, rest_area))
        return NAN;
    return wall_p(law, x.K, (wall_shape){.at = x.coefficient, .stride = 1}, x.a, sqrt(x.a));
}

double zoo_wave_speed(int32_t law, double factor, double stiffness, const double *shape, double area,
                      double rest_area, double density)
{
    point x;
    if (!point_of(&x, law, factor, stiffness, shape, area, rest_area))
        return NAN;
    const wall_shape g = {.at = x.coefficient, .stride = 1};
    double root = sqrt(x.a), p = wall_p(law, x.K, g, x.a, root);
    return sqrt(x.a * wall_slope(law, x.K, g, p, x.a, root) / density);
}
