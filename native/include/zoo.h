/* Public interface of zoo's one-dimensional blood-flow solver.
 *
 * All quantities are in cgs units: cm, s, g, dyn/cm^2, ml/s (= cm^3/s).  The
 * caller owns every buffer; the library keeps no state, prints nothing and
 * never exits.  Two solves may run at the same time in two threads when each
 * has a workspace of its own.
 */
#ifndef ZOO_H
#define ZOO_H

#include <stdint.h>

/* cffi:begin */
enum { ZOO_ABI = 12 }; /* raised when a struct or an entry point changes, so that no other library is taken for this one */

enum zoo_status {
    ZOO_OK = 0,
    ZOO_BAD_ARGUMENT = 1, /* an input is out of range; report.vessel names the vessel, or -1 */
    ZOO_CFL = 2,          /* the wave speed outran the time step and no finer one was allowed */
    ZOO_COLLAPSE = 3,     /* a cross-section fell to zero, or to the smallest area of its wall law */
    ZOO_WALL_LIMIT = 4,   /* a cross-section passed the largest area of its wall law */
    ZOO_NO_ROOT = 5,      /* a junction or an outlet had no solution */
    ZOO_NOT_PERIODIC = 6, /* max_beats passed before the beat repeated itself */
    ZOO_WORKSPACE = 7,    /* the workspace handed in is too small */
    ZOO_WALL_FALLS = 8,   /* with the function added to it the wall's pressure falls where its area grows */
    ZOO_NO_DERIVATIVE = 9, /* the changed arguments of a direction cannot be solved beside the given ones */
    ZOO_INLET_AREA = 10   /* the wall at the root's inlet has no area at the pressure given there */
};

enum zoo_friction {
    ZOO_FRICTION_CURRENT = 0, /* r = sqrt(A / pi), as eq. (3.1) is printed */
    ZOO_FRICTION_REST = 1,    /* r = r0(x) */
    ZOO_FRICTION_FIXED = 2    /* r = friction_radius in every vessel */
};

/* The vessels; a parent stands before its children, vessel 0 is the root. */
typedef struct {
    int32_t n_vessels;
    const int32_t *parent;    /* [n_vessels] index of the parent, -1 for the root */
    const int32_t *n_cells;   /* [n_vessels] grid cells, at least 1 */
    const double *length;     /* [n_vessels] cm */
    const double *radius_in;  /* [n_vessels] cm, at rest, at the inlet; 1e-15 to 1e15 */
    const double *radius_out; /* [n_vessels] cm, at rest, at the outlet; linear between */
} zoo_network;

/* A function of one argument, given by its values at evenly spaced knots from `low` to `high`: between them a cubic
 * spline with a continuous second derivative. */
typedef struct {
    int32_t n_knots;      /* at least 4, at most 4096; 0: there is no such function, and nothing of it is read */
    double low, high;     /* first and last knot, low < high, within +-1e30 */
    const double *values; /* [n_knots] within +-1e30 */
} zoo_function;

/* Zero, or NULL where an array may be absent, stands for no addition to eq. (3.1) to (3.7). */

/* The blood in the vessels: inertia, friction, and what leaks through the walls. */
typedef struct {
    double density;             /* g/cm^3 */
    double viscosity;           /* g/(cm s) */
    double momentum_correction; /* factor of q^2/A; 1 as eq. (3.1) is printed */
    int32_t friction;           /* enum zoo_friction */
    double friction_radius;     /* cm, read for ZOO_FRICTION_FIXED */
    double stokes_friction;     /* factor of the Stokes layer's friction; 1 as eq. (3.1) is printed */
    double viscous_friction;    /* k in a further -k pi nu q/A; 0 as eq. (3.1) is printed, 8 Poiseuille's */
    const double *viscosity_factor; /* [n_vessels] factor of the viscosity, or NULL for 1 */
    const double *leak;         /* [n_vessels] cm^4 s/g, A_t + q_x = -leak p, or NULL */
    zoo_function friction_function; /* factor of the friction at |u| (cm/s, low at least 0), not negative; constant beyond */
} zoo_fluid;

