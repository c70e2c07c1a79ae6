/* What the solver's source files share: the layout of a run in memory.
 *
 * The nodes of all vessels stand one after the other in one array, so that one
 * loop serves the whole tree.  Vessel v has nodes first[v] .. last[v]; the
 * midpoint between nodes j and j+1 has index j.  The midpoint after a vessel's
 * last node joins two vessels that are not joined: lam_mid is 0 there, so that
 * what is computed stays finite, and lam is 0 where it would be used.
 */
#ifndef ZOO_INTERNAL_H
#define ZOO_INTERNAL_H

#include <stddef.h>

#include "../include/zoo.h"
#include "function.h"
#include "wall.h"

enum {
    ZOO_HISTORY = 4,   /* beats kept for the extrapolation */
    ZOO_CHECKS = 32,   /* times in a beat at which the state is checked */
    ZOO_STEP_UNIT = 32, /* steps per beat are a multiple of this when chosen from cfl */
    ZOO_MOST = 1 << 28 /* of anything that is counted, so that sums of a few counts are ints */
};

/* Junctions with the same number of branches; branch 0 is the parent, and
 * branch b of junction j has the number x = b*count + j. */
typedef struct {
    int count, branches;
    int *node, *mid, *junction;          /* [branches*count] end node, midpoint next to it, j */
    double *w, *per_w, *sign;            /* [branches*count] dx/2, dt/w, 1 for the parent else -1 */
    double *A0, *f_s, *f_c;              /* [branches*count] rest area and friction at the node */
    double *soft;                        /* [branches*count] 1/K */
    double *rest;                        /* [count] sum of w A0 */
    double *soft1, *soft2;               /* [count] sums of w A0/K and w A0/K^2 */
    double *area, *c, *beta;             /* [branches*count] scratch of a step */
    double *volume, *sum_c, *sum_beta;   /* [count] scratch of a step */
    /* only with additions: scratch of Newton's method, junction_total_pressure.h */
    double *flow, *old, *a0, *aP, *aH, *q0, *qP, *qH; /* [branches*count] */
    double *P, *H, *D, *g0, *gP, *gH;    /* [count] */
    double *m0, *mP, *mH, *f0, *fP, *fH; /* [count] */
} zoo_junction_group;

/* The ends of the terminal vessels.  What one kind of outlet needs stands in rows of [count], as
 * many as the kind asks for: outlet.h. */
typedef struct {
    int coefficients; /* made from the parameters for a time step */
    int pressures;    /* of the state, dyn/cm^2, */
    int flows;        /* ml/s */
    int scratch;      /* of a step */
} zoo_rows;

typedef struct {
    int count;
    int kind;                            /* of the loops that are run, outlet.h */
    zoo_rows rows;
    int *vessel, *node;                  /* [count] */
    double *per_w, *A0;                  /* [count] 2 dt/dx, rest area at the node */
    double *R1, *R2, *C, *psi1;          /* [count] */
    double *behind;                      /* [count] pressure behind the outlet */
    double *wave_sum;                    /* [count][n_wave+1] running integral of what is added to `behind`, which is */
    double *wave_now, *wave_then;        /* [count] this at the step's start and end, */
    double *wave_mean;                   /* [count] and this in the mean over it; without a wave there is no memory */
    double *volume;                      /* [count] ml that left so far in this beat */
    double *coefficient;                 /* [rows.coefficients][count] */
    double *v;                           /* [rows.pressures][count] state */
    double *carry;                       /* [rows.flows][count] state */
    double *scratch;                     /* [rows.scratch][count] */
} zoo_terminals;

