/* The wall laws against libm, finite differences and their own inverse. */
#include "check.h"

int main(void)
{
    for (double x = -1.57; x < 1.57; x += 0.001)
        NEAR(wall_tan(x), tan(x), 2e-14 * fabs(tan(x)) * (1.0 + fabs(tan(x))) + 1e-300);

    for (double x = 1e-6; x < 1e12; x *= 1.37) {
        NEAR(wall_rsqrt(x) * sqrt(x), 1.0, 2e-14);
        NEAR(wall_reciprocal(x) * x, 1.0, 2e-14);
        NEAR(wall_reciprocal(-x) * x, -1.0, 2e-14);
    }
    CHECK(isnan(wall_rsqrt(-1.0)));

    for (int wall = ZOO_WALL_LINEAR; wall <= ZOO_WALL_TANGENT; wall++) {
        double chi = 6e4, gamma = 4.5, k = 1.0 / ZOO_PI;
        double K = wall_scale(wall, k, chi), theta = wall_theta(wall, gamma);
        for (double a = 0.6; a < 1.9; a += 0.05) {
            double h = 1e-6, p = wall_p(wall, K, theta, a, sqrt(a));
            double up = wall_p(wall, K, theta, a + h, sqrt(a + h));
            double down = wall_p(wall, K, theta, a - h, sqrt(a - h));
            double slope = wall_slope(wall, K, theta, p, sqrt(a));
            NEAR(slope, (up - down) / (2.0 * h), 1e-7 * slope);
            NEAR(wall_area_ratio(wall, K, theta, p), a, 1e-13);
            double expected = wall == ZOO_WALL_LINEAR ? 4.0 / 3.0 * chi * (sqrt(a) - 1.0)
                                                      : chi / ZOO_PI * tan(ZOO_PI / gamma * (a - 1.0));
            NEAR(zoo_wall_pressure(wall, k, chi, gamma, 0.3 * a, 0.3), expected, 1e-9 * fabs(expected) + 1e-9);
            /* c^2 = (A/rho) dp/dA */
            NEAR(pow(zoo_wave_speed(wall, k, chi, gamma, 0.3 * a, 0.3, 1.055), 2), a * slope / 1.055,
                 1e-9 * slope);
        }
    }
    CHECK(isnan(zoo_wall_pressure(ZOO_WALL_TANGENT, 1.0, 5e4, 2.0, 2.01, 1.0))); /* limit: 1 + gamma/2 */
    CHECK(isnan(zoo_wall_pressure(ZOO_WALL_TANGENT, 1.0, 5e4, 1.0, 0.4, 1.0))); /* floor: 1 - gamma/2 */
    CHECK(zoo_wall_pressure(ZOO_WALL_TANGENT, 1.0, 5e4, 1.0, 0.6, 1.0) < 0.0);
    CHECK(isnan(zoo_wall_pressure(ZOO_WALL_LINEAR, 1.0, 5e4, 2.0, -0.1, 1.0)));
    CHECK(isnan(zoo_wave_speed(ZOO_WALL_LINEAR, 1.0, 5e4, 2.0, 0.0, 1.0, 1.0)));
    return finish("wall");
}
