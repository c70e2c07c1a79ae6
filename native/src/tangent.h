/* Derivatives of a run: what tangent.c, tangent_step.c and tangent_periodic.c share.
 *
 * A direction is a change of the arguments.  ZOO_DIRECTIONS of them make a block and stand side by side, innermost,
 * so that the coefficients of a node, which all directions share, are computed once and multiply vectors:
 * element [i*ZOO_DIRECTIONS + d] of an array. */
#ifndef ZOO_TANGENT_H
#define ZOO_TANGENT_H

#include "internal.h"

enum {
    ZOO_DIRECTIONS = 8,
    ZOO_NODE_ROWS = 8,      /* of coefficients of a step at nodes and midpoints, */
    ZOO_ADDED_ROWS = 11,    /* at a branch of a junction with additions, */
    ZOO_PLAIN_ROWS = 9,     /* without, */
    ZOO_OUTLET_ROWS = 2,    /* and at an outlet without */
    ZOO_MOST_KEPT = 1 << 28 /* bytes of coefficients that are kept for other beats */
};

/* As step.c: a version for each instruction set. */
#if defined(__x86_64__) && defined(__GLIBC__) && (defined(__GNUC__) || defined(__clang__)) && !defined(ZOO_NO_CLONES)
#define ZOO_CLONES __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define ZOO_CLONES
#endif

/* Derivatives of what nodes, or midpoints, make of their area A and flow q: the wall's pressure by area and by the
 * law's coefficients, momentum flux and friction by area, flow and (with a leak) pressure. */
typedef struct {
    const double *elastic;            /* [n_nodes] the wall's own pressure */
    double *slope, *shape;            /* [n_nodes], [wall_shapes][n_nodes] */
    double *by_K;                     /* [n_nodes] where a direction changes the walls */
    double *M_A, *M_q, *G_A, *G_q, *G_P; /* [n_nodes] */
} zoo_partials;

/* A block of directions. */
typedef struct {
    int walls, outlets, inlet;     /* 1: some direction changes walls (K, coefficients), outlets, the inlet's curve */
    double *state;                 /* [n_state][D] in the order of zoo_pack */
    double *A, *q, *v, *z, *carry; /* its parts */
    double *pe;                    /* [n_nodes][D] pressure of the wall; where it is not slope A alone */
    double *Ah, *qh, *Ph;          /* [n_nodes][D] at midpoints, one more in front */
    double *K, *K_mid, *coefficient; /* [n_nodes][D], [wall_shapes][n_nodes][D] changes of the arguments' arrays */
    double *row, *behind;          /* [rows.coefficients][count][D], [count][D] */
    double *curve_node, *curve_mean; /* [n_steps+1][D], [n_steps][D] */
    double *node_source, *mid_source; /* [n_nodes][D] change of the walls' pressure with the areas left alone */
    double *out_P;                 /* [n_nodes][D] change of P with the state left alone, of directions by differences */
    double *ring, *sample;         /* as in zoo_sim, each number D times */
    int next_time;
} zoo_block;

