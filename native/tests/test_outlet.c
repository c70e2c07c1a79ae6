/* The outlets: what their state and their end have to do with each other, after many steps. */
#include "check.h"

static tree one, two;
static additions x;

static const double behind_outlets[NV] = {0, 0, 0, 0, 2e3, 3e3, -1e3, 0};
static const double some_R2[NV] = {0, 0, 0, 0, 8e5, 0, 4e5, 0}; /* two single resistances */

/* The state of the terminal vessels' ends: p = p_out + R1 q + sum_k v_k without an inertance. */
static void relation(int wall, int circuit, int pressure)
{
    tree_make(&one, wall);
    if (pressure) {
        one.problem.outlet.pressure = behind_outlets;
        one.problem.outlet.R2 = some_R2;
    }
    if (circuit) {
        tree_add(&one, &x);
        one.problem.outlet.inertance = NULL;
    }
    tree_open(&one, 4096);
    zoo_sim *s = &one.sim;
    circuit |= wall_has_function(wall); /* functions have the loops with additions alone */
    CHECK(s->outlets.kind == (circuit ? ZOO_OUTLET_CIRCUIT : ZOO_OUTLET_WINDKESSEL));
    zoo_start(s);
    for (int i = 0; i < 3000; i++)
        CHECK(zoo_step(s, i) == 0);
    for (int t = 0; t < s->outlets.count; t++) {
        int o = s->outlets.node[t];
        double behind = circuit && pressure ? behind_outlets[s->outlets.vessel[t]] : 0.0; /* else it is part of v */
        const int sections = circuit ? circuit_sections(&one.problem) : 1;
        for (int m = 0; m < s->outlets.rows.pressures; m += m < sections ? 1 : 2) /* of a mode the real part */
            behind += outlet_row(s, s->outlets.v, m)[t];
        if (circuit && pressure && s->outlets.R2[t] == 0.0 && one.problem.outlet.n_wave > 0)
            behind += s->outlets.wave_then[t]; /* that of the others is in v */
        NEAR(s->P[o], behind + s->outlets.R1[t] * s->q[o], 1e-6);
    }
    tree_close(&one);
}

/* A circuit of one section of (1, 1), of two equal ones of half, and one with a tiny inertance are the Windkessel. */
static void special_cases(int wall)
{
    static const double whole[NV] = {1, 1, 1, 1, 1, 1, 1, 1}, tiny[NV] = {0, 0, 0, 0, 1e-9, 1e-9, 1e-9, 1e-9};
    double half[2 * NV], doubled[2 * NV];
    for (int i = 0; i < 2 * NV; i++)
        half[i] = 0.5, doubled[i] = 2.0;
    tree_make(&one, wall);
    tree_open(&one, 4096);
    zoo_start(&one.sim);
    for (int i = 0; i < 1000; i++)
        zoo_step(&one.sim, i);
    for (int which = 0; which < 3; which++) {
        tree_make(&two, wall);
        zoo_outlet *out = &two.problem.outlet;
        out->kind = ZOO_OUTLET_CIRCUIT;
        out->n_sections = which == 1 ? 2 : 1;
        out->section_resistance = which == 1 ? half : whole; /* R/2 and 2 C in series: R and C */
        out->section_compliance = which == 1 ? doubled : whole;
        out->inertance = which == 2 ? tiny : NULL;
        two.problem.numerics.additions = 1;
        tree_open(&two, 4096);
        CHECK(two.sim.outlets.kind == ZOO_OUTLET_CIRCUIT);
        for (int t = 0; t < one.sim.outlets.count; t++) {
            NEAR(outlet_resistance(&two.sim, t), outlet_resistance(&one.sim, t), 1e-6);
            NEAR(outlet_capacity(&two.sim, t), outlet_capacity(&one.sim, t), 1e-20);
        }
        zoo_start(&two.sim);
        for (int i = 0; i < 1000; i++)
            zoo_step(&two.sim, i);
        for (int j = 0; j < one.sim.n_nodes; j++) {
            NEAR(two.sim.P[j], one.sim.P[j], which == 2 ? 1.0 : 1e-6);
            NEAR(two.sim.q[j], one.sim.q[j], which == 2 ? 1e-5 : 1e-11);
        }
        tree_close(&two);
    }
    tree_close(&one);
}

/* An outside pressure p0 of all vessels is the same as -p0 behind all outlets, with p0 more everywhere; and the
 * circuit's loops agree with the Windkessel's. */
