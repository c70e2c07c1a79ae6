/* One time step: Richtmyer's two-step Lax-Wendroff inside the vessels
 * (scheme.h), then junctions (junction.h), outlets (outlet.h) and the inlet
 * (inlet.h).  Each physical idea is an inline body; here they are put together
 * once for each wall law, without and with additions, and once more for each
 * instruction set. */
#include "inlet.h"
#include "junction.h"
#include "junction_total_pressure.h"
#include "outlet.h"
#include "scheme.h"

#if defined(__x86_64__) && defined(__GLIBC__) && (defined(__GNUC__) || defined(__clang__)) && \
    !defined(ZOO_NO_CLONES)
#define ZOO_CLONES __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define ZOO_CLONES
#endif

/* The parts of a step with law and additions known to the compiler. */
#define PARTS_OF_STEP(name, law, extra)                                                 \
    ZOO_CLONES static void half_##name(zoo_sim *s)                                      \
    {                                                                                   \
        scheme_half(law, extra, s);                                                  \
    }                                                                                   \
    ZOO_CLONES static void junctions_##name(zoo_sim *s)                                 \
    {                                                                                   \
        for (int g = 0; g < s->n_groups; g++)                                           \
            if (extra && s->coupled)                                                    \
                junction_total_pressure(law, 0, s, &s->groups[g]);                   \
            else                                                                        \
                junction_body(law, extra, 0, s, &s->groups[g]);                      \
    }                                                                                   \
    ZOO_CLONES static void ends_##name(zoo_sim *s, int step)                            \
    {                                                                                   \
        outlet_advance(law, extra, s);                                               \
        inlet_advance(law, extra, s, step);                                          \
    }                                                                                   \
    ZOO_CLONES static int full_##name(zoo_sim *s)                                       \
    {                                                                                   \
        return scheme_full(law, extra, 1, s);                                        \
    }                                                                                   \
    static int name(zoo_sim *s, int step)                                               \
    {                                                                                   \
        half_##name(s);                                                                 \
        junctions_##name(s);                                                            \
        ends_##name(s, step);                                                           \
        return full_##name(s);                                                          \
    }

/* The same with functions of the friction or the junctions (s->tables), which stand apart, so that the loops without
 * them are compiled as if there were none. */
#define PARTS_WITH_TABLES(name, law)                                                    \
    ZOO_CLONES static void junctions_tables_##name(zoo_sim *s)                          \
    {                                                                                   \
        for (int g = 0; g < s->n_groups; g++)                                           \
            if (s->coupled)                                                             \
                junction_total_pressure(law, 1, s, &s->groups[g]);                   \
            else                                                                        \
                junction_body(law, 1, 1, s, &s->groups[g]);                          \
    }                                                                                   \
    static int tables_##name(zoo_sim *s, int step)                                      \
    {                                                                                   \
        half_##name(s);                                                                 \
        friction_half(s);                                                               \
        junctions_tables_##name(s);                                                     \
        ends_##name(s, step);                                                           \
        const int wrong = full_##name(s);                                               \
        friction_full(s);                                                               \
        return wrong;                                                                   \
    }

/* What a function of the friction adds at midpoints and nodes. */
ZOO_CLONES static void friction_half(zoo_sim *s)
{
    if (s->problem->fluid.friction_function.n_knots)
        scheme_friction(s, s->n_nodes - 1, s->Ah, s->qh, s->inv_A0_mid, s->f_s_mid, s->f_c_mid, s->Gh);
}

ZOO_CLONES static void friction_full(zoo_sim *s)
{
    if (s->problem->fluid.friction_function.n_knots)
        scheme_friction(s, s->n_nodes, s->A, s->q, s->inv_A0, s->f_s, s->f_c, s->G);
}