/* The wall: its law, and what makes its pressure differ from the law's. */
typedef struct {
    int32_t law;                     /* number of the law, see zoo_wall_name */
    double factor;                   /* k in p = k chi tan(...): 1 as printed, 1/pi as in the published code */
    const double *stiffness_ratio;    /* [n_vessels] s in chi(x) = chi (1 + (s - 1) x/L) (r_in/r(x))^e, or NULL for 1 */
    const double *stiffness_exponent; /* [n_vessels] e; 1 where E h is constant; or NULL for 0 */
    const double *offset_in;         /* [n_vessels] dyn/cm^2, added to the pressure at the inlet, or NULL */
    const double *offset_out;        /* [n_vessels] and at the outlet; linear between */
    const double *viscoelastic_time; /* [n_vessels] s, tau in tau_r dp_v/dt + p_v = tau dp_e/dt, or NULL */
    double relaxation_time;          /* s, tau_r; must be positive where viscoelastic_time is given */
    int32_t n_wave;                  /* samples of stiffness_wave; 0: none */
    const double *stiffness_wave;    /* [n_wave] factor s of the stiffness at m period/n_wave, linear between, periodic */
    zoo_function function;           /* delta(s) in p = K (law(a) + delta(s)), s = sqrt(a), a = A/A0, K the law's scale of
                                      * the stiffness; low at least 1e-3; goes on below linearly in a, above in s */
} zoo_wall;

/* A narrow stretch of a vessel (a stenosis). */
typedef struct {
    const double *severity; /* [n_vessels] in [0, 1): relative loss of radius at the narrowest place, or NULL */
    const double *position; /* [n_vessels] in [0, 1] of the vessel's length */
    const double *length;   /* [n_vessels] cm */
    double loss;            /* K_t in K_t rho/2 (A0/A0_throat - 1)^2 (q/A0)^2 */
} zoo_throat;

/* A stretch of a vessel that loses pressure by a q|q| + b q (A0/A)^2, A0 the area at rest, and keeps its radius. */
typedef struct {
    const double *quadratic; /* [n_vessels] a, g/cm^7, or NULL */
    const double *linear;    /* [n_vessels] b, dyn s/cm^5, or NULL */
    const double *position;  /* [n_vessels] of its middle, in [0, 1] of the vessel's length */
    const double *length;    /* [n_vessels] cm */
} zoo_loss;

/* Where vessels meet. */
typedef struct {
    double total_pressure; /* tau: branches share p + tau rho u^2/2 */
    double loss;           /* K: daughters' inlets lack K rho/2 u|u| of the parent's end */
    zoo_function function; /* and D(u), dyn/cm^2, of that velocity u (cm/s) beside it; goes on linearly */
} zoo_junction;

/* At the root: samples at m period/n_samples, linear between, periodic. */
typedef struct {
    int32_t kind;       /* number of the kind, see zoo_inlet_name; 0: the flow is given, 1: the pressure */
    double period;      /* s */
    int32_t n_samples;
    const double *curve; /* [n_samples] ml/s where the flow is given, dyn/cm^2 where the pressure is */
} zoo_inlet;

