/* The inlet where the pressure is given: against the one where the flow is given, and what it does in a step. */
#include "check.h"

enum { STEPS = 4096, PER = STEPS / NSAMPLES, AT_INLET = 0 };
static tree t;
static additions x;
static double wave[3][NSERIES * NTIMES], back[3][NSERIES * NTIMES];
static double pressure[STEPS];

static zoo_report solve(double to[3][NSERIES * NTIMES])
{
    int64_t bytes;
    zoo_report report;
    CHECK(zoo_workspace_size(&t.problem, &bytes) == ZOO_OK);
    char *memory = malloc((size_t)bytes);
    CHECK(zoo_solve(&t.problem, &t.parameters, memory, bytes, to[0], to[1], to[2], NULL, &report) == ZOO_OK);
    free(memory);
    return report;
}

static void given(int wall, int added)
{
    tree_make(&t, wall);
    if (added)
        tree_add(&t, &x);
    t.problem.numerics.steps_per_beat = STEPS;
    t.problem.numerics.max_beats = 500;
    t.problem.numerics.tolerance = 1e-4;
}

/* Largest distance of two series over the largest value. */
static double apart(const double *a, const double *b, int series)
{
    double most = 0.0, worst = 0.0;
    for (int i = series * NTIMES; i < (series + 1) * NTIMES; i++) {
        most = fmax(most, fabs(a[i]));
        worst = fabs(a[i] - b[i]) > worst || isnan(b[i]) ? fabs(a[i] - b[i]) : worst;
    }
    return worst / most;
}

/* A beat with the flow given has, at the root, a pressure; with this given the flow comes back. */
static void round_trip(int wall, int added)
{
    int32_t vessel[NSERIES];
    double position[NSERIES];
    memcpy(vessel, tree_vessel, sizeof vessel);
    memcpy(position, tree_position, sizeof position);
    vessel[AT_INLET] = 0, position[AT_INLET] = 0.0;
    given(wall, added);
    t.problem.outputs.vessel = vessel;
    t.problem.outputs.position = position;
    CHECK(solve(wave).status == ZOO_OK);
    zoo_outputs outputs = t.problem.outputs;
    double times[STEPS];
    static double at_root[3][STEPS];
    for (int i = 0; i < STEPS; i++)
        times[i] = 0.11 * i / STEPS;
    t.problem.outputs = (zoo_outputs){1, vessel, position, STEPS, times};
    int64_t bytes;
    zoo_report report;
    CHECK(zoo_workspace_size(&t.problem, &bytes) == ZOO_OK);
    char *memory = malloc((size_t)bytes);
    CHECK(zoo_solve(&t.problem, &t.parameters, memory, bytes, at_root[0], at_root[1], at_root[2], NULL, &report) == ZOO_OK);
    free(memory);
    memcpy(pressure, at_root[0], sizeof pressure);
    const double entered = report.inflow;
    t.problem.outputs = outputs;
    t.problem.inlet = (zoo_inlet){ZOO_INLET_PRESSURE, 0.11, STEPS, pressure};
    report = solve(back);
    CHECK(report.status == ZOO_OK && report.junction_defect < 1e-9);
    printf("wall %d added %d: pressure %.1e, flow %.1e, area %.1e, entered %.1e after %d beats\n", wall, added,
           apart(wave[0], back[0], AT_INLET), apart(wave[1], back[1], AT_INLET), apart(wave[2], back[2], AT_INLET),
           report.inflow / entered - 1.0, report.beats);
    CHECK(apart(wave[0], back[0], AT_INLET) < 1e-6);
    for (int series = 0; series < NSERIES; series++)
        for (int part = 0; part < 3; part++)
            CHECK(apart(wave[part], back[part], series) < 1e-3);
    NEAR(report.inflow, entered, 1e-4 * entered);
}

static double volume(const zoo_sim *s)
{
    double sum = 0.0;
    for (int k = 0; k < s->n_vessels; k++)
        for (int j = s->first[k]; j <= s->last[k]; j++)
            sum += (j == s->first[k] || j == s->last[k] ? 0.5 : 1.0) * s->dx[k] * s->A[j];
    return sum;
}

