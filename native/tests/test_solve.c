/* The entry point: statuses, and memory that belongs to the caller. */
#include "check.h"

static tree t;
static double p[NSERIES * NTIMES], q[NSERIES * NTIMES], A[NSERIES * NTIMES];
static zoo_report report;

/* The status of the solve of what stands in t. */
static int32_t run(void)
{
    int64_t bytes = 0;
    CHECK(zoo_workspace_size(&t.problem, &bytes) == ZOO_OK);
    char *memory = malloc((size_t)bytes); /* exactly: the sanitizer sees a byte too many */
    memset(memory, 0xff, (size_t)bytes);
    CHECK(zoo_solve(&t.problem, &t.parameters, memory, bytes - 1, p, q, A, NULL, &report) == ZOO_WORKSPACE);
    CHECK(zoo_solve(&t.problem, &t.parameters, memory, bytes, p, q, A, NULL, &report) == ZOO_OK);
    free(memory);
    for (int i = 0; i < NSERIES * NTIMES; i++)
        CHECK(isnan(p[i]) == (report.status != ZOO_OK) && isnan(q[i]) == isnan(p[i]) && isnan(A[i]) == isnan(p[i]));
    return report.status;
}

/* Each failure has its own status. */
static void statuses(void)
{
    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.numerics.max_beats = 1;
    CHECK(run() == ZOO_NOT_PERIODIC);

    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.numerics.steps_per_beat = 300;
    CHECK(run() == ZOO_CFL);
    CHECK(report.steps_per_beat == 300 && report.max_cfl > 0.5 && isnan(p[0]));

    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.numerics.max_steps = 512;
    CHECK(run() == ZOO_CFL);
    t.stiffness[3] *= 1e4; /* its waves are the fastest by far */
    CHECK(run() == ZOO_CFL && report.vessel == 3 && report.max_cfl > 1.0);

    /* a tolerance that follows the pulse, and one below what rounding leaves */
    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.numerics.tolerance = 1e6;
    t.problem.numerics.relative = 1e-4;
    CHECK(run() == ZOO_OK && report.tolerance < 10.0 && report.distance <= report.tolerance);
    for (int i = 0; i < NSAMPLES; i++)
        t.flow[i] = 0.17;
    t.problem.numerics.max_beats = 500;
    CHECK(run() == ZOO_OK && report.tolerance > 0.0 && report.tolerance < 1e-5);

    /* a backflow larger than the vessels hold empties them */
    tree_make(&t, ZOO_WALL_LINEAR);
    for (int i = 0; i < NSAMPLES; i++)
        t.flow[i] = 0.02 + 0.9 * sin(2.0 * ZOO_PI * i / NSAMPLES);
    t.problem.numerics.max_steps = 32768;
    const int32_t status = run();
    CHECK((status == ZOO_COLLAPSE || status == ZOO_NO_ROOT) && report.vessel >= 0 && report.time > 0.0);
    for (int k = 0; k < NV; k++)
        t.stiffness[k] = 3e6; /* stiff enough to stand it */
    CHECK(run() == ZOO_OK);
    t.psi2[7] = -1.0;
    CHECK(run() == ZOO_BAD_ARGUMENT && report.vessel == 7);

    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.fluid.density = -1.0;
    int64_t bytes;
    CHECK(zoo_workspace_size(&t.problem, &bytes) == ZOO_BAD_ARGUMENT);
    tree_make(&t, ZOO_WALL_LINEAR);
    CHECK(zoo_workspace_size(NULL, &bytes) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_workspace_size(&t.problem, NULL) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_solve(&t.problem, NULL, NULL, 0, p, q, A, NULL, &report) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_solve(&t.problem, &t.parameters, NULL, 0, p, q, A, NULL, NULL) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_solve(&t.problem, &t.parameters, NULL, 0, p, q, A, NULL, &report) == ZOO_WORKSPACE);
    tree_make(&t, ZOO_WALL_TANGENT);
    t.parameters.shape = NULL;
    CHECK(zoo_solve(&t.problem, &t.parameters, NULL, 0, p, q, A, NULL, &report) == ZOO_BAD_ARGUMENT);
    CHECK(strcmp(zoo_inlet_name(ZOO_INLET_FLOW), "flow") == 0 && zoo_inlet_name(ZOO_N_INLETS) == NULL);
    CHECK(strcmp(zoo_outlet_name(ZOO_OUTLET_CIRCUIT), "circuit") == 0 && zoo_outlet_name(-1) == NULL);
    for (int i = 0; i <= ZOO_INLET_AREA; i++)
        CHECK(strcmp(zoo_status_text(i), "unknown status") != 0);
    CHECK(strcmp(zoo_status_text(99), "unknown status") == 0);
}

/* The largest speeds are those that set the time step, which is never longer than the given one. */
static void speeds(void)
{
    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.numerics.least_steps = 3000; /* in units of 32: what is chosen below is fewer */
    int64_t bytes = 0;
    double fastest[NV], worst = 0.0;
    CHECK(zoo_workspace_size(&t.problem, &bytes) == ZOO_OK);
    char *memory = malloc((size_t)bytes);
    CHECK(zoo_solve(&t.problem, &t.parameters, memory, bytes, p, q, A, fastest, &report) == ZOO_OK);
    free(memory);
    CHECK(report.status == ZOO_OK && report.steps_per_beat == 3000);
    for (int k = 0; k < NV; k++)
        worst = fmax(worst, fastest[k] * tree_cells[k] / tree_length[k] * 0.11 / 3000);
    NEAR(worst, report.max_cfl, 1e-12);
    t.problem.numerics.least_steps = 32;
    CHECK(run() == ZOO_OK && report.steps_per_beat < 3000);
}

int main(void)
{
    for (int wall = 0; wall < N_WALLS_IN_TESTS; wall++) {
        tree_make(&t, wall);
        CHECK(run() == ZOO_OK);
    }
    statuses();
    speeds();
    return finish("solve");
}
