/* Every argument out of its range is refused, alone and among additions. */
#include <limits.h>

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
    REJECTS(t.problem.wall.law = ZOO_N_WALLS); /* that of a law with a function is no number of the caller's */
    REJECTS(t.problem.fluid.friction = -1);
    REJECTS(t.problem.inlet.period = INFINITY);
    REJECTS(t.flow[9] = NAN);
    REJECTS(memset(t.flow, 0, sizeof t.flow));
    REJECTS(t.problem.outputs.vessel = bad_vessel);
    REJECTS(t.times[10] = 0.0);
    REJECTS(t.problem.numerics.cfl = 1.0);
    REJECTS(t.problem.numerics.tolerance = 0.0);
    REJECTS(t.problem.numerics.relative = 1.0);
    REJECTS(t.problem.numerics.relative = NAN);
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
    REJECTS(x.rho[3 * 7] = -0.1); /* its compliance is positive */
    REJECTS((x.rho[3 * 7] = -9.0, x.kappa[3 * 7] = -1.0)); /* the sum is negative */
    REJECTS((t.problem.outlet.resistance_function = (zoo_function){4, 0.0, 1e4, (double[]){0.0, 31.0, 0.0, 0.0}}));
    REJECTS((t.problem.outlet.compliance_function = (zoo_function){4, 1e4, 0.0, x.factor}));
    REJECTS(x.kappa[3 * 7] = 0.0);
    REJECTS(x.factor[3] = -0.1);
    REJECTS(x.factor[0] = NAN);
    REJECTS(t.problem.fluid.friction_function.low = -0.1);
    REJECTS(t.problem.fluid.friction_function.n_knots = 3);
    REJECTS(x.lost[4] = INFINITY);
    REJECTS(t.problem.junction.function.high = t.problem.junction.function.low);
    REJECTS(t.problem.junction.function.values = NULL);
    REJECTS((t.problem.wall.function = (zoo_function){NKNOTS, 0.0, 1.5, t.knots}));
    REJECTS((t.knots[2] = NAN, t.problem.wall.function = (zoo_function){NKNOTS, 0.8, 1.5, t.knots}));
    REJECTS(x.wave[4] = 0.0);
    REJECTS(x.wave[0] = NAN);
    REJECTS(t.problem.wall.n_wave = -1);
    REJECTS(x.veins[6 * NV - 1] = NAN);
    REJECTS(t.problem.outlet.n_wave = -1);
    REJECTS(t.problem.outlet.wave = NULL);
    REJECTS(t.problem.wall.stiffness_wave = NULL);
    REJECTS((t.problem.loss = (zoo_loss){.linear = x.length}));
    REJECTS((x.leak[1] = -1.0, t.problem.loss = (zoo_loss){x.leak, NULL, x.position, x.length}));
    REJECTS((t.problem.loss = (zoo_loss){x.leak, NULL, x.position, x.leak}));
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
    REJECTS(t.problem.outlet.n_modes = -1);
    REJECTS(t.problem.outlet.mode_rate = 0.0);
    REJECTS(x.turns[1] = -1.0);
    REJECTS(x.cosine[2 * NV - 1] = INFINITY);
    REJECTS(x.sine[2 * NV - 1] = NAN);
    REJECTS(t.problem.outlet.mode_frequency = NULL);
    REJECTS(t.problem.outlet.mode_cosine = NULL);
    REJECTS(t.problem.outlet.mode_sine = NULL);
    REJECTS(t.problem.fluid.stokes_friction = -1.0);
    REJECTS(t.problem.fluid.viscous_friction = NAN);
}

