/* The entry point: batches, statuses, and memory that belongs to the caller. */
#include "check.h"

static tree t;
enum { SETS = 37 };
static double p[SETS * NSERIES * NTIMES], q[SETS * NSERIES * NTIMES], A[SETS * NSERIES * NTIMES];
static double p1[NSERIES * NTIMES], q1[NSERIES * NTIMES], A1[NSERIES * NTIMES];
static zoo_report reports[SETS];

static int32_t run(int64_t n, zoo_parameters pa, double *P, double *Q, double *S, zoo_report *r)
{
    int64_t bytes = 0;
    int32_t code = zoo_workspace_size(&t.problem, n, &bytes);
    if (code != ZOO_OK)
        return code;
    char *memory = malloc((size_t)bytes); /* exactly: the sanitizer sees a byte too many */
    memset(memory, 0xff, (size_t)bytes);
    CHECK(zoo_solve(&t.problem, n, &pa, memory, bytes - 1, P, Q, S, NULL, r) == ZOO_WORKSPACE);
    code = zoo_solve(&t.problem, n, &pa, memory, bytes, P, Q, S, NULL, r);
    free(memory);
    return code;
}

static void batch(int wall)
{
    tree_make(&t, wall);
    t.problem.numerics.steps_per_beat = 2048;
    t.problem.numerics.tolerance = 1e-3;
    t.psi2[3 * NV + 7] = -1.0;  /* one set out of range, */
    t.stiffness[20 * NV] = NAN; /* another one */
    CHECK(run(SETS, t.parameters, p, q, A, reports) == ZOO_OK);
    for (int i = 0; i < SETS; i++) {
        int bad = i == 3 || i == 20;
        CHECK(reports[i].status == (bad ? ZOO_BAD_ARGUMENT : ZOO_OK));
        CHECK(reports[i].vessel == (i == 3 ? 7 : i == 20 ? 0 : -1));
        CHECK(isnan(p[i * NSERIES * NTIMES]) == bad);
        if (bad || i % 6)
            continue;
        CHECK(run(1, tree_from(&t, i), p1, q1, A1, reports) == ZOO_OK);
        for (int m = 0; m < NSERIES * NTIMES; m++) {
            NEAR(p[i * NSERIES * NTIMES + m], p1[m], 2e-3);
            NEAR(q[i * NSERIES * NTIMES + m], q1[m], 1e-7);
        }
    }
}

/* Each failure has its own status; the good sets beside it are solved all the same. */
static void statuses(void)
{
    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.numerics.max_beats = 1;
    CHECK(run(1, tree_from(&t, 0), p, q, A, reports) == ZOO_OK && reports[0].status == ZOO_NOT_PERIODIC);

    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.numerics.steps_per_beat = 300;
    CHECK(run(1, tree_from(&t, 0), p, q, A, reports) == ZOO_OK && reports[0].status == ZOO_CFL);
    CHECK(reports[0].steps_per_beat == 300 && reports[0].max_cfl > 0.5 && isnan(p[0]));

    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.numerics.max_steps = 512;
    CHECK(run(1, tree_from(&t, 0), p, q, A, reports) == ZOO_OK && reports[0].status == ZOO_CFL);

    /* a backflow larger than the vessels hold empties them */
    tree_make(&t, ZOO_WALL_LINEAR);
    for (int i = 0; i < NSAMPLES; i++)
        t.flow[i] = 0.02 + 0.9 * sin(2.0 * ZOO_PI * i / NSAMPLES);
    for (int k = 0; k < NV; k++)
        t.stiffness[2 * NV + k] = 3e6; /* set 2 is stiff enough to stand it */
    t.problem.numerics.max_steps = 32768;
    CHECK(run(3, t.parameters, p, q, A, reports) == ZOO_OK);
    CHECK(reports[0].status == ZOO_COLLAPSE || reports[0].status == ZOO_NO_ROOT);
    CHECK(reports[0].vessel >= 0 && reports[0].time > 0.0);
    CHECK(reports[2].status == ZOO_OK && !isnan(p[2 * NSERIES * NTIMES]));

    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.fluid.density = -1.0;
    int64_t bytes;
    CHECK(zoo_workspace_size(&t.problem, 1, &bytes) == ZOO_BAD_ARGUMENT);
    tree_make(&t, ZOO_WALL_LINEAR);
    CHECK(zoo_workspace_size(&t.problem, 0, &bytes) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_workspace_size(NULL, 1, &bytes) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_workspace_size(&t.problem, 1, NULL) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_solve(&t.problem, 1, NULL, NULL, 0, p, q, A, NULL, reports) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_solve(&t.problem, 1, &t.parameters, NULL, 0, p, q, A, NULL, NULL) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_solve(&t.problem, 1, &t.parameters, NULL, 0, p, q, A, NULL, reports) == ZOO_WORKSPACE);
    tree_make(&t, ZOO_WALL_TANGENT);
    t.parameters.shape = NULL;
    CHECK(zoo_solve(&t.problem, 1, &t.parameters, NULL, 0, p, q, A, NULL, reports) == ZOO_BAD_ARGUMENT);
    CHECK(strcmp(zoo_inlet_name(ZOO_INLET_FLOW), "flow") == 0 && zoo_inlet_name(ZOO_N_INLETS) == NULL);
    CHECK(strcmp(zoo_outlet_name(ZOO_OUTLET_CIRCUIT), "circuit") == 0 && zoo_outlet_name(-1) == NULL);
    for (int i = 0; i <= ZOO_WORKSPACE; i++)
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
    CHECK(zoo_workspace_size(&t.problem, 1, &bytes) == ZOO_OK);
    char *memory = malloc((size_t)bytes);
    CHECK(zoo_solve(&t.problem, 1, &t.parameters, memory, bytes, p, q, A, fastest, reports) == ZOO_OK);
    free(memory);
    CHECK(reports[0].status == ZOO_OK && reports[0].steps_per_beat == 3000);
    for (int k = 0; k < NV; k++)
        worst = fmax(worst, fastest[k] * tree_cells[k] / tree_length[k] * 0.11 / 3000);
    NEAR(worst, reports[0].max_cfl, 1e-12);
    t.problem.numerics.least_steps = 32;
    CHECK(run(1, t.parameters, p, q, A, reports) == ZOO_OK && reports[0].steps_per_beat < 3000);
}

int main(void)
{
    for (int wall = 0; wall < N_WALLS_IN_TESTS; wall++)
        batch(wall);
    statuses();
    speeds();
    return finish("solve");
}