/* A law with a function is compiled once, in the loops with additions. */
#define STEPS_OF_LAW(NAME, name, ...)                                         \
    PARTS_OF_STEP(plain_##name, ZOO_WALL_##NAME, 0)                           \
    PARTS_OF_STEP(added_##name, ZOO_WALL_##NAME, 1)                           \
    PARTS_OF_STEP(function_##name, ZOO_WALL_##NAME + ZOO_N_WALLS, 1)          \
    PARTS_WITH_TABLES(added_##name, ZOO_WALL_##NAME)                          \
    PARTS_WITH_TABLES(function_##name, ZOO_WALL_##NAME + ZOO_N_WALLS)
ZOO_WALLS(STEPS_OF_LAW, )

#define STEP_OF_LAW(NAME, name, ...)                                                               \
    case ZOO_WALL_##NAME:                                                                          \
        if (s->tables)                                                                             \
            return tables_added_##name(s, step);                                                   \
        return s->extra ? added_##name(s, step) : plain_##name(s, step);                           \
    case ZOO_WALL_##NAME + ZOO_N_WALLS:                                                            \
        return s->tables ? tables_function_##name(s, step) : function_##name(s, step);

int zoo_step(zoo_sim *s, int step)
{
    if (s->extra && s->problem->wall.n_wave > 0) {
        s->stiff_half = s->wave_half[step];
        s->stiff = s->wave_node[step + 1];
    }
    if (s->problem->outlet.n_wave > 0)
        zoo_curve_behind(s, step);
    if (outlet_depends(s->problem))
        circuit_set_pressure(s);
    switch (s->wall) {
        ZOO_WALLS(STEP_OF_LAW, )
    default:
        return 1;
    }
}

/* Pressure, momentum flux and friction at the nodes, from areas and flows that were just set for a time in the beat. */
void zoo_refresh_at(zoo_sim *s, int step)
{
    if (s->extra && s->problem->wall.n_wave > 0)
        s->stiff = s->wave_node[step];
    (void)scheme_full(s->wall, s->extra, 0, s);
    if (s->problem->fluid.friction_function.n_knots)
        scheme_friction(s, s->n_nodes, s->A, s->q, s->inv_A0, s->f_s, s->f_c, s->G);
}

/* The same for the start of a beat. */
void zoo_refresh_nodes(zoo_sim *s)
{
    zoo_refresh_at(s, 0);
}

/* Largest (|u| + c)/dx, 1/s, c at the wall's largest stiffness of the beat; NaN when the
 * state is not a number.  The largest |u| + c of each vessel is kept in `fastest`. */
double zoo_speed(zoo_sim *s)
{
    double worst = 0.0;
    for (int j = 0; j < s->n_nodes; j++) {
        double a = s->A[j] * s->inv_A0[j];
        double slope = s->extra ? (1.0 + s->kappa[j]) * s->stiffest / s->stiff *
                                      wall_slope(s->wall, zoo_K(s, j), zoo_shape(s, j), s->pe[j], a, sqrt(a))
                                : wall_slope(s->wall, s->K[j], zoo_shape(s, j), s->P[j], a, sqrt(a));
        int k = s->vessel_of[j];
        double fast = fabs(s->q[j] / s->A[j]) + sqrt(a * slope * s->inv_density), speed = fast / s->dx[k];
        if (!(fast <= s->fastest[k]))
            s->fastest[k] = fast;
        if (!(speed <= worst))
            worst = speed;
    }
    return worst;
}

/* Largest |flow in - flow out| of a junction's nodes, ml/s. */
double zoo_junction_defect(const zoo_sim *s)
{
    double worst = 0.0;
    for (int g = 0; g < s->n_groups; g++) {
        const zoo_junction_group *ju = &s->groups[g];
        for (int i = 0; i < ju->count; i++) {
            double sum = 0.0;
            for (int b = 0; b < ju->branches; b++)
                sum += (b == 0 ? 1.0 : -1.0) * s->q[ju->node[b * ju->count + i]];
            if (!(fabs(sum) <= worst))
                worst = fabs(sum);
        }
    }
    return worst;
}
