/* Stiffness that varies along a vessel: its values at the nodes, blood at rest, and the order of what is left. */
#include "check.h"

static tree one;
static const double ratio[NV] = {1.0, 1.4, 1.0, 0.7, 1.2, 1.0, 1.0, 1.5};
static const double exponent[NV] = {1.0, 0.0, 1.0, 1.0, 0.0, 1.0, 2.0, 0.0};
static const double narrow[NV] = {0.041, 0.03, 0.030, 0.024, 0.014, 0.018, 0.020, 0.025};

static void vary(int wall, int finer)
{
    static int32_t cells[NV];
    tree_make(&one, wall);
    for (int k = 0; k < NV; k++)
        cells[k] = finer * tree_cells[k];
    one.problem.network.n_cells = cells;
    one.problem.network.radius_out = narrow;
    one.problem.wall.stiffness_ratio = ratio;
    one.problem.wall.stiffness_exponent = exponent;
}

/* K at the nodes is chi (1 + (s - 1) x/L) (r_in/r)^e of the law. */
static void values(int wall)
{
    vary(wall, 1);
    tree_open(&one, 4096);
    const zoo_sim *s = &one.sim;
    CHECK(s->varying && !s->uniform && s->K_mid != s->K && s->extra == wall_has_function(wall));
    for (int k = 0; k < NV; k++)
        for (int j = s->first[k]; j <= s->last[k]; j++) {
            double part = (double)(j - s->first[k]) / (s->last[k] - s->first[k]);
            double r = (1.0 - part) * tree_in[k] + part * narrow[k], here = s->K[j];
            NEAR(here / s->K[s->first[k]], (1.0 + (ratio[k] - 1.0) * part) * pow(tree_in[k] / r, exponent[k]), 1e-12);
            if (j < s->last[k]) {
                double next = s->K[j + 1], mid = s->K_mid[j];
                CHECK(mid >= fmin(here, next) * (1.0 - 1e-12) && mid <= fmax(here, next) * (1.0 + 1e-12));
            }
        }
    tree_close(&one);
}

/* The largest flow that a step makes of blood at rest at one pressure p, relative to A p dt/(rho L). */
static double stirred(int wall, int finer, double p)
{
    vary(wall, finer);
    tree_open(&one, 4096);
    zoo_sim *s = &one.sim;
    double worst = 0.0;
    for (int j = 0; j < s->n_nodes; j++) {
        s->A[j] = s->A0[j] * wall_area_ratio(s->wall, s->K[j], zoo_shape(s, j), p);
        s->q[j] = 0.0;
    }
    for (int t = 0; t < s->outlets.count; t++)
        outlet_start(s, t);
    tree_without_memory(s);
    zoo_refresh_nodes(s);
    for (int j = 0; j < s->n_nodes; j++)
        NEAR(s->P[j], p, 1e-9 * p);
    zoo_step(s, 0);
    for (int k = 0; k < NV; k++) /* what the ends start has not come further than their neighbours */
        for (int j = s->first[k] + 1; j < s->last[k]; j++)
            worst = fmax(worst, fabs(s->q[j]) * tree_length[k] / (s->A[j] * p * s->inv_density * s->dt));
    tree_close(&one);
    return worst;
}

int main(void)
{
    for (int wall = 0; wall < N_WALLS_IN_TESTS; wall++) {
        values(wall);
        /* of second order; with the left node's K at a midpoint it would be 0.03, and of first order */
        double coarse = stirred(wall, 1, 2e4), fine = stirred(wall, 4, 2e4);
        static const double most[] = {1e-3, 1e-3, 4e-3, 4e-3, 4e-3, 8e-3}; /* Olufsen's is stretched further */
        CHECK(coarse < most[wall] && fine < coarse / 9.0);
        /* ratios of 1, and exponents where radii do not change, are no change at all */
        static const double same[NV] = {1, 1, 1, 1, 1, 1, 1, 1};
        tree_make(&one, wall);
        one.problem.network.radius_out = tree_in;
        one.problem.wall.stiffness_ratio = same;
        one.problem.wall.stiffness_exponent = exponent;
        CHECK(!zoo_stiffness_varies(&one.problem));
        one.problem.wall.stiffness_ratio = ratio;
        CHECK(zoo_stiffness_varies(&one.problem) && zoo_check_problem(&one.problem) == 0);
        double bad[NV] = {1, 1, 1, 0, 1, 1, 1, 1};
        one.problem.wall.stiffness_ratio = bad;
        CHECK(zoo_check_problem(&one.problem) == 1);
    }
    return finish("taper");
}
