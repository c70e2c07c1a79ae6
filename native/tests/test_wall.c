/* The wall laws against libm, finite differences and their own inverse. */
#include "check.h"

/* What must hold for any law, at its typical shape parameters. */
static void any_law(int law)
{
    const double chi = 6e4, A0 = 0.3, rho = 1.055, k = 1.0 / ZOO_PI;
    double given[ZOO_MOST_SHAPES], made[ZOO_MOST_SHAPES];
    const wall_shape typical = {.at = given, .stride = 1}, g = {.at = made, .stride = 1};
    for (int m = 0; m < wall_shapes(law); m++)
        given[m] = wall_shape_parameter(law, m).typical;
    for (int m = 0; m < wall_shapes(law); m++)
        made[m] = wall_coefficient(law, typical, m);
    CHECK(wall_usable(law, typical));
    const double K = wall_scale(law, k, chi, typical), from = fmax(0.6, 1.01 * wall_floor(law, g));
    const double to = fmin(1.9, 0.99 * wall_limit(law, g));
    CHECK(K > 0.0 && from < 1.0 && to > 1.0);
    for (int m = 0; m < wall_shapes(law); m++)
        for (double a = 0.9; a < 1.15; a += 0.05) {
            const double s = sqrt(a), p = wall_p(law, K, g, a, s), at = made[m], h = 1e-4 * at;
            made[m] = at + h;
            const double up = wall_p(law, K, g, a, s);
            made[m] = at - h;
            const double down = wall_p(law, K, g, a, s);
            made[m] = at;
            NEAR(wall_by(law, K, g, p, a, s, m), (up - down) / (2.0 * h), 1e-6 * K);
        }
    NEAR(wall_p(law, K, g, 1.0, 1.0), 0.0, 1e-9 * K); /* A0 is the area at rest */
    for (double a = from; a < to; a += 0.01) {
        double h = 1e-6, s = sqrt(a), p = wall_p(law, K, g, a, s), slope = wall_slope(law, K, g, p, a, s);
        double up = wall_p(law, K, g, a + h, sqrt(a + h)), down = wall_p(law, K, g, a - h, sqrt(a - h));
        CHECK(slope > 0.0 && wall_holds(law, g, a) && wall_inside(law, g, a));
        NEAR(slope, (up - down) / (2.0 * h), 1e-6 * slope);
        NEAR(wall_slope_area(law, K, g, p, s, 1.0 / (a * A0), 1.0 / A0), slope / A0, 1e-12 * slope / A0);
        NEAR(wall_area_ratio(law, K, g, p), a, 1e-12);
        if (wall_in_root(law))
            NEAR(p, K * (s - 1.0), 1e-12 * K);
        NEAR(zoo_wall_pressure(law, k, chi, given, A0 * a, A0), p, 1e-9 * fabs(p) + 1e-9);
        /* c^2 = (A/rho) dp/dA */
        NEAR(pow(zoo_wave_speed(law, k, chi, given, A0 * a, A0, rho), 2), a * slope / rho, 1e-9 * slope);
    }
    CHECK(isnan(zoo_wall_pressure(law, k, chi, given, -0.1, 1.0)));
    CHECK(isnan(zoo_wave_speed(law, k, chi, given, 0.0, 1.0, 1.0)));
    CHECK(isnan(zoo_wall_pressure(law, k, chi, given, NAN, 1.0)));
    if (isfinite(wall_limit(law, g))) {
        CHECK(isnan(zoo_wall_pressure(law, k, chi, given, 1.001 * wall_limit(law, g), 1.0)));
        CHECK(!wall_inside(law, g, 1.001 * wall_limit(law, g)));
    }
    if (wall_floor(law, g) > 0.0)
        CHECK(!wall_inside(law, g, 0.999 * wall_floor(law, g)));
    /* the list, as callers see it */
    CHECK(zoo_wall_name(law) != NULL && zoo_wall_shapes(law) == wall_shapes(law));
    for (int m = 0; m < wall_shapes(law); m++) {
        CHECK(zoo_wall_shape_name(law, m) != NULL);
        double kept = given[m];
        given[m] = NAN;
        CHECK(!wall_usable(law, typical) && isnan(zoo_wall_pressure(law, k, chi, given, 1.0, 1.0)));
        given[m] = kept;
    }
    CHECK(zoo_wall_shape_name(law, wall_shapes(law)) == NULL && zoo_wall_shape_name(law, -1) == NULL);
}