/* At the terminals, the vessels without children; elsewhere the values are not read. */
typedef struct {
    int32_t kind;                     /* number of the kind, see zoo_outlet_name; 0: the Windkessel */
    const double *R1;                 /* [n_vessels] dyn s/cm^5 */
    const double *R2;                 /* [n_vessels] dyn s/cm^5; 0: a single resistance, R1, */
    const double *C;                  /* [n_vessels] cm^5/dyn; not read where R2 is 0 */
    const double *pressure;           /* [n_vessels] dyn/cm^2 behind the outlet, or NULL for 0, */
    int32_t n_wave;                   /* with samples of what is added to it over the beat; 0: nothing is */
    const double *wave;               /* [n_vessels][n_wave] dyn/cm^2 at m period/n_wave, linear between, periodic */
    const double *inertance;          /* [n_vessels] g/cm^4, or NULL */
    int32_t n_sections;               /* parallel RC pairs at each terminal; 0: one of R2 and C */
    const double *section_resistance; /* [n_vessels][n_sections] shares of R2; 0: the section is absent; their sum is
                                       * positive, single ones may be negative as long as R1 outweighs these: the
                                       * terminal takes energy at every frequency then */
    const double *section_compliance; /* [n_vessels][n_sections] shares of C, of the resistance's sign */
    int32_t n_modes;                  /* damped oscillations of each terminal's response to a unit of volume, which are
                                       * added to its circuit */
    double mode_rate;                 /* 1/s, s in psi1 exp(-s t) (a cos(w t) + b sin(w t)), positive */
    const double *mode_frequency;     /* [n_modes] w, rad/s, not negative */
    const double *mode_cosine;        /* [n_vessels][n_modes] a, dyn/cm^5, */
    const double *mode_sine;          /* and b; all 0: absent */
    zoo_function resistance_function; /* f(v) in R exp(f(v)) of every section, v the pressure behind R1 (dyn/cm^2), within
                                       * +-30; constant beyond */
    zoo_function compliance_function; /* and the same for C */
} zoo_outlet;

/* Where and when the solution is wanted. */
typedef struct {
    int32_t n_series;
    const int32_t *vessel;  /* [n_series] index */
    const double *position; /* [n_series] 0 at the inlet, 1 at the outlet */
    int32_t n_times;
    const double *times;    /* [n_times] s, ascending, in [0, period] */
} zoo_outputs;

typedef struct {
    double cfl;             /* wanted largest (|u| + c) dt/dx, in (0, 1) */
    int32_t steps_per_beat; /* 0: chosen from cfl */
    int32_t least_steps;    /* when they are chosen, at least as many; 0: no such limit */
    int32_t max_steps;      /* upper limit of the steps in a beat */
    int32_t max_beats;
    double tolerance;       /* dyn/cm^2, on the estimated distance from the periodic state */
    double relative;        /* where positive, the same as a part of the pressure's range at the root's inlet, instead */
    int32_t accelerate;     /* 1: extrapolate from beat to beat (Anderson), 0: plain beats */
    int32_t additions;      /* 1: take the loops with additions even if nothing is added, for tests */
} zoo_numerics;

typedef struct {
    zoo_network network;
    zoo_fluid fluid;
    zoo_wall wall;
    zoo_throat throat;
    zoo_loss loss;
    zoo_junction junction;
    zoo_inlet inlet;
    zoo_outlet outlet;
    zoo_outputs outputs;
    zoo_numerics numerics;
} zoo_problem;

typedef struct {
    const double *stiffness; /* [n_vessels] chi at the inlet, dyn/cm^2; the law's scale of it, 1e-30 to 1e30 */
    const double *shape;     /* [zoo_wall_shapes][n_vessels] further parameters of the wall law, or NULL if none */
    const double *psi1;      /* [n_vessels] factor of R1 */
    const double *psi2;      /* [n_vessels] factor of R2 */
    const double *c;         /* [n_vessels] factor of C */
} zoo_parameters;

typedef struct {
    int32_t status;         /* enum zoo_status */
    int32_t vessel;         /* where it failed, or -1 */
    double time;            /* s from the start of the beat in which it failed */
    int32_t beats;          /* beats computed */
    int32_t steps_per_beat; /* of the last beat */
    double change;          /* dyn/cm^2, largest difference between the last beat's end and its start */
    double distance;        /* dyn/cm^2, change / (1 - slowest decay per beat) */
    double tolerance;       /* dyn/cm^2, that the distance was compared with; not less than rounding lets it become */
    double max_cfl;         /* largest (|u| + c) dt/dx at 32 times of the last beat */
    double inflow;          /* ml, into the root over the last beat */
    double outflow;         /* ml, out of all terminals over the last beat */
    double junction_defect; /* ml/s, largest |flow in - flow out| of a junction at these times */
    int64_t total_steps;    /* time steps over all beats */
} zoo_report;