/* Sizes that ints, pointers or memory do not hold, and times that have no inverse. */
static void sizes(int added)
{
    int32_t huge[NV], many[NV];
    for (int k = 0; k < NV; k++)
        huge[k] = INT_MAX, many[k] = 1;
    many[0] = 60000000; /* a block of directions of the state alone: more than INT_MAX */
    REJECTS(t.problem.network.n_cells = huge);
    REJECTS(t.problem.network.n_cells = many);
    REJECTS(t.problem.network.n_vessels = INT_MAX);
    REJECTS(t.problem.network.n_vessels = INT_MIN);
    REJECTS(t.problem.outputs.n_times = INT_MAX);
    REJECTS(t.problem.numerics.max_steps = INT_MAX);
    REJECTS(t.problem.numerics.max_beats = INT_MAX);
    REJECTS((t.problem.inlet.period = 5e-324, t.problem.outputs.n_times = 0)); /* no sample is beyond it */
    REJECTS((t.problem.inlet.period = 1e-300, t.problem.outputs.n_times = 0));
    REJECTS(t.problem.fluid.momentum_correction = INFINITY);
    REJECTS((t.flow[0] = 1e308, t.flow[1] = 1e308)); /* the mean is not a number */
    REJECTS(t.problem.network.parent = NULL);
    REJECTS(t.problem.network.n_cells = NULL);
    REJECTS(t.problem.network.length = NULL);
    REJECTS(t.problem.network.radius_in = NULL);
    REJECTS(t.problem.network.radius_out = NULL);
    REJECTS(t.problem.inlet.curve = NULL);
    REJECTS(t.problem.outlet.R1 = NULL);
    REJECTS(t.problem.outlet.R2 = NULL);
    REJECTS(t.problem.outlet.C = NULL);
    REJECTS(t.problem.outputs.vessel = NULL);
    REJECTS(t.problem.outputs.position = NULL);
    REJECTS(t.problem.outputs.times = NULL);
    if (added)
        REJECTS(t.problem.outlet.n_sections = INT_MAX);
    if (added)
        REJECTS(t.problem.outlet.n_modes = INT_MAX);

    /* arrays that are not there */
    static double waves[3][NSERIES * NTIMES];
    zoo_report report;
    int64_t bytes;
    tree_make(&t, ZOO_WALL_TANGENT);
    CHECK(zoo_workspace_size(NULL, &bytes) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_workspace_size(&t.problem, NULL) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_workspace_size(&t.problem, &bytes) == ZOO_OK);
    char *memory = malloc((size_t)bytes);
    const double **array[] = {&t.parameters.stiffness, &t.parameters.shape, &t.parameters.psi1, &t.parameters.psi2,
                              &t.parameters.c};
#define SOLVE(p, q, a, r, pa) zoo_solve(&t.problem, pa, memory, bytes, p, q, a, NULL, r)
    CHECK(SOLVE(waves[0], waves[1], waves[2], &report, &t.parameters) == ZOO_OK);
    for (size_t i = 0; i < sizeof array / sizeof *array; i++) {
        const double *there = *array[i];
        *array[i] = NULL;
        CHECK(SOLVE(waves[0], waves[1], waves[2], &report, &t.parameters) == ZOO_BAD_ARGUMENT);
        *array[i] = there;
    }
    CHECK(SOLVE(NULL, waves[1], waves[2], &report, &t.parameters) == ZOO_BAD_ARGUMENT);
    CHECK(SOLVE(waves[0], NULL, waves[2], &report, &t.parameters) == ZOO_BAD_ARGUMENT);
    CHECK(SOLVE(waves[0], waves[1], NULL, &report, &t.parameters) == ZOO_BAD_ARGUMENT);
    CHECK(SOLVE(waves[0], waves[1], waves[2], NULL, &t.parameters) == ZOO_BAD_ARGUMENT);
    CHECK(SOLVE(waves[0], waves[1], waves[2], &report, NULL) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_solve(&t.problem, &t.parameters, NULL, bytes, waves[0], waves[1], waves[2], NULL, &report) ==
          ZOO_WORKSPACE);
    CHECK(zoo_solve(&t.problem, &t.parameters, memory, bytes - 1, waves[0], waves[1], waves[2], NULL, &report) ==
          ZOO_WORKSPACE);
    t.problem.outputs.n_times = 0; /* without samples there is nothing to write */
    CHECK(SOLVE(NULL, NULL, NULL, &report, &t.parameters) == ZOO_OK && report.status == ZOO_OK);
    free(memory);
}

int main(void)
{
    problem(0);
    problem(1);
    addition(1);
    sizes(0);
    sizes(1);
    return finish("check");
}
