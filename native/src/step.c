/* One time step: Richtmyer's two-step Lax-Wendroff inside the vessels
 * (scheme.h), then junctions (junction.h), outlets (outlet.h) and the inlet.
 * Each physical idea is an inline body; here they are put together once for
 * each wall law and lane count, without and with what zoo_extras adds, and once
 * more for each instruction set. */
#include "internal.h"
#include "junction.h"
#include "junction_extra.h"
#include "outlet.h"
#include "outlet_extra.h"
#include "scheme.h"

#if defined(__x86_64__) && defined(__GLIBC__) && (defined(__GNUC__) || defined(__clang__)) && \
    !defined(ZOO_NO_CLONES)
#define ZOO_CLONES __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define ZOO_CLONES
#endif

/* The inlet: the flow is given, the area follows from the mass balance of the
 * half cell next to it.  A' = A - (2 dt/dx) (q_mid - mean inflow of the step). */
ZOO_INLINE void inlet_body(const int W, const int extra, zoo_sim *s, int step)
{
    for (int l = 0; l < W; l++) {
        s->A[l] -= 2.0 * s->dt / s->dx[0] * (s->qh[l] - s->flow_mean[step]);
        if (extra)
            s->A[l] -= s->dt * s->leak[0] * s->Ph[l];
        s->q[l] = s->flow_node[step + 1];
    }
}

ZOO_INLINE int step_body(const int wall, const int W, const int extra, zoo_sim *s, int step)
{
    if (extra && s->problem->extras.n_wave > 0) {
        s->stiff_half = s->wave_half[step];
        s->stiff = s->wave_node[step + 1];
    }
    scheme_half(wall, W, extra, s);
    for (int g = 0; g < s->n_groups; g++)
        if (extra && s->coupled)
            junction_extra(wall, W, s, &s->groups[g]);
        else
            junction_body(wall, W, extra, s, &s->groups[g]);
    if (extra)
        outlet_extra(wall, W, s);
    else
        outlet_body(wall, W, s);
    inlet_body(W, extra, s, step);
    return scheme_full(wall, W, extra, 1, s);
}

#define ZOO_STEP(name, wall, W, extra) \
    ZOO_CLONES static int name(zoo_sim *s, int step) { return step_body(wall, W, extra, s, step); }
ZOO_STEP(step_linear_1, ZOO_WALL_LINEAR, 1, 0)
ZOO_STEP(step_linear_n, ZOO_WALL_LINEAR, ZOO_LANES, 0)
ZOO_STEP(step_tangent_1, ZOO_WALL_TANGENT, 1, 0)
ZOO_STEP(step_tangent_n, ZOO_WALL_TANGENT, ZOO_LANES, 0)
ZOO_STEP(extra_linear_1, ZOO_WALL_LINEAR, 1, 1)
ZOO_STEP(extra_linear_n, ZOO_WALL_LINEAR, ZOO_LANES, 1)
ZOO_STEP(extra_tangent_1, ZOO_WALL_TANGENT, 1, 1)
ZOO_STEP(extra_tangent_n, ZOO_WALL_TANGENT, ZOO_LANES, 1)

int zoo_step(zoo_sim *s, int step)
{
    if (s->extra && s->wall == ZOO_WALL_LINEAR)
        return s->lanes == 1 ? extra_linear_1(s, step) : extra_linear_n(s, step);
    if (s->extra)
        return s->lanes == 1 ? extra_tangent_1(s, step) : extra_tangent_n(s, step);
    if (s->wall == ZOO_WALL_LINEAR)
        return s->lanes == 1 ? step_linear_1(s, step) : step_linear_n(s, step);
    return s->lanes == 1 ? step_tangent_1(s, step) : step_tangent_n(s, step);
}

/* Pressure, momentum flux and friction at the nodes, from areas and flows that were just set for the
 * start of a beat. */
void zoo_refresh_nodes(zoo_sim *s)
{
    if (s->extra && s->problem->extras.n_wave > 0)
        s->stiff = s->wave_node[0];
    if (s->extra)
        (void)scheme_full(s->wall, s->lanes, 1, 0, s);
    else if (s->wall == ZOO_WALL_LINEAR)
        (void)scheme_full(ZOO_WALL_LINEAR, s->lanes, 0, 0, s);
    else
        (void)scheme_full(ZOO_WALL_TANGENT, s->lanes, 0, 0, s);
}

/* Largest (|u| + c)/dx of one lane, 1/s, c at the wall's largest stiffness of the beat; NaN when the
 * state is not a number. */
double zoo_speed(const zoo_sim *s, int lane)
{
    double worst = 0.0;
    for (int j = 0; j < s->n_nodes; j++) {
        int i = j * s->lanes + lane;
        double a = s->A[i] * s->inv_A0[j];
        double slope = s->extra ? (1.0 + s->kappa[j]) * s->stiffest / s->stiff *
                                      wall_slope(s->wall, zoo_K(s, i), s->theta[i], s->pe[i], sqrt(a))
                                : wall_slope(s->wall, s->K[i], s->theta[i], s->P[i], sqrt(a));
        double speed = (fabs(s->q[i] / s->A[i]) + sqrt(a * slope * s->inv_density)) /
                       s->dx[s->vessel_of[j]];
        if (!(speed <= worst))
            worst = speed;
    }
    return worst;
}

/* Largest |flow in - flow out| of a junction's nodes, ml/s. */
double zoo_junction_defect(const zoo_sim *s, int lane)
{
    double worst = 0.0;
    for (int g = 0; g < s->n_groups; g++) {
        const zoo_junctions *ju = &s->groups[g];
        for (int i = 0; i < ju->count; i++) {
            double sum = 0.0;
            for (int b = 0; b < ju->branches; b++)
                sum += (b == 0 ? 1.0 : -1.0) * s->q[ju->node[b * ju->count + i] * s->lanes + lane];
            if (!(fabs(sum) <= worst))
                worst = fabs(sum);
        }
    }
    return worst;
}