/* Bytes of workspace that zoo_solve needs. */
int32_t zoo_workspace_size(const zoo_problem *problem, int64_t *bytes);

/* Solve to the periodic state.
 * pressure, flow, area: [n_series][n_times], dyn/cm^2, ml/s, cm^2; filled with NaN when the solve fails.
 * fastest: [n_vessels] or NULL, largest |u| + c in each vessel at 32 times of the last beat, cm/s.  Returns ZOO_OK
 * unless the problem itself is unusable (then the report is not written); how the solve ended is in the report. */
int32_t zoo_solve(const zoo_problem *problem, const zoo_parameters *parameters, void *workspace,
                  int64_t workspace_bytes, double *pressure, double *flow, double *area, double *fastest,
                  zoo_report *report);

/* A direction in which the solution is differentiated: the change of all arguments is sum_i weight_i x_i over points
 * x_i, sets of arguments near those of the solve, with weights whose sum is 0: 1/(2 h) and -1/(2 h) for arguments
 * a step h of some parameter to either side, or any other stencil of differences. */
typedef struct {
    int32_t n_points;
    const zoo_problem *const *problem;       /* [n_points] with the sizes, the tree, the period and the kinds of the
                                                solve's; its outputs and numerics are not read.  NULL: the solve's */
    const zoo_parameters *const *parameters; /* [n_points] */
    const double *weight;                    /* [n_points] */
} zoo_direction;

typedef struct {
    int32_t status;    /* enum zoo_status; ZOO_OK: the derivatives are there */
    int32_t direction; /* that is at fault, or -1 */
    int32_t beats;     /* linearised beats */
    int32_t along;     /* 1: the first of them was the solve's last beat */
    int32_t vectors;   /* that went through a beat beside the directions themselves */
    int32_t stepped;   /* points whose steps were computed one by one, which is slower: geometry, blood and walls */
    double residual;   /* estimated largest error that is left, over a direction's largest derivative */
    int64_t room;      /* bytes that the coefficients of a beat's steps took; 0: they were not kept */
} zoo_tangent_report;

/* Solve as zoo_solve does, and differentiate the discrete periodic solution, at the steps
 * that the solve chose, in n_directions directions.
 * tolerance: accepted residual.  d_pressure, d_flow, d_area: [n_directions][n_series][n_times], NaN where the report's
 * or the derivatives' status is not ZOO_OK.  Memory is taken and freed within the call; `room`, room_bytes long, at a
 * multiple of 8 bytes, is used for most of it where that is enough, since fresh memory costs as much as a solve (NULL
 * and 0: none).  A solve for which a point has additions runs the loops with additions, which changes its rounding. */
int32_t zoo_jacobian(const zoo_problem *problem, const zoo_parameters *parameters, int32_t n_directions,
                     const zoo_direction *directions, double tolerance, void *room, int64_t room_bytes,
                     double *pressure, double *flow, double *area, double *fastest, double *d_pressure,
                     double *d_flow, double *d_area, zoo_report *report, zoo_tangent_report *tangent);

/* Name of a wall law, an inlet or an outlet, by its number from 0 on; NULL past the last. */
const char *zoo_wall_name(int32_t law);
const char *zoo_inlet_name(int32_t kind);
const char *zoo_outlet_name(int32_t kind);

/* How many parameters a wall law has beside the stiffness, and the name of one; -1 and NULL where there is none. */
int32_t zoo_wall_shapes(int32_t law);
const char *zoo_wall_shape_name(int32_t law, int32_t shape);

/* Pressure of a wall law (dyn/cm^2) at area A (cm^2), for plots and tests; shape: [zoo_wall_shapes].
 * NaN where the law has no pressure, or an argument is out of range. */
double zoo_wall_pressure(int32_t law, double factor, double stiffness, const double *shape, double area,
                         double rest_area);

/* Wave speed (cm/s) at area A (cm^2). */
double zoo_wave_speed(int32_t law, double factor, double stiffness, const double *shape, double area,
                      double rest_area, double density);

/* One line of English for a status. */
const char *zoo_status_text(int32_t status);
/* cffi:end */

#endif
