/* The fixed point: extrapolation on a map whose answer is known, and a beat that repeats itself. */
#include "check.h"

static tree t;

/* x -> fixed + D (x - fixed) with two distinct decay factors: three beats determine the fixed point. */
static void extrapolation(void)
{
    tree_make(&t, ZOO_WALL_LINEAR);
    tree_open(&t, 1024);
    zoo_sim *s = &t.sim;
    zoo_start(s);
    int n = s->n_state;
    double *fixed = malloc((size_t)n * sizeof(double)), *x = malloc((size_t)n * sizeof(double));
    zoo_pack(s, fixed);
    for (int i = 0; i < n; i++) {
        s->weight[i] = 1.0;
        x[i] = fixed[i] * (1.0 + 0.1 * sin(i));
    }
    for (int b = 2; b >= 0; b--)
        for (int i = 0; i < n; i++) {
            s->states[b * n + i] = x[i];
            x[i] = fixed[i] + (i % 2 ? 0.9 : 0.4) * (x[i] - fixed[i]);
            s->ends[b * n + i] = x[i];
        }
    double left = -1.0;
    CHECK(zoo_extrapolate(s, 3, &left) == 1);
    NEAR(left, 0.0, 1e-6);
    zoo_pack(s, x);
    for (int i = 0; i < n; i++)
        NEAR(x[i], fixed[i], 1e-6 * fabs(fixed[i]) + 1e-9);
    /* of two beats the change that is left, by the formula for one unknown */
    double over = 0.0, by = 0.0, most = 0.0;
    for (int i = 0; i < n; i++) {
        const double f = s->ends[i] - s->states[i], d = f - (s->ends[n + i] - s->states[n + i]);
        over += d * f;
        by += d * d;
    }
    for (int i = 0; i < n; i++) {
        const double f = s->ends[i] - s->states[i], d = f - (s->ends[n + i] - s->states[n + i]);
        most = fmax(most, fabs(f - over / by * d));
    }
    CHECK(zoo_extrapolate(s, 2, &left) == 1 && most > 1e-3);
    NEAR(left, most, 1e-9 * most);
    zoo_unpack(s, x);
    /* a combination with an area below zero is refused and leaves the state alone; so is one of a weight of 200, but
     * where the slowest decay takes a hundred beats */
    const double before[] = {0.55, 1.1}, after[] = {0.3, 0.702};
    for (int k = 0; k < 2; k++) {
        for (int i = 0; i < n; i++) {
            s->states[i] = fixed[i];
            s->ends[i] = 0.6 * fixed[i];
            s->states[n + i] = before[k] * fixed[i];
            s->ends[n + i] = after[k] * fixed[i];
        }
        s->slow = 0.9;
        CHECK(zoo_extrapolate(s, 2, &left) == 0);
        s->slow = 0.99;
        CHECK(k == 1 || zoo_extrapolate(s, 2, &left) == 0);
    }
    zoo_pack(s, x);
    for (int i = 0; i < n; i++)
        NEAR(x[i], fixed[i], 1e-6 * fabs(fixed[i]) + 1e-9);
    CHECK(zoo_extrapolate(s, 2, &left) == 1);
    free(fixed);
    free(x);
    tree_close(&t);
}

/* Run to a tight tolerance, then check that a further plain beat changes nothing and that mass balances. */
static void repeats(int wall, int accelerate)
{
    double p[NSERIES * NTIMES], q[NSERIES * NTIMES], A[NSERIES * NTIMES];
    tree_make(&t, wall);
    t.problem.numerics.tolerance = 1e-5;
    t.problem.numerics.accelerate = accelerate;
    tree_open(&t, 64);
    zoo_sim *s = &t.sim;
    zoo_periodic(s, NULL, p, q, A);
    zoo_report r = s->report;
    CHECK(r.status == ZOO_OK && r.change < 1e-5 && r.max_cfl < 1.0);
    NEAR(r.outflow, r.inflow, 1e-9 * r.inflow);
    CHECK(r.junction_defect < 1e-13);
    for (int i = 0; i < NSERIES; i++)
        NEAR(p[i * NTIMES], p[i * NTIMES + NTIMES - 1], 1e-4);
    double *before = malloc((size_t)s->n_state * sizeof(double)), *after = malloc((size_t)s->n_state * sizeof(double));
    zoo_pack(s, before);
    for (int i = 0; i < s->n_steps; i++)
        zoo_step(s, i);
    zoo_pack(s, after);
    for (int i = 0; i < s->n_state; i++)
        NEAR(s->weight[i] * (after[i] - before[i]), 0.0, 1e-5);
    free(before);
    free(after);
    tree_close(&t);
}

int main(void)
{
    extrapolation();
    repeats(ZOO_WALL_LINEAR, 1);
    repeats(ZOO_WALL_TANGENT, 1);
    repeats(ZOO_WALL_LINEAR, 0);
    return finish("periodic");
}