typedef struct {
    zoo_sim *s;
    int forced;   /* 1: the arguments change, 0: only the state */
    int shapes;   /* coefficients of the wall's law that may change now */
    int n_blocks;
    zoo_block *block;
    zoo_partials now, next, mid; /* nodes at the start and end of the step, midpoints */
    double *mid_elastic;         /* [n_nodes] with additions */
    double *old_A, *old_q, *old_P, *old_off; /* [n_nodes] at the start of the step; old_off at half a step */
    double *old_v, *old_carry;   /* [rows][count] */
    /* [n_nodes] how a midpoint follows from the nodes before and after it, and a node from the midpoints */
    double *hA0, *hA1, *hq0, *hq1, *hP0, *hP1, *fA0, *fA1, *fq0, *fq1, *fP0, *fP1;
    double *row;                 /* [ZOO_ADDED_ROWS or ZOO_PLAIN_ROWS][branches] of each group: what the directions have in common there */
    double *inlet;               /* the same rows of the inlet's half cell, where the pressure is given */
    double *outlet;              /* [ZOO_OUTLET_ROWS][outlets] */
    double *seen;                /* [n_series][4] the walls' slope where outputs are taken, at the end of the step */
    double *seen_first;          /* the same at the start of the beat */
    double *one;                 /* [size] what hA0 to hq1, fA0 to fq1, seen, outlet, inlet and row hold in one step */
    double *kept;                /* [n_steps][zoo_tangent_kept] that of all steps, or NULL */
    double over[ZOO_NODE_ROWS];  /* what the integers of the last step that was kept were over */
    size_t size;
    const char *ahead;           /* what the next step will need: fetch `ahead_by` bytes for each node */
    size_t ahead_by;
    int done;                    /* 1: `kept` is filled */
    double *zero;                /* [n_nodes or outlets' coefficients][D] zeros */
    double *branch;              /* [4][branches][D] scratch of one junction */
    double *part;                /* [8][branches] */
    double *rows;                /* [rows.coefficients][D] changes of one outlet's coefficients with the state */
    /* of the first beat, in which the arguments change */
    int n_directions, n_points, n_seeds;
    struct zoo_point *points;    /* [n_points] that are stepped */
    double *start;               /* [n_state] of the run */
    double *seeds;               /* [n_seeds][n_state] the run's own changes, in the places after the directions' */
    double *scratch;             /* [n_blocks][n_state][D] and 2 [n_state]; of points */
} zoo_tangent;

/* tangent.c: the arrays at `at`, a multiple of 64 bytes that hold zeros, for s, n_blocks and block as they are set;
 * with NULL only how many bytes. */
size_t zoo_tangent_layout(zoo_tangent *t, char *at);

/* tangent_kept.c: place a step's coefficients at `at` and return how many they are (with NULL only count); how many
 * numbers a step takes when it is kept; keep those of a step, and have them back. */
size_t zoo_tangent_place(zoo_tangent *t, double *at);
size_t zoo_tangent_kept(const zoo_tangent *t);
void zoo_tangent_keep(zoo_tangent *t, int step);
void zoo_tangent_recall(zoo_tangent *t, int step);

/* tangent_step.c: partials of the nodes at the start of a beat, and all blocks by one step; with the run itself, unless
 * its coefficients are `done`.  Returns what zoo_step returns.  `change` holds what is added to the state of block b. */
void zoo_tangent_begin(zoo_tangent *t);
int zoo_tangent_step(zoo_tangent *t, int step);
void zoo_tangent_add(zoo_tangent *t, int block, const double *change);
void zoo_tangent_record(zoo_tangent *t, int step);

/* tangent_plain.c, without additions: the coefficients of the step that was just made, a block through such a step, and
 * what changed walls add to its pressures at a node. */
void zoo_plain_keep(zoo_tangent *t);
void zoo_plain_step(const zoo_tangent *t, zoo_block *b, int step);
void zoo_plain_source(const zoo_tangent *t, const zoo_block *b, ptrdiff_t node, double *P);

/* Arguments near those of the run whose steps are computed one by one, from the run's own state, and compared: for
 * what no coefficient array of a block holds. */
typedef struct zoo_point {
    int direction;
    double weight;
    zoo_problem problem;
    zoo_sim sim;
    void *memory;
} zoo_point;

/* tangent_directions.c: the changes of all directions into the blocks; points that must be stepped are kept in
 * t->points[t->n_points].  Returns a status, with the direction at fault in the report. */
int32_t zoo_tangent_directions(zoo_tangent *t, const zoo_parameters *parameters, const zoo_direction *directions,
                               zoo_tangent_report *report);

/* tangent_periodic.c, in their order.  Each returns a status.
 * What the first beat starts from, for the run's state as it is and its last beats, and that beat's start; `start`,
 * `seeds` and `scratch` are taken here and freed by the caller. */
int32_t zoo_tangent_first(zoo_tangent *t);
/* A step of the beat under way, with the run's own where its coefficients are not `done`. */
int32_t zoo_tangent_advance(zoo_tangent *t, int step, zoo_tangent_report *report);
/* After the last step of the first beat: derivatives of the periodic state's samples, [n_directions][n_times][n_series][3]. */
int32_t zoo_tangent_periodic(zoo_tangent *t, double tolerance, double *samples, zoo_tangent_report *report);

#endif
