/* Derivatives of the periodic solution against differences of solves at the same steps, for every kind of input, wall,
 * outlet, junction and inlet. */
#include "check.h"

enum { SAMPLES = NSERIES * NTIMES, STEPS = 4096 };
/* One set of arguments that may be changed in place. */
typedef struct {
    tree t;
    additions x;
    double length[NV], in[NV], out[NV], R1[NV], R2[NV], C[NV], behind[NV], ratio[NV], exponent[NV];
} arguments;

static void make(arguments *a, int wall, int added, int coupled, int windkessel, int inlet)
{
    tree_make(&a->t, wall);
    zoo_problem *p = &a->t.problem;
    p->inlet.kind = inlet;
    if (inlet == ZOO_INLET_PRESSURE)
        tree_pressure(a->t.flow);
    memcpy(a->length, tree_length, sizeof tree_length);
    memcpy(a->in, tree_in, sizeof tree_in);
    memcpy(a->out, tree_out, sizeof tree_out);
    memcpy(a->R1, tree_R1, sizeof tree_R1);
    memcpy(a->R2, tree_R2, sizeof tree_R2);
    memcpy(a->C, tree_C, sizeof tree_C);
    p->fluid.viscous_friction = 2.0;
    p->network.length = a->length;
    p->network.radius_in = a->in;
    p->network.radius_out = a->out;
    p->outlet.R1 = a->R1;
    p->outlet.R2 = a->R2;
    p->outlet.C = a->C;
    if (added) {
        tree_add(&a->t, &a->x);
        p->fluid.friction_function = (zoo_function){0}; /* has kinks at its ends, where differences are of no use */
        a->x.length[3] = 0.73 * tree_length[3]; /* whose ends are no nodes or midpoints: there its slope has a kink */
        for (int k = 0; k < NV; k++) {
            a->behind[k] = 300.0 * k;
            a->ratio[k] = 1.0 + 0.02 * k;
            a->exponent[k] = 1.0;
        }
        p->outlet.pressure = a->behind;
        p->wall.stiffness_ratio = a->ratio;
        p->wall.stiffness_exponent = a->exponent;
        if (!coupled)
            p->junction.total_pressure = p->junction.loss = 0.0;
        if (windkessel)
            p->outlet.kind = ZOO_OUTLET_WINDKESSEL;
    }
    p->numerics = (zoo_numerics){.cfl = 0.9, .steps_per_beat = STEPS, .max_steps = 8192, .max_beats = 400, .tolerance = 1e-8, .accelerate = 1};
}

/* Changes argument number `which` of one kind by the share `by`; 0 past the last.  *plain: it exists without additions. */
static const char *change(arguments *a, int which, double by, int *plain)
{
    zoo_problem *p = &a->t.problem;
    double f = 1.0 + by;
    *plain = which < 15;
    switch (which) {
    case 0: a->t.stiffness[1] *= f; return "stiffness of a vessel";
    case 1: for (int k = 0; k < NV; k++) a->t.stiffness[k] *= f; return "stiffness";
    case 2: for (int k = 0; k < NV; k++) a->t.psi1[k] *= f; return "psi1";
    case 3: a->t.psi2[6] *= f; return "psi2";
    case 4: for (int k = 0; k < NV; k++) a->t.c[k] *= f; return "c";
    case 5: for (int k = 0; k < NV; k++) a->t.shape[k] *= f; return "shape";
    case 6: for (int i = 0; i < NSAMPLES; i++) a->t.flow[i] *= 1.0 + by * cos(0.05 * i); return "curve of the inlet";
    case 7: a->length[2] *= f; return "length";
    case 8: a->in[1] *= f; return "radius";
    case 9: a->R1[5] *= f; a->C[6] *= f; return "loads";
    case 10: p->fluid.density *= f; return "density";
    case 11: p->fluid.viscosity *= f; return "viscosity";
    case 12: p->fluid.momentum_correction *= f; return "momentum correction";
    case 13: p->fluid.stokes_friction *= f; return "friction";
    case 14: p->fluid.viscous_friction += by; return "viscous friction";
    case 15: a->x.viscosity[3] *= f; return "viscosity of a vessel";
    case 16: a->x.leak[1] *= f; return "leak";
    case 17: a->x.offset_in[2] += 1e3 * by; return "offset";
    case 18: a->x.memory[2] *= f; return "memory";
    case 19: p->wall.relaxation_time *= f; return "relaxation";
    case 20: a->x.wave[2] *= f; return "wave";
    case 21: a->x.severity[3] *= f; return "throat";
    case 22: a->x.position[3] *= f; return "place of the throat";
    case 23: a->x.length[3] *= f; return "length of the throat";
    case 24: p->throat.loss *= f; return "loss of the throat";
    case 25: a->behind[5] += 1e3 * by; return "pressure behind an outlet";
    case 26: a->ratio[1] *= f; return "stiffness ratio";
    case 27: a->exponent[4] *= f; return "stiffness exponent";
    case 28: a->x.inertance[7] *= f; return "inertance";
    case 29: a->x.rho[3 * 5 + 1] *= f; return "section resistance";
    case 30: a->x.kappa[3 * 5] *= f; return "section compliance";
    case 31: p->junction.total_pressure *= f; return "total pressure";
    case 32: p->junction.loss *= f; return "junction loss";
    case 33: a->x.larger[1] += by; return "an outlet's resistance at a pressure";
    case 34: a->x.cosine[2 * 7 + 1] *= f; return "a mode's cosine";
    case 35: a->x.sine[2 * 5 + 1] += 1e6 * by; return "a mode's sine";
    case 36: a->x.turns[1] *= f; return "a mode's frequency";
    case 37: p->outlet.mode_rate *= f; return "the modes' rate";
    case 38: a->x.softer[2] += by; return "an outlet's compliance at a pressure";
    default: return NULL;
    }
}

