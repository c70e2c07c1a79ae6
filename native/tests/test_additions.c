/* The loops with additions: nothing added, everything added at rest and in motion, and the state. */
#include "check.h"

static int adds(const zoo_problem *pr)
{
    int *children = zoo_count_children(&pr->network), found = zoo_has_additions(pr, children);
    free(children);
    return found;
}

static tree one, other;
static additions x;

/* With all of it zero the loops with additions compute what the plain ones do. */
static void nothing(int wall)
{
    for (int unlike = 0; unlike < 2; unlike++) {
        tree_make(&one, wall);
        tree_make(&other, wall);
        for (int k = 0; k < NV && !unlike; k++) {
            one.stiffness[k] = other.stiffness[k] = 5e4;
            for (int m = 0; m < wall_shapes(wall); m++)
                one.shape[m * NV + k] = other.shape[m * NV + k] = wall_shape_parameter(wall, m).typical;
        }
        other.problem.numerics.additions = 1;
        other.problem.junction.total_pressure = unlike * 1e-100; /* Newton's method at junctions as well */
        tree_open(&one, 1600);
        tree_open(&other, 1600);
        CHECK(!one.sim.extra && other.sim.extra);
        zoo_start(&one.sim);
        zoo_start(&other.sim);
        for (int i = 0; i < 800; i++) {
            CHECK(zoo_step(&one.sim, i) == 0);
            CHECK(zoo_step(&other.sim, i) == 0);
        }
        for (int i = 0; i < one.sim.n_nodes; i++) {
            NEAR(other.sim.P[i], one.sim.P[i], 1e-7);
            NEAR(other.sim.q[i], one.sim.q[i], 1e-12);
        }
        tree_close(&one);
        tree_close(&other);
    }
}

/* Blood at rest with throats and a viscoelastic wall stays at rest: to rounding where a vessel has one
 * offset, to second order where the offset falls along it (then A/A0 is not linear between nodes). */
static void rest(int wall, int falls, int coupled)
{
    tree_make(&one, wall);
    memset(one.flow, 0, sizeof one.flow);
    tree_add(&one, &x);
    if (!falls)
        memcpy(x.offset_out, x.offset_in, sizeof x.offset_in);
    one.problem.fluid.leak = NULL;
    one.problem.wall.n_wave = 0;
    one.problem.outlet.n_modes = 0; /* their pressures fall */
    if (!coupled)
        one.problem.junction = (zoo_junction){.total_pressure = 0.0, .loss = 0.0};
    tree_open(&one, 4096);
    zoo_sim *s = &one.sim;
    for (int j = 0; j < s->n_nodes; j++) {
        double p = 8000.0 - s->offset[j];
        s->A[j] = s->A0[j] * wall_area_ratio(wall, s->K[j], zoo_shape(s, j), p);
        s->q[j] = 0.0;
        s->z[j] = -s->kappa[j] * p;
    }
    for (int t = 0; t < s->outlets.count; t++) {
        double sum = 0.0;
        for (int m = 0; m < 3; m++)
            sum += circuit_R(s, m, t);
        for (int m = 0; m < 3; m++)
            s->outlets.v[m * s->outlets.count + t] = 8000.0 * circuit_R(s, m, t) / sum;
        s->outlets.C[t] = 1e9; /* so large that nothing drains */
        s->outlets.carry[t] = 0.0;
    }
    zoo_set_step(s, 4096);
    zoo_refresh_nodes(s);
    for (int i = 0; i < 200; i++)
        CHECK(zoo_step(s, i) == 0);
    for (int j = 0; j < s->n_nodes; j++) {
        NEAR(s->P[j], 8000.0, falls ? 20.0 : 1e-6);
        NEAR(s->q[j], 0.0, falls ? 3e-5 : 1e-10);
    }
    tree_close(&one);
}

/* Blood: what enters less what leaves and leaks is what stays, to rounding. */
static void balance(int wall, int coupled)
{
    tree_make(&one, wall);
    tree_add(&one, &x);
    if (!coupled)
        one.problem.junction = (zoo_junction){.total_pressure = 0.0, .loss = 0.0};
    tree_open(&one, 4096);
    zoo_sim *s = &one.sim;
    zoo_start(s);
    memset(s->outlets.volume, 0, (size_t)s->outlets.count * sizeof(double));
    double before = tree_volume(s), in = 0.0, out = 0.0, leaked = 0.0;
    for (int i = 0; i < 4096; i++) {
        CHECK(zoo_step(s, i) == 0);
        in += s->dt * s->curve_mean[i];
        for (int j = 0; j < s->n_nodes; j++)
            leaked += s->dt * s->dx[s->vessel_of[j]] * s->leak_mid[j] * s->Ph[j];
        CHECK(zoo_junction_defect(s) < 1e-13);
    }
    for (int t = 0; t < s->outlets.count; t++)
        out += s->outlets.volume[t];
    CHECK(in > 0.01 && out > 0.01 && leaked > 1e-4);
    NEAR(tree_volume(s) - before, in - out - leaked, 1e-13);
    tree_close(&one);
}

