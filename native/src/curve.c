/* The inlet's curve: samples over one period, linear between, periodic; at the steps, and its exact mean
 * over each of them. */
#include "internal.h"
#include "values.h"

/* The running integral of the samples. */
void zoo_curve_sum(zoo_sim *s)
{
    const zoo_inlet *in = &s->problem->inlet;
    double h = in->period / in->n_samples;
    s->curve_sum[0] = 0.0;
    for (int i = 0; i < in->n_samples; i++)
        s->curve_sum[i + 1] = s->curve_sum[i] + 0.5 * h * (in->curve[i] + in->curve[(i + 1) % in->n_samples]);
}

/* Integral from 0 to t (0 <= t <= period), exact for the piecewise linear curve. */
static double integral(const zoo_sim *s, double t)
{
    const zoo_inlet *in = &s->problem->inlet;
    double h = in->period / in->n_samples, x = t / h;
    int i = whole(x, in->n_samples);
    if (i >= in->n_samples)
        return s->curve_sum[in->n_samples];
    double f = x - i, a = in->curve[i], b = in->curve[(i + 1) % in->n_samples];
    return s->curve_sum[i] + h * f * (a + 0.5 * f * (b - a));
}

void zoo_curve_step(zoo_sim *s)
{
    const zoo_inlet *in = &s->problem->inlet;
    double before = 0.0;
    for (int i = 0; i <= s->n_steps; i++) {
        double t = i == s->n_steps ? in->period : i * s->dt, x = t / in->period * in->n_samples;
        int m = whole(x, in->n_samples);
        double f = x - m, now = integral(s, t);
        s->curve_node[i] = (1.0 - f) * in->curve[m % in->n_samples] + f * in->curve[(m + 1) % in->n_samples];
        if (i > 0)
            s->curve_mean[i - 1] = (now - before) / s->dt;
        before = now;
    }
}
