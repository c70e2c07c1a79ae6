/* Where vessels meet: no flow is lost, and the pressures obey their relation, after many steps. */
#include "check.h"

static tree one;
static additions x;

/* p + tau rho u^2/2 is shared, with the daughters' loss; tau = 1, K = 2 and a function when coupled, else 0. */
static void relation(int wall, int added, int coupled, int alike)
{
    tree_make(&one, wall);
    for (int i = 0; i < NV && alike; i++) {
        one.stiffness[i] = 5e4;
        for (int m = 0; m < wall_shapes(wall); m++)
            one.shape[m * NV + i] = wall_shape_parameter(wall, m).typical;
    }
    if (added)
        tree_add(&one, &x);
    const zoo_function lost_at = one.problem.junction.function;
    one.problem.junction = (zoo_junction){.total_pressure = coupled, .loss = 2.0 * coupled};
    if (coupled && added)
        one.problem.junction.function = lost_at;
    tree_open(&one, 4096);
    zoo_sim *s = &one.sim;
    CHECK(s->uniform == alike && s->coupled == coupled);
    zoo_start(s);
    for (int i = 0; i < 3000; i++) {
        CHECK(zoo_step(s, i) == 0);
        CHECK(zoo_junction_defect(s) < 1e-13);
    }
    for (int g = 0; g < s->n_groups; g++) {
        const zoo_junction_group *ju = &s->groups[g];
        for (int x = 0; x < ju->branches * ju->count; x++) {
            int up = ju->node[x % ju->count], o = ju->node[x];
            double u0 = s->q[up] / s->A[up], u = s->q[o] / s->A[o];
            double half_rho = coupled ? 0.5 * 1.055 : 0.0, shared = s->P[up] + half_rho * u0 * u0;
            double lost = x < ju->count ? 0.0 : 2.0 * half_rho * u0 * fabs(u0); /* K = 2 */
            if (coupled && added && x >= ju->count)
                lost += spline_value(s->junction_function, u0);
            NEAR(s->P[o] + half_rho * u * u, shared - lost, 1e-4);
        }
    }
    tree_close(&one);
}

/* Junctions with total pressure that have no solution are told. */
static void stuck(int wall, int bad)
{
    tree_make(&one, wall);
    one.problem.junction = (zoo_junction){.total_pressure = 1.0, .loss = 2.0};
    tree_open(&one, 1600);
    zoo_sim *s = &one.sim;
    zoo_start(s);
    for (int j = 0; j < s->n_nodes && bad; j++) /* in a step more flows away from the first junction than is there */
        s->q[j] = j <= s->last[0] ? 0.0 : 1.0;
    zoo_refresh_nodes(s);
    zoo_step(s, 0);
    CHECK(s->no_root == bad && s->stuck == bad);
    tree_close(&one);
}

/* A search that rounding keeps from its end, here by a curvature far from any velocity, is no failure. */
static void rounding(void)
{
    enum { KNOTS = 128 };
    static double spike[KNOTS];
    spike[100] = 1e25;
    tree_make(&one, ZOO_WALL_LINEAR);
    one.problem.junction = (zoo_junction){1.0, 2.0, {KNOTS, 1000.0, 1127.0, spike}};
    tree_open(&one, 1600);
    zoo_sim *s = &one.sim;
    zoo_start(s);
    for (int i = 0; i < 100; i++)
        CHECK(zoo_step(s, i) == 0);
    CHECK(s->no_root && !s->stuck);
    tree_close(&one);
}

int main(void)
{
    for (int wall = 0; wall < N_WALLS_IN_TESTS; wall++)
        for (int i = 0; i < 8; i++)
            relation(wall, i & 1, i >> 1 & 1, i >> 2);
    for (int i = 0; i < 2 * ZOO_N_WALLS; i++)
        stuck(i / 2, i % 2);
    rounding();
    return finish("junction");
}