/* NaN when one is. */
static double larger(double x, double y)
{
    return isnan(x) || x > y ? x : y;
}

static arguments given, shifted;
static double wave[4][3][SAMPLES];

static void solve(arguments *a, double to[3][SAMPLES])
{
    int64_t bytes;
    zoo_report report;
    CHECK(zoo_workspace_size(&a->t.problem, &bytes) == ZOO_OK);
    char *memory = malloc((size_t)bytes);
    CHECK(zoo_solve(&a->t.problem, &a->t.parameters, memory, bytes, to[0], to[1], to[2], NULL, &report) == ZOO_OK);
    CHECK(report.status == ZOO_OK);
    free(memory);
}

/* With the caller's memory or without, too little of it, and with the solve's last beat or after it. */
static void rooms(void)
{
    static double found[4][3][SAMPLES];
    zoo_report report;
    zoo_tangent_report tangent;
    int plain;
    const double h = 1e-5, weight[2] = {0.5 / h, -0.5 / h};
    make(&given, ZOO_WALL_LINEAR, 0, 0, 1, ZOO_INLET_FLOW);
    static arguments near[2];
    for (int m = 0; m < 2; m++) {
        make(&near[m], ZOO_WALL_LINEAR, 0, 0, 1, ZOO_INLET_FLOW);
        change(&near[m], 0, m ? -h : h, &plain);
    }
    const zoo_parameters *parameters[2] = {&near[0].t.parameters, &near[1].t.parameters};
    const zoo_direction direction = {2, NULL, parameters, weight};
    double *room = NULL;
    int64_t bytes = 0;
    for (int i = 0; i < 4; i++) {
        given.t.problem.numerics.accelerate = i < 3;
        const int64_t size = i == 2 ? bytes - 8 : bytes;
        CHECK(zoo_jacobian(&given.t.problem, &given.t.parameters, 1, &direction, 1e-9, room, size, wave[0][0], wave[0][1],
                           wave[0][2], NULL, found[i][0], found[i][1], found[i][2], &report, &tangent) == ZOO_OK);
        CHECK(report.status == ZOO_OK && tangent.status == ZOO_OK && tangent.along == (i < 3));
        if (i == 0) {
            bytes = tangent.room;
            CHECK(bytes > 0 && (room = malloc((size_t)bytes)));
        } else {
            CHECK(i == 3 || tangent.room == bytes);
        }
        CHECK(i == 0 || (room[0] != 12345.0) == (tangent.room <= size)); /* written to only when it is large enough */
        for (int64_t k = 0; room && k < bytes / 8; k++)
            room[k] = 12345.0;
        CHECK(i == 3 || memcmp(found[i], found[0], sizeof found[0]) == 0);
    }
    for (int i = 0; i < SAMPLES; i++)
        NEAR(found[3][0][i], found[0][0][i], 1e-6 * fabs(found[0][0][i]) + 1e-4);
    CHECK(zoo_jacobian(&given.t.problem, &given.t.parameters, 1, &direction, 1e-9, (char *)room + 4, bytes - 8, wave[0][0], wave[0][1],
                       wave[0][2], NULL, found[0][0], found[0][1], found[0][2], &report, &tangent) == ZOO_BAD_ARGUMENT);
    CHECK(zoo_jacobian(&given.t.problem, &given.t.parameters, 1, &direction, 1e-9, NULL, bytes, wave[0][0], wave[0][1],
                       wave[0][2], NULL, found[0][0], found[0][1], found[0][2], &report, &tangent) == ZOO_BAD_ARGUMENT);
    free(room);
}

