/* One step: what must not change, and what must balance. */
#include "check.h"

static tree one;
static additions more;

/* Fluid at rest at one pressure stays at rest, in tapered vessels too. */
static void rest(int wall, const int32_t *cells)
{
    tree_make(&one, wall);
    one.problem.network.n_cells = cells;
    memset(one.flow, 0, sizeof one.flow);
    tree_open(&one, 1024);
    zoo_sim *s = &one.sim;
    for (int j = 0; j < s->n_nodes; j++) {
        s->A[j] = s->A0[j] * wall_area_ratio(wall, s->K[j], zoo_shape(s, j), 8000.0);
        s->q[j] = 0.0;
    }
    for (int t = 0; t < s->outlets.count; t++) {
        s->outlets.v[t] = 8000.0;
        s->outlets.C[t] = 1e9; /* so large that nothing drains */
    }
    tree_without_memory(s);
    zoo_set_step(s, 1024);
    zoo_refresh_nodes(s);
    for (int i = 0; i < 200; i++)
        CHECK(zoo_step(s, i) == 0);
    for (int j = 0; j < s->n_nodes; j++) {
        NEAR(s->P[j], 8000.0, 1e-7);
        NEAR(s->q[j], 0.0, 1e-11);
    }
    tree_close(&one);
}

/* Blood is neither lost nor made, and junctions pass on what they get. */
static void mass(int wall, const int32_t *cells)
{
    tree_make(&one, wall);
    one.problem.network.n_cells = cells;
    tree_open(&one, 1600);
    zoo_sim *s = &one.sim;
    zoo_start(s);
    memset(s->outlets.volume, 0, (size_t)s->outlets.count * sizeof(double));
    double before = tree_volume(s), in = 0.0, out = 0.0;
    for (int i = 0; i < 1600; i++) {
        CHECK(zoo_step(s, i) == 0);
        in += s->dt * s->curve_mean[i];
        CHECK(zoo_junction_defect(s) < 1e-13);
        out = 0.0;
        for (int t = 0; t < s->outlets.count; t++)
            out += s->outlets.volume[t];
        NEAR(tree_volume(s) - before, in - out, 1e-14); /* at any time, not only after a beat */
    }
    CHECK(in > 0.01 && out > 0.01);
    /* one pressure at every junction, and the Windkessel's own law at every outlet */
    for (int g = 0; g < s->n_groups; g++)
        for (int x = 0; x < s->groups[g].branches * s->groups[g].count; x++)
            NEAR(s->P[s->groups[g].node[x]], s->P[s->groups[g].node[s->groups[g].junction[x]]], 1e-6);
    for (int t = 0; t < s->outlets.count; t++)
        NEAR(s->P[s->outlets.node[t]], s->outlets.v[t] + s->outlets.R1[t] * s->q[s->outlets.node[t]], 1e-6);
    tree_close(&one);
}

/* The speed is |u| + c, c^2 = (a/rho) dp/da by differences, at the largest stiffness of the beat and as stiff
 * as a wall with a memory is to what comes suddenly: 1 + kappa times. */
static void speed(int wall, int added)
{
    tree_make(&one, wall);
    if (added)
        tree_add(&one, &more);
    tree_open(&one, 1600);
    zoo_sim *s = &one.sim;
    zoo_start(s);
    double worst = 0.0, h = 1e-5;
    for (int j = 0; j < s->n_nodes; j++) {
        int k = s->vessel_of[j];
        double a = s->A[j] / s->A0[j], K = s->K[j] * (added ? 1.3 : 1.0); /* the largest of `wave` */
        double up = wall_p(wall, K, zoo_shape(s, j), a + h, sqrt(a + h));
        double slope = (up - wall_p(wall, K, zoo_shape(s, j), a - h, sqrt(a - h))) / (2.0 * h);
        double kappa = added ? more.memory[k] / 3e-4 : 0.0, c = sqrt((1.0 + kappa) * a * slope / 1.055);
        worst = fmax(worst, (fabs(s->q[j] / s->A[j]) + c) / s->dx[k]);
    }
    NEAR(zoo_speed(s), worst, 1e-6 * worst);
    tree_close(&one);
}

/* An area that is not positive is reported. */
static void wrong(void)
{
    tree_make(&one, ZOO_WALL_TANGENT);
    tree_open(&one, 1600);
    zoo_start(&one.sim);
    one.sim.A[5] = -1e-3;
    CHECK(zoo_step(&one.sim, 0) == 1);
    zoo_start(&one.sim);
    one.sim.A[5] = one.sim.A0[5] * 10.0;
    CHECK(zoo_step(&one.sim, 0) == 1);
    for (int j = 0; j < one.sim.n_nodes; j++)
        one.sim.coefficient[j] = ZOO_PI; /* gamma 1: areas lie between A0/2 and 3 A0/2 */
    zoo_start(&one.sim);
    one.sim.A[5] = one.sim.A0[5] * 0.4;
    CHECK(zoo_step(&one.sim, 0) == 1);
    tree_close(&one);
}

int main(void)
{
    for (int wall = 0; wall < N_WALLS_IN_TESTS; wall++) {
        rest(wall, tree_cells);
        rest(wall, tree_single_cells);
        mass(wall, tree_cells);
        mass(wall, tree_single_cells);
        speed(wall, 0);
        speed(wall, 1);
    }
    wrong();
    return finish("step");
}
