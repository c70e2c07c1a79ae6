/* The vectorising reciprocals, roots and tangents against libm. */
#include "check.h"

int main(void)
{
    for (double x = -1.57; x < 1.57; x += 0.001)
        NEAR(fast_tan(x), tan(x), 2e-14 * fabs(tan(x)) * (1.0 + fabs(tan(x))) + 1e-300);
    for (double x = 1e-6; x < 1e12; x *= 1.37) {
        NEAR(fast_rsqrt(x) * sqrt(x), 1.0, 2e-14);
        NEAR(fast_reciprocal(x) * x, 1.0, 2e-14);
        NEAR(fast_reciprocal(-x) * x, -1.0, 2e-14);
    }
    CHECK(isnan(fast_rsqrt(-1.0)));
    return finish("arithmetic");
}