/* The root's inlet has the given pressure at every step, and what enters less what leaves is what the tree holds more. */
static void steps(int wall, int added)
{
    given(wall, added);
    if (added)
        t.problem.fluid.leak = NULL;
    tree_pressure(pressure);
    t.problem.inlet = (zoo_inlet){ZOO_INLET_PRESSURE, 0.11, NSAMPLES, pressure};
    tree_open(&t, STEPS);
    zoo_sim *s = &t.sim;
    zoo_start(s);
    s->entered = 0.0;
    memset(s->outlets.volume, 0, (size_t)s->outlets.count * sizeof(double));
    const double before = volume(s);
    double left = 0.0;
    for (int step = 0; step < STEPS / 4; step++) {
        CHECK(!zoo_step(s, step));
        const double part = (double)(step + 1) / PER, between = part - floor(part);
        const int i = (int)part;
        const double p = (1.0 - between) * pressure[i] + between * pressure[i + 1];
        NEAR(s->P[0], p, 1e-8 * p);
    }
    for (int i = 0; i < s->outlets.count; i++)
        left += s->outlets.volume[i];
    CHECK(s->entered > 1e-3);
    NEAR(volume(s) - before, s->entered - left, 1e-11);
    tree_close(&t);
}

/* Steady pressure: what enters leaves, and the pressure falls by the resistances of friction and loads. */
static void steady(void)
{
    static const int32_t parent[1] = {-1}, cells[1] = {40}, vessel[2] = {0, 0};
    static const double length[1] = {4.0}, r[1] = {0.05}, R1[1] = {2e4}, R2[1] = {8e4}, C[1] = {1e-6}, position[2] = {0.0, 1.0};
    given(ZOO_WALL_LINEAR, 0);
    t.problem.network = (zoo_network){1, parent, cells, length, r, r};
    t.problem.fluid.stokes_friction = 0.0;
    t.problem.fluid.viscous_friction = 8.0;
    t.problem.fluid.momentum_correction = 0.0;
    t.problem.outlet = (zoo_outlet){.kind = ZOO_OUTLET_WINDKESSEL, .R1 = R1, .R2 = R2, .C = C};
    t.problem.outputs = (zoo_outputs){2, vessel, position, NTIMES, t.times};
    t.problem.numerics.tolerance = 1e-3;
    t.stiffness[0] = 1e9; /* as good as rigid: Poiseuille's law by the radius at rest */
    t.problem.numerics.steps_per_beat = 65536;
    t.problem.numerics.max_steps = 65536;
    for (int i = 0; i < 16; i++)
        pressure[i] = 13000.0;
    t.problem.inlet = (zoo_inlet){ZOO_INLET_PRESSURE, 0.11, 16, pressure};
    const zoo_report report = solve(wave);
    CHECK(report.status == ZOO_OK);
    const double poiseuille = 8.0 * 0.049 * 4.0 / (ZOO_PI * pow(0.05, 4));
    const double expected = 13000.0 / (poiseuille + 0.8 * 2e4 + 8e4);
    for (int i = 0; i < NTIMES; i++) {
        NEAR(wave[1][i], expected, 1e-4 * expected);
        NEAR(wave[0][NTIMES + i], 13000.0 - expected * poiseuille, 1e-4 * 13000.0);
    }
    NEAR(report.inflow, 0.11 * expected, 1e-4 * 0.11 * expected);
}

static void refused(void)
{
    given(ZOO_WALL_LINEAR, 0);
    for (int i = 0; i < 16; i++)
        pressure[i] = i < 8 ? 12000.0 : -1e6; /* below -K, where the linear wall has no area */
    t.problem.inlet = (zoo_inlet){ZOO_INLET_PRESSURE, 0.11, 16, pressure};
    zoo_report report = solve(wave);
    CHECK(report.status == ZOO_INLET_AREA && report.vessel == 0 && report.time > 0.04 && report.time < 0.06);
    CHECK(isnan(wave[0][0]) && strcmp(zoo_status_text(ZOO_INLET_AREA), "unknown status") != 0);
    pressure[8] = 12000.0;
    int64_t bytes;
    for (int i = 0; i < 3; i++) {
        pressure[3] = (double[]){NAN, INFINITY, 1e31}[i];
        CHECK(zoo_workspace_size(&t.problem, &bytes) == ZOO_BAD_ARGUMENT);
    }
    /* Olufsen's wall bears no more than K: on the way there blood outruns its waves */
    given(ZOO_WALL_OLUFSEN, 0);
    for (int i = 0; i < 16; i++)
        pressure[i] = i < 8 ? 12000.0 : 1e5;
    t.problem.inlet = (zoo_inlet){ZOO_INLET_PRESSURE, 0.11, 16, pressure};
    report = solve(wave);
    CHECK(report.status == ZOO_CFL && report.vessel == 0);
    CHECK(strcmp(zoo_inlet_name(ZOO_INLET_PRESSURE), "pressure") == 0);
}

int main(void)
{
    for (int wall = 0; wall < 2 * ZOO_N_WALLS; wall++)
        for (int added = 0; added < 2; added++)
            steps(wall, added);
    for (int wall = 0; wall < ZOO_N_WALLS; wall++)
        for (int added = 0; added < 2; added++)
            round_trip(wall, added);
    steady();
    refused();
    return finish("inlet");
}