static void derivative(int wall, int added, int coupled, int windkessel, int inlet)
{
    enum { MOST = 40 };
    static double slope[3][MOST * SAMPLES], own[3][SAMPLES];
    static arguments near[MOST][2];
    const zoo_problem *problems[MOST][2];
    const zoo_parameters *parameters[MOST][2];
    double weights[MOST][2];
    zoo_direction directions[MOST];
    const char *names[MOST];
    int n = 0, which[MOST], plain;
    const double h = 1e-5;
    make(&given, wall, added, coupled, windkessel, inlet);
    for (int i = 0;; i++) {
        arguments *a = &shifted;
        make(a, wall, added, coupled, windkessel, inlet);
        names[n] = change(a, i, 0.0, &plain);
        if (!names[n])
            break;
        if (!added && !plain)
            continue;
        for (int m = 0; m < 2; m++) {
            make(&near[n][m], wall, added, coupled, windkessel, inlet);
            change(&near[n][m], i, m ? -h : h, &plain);
            problems[n][m] = i < 6 ? NULL : &near[n][m].t.problem;
            parameters[n][m] = &near[n][m].t.parameters;
            weights[n][m] = (m ? -0.5 : 0.5) / h;
            if (i == 6 || i == 9) { /* the tree as it was, so that no step need be compared */
                near[n][m].t.problem.network = given.t.problem.network;
                near[n][m].t.problem.wall = given.t.problem.wall;
                near[n][m].t.problem.fluid = given.t.problem.fluid;
                near[n][m].t.problem.throat = given.t.problem.throat;
            }
        }
        directions[n] = (zoo_direction){2, problems[n], parameters[n], weights[n]};
        which[n++] = i;
    }
    zoo_report report;
    zoo_tangent_report tangent;
    CHECK(zoo_jacobian(&given.t.problem, &given.t.parameters, n, directions, 1e-9, NULL, 0, own[0], own[1], own[2], NULL,
                       slope[0], slope[1], slope[2], &report, &tangent) == ZOO_OK);
    CHECK(report.status == ZOO_OK && tangent.status == ZOO_OK);
    if (report.status != ZOO_OK)
        printf("%s\n", zoo_status_text(report.status));
    CHECK(tangent.residual <= 1e-9 && tangent.stepped > 0 && tangent.stepped < 2 * n);
    printf("wall %d added %d coupled %d windkessel %d inlet %d: %d directions, %d beats (%d along), %d vectors, residual %.1e, status %d %d\n", wall, added, coupled,
           windkessel, inlet, n, tangent.beats, tangent.along, tangent.vectors, tangent.residual, tangent.status, tangent.direction);
    for (int d = 0; d < n; d++) {
        const double step = 4e-4, by[4] = {step, -step, 2.0 * step, -2.0 * step};
        for (int m = 0; m < 4; m++) {
            make(&shifted, wall, added, coupled, windkessel, inlet);
            change(&shifted, which[d], by[m], &plain);
            solve(&shifted, wave[m]);
        }
        for (int part = 0; part < 3; part++)
            for (int i = 0; i < NSERIES; i++) {
                double most = 0.0, worst = 0.0;
                for (int k = i * NTIMES; k < (i + 1) * NTIMES; k++) {
                    const double found = (8.0 * (wave[0][part][k] - wave[1][part][k]) - (wave[2][part][k] - wave[3][part][k])) / (12.0 * step);
                    most = fmax(most, fabs(found));
                    worst = larger(worst, fabs(found - slope[part][d * SAMPLES + k]));
                }
                const double allowed = 1e-6 * most + (part == 0 ? 1e-4 : part == 1 ? 1e-8 : 1e-10);
                if (!(worst <= allowed))
                    printf("  %s, part %d, series %d: %g of %g\n", names[d], part, i, worst, most);
                CHECK(worst <= allowed);
            }
    }
}

/* Four of the thirty combinations, which take two minutes; all of them with an argument. A single step is compared for
 * all of them in test_tangent_step.c. */
int main(int argc, char **argv)
{
    (void)argv;
    rooms();
    for (int wall = 0; wall < ZOO_N_WALLS; wall++)
        for (int kind = 0; kind < 5; kind++) {
            const int added = kind > 0, coupled = kind > 2, windkessel = kind == 0 || kind % 2 == 0;
            for (int inlet = 0; inlet < ZOO_N_INLETS; inlet++)
                if (argc > 1 || (wall == ZOO_WALL_LINEAR && kind == 0) || (wall == ZOO_WALL_TANGENT && kind == 3 + inlet))
                    derivative(wall, added, coupled, windkessel, inlet);
        }
    return finish("tangent");
}
