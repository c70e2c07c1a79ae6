/* Every argument out of its range is refused, alone and among additions. */
#include "check.h"

static tree t;
static additions x;

#define REJECTS(change)                            \
    do {                                           \
        tree_make(&t, ZOO_WALL_LINEAR);            \
        if (added)                                 \
            tree_add(&t, &x);                      \
        CHECK(zoo_check_problem(&t.problem) == 0); \
        change;                                    \
        CHECK(zoo_check_problem(&t.problem) == 1); \
    } while (0)

static void problem(int added)
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
    bad_cells[4] = 0;
    int32_t bad_vessel[NSERIES] = {0, NV, 1};
    REJECTS(t.problem.network.length = bad_length);
    REJECTS(t.problem.outlet.C = bad_C);
    REJECTS(t.problem.network.parent = bad_parent);
    REJECTS(t.problem.network.n_cells = bad_cells);
    REJECTS(t.problem.network.n_vessels = 0);
    REJECTS(t.problem.fluid.density = 0.0);
    REJECTS(t.problem.wall.law = ZOO_N_WALLS);
    REJECTS(t.problem.fluid.friction = -1);
    REJECTS(t.problem.inlet.period = INFINITY);
    REJECTS(t.flow[9] = NAN);
    REJECTS(memset(t.flow, 0, sizeof t.flow));
    REJECTS(t.problem.outputs.vessel = bad_vessel);
    REJECTS(t.times[10] = 0.0);
    REJECTS(t.problem.numerics.cfl = 1.0);
    REJECTS(t.problem.numerics.tolerance = 0.0);
    REJECTS(t.problem.numerics.steps_per_beat = 31);
    REJECTS(t.problem.inlet.kind = ZOO_N_INLETS);
    REJECTS(t.problem.outlet.kind = -1);
    REJECTS(t.problem.wall.factor = 0.0);
    REJECTS(t.problem.outputs.n_times = -1);
}

static void addition(int added)
{
    REJECTS(x.viscosity[3] = 0.0);
    REJECTS(x.offset_in[3] = NAN);
    REJECTS(x.offset_out[3] = INFINITY);
    REJECTS(x.memory[1] = -1e-3);
    REJECTS(x.leak[2] = -1e-9);
    REJECTS(x.inertance[7] = NAN);
    REJECTS(x.severity[0] = 1.0);
    REJECTS(x.position[0] = 1.1);
    REJECTS(x.length[0] = 0.0);
    REJECTS(x.rho[3 * 7] = -0.1);
    REJECTS(x.kappa[3 * 7] = 0.0);
    REJECTS(x.wave[4] = 0.0);
    REJECTS(x.wave[0] = NAN);
    REJECTS(t.problem.wall.n_wave = -1);
    REJECTS(t.problem.wall.stiffness_wave = NULL);
    REJECTS(memset(x.rho, 0, sizeof x.rho));
    REJECTS(t.problem.wall.relaxation_time = 0.0);
    REJECTS(t.problem.junction.total_pressure = -1.0);
    REJECTS(t.problem.junction.loss = NAN);
    REJECTS(t.problem.numerics.least_steps = -1);
    REJECTS(t.problem.numerics.least_steps = t.problem.numerics.max_steps + 1);
    REJECTS(t.problem.throat.loss = INFINITY);
    REJECTS(t.problem.wall.offset_out = NULL);
    REJECTS(t.problem.throat.length = NULL);
    REJECTS(t.problem.outlet.section_compliance = NULL);
    REJECTS(t.problem.fluid.stokes_friction = -1.0);
    REJECTS(t.problem.fluid.viscous_friction = NAN);
}

int main(void)
{
    problem(0);
    problem(1);
    addition(1);
    return finish("check");
}
