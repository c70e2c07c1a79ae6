/* Functions given by their values: cubics exactly, others to fourth order, and how they go on. */
#include "check.h"

enum { MOST = 200 };
static double piece[4 * (MOST + 1)], values[MOST];

static double cubic(double x)
{
    return 0.3 - 1.7 * x + 0.4 * x * x + 0.9 * x * x * x;
}

static zoo_spline through(double (*f)(double), int n, double low, double high, zoo_beyond beyond)
{
    for (int i = 0; i < n; i++)
        values[i] = f(low + (high - low) * i / (n - 1));
    const zoo_function given = {n, low, high, values};
    CHECK(zoo_function_bad(&given, -ZOO_MOST_VALUE, -ZOO_MOST_VALUE, ZOO_MOST_VALUE) == 0 && zoo_function_size(&given) == 4 * (n + 1));
    return zoo_function_spline(&given, beyond, 0.0, piece);
}

static double miss(int n)
{
    const zoo_spline f = through(sin, n, -1.0, 3.0, ZOO_BEYOND_LINEAR);
    double worst = 0.0;
    for (double x = -1.0; x <= 3.0; x += 1e-3)
        worst = fmax(worst, fabs(spline_value(f, x) - sin(x)));
    return worst;
}

static void knots(void)
{
    for (int n = ZOO_FEWEST_KNOTS; n < 20; n += 5) {
        const zoo_spline f = through(cubic, n, 0.7, 1.9, ZOO_BEYOND_LINEAR);
        for (double x = 0.7; x <= 1.9; x += 0.01) {
            double slope;
            NEAR(spline_at(f, x, &slope), cubic(x), 1e-13);
            NEAR(slope, -1.7 + 0.8 * x + 2.7 * x * x, 1e-12);
        }
        NEAR(zoo_function_curvature(f), 0.8 + 5.4 * 1.9, 1e-10);
    }
    /* of fourth order up to the ends */
    const double coarse = miss(21), fine = miss(41);
    CHECK(fine < 5e-6 && coarse / fine > 12.0 && coarse / fine < 20.0);
    /* value, slope and second derivative go through a knot without a jump */
    const zoo_spline f = through(sin, 9, -1.0, 3.0, ZOO_BEYOND_LINEAR);
    for (int i = 1; i < 8; i++) {
        const double x = -1.0 + 0.5 * i, h = 1e-7;
        double before, at, after;
        NEAR(spline_at(f, x - h, &before), sin(x) - h * cos(x), 1e-6);
        NEAR(spline_at(f, x, &at), sin(x), 1e-14);
        (void)spline_at(f, x + h, &after);
        NEAR(after - at, at - before, 1e-12);
    }
}

static void beyond(void)
{
    const double low = 0.8, high = 1.6, v0 = cubic(low), v1 = cubic(high);
    const double m0 = -1.7 + 0.8 * low + 2.7 * low * low, m1 = -1.7 + 0.8 * high + 2.7 * high * high;
    for (int kind = ZOO_BEYOND_CONSTANT; kind <= ZOO_BEYOND_WALL; kind++) {
        const zoo_spline f = through(cubic, 6, low, high, (zoo_beyond)kind);
        for (double far = 1e-9; far < 1e3; far *= 7.0) {
            double slope, x = low - far;
            double value = kind == ZOO_BEYOND_CONSTANT ? v0
                           : kind == ZOO_BEYOND_LINEAR ? v0 - m0 * far
                                                       : v0 + m0 / (2.0 * low) * (x * x - low * low);
            double rise = kind == ZOO_BEYOND_CONSTANT ? 0.0 : kind == ZOO_BEYOND_LINEAR ? m0 : m0 * x / low;
            NEAR(spline_at(f, x, &slope), value, 1e-12 * (1.0 + fabs(value)));
            NEAR(slope, rise, 1e-12 * (1.0 + fabs(rise)));
            value = kind == ZOO_BEYOND_CONSTANT ? v1 : v1 + m1 * far;
            NEAR(spline_at(f, high + far, &slope), value, 1e-12 * (1.0 + fabs(value)));
            NEAR(slope, kind == ZOO_BEYOND_CONSTANT ? 0.0 : m1, 1e-12);
        }
        CHECK(isnan(spline_value(f, NAN)));
        CHECK(!(fabs(spline_value(f, 1e300)) < 0.0) && !(fabs(spline_value(f, -INFINITY)) < 0.0)); /* nothing is read outside */
    }
    const zoo_function absent = {0};
    const zoo_spline f = zoo_function_spline(&absent, ZOO_BEYOND_LINEAR, 0.75, piece);
    CHECK(zoo_function_bad(&absent, 0.0, 0.0, 1.0) == 0 && zoo_function_size(&absent) == 4);
    double slope;
    CHECK(spline_at(f, 1e9, &slope) == 0.75 && slope == 0.0 && spline_value(f, -3.0) == 0.75);
    CHECK(zoo_function_curvature(f) == 0.0);
}

#define BAD(...) CHECK(zoo_function_bad(&(zoo_function)__VA_ARGS__, 0.5, -2.0, 9.0) == 1)

static void arguments(void)
{
    double v[5] = {0.0, 1.0, 2.0, 3.0, 4.0}, low[4] = {0.0, -2.1, 0.0, 0.0}, none[4] = {0.0, 0.0, NAN, 0.0};
    CHECK(zoo_function_bad(&(zoo_function){5, 0.5, 1.0, v}, 0.5, -2.0, 9.0) == 0);
    BAD({3, 0.5, 1.0, v});
    BAD({-1, 0.5, 1.0, v});
    BAD({ZOO_MOST_KNOTS + 1, 0.5, 1.0, v});
    BAD({5, 0.5, 1.0, NULL});
    BAD({5, 0.4, 1.0, v});
    BAD({5, NAN, 1.0, v});
    BAD({5, 0.5, NAN, v});
    BAD({5, 0.5, INFINITY, v});
    BAD({5, 1.0, 1.0, v});
    BAD({5, 1.0, 0.9, v});
    BAD({4, 0.5, 1.0, low});
    BAD({4, 0.5, 1.0, none});
    v[4] = 9.1;
    BAD({5, 0.5, 1.0, v});
}

int main(void)
{
    knots();
    beyond();
    arguments();
    return finish("function");
}