typedef struct {
    const zoo_problem *problem;
    int n_vessels, n_nodes, n_groups;
    int wall;    /* the law, or wall_with_function of it */
    double dt, momentum, inv_density;
    int extra;   /* 1: something is added that the plain loops do not have, see zoo_has_additions */
    int coupled; /* 1: pressures at junctions depend on flows there (total pressure, losses) */
    int tables;  /* 1: friction's factor or the junctions' loss is given as a function */
    int uniform; /* 1: all vessels share one stiffness and one shape */

    /* grid, per vessel and per node */
    int *first, *last;                   /* [n_vessels] */
    int *vessel_of;                      /* [n_nodes] */
    int *children;                       /* [n_vessels] how many each vessel has; a terminal has none */
    int *place;                          /* [n_vessels] scratch: the last branch of the junction at its outlet */
    double *dx;                          /* [n_vessels] */
    double *A0, *inv_A0;                 /* [n_nodes] rest area, and its inverse */
    double *inv_A0_mid;                  /* [n_nodes] at midpoints */
    double *f_s, *f_c, *f_s_mid, *f_c_mid; /* [n_nodes] friction = (f_s sqrt(A/A0) + f_c) q/A */
    double *lam_mid;                     /* [n_nodes] dt/dx, 0 between vessels */
    double *lam, *half_dt;               /* [n_nodes] dt/dx and dt/2, 0 at boundary nodes */

    /* wall at nodes; midpoint j lies in the vessel of node j */
    double *K;                           /* [n_nodes] */
    double *K_mid;                       /* [n_nodes] at midpoints; K itself unless stiffness varies along a vessel */
    double *stiffening;                  /* [n_nodes] chi over that at the inlet, where it varies */
    int varying;                         /* 1: stiffness varies along a vessel */
    double *coefficient;                 /* [wall_shapes][n_nodes] of the law, zoo_shape */

    /* functions that are given by their values: without them 0 everywhere, 1 as the friction's factor */
    double *wall_piece, *friction_piece, *junction_piece, *resistance_piece, *compliance_piece;
    zoo_spline wall_function, friction_function, junction_function, resistance_function, compliance_function;
    double junction_curvature;           /* largest |D''| */

    /* state at nodes: area, flow, pressure, momentum flux, friction force */
    double *A, *q, *P, *M, *G;           /* [n_nodes] */
    /* the same at midpoints, half a step on */
    double *Ah, *qh, *Ph, *Mh, *Gh;      /* [n_nodes] */

    /* only with additions (extra): p = p_e + p_v + offset, p_v = kappa p_e + z,
     * tau_r dz/dt = -(z + kappa p_e), kappa = tau/tau_r */
    double relax, relax_half;            /* exp(-dt/tau_r), exp(-dt/(2 tau_r)) */
    double *wave_node, *wave_half;       /* [max_steps+1] at the steps, [max_steps] between: factor of K */
    double stiff, stiff_half, stiffest;  /* the factor now, half a step ago, at most; 1 without a wave */
    double *offset, *kappa;              /* [n_nodes] */
    double *leak, *leak_mid;             /* [n_nodes] 0 at the midpoint between two vessels */
    double *loss, *loss_mid;             /* [n_nodes] of throats and losses: friction += loss A q|q| */
    double *z, *pe;                      /* [n_nodes] state, pressure of the wall */
    double *off, *off_half;              /* [n_nodes] part of p that is known a step, half a step ahead */

    zoo_junction_group *groups;          /* [n_groups] */

    zoo_terminals outlets;
    int no_root;                         /* a root search did not end in this step, */
    int stuck;                           /* and is not near its end */

    /* the inlet's curve on the steps of a beat */
    double *curve_node;                  /* [max_steps+1] at the steps */
    double *curve_mean;                  /* [max_steps] mean over each step */
    double *curve_sum;                   /* [n_samples+1] running integral of the samples */
    double *inlet_cell;                  /* [4] of the half cell at node 0: dx/2, dt/(dx/2), -1, pressure at mid-step */
    double entered;                      /* ml so far in this beat, where the flow is not given */
    int n_steps;

    /* outputs: cubic in space from four nodes, cubic in time from four steps */
    int *out_node;                       /* [n_series*4] */
    double *out_weight;                  /* [n_series*4] */
    double *ring;                        /* [4][n_series][3] */
    double *sample;                      /* [n_times][n_series][3] */
    int next_time;

    /* beat to beat */
    int n_state;                         /* doubles of the state: A, q, v, z when extra, carry */
    double *start;                       /* [n_state] state at the start of the beat */
    double *states, *ends;               /* [ZOO_HISTORY][n_state] starts and ends of past beats */
    double *weight;                      /* [n_state] turns a difference of state into a pressure */
    double slow;                         /* estimated slowest decay factor per beat */
    double *fastest;                     /* [n_vessels] largest |u| + c seen in this beat, cm/s */
    zoo_report report;
} zoo_sim;

/* A loop over nodes (or branches, or terminals) j from 0 to n - 1 that the compiler may vectorise: the iterations must not
 * depend on each other. */
#ifdef __clang__ /* has other pragmas, and warns of loops that it cannot vectorise */
#define ZOO_SIMD
#else
#define ZOO_SIMD _Pragma("GCC ivdep") _Pragma("GCC unroll 1")
#endif
#define ZOO_LOOP(j, n, ...)                                \
    do {                                                   \
        ZOO_SIMD for (ptrdiff_t j = 0; j < (n); j++) {     \
            __VA_ARGS__                                    \
        }                                                  \
    } while (0)

/* K of the wall at node i, at this time. */
ZOO_INLINE double zoo_K(const zoo_sim *s, ptrdiff_t i)
{
    return s->stiff * s->K[i];
}