/* With a function added: the derivative of the sum, its inverse, and whether it rises. */
static void with_function(int law)
{
    double values[9], piece[4 * 10], given[ZOO_MOST_SHAPES], made[ZOO_MOST_SHAPES];
    const zoo_function added = {9, 0.85, 1.25, values};
    const int both = wall_with_function(law);
    const double A0 = 0.3, K = 5e4;
    for (int i = 0; i < 9; i++)
        values[i] = (law == ZOO_WALL_OLUFSEN ? 0.02 : 0.03) * sin(1.1 * i) + 0.01;
    wall_shape g = {made, 1, zoo_function_spline(&added, ZOO_BEYOND_WALL, 0.0, piece)};
    for (int m = 0; m < wall_shapes(law); m++) {
        given[m] = wall_shape_parameter(law, m).typical;
        made[m] = wall_coefficient(law, (wall_shape){.at = given, .stride = 1}, m);
    }
    CHECK(wall_base(both) == law && wall_shapes(both) == wall_shapes(law) && !wall_in_root(both));
    CHECK(zoo_wall_name(both) == NULL && zoo_wall_shapes(both) == -1 && wall_limit(both, g) == wall_limit(law, g));
    for (double a = 0.4; a < 1.9; a += 0.01) {
        double h = 1e-6, s = sqrt(a), p = wall_p(both, K, g, a, s), slope = wall_slope(both, K, g, p, a, s);
        double up = wall_p(both, K, g, a + h, sqrt(a + h)), down = wall_p(both, K, g, a - h, sqrt(a - h));
        NEAR(p, wall_p(law, K, g, a, s) + K * spline_value(g.function, s), 1e-9);
        NEAR(slope, (up - down) / (2.0 * h), 1e-5 * K);
        NEAR(wall_slope_area(both, K, g, p, s, 1.0 / (a * A0), 1.0 / A0), slope / A0, 1e-10 * K);
        if (wall_rises(both, g) && (law != ZOO_WALL_OLUFSEN || s < 1.25)) /* whose slope falls to 0 beyond the knots */
            NEAR(wall_area_ratio(both, K, g, p), a, 1e-11);
    }
    CHECK(wall_rises(both, g));
    if (law != ZOO_WALL_OLUFSEN) /* has no such pressure */
        NEAR(wall_p(both, K, g, wall_area_ratio(both, K, g, 3.0 * K), sqrt(wall_area_ratio(both, K, g, 3.0 * K))), 3.0 * K, 1e-6 * K);
    /* a slope of -0.98 of the linear wall's is none too little, -1 is */
    for (int i = 0; i < 9; i++)
        values[i] = -0.98 * 0.05 * i;
    g.function = zoo_function_spline(&added, ZOO_BEYOND_WALL, 0.0, piece);
    CHECK(wall_rises(ZOO_WALL_LINEAR + ZOO_N_WALLS, g));
    for (int i = 0; i < 9; i++)
        values[i] = -0.05 * i;
    g.function = zoo_function_spline(&added, ZOO_BEYOND_WALL, 0.0, piece);
    CHECK(!wall_rises(ZOO_WALL_LINEAR + ZOO_N_WALLS, g));
    for (int i = 0; i < 9; i++)
        values[i] *= 10.0;
    g.function = zoo_function_spline(&added, ZOO_BEYOND_WALL, 0.0, piece);
    CHECK(!wall_rises(both, g) && wall_rises(law, g));
}