/* To the periodic state through the entry point, in memory that is exactly as large as it says. */
static void solve(int wall)
{
    static double p[NSERIES * NTIMES], q[NSERIES * NTIMES], A[NSERIES * NTIMES];
    zoo_report report;
    int64_t bytes = 0;
    tree_make(&one, wall);
    tree_add(&one, &x);
    CHECK(zoo_workspace_size(&one.problem, &bytes) == ZOO_OK);
    char *memory = malloc((size_t)bytes);
    memset(memory, 0xff, (size_t)bytes);
    CHECK(zoo_solve(&one.problem, &one.parameters, memory, bytes, p, q, A, NULL, &report) == ZOO_OK);
    CHECK(report.status == ZOO_OK && !isnan(p[0]));
    free(memory);
}

/* The state packed and unpacked is the state, and another state in between leaves nothing behind. */
static void packing(void)
{
    tree_make(&one, ZOO_WALL_TANGENT);
    tree_add(&one, &x);
    tree_open(&one, 4096);
    zoo_sim *s = &one.sim;
    zoo_start(s);
    double *x = malloc((size_t)s->n_state * sizeof *x), *y = malloc((size_t)s->n_state * sizeof *y);
    for (int i = 0; i < 100; i++)
        zoo_step(s, i);
    zoo_pack(s, x);
    zoo_refresh_nodes(s); /* a state is that of a beat's start: with the stiffness of that time */
    for (int i = 0; i < 50; i++)
        zoo_step(s, i);
    double P = s->P[20], q = s->q[40];
    zoo_start(s);
    zoo_unpack(s, x);
    zoo_pack(s, y);
    CHECK(memcmp(x, y, (size_t)s->n_state * sizeof *x) == 0);
    for (int i = 0; i < 50; i++)
        zoo_step(s, i);
    NEAR(s->P[20], P, 1e-6);
    NEAR(s->q[40], q, 1e-10);
    free(x);
    free(y);
    tree_close(&one);
}

/* What changes the grid only, or nothing, needs no other loops. */
static void no_further_loops(void)
{
    static const double zero[NV], single[NV] = {1, 1, 1, 1, 1, 1, 1, 1}, half[NV] = {0.5};
    double severity[NV] = {0.0};
    tree_make(&one, ZOO_WALL_LINEAR);
    zoo_problem *pr = &one.problem;
    pr->fluid.viscous_friction = 8.0;
    pr->fluid.viscosity_factor = single;
    pr->fluid.leak = pr->wall.offset_in = pr->wall.offset_out = pr->wall.viscoelastic_time = zero;
    pr->wall.relaxation_time = 3e-4;
    pr->wall.n_wave = 2;
    pr->wall.stiffness_wave = single;
    pr->throat = (zoo_throat){severity, half, single, 1.52};
    pr->outlet.kind = ZOO_OUTLET_CIRCUIT;
    pr->outlet.inertance = zero;
    pr->outlet.n_sections = 1;
    pr->outlet.section_resistance = pr->outlet.section_compliance = single;
    CHECK(zoo_check_problem(pr) == 0 && adds(pr) == 0);
    severity[0] = 0.3;
    CHECK(adds(pr) == 1);
    pr->throat.loss = 0.0;
    CHECK(adds(pr) == 0);
    pr->outlet.section_compliance = half;
    CHECK(adds(pr) == 1);
    pr->outlet.kind = ZOO_OUTLET_WINDKESSEL; /* which does not read them */
    CHECK(adds(pr) == 0);
}

int main(void)
{
    for (int wall = 0; wall < N_WALLS_IN_TESTS; wall++) {
        if (wall < ZOO_N_WALLS) /* a law with a function has no plain loops */
            nothing(wall);
        for (int i = 0; i < 4; i++)
            rest(wall, i & 1, i >> 1);
        balance(wall, 0);
        balance(wall, 1);
        solve(wall);
    }
    packing();
    no_further_loops();
    return finish("additions");
}
