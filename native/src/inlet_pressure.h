/* The inlet where the pressure is given.
 *
 * Node 0 has the area of that pressure p, A' = A(p'), and its flow follows from the momentum balance of the half cell
 * next to it, as at a junction (junction.h) whose pressures are known: P' = p', and at mid-step the mean of p over the
 * step.  The mass balance of the half cell is what enters; inlet.h says what each function is for. */
#ifndef ZOO_INLET_PRESSURE_H
#define ZOO_INLET_PRESSURE_H

static inline int pressure_bad(const zoo_problem *pr)
{
    return values_outside(pr->inlet.curve, pr->inlet.n_samples, -ZOO_MOST_VALUE, ZOO_MOST_VALUE);
}

/* Of a steady state that has the pressure of the beat's start. */
static inline double pressure_mean(const zoo_sim *s, double resistance, double against)
{
    return (s->problem->inlet.curve[0] - against) / resistance;
}

static inline double pressure_sample(const zoo_sim *s, int i)
{
    (void)s, (void)i;
    return NAN;
}

static inline double pressure_volume(const zoo_sim *s)
{
    return s->entered;
}

ZOO_INLINE void pressure_advance(const int wall, const int extra, zoo_sim *s, int step)
{
    const zoo_junction_group in = inlet_branch(s);
    const double dt = s->dt, w = *in.w, per_w = *in.per_w, Ph = s->Ph[0], P_mid = s->curve_mean[step];
    const double later = 0.5 * (1.0 + s->relax);
    const double K = extra ? wall_stiffened(s->K[0], s->stiff, later, s->kappa[0]) : s->K[0];
    const double p = extra ? s->curve_node[step + 1] - s->off[0] : s->curve_node[step + 1];
    const double a = wall_area_ratio(wall, K, zoo_shape(s, 0), p);
    /* a pressure that the wall cannot have has no area */
    const int found = a > 0.0 && fabs(wall_p(wall, K, zoo_shape(s, 0), a, sqrt(a)) - p) <= 1e-6 * (fabs(p) + K);
    const double now = s->A[0], then = found ? a * s->A0[0] : NAN, half = 0.5 * (now + then);
    const double leak = extra ? s->leak[0] * Ph : 0.0, loss = extra ? s->loss[0] : 0.0;
    const double flux = s->qh[0] + (then - now) / per_w + w * leak, u = flux / half;
    const double stick = spline_value(s->friction_function, fabs(u)) * (s->f_s[0] * sqrt(half / s->A0[0]) + s->f_c[0]);
    const double drag = (stick + leak + loss * half * half * fabs(flux)) * u;
    s->q[0] += per_w * (s->momentum * flux * u - s->Mh[0] + 0.5 * (half + s->Ah[0]) * s->inv_density * (P_mid - Ph)) -
               0.5 * dt * (drag + s->Gh[0]);
    s->A[0] = then;
    s->entered += dt * flux;
    *in.sum_c = P_mid;
}

#endif