int main(void)
{
    for (int law = 0; law < ZOO_N_WALLS; law++)
        any_law(law), with_function(law);
    CHECK(zoo_wall_name(ZOO_N_WALLS) == NULL && zoo_wall_name(-1) == NULL && zoo_wall_shapes(ZOO_N_WALLS) == -1);
    CHECK(isnan(zoo_wall_pressure(ZOO_N_WALLS, 1.0, 5e4, NULL, 1.1, 1.0)));

    /* a relaxing part that is half as stiff as the lasting one, and of which a fifth is left, adds a tenth */
    NEAR(wall_stiffened(6e4, 2.0, 0.2, 0.5), 1.1 * 2.0 * 6e4, 1e-9);
    NEAR(wall_stiffened(6e4, 1.0, 1.0, 0.0), 6e4, 0.0);

    /* the formulas of eq. (3.3) and (3.4), and Olufsen's */
    double gamma = 4.5, chi = 6e4, k = 1.0 / ZOO_PI;
    for (double a = 0.6; a < 1.9; a += 0.05) {
        double linear = 4.0 / 3.0 * chi * (sqrt(a) - 1.0), tangent = chi / ZOO_PI * tan(ZOO_PI / gamma * (a - 1.0));
        double olufsen = 4.0 / 3.0 * chi * (1.0 - sqrt(0.3 / (0.3 * a)));
        NEAR(zoo_wall_pressure(ZOO_WALL_OLUFSEN, k, chi, NULL, 0.3 * a, 0.3), olufsen, 1e-9 * fabs(olufsen) + 1e-9);
        NEAR(pow(zoo_wave_speed(ZOO_WALL_OLUFSEN, k, chi, NULL, 0.3 * a, 0.3, 1.06), 2), 2.0 / 3.0 * chi / (1.06 * sqrt(a)), 1e-6);
        NEAR(zoo_wall_pressure(ZOO_WALL_LINEAR, k, chi, NULL, 0.3 * a, 0.3), linear, 1e-9 * fabs(linear) + 1e-9);
        NEAR(zoo_wall_pressure(ZOO_WALL_TANGENT, k, chi, &gamma, 0.3 * a, 0.3), tangent, 1e-9 * fabs(tangent) + 1e-9);
    }
    CHECK(isinf(olufsen_area_ratio(5e4, (wall_shape){.stride = 1}, 5e4))); /* the most that it bears */
    double two = 2.0, one = 1.0;
    CHECK(isnan(zoo_wall_pressure(ZOO_WALL_TANGENT, 1.0, 5e4, NULL, 1.1, 1.0)));
    CHECK(isnan(zoo_wall_pressure(ZOO_WALL_TANGENT, 1.0, 5e4, &two, 2.01, 1.0))); /* limit: 1 + gamma/2 */
    CHECK(isnan(zoo_wall_pressure(ZOO_WALL_TANGENT, 1.0, 5e4, &one, 0.4, 1.0))); /* floor: 1 - gamma/2 */
    CHECK(zoo_wall_pressure(ZOO_WALL_TANGENT, 1.0, 5e4, &one, 0.6, 1.0) < 0.0);
    CHECK(isnan(zoo_wall_pressure(ZOO_WALL_LINEAR, 1.0, -5e4, NULL, 1.1, 1.0)));
    CHECK(isnan(zoo_wall_pressure(ZOO_WALL_LINEAR, 0.0, 5e4, NULL, 1.1, 1.0)));
    CHECK(isnan(zoo_wall_pressure(ZOO_WALL_LINEAR, 1.0, 5e4, NULL, -1.1, -1.0)));
    CHECK(isnan(zoo_wave_speed(ZOO_WALL_LINEAR, 1.0, 5e4, NULL, 1.1, 1.0, -1.0)));
    CHECK(isnan(zoo_wave_speed(ZOO_N_WALLS, 1.0, 5e4, NULL, 1.1, 1.0, 1.0)));
    CHECK(strcmp(zoo_wall_name(ZOO_WALL_TANGENT), "tangent") == 0);
    CHECK(strcmp(zoo_wall_shape_name(ZOO_WALL_TANGENT, 0), "gamma") == 0);
    return finish("wall");
}