static void shifted(int wall)
{
    enum { P0 = 4000, SIZE = NSERIES * NTIMES };
    static double offset[NV], less[NV], wave[3][3][SIZE];
    for (int k = 0; k < NV; k++) {
        offset[k] = P0;
        less[k] = behind_outlets[k] - P0;
    }
    for (int which = 0; which < 3; which++) { /* 0: outside; 1: behind, in the plain loops; 2: in the others */
        tree_make(&one, wall);
        one.problem.numerics.tolerance = 1e-3;
        one.problem.numerics.steps_per_beat = 4096;
        one.problem.numerics.additions = which == 2;
        one.problem.outlet.R2 = some_R2;
        one.problem.outlet.pressure = which ? less : behind_outlets;
        if (which == 0)
            one.problem.wall.offset_in = one.problem.wall.offset_out = offset;
        int64_t bytes;
        CHECK(zoo_workspace_size(&one.problem, &bytes) == ZOO_OK);
        void *work = malloc((size_t)bytes);
        zoo_report report;
        CHECK(zoo_solve(&one.problem, &one.parameters, work, bytes, wave[which][0], wave[which][1], wave[which][2],
                        NULL, &report) == ZOO_OK);
        CHECK(report.status == ZOO_OK);
        free(work);
    }
    for (int which = 1; which < 3; which++)
        for (int i = 0; i < SIZE; i++) {
            NEAR(wave[which][0][i] + P0, wave[0][0][i], 0.01);
            NEAR(wave[which][1][i], wave[0][1][i], 1e-6);
            NEAR(wave[which][2][i], wave[0][2][i], 1e-8);
        }
}

/* What is added behind the outlets is a pressure behind them where it does not change: with single resistances, and with
 * resistances and compliances that depend on the pressure. */
static void waves(int wall, int functions)
{
    enum { SIZE = NSERIES * NTIMES };
    static double all[NV], wave[2][3][SIZE], veins[4 * NV];
    for (int k = 0; k < NV; k++) {
        all[k] = behind_outlets[k] + 700.0 * k;
        for (int i = 0; i < 4; i++)
            veins[4 * k + i] = 700.0 * k;
    }
    for (int which = 0; which < 2; which++) {
        tree_make(&one, wall);
        tree_add(&one, &x);
        one.problem.numerics.tolerance = 1e-3;
        one.problem.numerics.steps_per_beat = 4096;
        one.problem.outlet.n_modes = 0; /* whose steady part is not seen behind single resistances */
        if (!functions)
            one.problem.outlet.resistance_function = one.problem.outlet.compliance_function = (zoo_function){0};
        one.problem.outlet.R2 = some_R2;
        one.problem.outlet.pressure = which ? behind_outlets : all;
        one.problem.outlet.n_wave = which ? 4 : 0;
        one.problem.outlet.wave = veins;
        int64_t bytes;
        CHECK(zoo_workspace_size(&one.problem, &bytes) == ZOO_OK);
        void *work = malloc((size_t)bytes);
        zoo_report report;
        CHECK(zoo_solve(&one.problem, &one.parameters, work, bytes, wave[which][0], wave[which][1], wave[which][2],
                        NULL, &report) == ZOO_OK);
        CHECK(report.status == ZOO_OK);
        free(work);
    }
    for (int i = 0; i < SIZE; i++) {
        NEAR(wave[1][0][i], wave[0][0][i], 0.01);
        NEAR(wave[1][1][i], wave[0][1][i], 1e-6);
    }
}

/* Modes whose steady part outweighs all else are refused: no pressure would drive a flow. */
static void refused(void)
{
    tree_make(&one, 0);
    tree_add(&one, &x);
    tree_open(&one, 4096);
    const double least = -(tree_R1[7] + (x.rho[21] + x.rho[22] + x.rho[23]) * tree_R2[7] * one.psi2[7] / one.psi1[7]);
    x.sine[14] = x.sine[15] = x.cosine[15] = 0.0;
    for (int more = -1; more < 2; more += 2) {
        x.cosine[14] = 20.0 * least * (1.0 + 1e-6 * more); /* over the rate: its steady part */
        CHECK((zoo_set_parameters(&one.sim, &one.parameters) == ZOO_OK) == (more < 0));
        CHECK(more < 0 || one.sim.report.vessel == 7);
    }
    tree_close(&one);
}

int main(void)
{
    for (int wall = 0; wall < N_WALLS_IN_TESTS; wall++) {
        for (int pressure = 0; pressure < 2; pressure++) {
            relation(wall, 0, pressure);
            relation(wall, 1, pressure);
        }
        shifted(wall);
        special_cases(wall);
        waves(wall, 0);
        waves(wall, 1);
    }
    refused();
    return finish("outlet");
}