/* Coefficients of the wall law there. */
ZOO_INLINE wall_shape zoo_shape(const zoo_sim *s, ptrdiff_t i)
{
    return (wall_shape){s->coefficient + i, s->n_nodes, s->wall_function};
}

/* check.c: ZOO_OK when the problem can be solved at all; ZOO_BAD_ARGUMENT, or ZOO_WORKSPACE without memory to look. */
int32_t zoo_check_problem(const zoo_problem *problem);

/* memory.c: how many children each vessel has, [n_vessels], 0 for a terminal; to be freed, NULL without memory. */
int *zoo_count_children(const zoo_network *network);

/* memory.c: carve the arrays out of the workspace; with base NULL only count the bytes.  Returns the bytes, or -1
 * where they are more than memory can have, or nothing is left to count with. */
int64_t zoo_layout(const zoo_problem *problem, zoo_sim *sim, void *base);

/* grid.c: nodes, ends of vessels, and where outputs are taken. */
void zoo_set_grid(zoo_sim *sim);

/* parameters.c: whether stiffness varies along a vessel. */
int zoo_stiffness_varies(const zoo_problem *problem);

/* friction.c and throat.c: at one rest radius, at one place of a vessel. */
void zoo_friction(const zoo_sim *sim, int vessel, double r0, double *f_s, double *f_c);
double zoo_narrowed(const zoo_sim *sim, int vessel, double x, double r);
double zoo_throat_loss(const zoo_sim *sim, int vessel, double x, double r);

/* loss.c: at one place of a vessel. */
double zoo_loss_quadratic(const zoo_sim *sim, int vessel, double x);
double zoo_loss_linear(const zoo_sim *sim, int vessel, double x, double r);

/* additions.c: what only the loops with additions have. */
int zoo_has_additions(const zoo_problem *problem, const int *children);
void zoo_set_additions(zoo_sim *sim, int vessel);

/* parameters.c: a new report, and the parameters at the nodes unless one is out of range; returns the report's status. */
int32_t zoo_set_parameters(zoo_sim *sim, const zoo_parameters *parameters);

/* time_step.c: set the time step to period/n_steps and everything that depends on it. */
void zoo_set_step(zoo_sim *sim, int n_steps);

/* curve.c: the inlet's samples as a curve, and the pressures behind the outlets; these in one step. */
void zoo_curve_sum(zoo_sim *sim);
void zoo_curve_step(zoo_sim *sim);
void zoo_curve_behind(zoo_sim *sim, int step);

/* start.c: the state from which the first beat starts. */
void zoo_start(zoo_sim *sim);
double zoo_start_speed(const zoo_sim *sim);

/* step.c: advance by one step; returns 1 if some node left the wall's range. */
int zoo_step(zoo_sim *sim, int step);
void zoo_refresh_nodes(zoo_sim *sim);
void zoo_refresh_at(zoo_sim *sim, int step);
double zoo_speed(zoo_sim *sim);
double zoo_junction_defect(const zoo_sim *sim);

/* output.c: sample the wanted series while the beat runs. */
void zoo_output_weights(zoo_sim *sim, int series);
void zoo_output_begin(zoo_sim *sim);
void zoo_output_step(zoo_sim *sim, int step);
int zoo_output_finite(const zoo_sim *sim);
void zoo_output_store(const zoo_sim *sim, double *pressure, double *flow, double *area);

/* Samples that the last four steps in `ring` give, from sample `next` on, [n_times][n_series][3][width]; returns the first
 * that needs further steps.  `width` numbers stand side by side: 1 of a run, ZOO_DIRECTIONS of a block of directions. */
int zoo_output_emit(const zoo_sim *sim, int step, int width, const double *ring, double *sample, int next);

/* solve.c: what the caller is told of a run that ended. */
void zoo_tell(const zoo_sim *sim, double *pressure, double *flow, double *area, double *fastest, zoo_report *report);

/* What wants to go along with the last beat: `begin` before its steps (0: stays behind), `step` in place of zoo_step.
 * It goes along with the first beat that is expected to be the last, if it is not run again with more steps. */
typedef struct {
    int (*begin)(void *self), (*step)(void *self, int step);
    void *self;
    int beat; /* the beat that it went along with, from 1 on; 0: none so far, -1: one that was run again */
} zoo_companion;

/* periodic.c: beats until the solution repeats itself; `with` may be NULL. */
void zoo_periodic(zoo_sim *sim, zoo_companion *with, double *pressure, double *flow, double *area);
void zoo_pack(const zoo_sim *sim, double *state);
void zoo_unpack(zoo_sim *sim, const double *state);
int zoo_extrapolate(zoo_sim *sim, int n_past, double *left);

#endif
