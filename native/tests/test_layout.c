/* Grid, memory and the checks of the problem. */
#include "check.h"

static tree t;

#define REJECTS(change)                        \
    do {                                       \
        tree_make(&t, ZOO_WALL_LINEAR);        \
        CHECK(zoo_check_problem(&t.problem) == 0); \
        change;                                \
        CHECK(zoo_check_problem(&t.problem) == 1); \
    } while (0)

int main(void)
{
    double bad_length[NV], bad_C[NV];
    int32_t bad_parent[NV], bad_cells[NV];
    memcpy(bad_length, tree_length, sizeof bad_length);
    memcpy(bad_C, tree_C, sizeof bad_C);
    memcpy(bad_parent, tree_parent, sizeof bad_parent);
    memcpy(bad_cells, tree_cells, sizeof bad_cells);
    bad_length[3] = -0.1;
    bad_C[7] = NAN;
    bad_parent[2] = 5;
    bad_cells[4] = 1;
    int32_t bad_vessel[NSERIES] = {0, NV, 1};
    REJECTS(t.problem.network.length = bad_length);
    REJECTS(t.problem.network.C = bad_C);
    REJECTS(t.problem.network.parent = bad_parent);
    REJECTS(t.problem.network.n_cells = bad_cells);
    REJECTS(t.problem.network.n_vessels = 0);
    REJECTS(t.problem.physics.density = 0.0);
    REJECTS(t.problem.physics.wall = 2);
    REJECTS(t.problem.physics.friction = -1);
    REJECTS(t.problem.inflow.period = INFINITY);
    REJECTS(t.flow[9] = NAN);
    REJECTS(memset(t.flow, 0, sizeof t.flow));
    REJECTS(t.problem.outputs.vessel = bad_vessel);
    REJECTS(t.times[10] = 0.0);
    REJECTS(t.problem.numerics.cfl = 1.0);
    REJECTS(t.problem.numerics.tolerance = 0.0);
    REJECTS(t.problem.numerics.steps_per_beat = 31);

    tree_make(&t, ZOO_WALL_LINEAR);
    tree_open(&t, 1, 1024);
    zoo_sim *s = &t.sim;
    int nodes = 0;
    for (int k = 0; k < NV; k++) {
        CHECK(s->first[k] == nodes);
        nodes += tree_cells[k] + 1;
        CHECK(s->last[k] == nodes - 1);
        NEAR(s->A0[s->last[k]], ZOO_PI * tree_out[k] * tree_out[k], 1e-15);
    }
    CHECK(s->n_nodes == nodes);
    CHECK(s->n_groups == 3 && s->outlets.count == 4);
    int ends = 1; /* every end of a vessel belongs to the inlet, a junction or an outlet, once */
    for (int g = 0; g < s->n_groups; g++)
        ends += s->groups[g].count * s->groups[g].branches;
    CHECK(ends + s->outlets.count == 2 * NV);

    /* the mean inflow of the steps adds up to the exact integral, whatever the number of steps */
    double exact = 0.0;
    for (int i = 0; i < NSAMPLES; i++)
        exact += t.flow[i] * 0.11 / NSAMPLES;
    for (int n = 64; n < 1000; n += 97) {
        zoo_set_step(s, n);
        double sum = 0.0;
        for (int i = 0; i < n; i++)
            sum += s->flow_mean[i] * s->dt;
        NEAR(sum, exact, 1e-15);
        NEAR(s->flow_node[0], s->flow_node[n], 1e-15);
    }
    tree_close(&t);
    return finish("layout");
}
