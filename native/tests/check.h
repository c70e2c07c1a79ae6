/* A check that counts, and a small problem to try things on. */
#ifndef ZOO_TEST_CHECK_H
#define ZOO_TEST_CHECK_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../src/inlet.h"
#include "../src/outlet.h"

static int checks, failures; /* only the first 20 failures are printed */

#define CHECK(condition)                                                            \
    do {                                                                            \
        checks++;                                                                   \
        if (!(condition)) {                                                         \
            if (failures++ < 20)                                                    \
                fprintf(stderr, "%s:%d: failed: %s\n", __FILE__, __LINE__, #condition); \
        }                                                                           \
    } while (0)

/* |x - y| <= bound, and both numbers */
#define NEAR(x, y, bound)                                                                    \
    do {                                                                                     \
        double x_ = (x), y_ = (y);                                                           \
        checks++;                                                                            \
        if (!(fabs(x_ - y_) <= (bound))) {                                                   \
            if (failures++ < 20)                                                             \
                fprintf(stderr, "%s:%d: %s = %.17g, %s = %.17g\n", __FILE__, __LINE__, #x, x_, #y, y_); \
        }                                                                                    \
    } while (0)

static inline int finish(const char *name)
{
    printf("%s: %d passed, %d failed\n", name, checks - failures, failures);
    return failures != 0;
}

/* One root, a bifurcation, one daughter that goes on into one vessel and one
 * that splits in three: junctions with 2, 3 and 4 branches; 4 terminals. */
enum { NV = 8, NSAMPLES = 256, NTIMES = 50, NSERIES = 3 };
static const int32_t tree_parent[NV] = {-1, 0, 0, 1, 2, 2, 2, 3};
static const int32_t tree_cells[NV] = {16, 12, 8, 5, 2, 7, 9, 3};
static const int32_t tree_single_cells[NV] = {1, 1, 1, 1, 1, 1, 1, 1};
static const double tree_length[NV] = {0.41, 0.3, 0.2, 0.13, 0.06, 0.18, 0.22, 0.08};
static const double tree_in[NV] = {0.047, 0.03, 0.035, 0.028, 0.015, 0.02, 0.022, 0.026};
static const double tree_out[NV] = {0.047, 0.03, 0.030, 0.028, 0.015, 0.018, 0.022, 0.026};
static const double tree_R1[NV] = {0, 0, 0, 0, 2e5, 1.5e5, 1e5, 0.5e5};
static const double tree_R2[NV] = {0, 0, 0, 0, 8e5, 6e5, 4e5, 2e5};
static const double tree_C[NV] = {0, 0, 0, 0, 1.3e-7, 1.8e-7, 2.7e-7, 5e-7};
static const int32_t tree_vessel[NSERIES] = {0, 4, 7};
static const double tree_position[NSERIES] = {0.0, 0.5, 1.0};

/* Of the laws a test runs over: each alone, and with a function added to it. */
enum { N_WALLS_IN_TESTS = 2 * ZOO_N_WALLS, NKNOTS = 7 };

typedef struct {
    zoo_problem problem;
    double knots[NKNOTS];
    double flow[NSAMPLES], times[NTIMES];
    double stiffness[NV], shape[NV * ZOO_MOST_SHAPES], psi1[NV], psi2[NV], c[NV];
    zoo_parameters parameters;
    char *memory;
    zoo_sim sim;
} tree;

static inline void tree_make(tree *t, int wall)
{
    memset(t, 0, sizeof *t);
    for (int i = 0; i < NSAMPLES; i++) {
        double x = (double)i / NSAMPLES;
        t->flow[i] = x < 0.5 ? 0.5 * pow(sin(2.0 * ZOO_PI * x), 2) : 0.0;
    }
    for (int i = 0; i < NTIMES; i++)
        t->times[i] = 0.11 * i / (NTIMES - 1);
    t->problem.network = (zoo_network){NV, tree_parent, tree_cells, tree_length, tree_in, tree_out};
    t->problem.fluid = (zoo_fluid){.density = 1.055,
                                   .viscosity = 0.049,
                                   .momentum_correction = 1.0,
                                   .friction = ZOO_FRICTION_CURRENT,
                                   .friction_radius = 0.07,
                                   .stokes_friction = 1.0};
    t->problem.wall = (zoo_wall){.law = wall_base(wall), .factor = 1.0};
    for (int i = 0; i < NKNOTS; i++)
        t->knots[i] = 0.04 * sin(6.0 * i / (NKNOTS - 1)) - 0.02;
    if (wall_has_function(wall))
        t->problem.wall.function = (zoo_function){NKNOTS, 0.8, 1.6, t->knots};
    t->problem.inlet = (zoo_inlet){ZOO_INLET_FLOW, 0.11, NSAMPLES, t->flow};
    t->problem.outlet = (zoo_outlet){.kind = ZOO_OUTLET_WINDKESSEL, .R1 = tree_R1, .R2 = tree_R2, .C = tree_C};
    t->problem.outputs = (zoo_outputs){NSERIES, tree_vessel, tree_position, NTIMES, t->times};
    t->problem.numerics = (zoo_numerics){
        .cfl = 0.9, .max_steps = 32768, .max_beats = 60, .tolerance = 1.0, .accelerate = 1};
    for (int k = 0; k < NV; k++) {
        t->stiffness[k] = 5e4 * (1.0 + 0.02 * k);
        for (int m = 0; m < wall_shapes(wall); m++)
            t->shape[m * NV + k] = wall_shape_parameter(wall, m).typical * (1.0 + 0.025 * k);
        t->psi1[k] = 0.8;
        t->psi2[k] = 1.0;
        t->c[k] = 1.1;
    }
    t->parameters = (zoo_parameters){t->stiffness, t->shape, t->psi1, t->psi2, t->c};
}

/* At the root's inlet, dyn/cm^2. */
static inline void tree_pressure(double *pressure)
{
    for (int i = 0; i < NSAMPLES; i++) {
        const double turn = 2.0 * ZOO_PI * i / NSAMPLES;
        pressure[i] = 14000.0 + 4000.0 * sin(turn) + 700.0 * cos(5.0 * turn);
    }
}

/* Everything that can be added, different in every vessel. */
typedef struct {
    double viscosity[NV], offset_in[NV], offset_out[NV], memory[NV], leak[NV], inertance[NV];
    double turns[2], cosine[2 * NV], sine[2 * NV];
    double severity[NV], position[NV], length[NV], rho[3 * NV], kappa[3 * NV], wave[5], factor[4], lost[5], larger[4], softer[5], veins[6 * NV];
} additions;

static inline void tree_add(tree *t, additions *x)
{
    for (int k = 0; k < NV; k++) {
        x->viscosity[k] = 1.0 + 0.1 * k;
        x->offset_in[k] = 500.0 * k;
        x->offset_out[k] = 500.0 * k - 300.0;
        x->memory[k] = 3e-4 * (k % 3);
        x->leak[k] = 1e-7 * (k % 2);
        x->inertance[k] = 20.0 * (k % 2);
        x->severity[k] = k % 3 ? 0.0 : 0.2;
        x->position[k] = 0.5;
        x->length[k] = 0.8 * tree_length[k];
        for (int m = 0; m < 3; m++) {
            x->rho[3 * k + m] = m == k % 3 ? 0.0 : 0.3 + 0.2 * m;
            x->kappa[3 * k + m] = 0.2 + 0.4 * m;
        }
        for (int m = 0; m < 2; m++) {
            x->cosine[2 * k + m] = k % 3 ? 2e6 * (m + 1) : 0.0;
            x->sine[2 * k + m] = k % 3 ? 1e6 * (k - 6) : 0.0;
        }
    }
    for (int i = 0; i < 5; i++)
        x->wave[i] = 0.9 + 0.1 * i;
    for (int i = 0; i < 4; i++)
        x->factor[i] = 1.0 + 0.5 * cos(2.0 * i);
    for (int i = 0; i < 4; i++)
        x->larger[i] = 0.3 * sin(2.0 * i);
    for (int i = 0; i < 5; i++)
        x->softer[i] = 0.4 - 0.2 * i;
    for (int i = 0; i < 5; i++)
        x->lost[i] = 40.0 * (i - 1) * (i - 1) + 25.0 * (i - 1); /* none at rest */
    t->problem.fluid.friction_function = (zoo_function){4, 0.0, 40.0, x->factor};
    t->problem.fluid.viscosity_factor = x->viscosity;
    t->problem.fluid.leak = x->leak;
    t->problem.wall.offset_in = x->offset_in;
    t->problem.wall.offset_out = x->offset_out;
    t->problem.wall.viscoelastic_time = x->memory;
    t->problem.wall.relaxation_time = 3e-4;
    t->problem.wall.n_wave = 5;
    t->problem.wall.stiffness_wave = x->wave;
    t->problem.throat = (zoo_throat){x->severity, x->position, x->length, 1.52};
    t->problem.junction = (zoo_junction){1.0, 2.0, {5, -20.0, 60.0, x->lost}};
    t->problem.outlet.kind = ZOO_OUTLET_CIRCUIT;
    t->problem.outlet.inertance = x->inertance;
    t->problem.outlet.n_sections = 3;
    t->problem.outlet.section_resistance = x->rho;
    t->problem.outlet.section_compliance = x->kappa;
    x->turns[0] = 0.0;
    x->turns[1] = 60.0;
    t->problem.outlet.n_modes = 2;
    t->problem.outlet.mode_rate = 20.0;
    t->problem.outlet.mode_frequency = x->turns;
    t->problem.outlet.mode_cosine = x->cosine;
    t->problem.outlet.mode_sine = x->sine;
    for (int i = 0; i < 6 * NV; i++)
        x->veins[i] = 1500.0 * sin(1.0 + i);
    t->problem.outlet.n_wave = 6;
    t->problem.outlet.wave = x->veins;
    t->problem.outlet.resistance_function = (zoo_function){4, 0.0, 3e4, x->larger};
    t->problem.outlet.compliance_function = (zoo_function){5, 0.0, 3e4, x->softer};
}

/* A run set up as zoo_solve does it, for looking inside. */
static inline void tree_open(tree *t, int n_steps)
{
    int64_t bytes = zoo_layout(&t->problem, &t->sim, NULL);
    t->memory = aligned_alloc(64, (size_t)bytes);
    memset(t->memory, 0xff, (size_t)bytes); /* NaN everywhere: nothing may be read before it is set */
    zoo_layout(&t->problem, &t->sim, t->memory);
    zoo_set_grid(&t->sim);
    if (zoo_set_parameters(&t->sim, &t->parameters) != ZOO_OK)
        abort();
    zoo_set_step(&t->sim, n_steps);
}

static inline void tree_close(tree *t)
{
    free(t->memory);
    t->memory = NULL;
}

/* What only loops with additions have, of walls without a memory and outlets at rest: a law with a function has them. */
static inline void tree_without_memory(zoo_sim *s)
{
    memset(s->z, 0, s->extra ? (size_t)s->n_nodes * sizeof(double) : 0);
    memset(s->outlets.carry, 0, (size_t)s->outlets.rows.flows * s->outlets.count * sizeof(double));
}

/* Blood in all vessels, ml: whole cells inside, half cells at the ends. */
static inline double tree_volume(const zoo_sim *s)
{
    double sum = 0.0;
    for (int k = 0; k < s->n_vessels; k++)
        for (int j = s->first[k]; j <= s->last[k]; j++)
            sum += (j == s->first[k] || j == s->last[k] ? 0.5 : 1.0) * s->dx[k] * s->A[j];
    return sum;
}

#endif
