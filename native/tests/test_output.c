/* The samples against cubics in space and time, which they must reproduce. */
#include "check.h"

static tree t;

static double cubic(double x)
{
    return 2.0 - x + 3.0 * x * x - 1.5 * x * x * x;
}

int main(void)
{
    int32_t vessel[5] = {0, 1, 4, 7, 5}, cells[NV];
    double position[5] = {0.0, 0.37, 0.5, 1.0, 0.7};
    memcpy(cells, tree_cells, sizeof cells);
    cells[5] = 1; /* only a straight line goes through two nodes */
    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.outputs.n_series = 5;
    t.problem.network.n_cells = cells;
    t.problem.outputs.vessel = vessel;
    t.problem.outputs.position = position;
    tree_open(&t, 64);
    zoo_sim *s = &t.sim;
    for (int step = 0; step <= 64; step++) {
        for (int k = 0; k < NV; k++)
            for (int j = s->first[k]; j <= s->last[k]; j++) {
                double x = (double)(j - s->first[k]) / (s->last[k] - s->first[k]), y = step / 64.0;
                s->P[j] = cubic(y) + (k == 5 ? x : k == 4 ? x * x : cubic(x));
                s->q[j] = cubic(y) * x;
                s->A[j] = 1.0 + x;
            }
        if (step == 0)
            zoo_output_begin(s);
        else
            zoo_output_step(s, step);
    }
    CHECK(s->next_time == NTIMES);
    double p[5 * NTIMES], q[5 * NTIMES], A[5 * NTIMES];
    zoo_output_store(s, p, q, A);
    for (int i = 0; i < 5; i++)
        for (int m = 0; m < NTIMES; m++) {
            double x = position[i], y = t.times[m] / 0.11;
            NEAR(p[i * NTIMES + m], cubic(y) + (vessel[i] == 5 ? x : vessel[i] == 4 ? x * x : cubic(x)), 1e-12);
            NEAR(q[i * NTIMES + m], cubic(y) * x, 1e-12);
            NEAR(A[i * NTIMES + m], 1.0 + x, 1e-12);
        }
    CHECK(zoo_output_finite(s) == 1);
    s->sample[5 * NTIMES * 3 - 1] = INFINITY;
    CHECK(zoo_output_finite(s) == 0);
    s->report.status = ZOO_COLLAPSE;
    zoo_output_store(s, p, q, A);
    CHECK(isnan(p[0]) && isnan(q[5 * NTIMES - 1]));
    tree_close(&t);
    return finish("output");
}
