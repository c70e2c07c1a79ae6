/* The inlet where the flow is given.
 *
 * The area follows from the mass balance of the half cell next to it,
 * A' = A - (2 dt/dx) (q_mid - mean inflow of the step); inlet.h says what each function is for. */
#ifndef ZOO_INLET_FLOW_H
#define ZOO_INLET_FLOW_H

static inline int flow_bad(const zoo_problem *pr)
{
    double mean = 0.0;
    for (int i = 0; i < pr->inlet.n_samples; i++)
        mean += pr->inlet.curve[i];
    return value_bad(mean);
}

static inline double flow_mean(const zoo_sim *s, double resistance, double against)
{
    (void)resistance, (void)against;
    return s->curve_sum[s->problem->inlet.n_samples] / s->problem->inlet.period;
}

static inline double flow_sample(const zoo_sim *s, int i)
{
    return s->problem->inlet.curve[i];
}

static inline double flow_volume(const zoo_sim *s)
{
    return s->curve_sum[s->problem->inlet.n_samples];
}

ZOO_INLINE void flow_advance(const int wall, const int extra, zoo_sim *s, int step)
{
    (void)wall;
    s->A[0] -= 2.0 * s->dt / s->dx[0] * (s->qh[0] - s->curve_mean[step]);
    if (extra)
        s->A[0] -= s->dt * s->leak[0] * s->Ph[0];
    s->q[0] = s->curve_node[step + 1];
}

#endif
