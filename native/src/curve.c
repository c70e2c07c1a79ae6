/* Curves over the beat, of the inlet and of the pressures behind the outlets: samples over one period, linear
 * between, periodic; at the steps, and their exact mean over each of them. */
#include "internal.h"
#include "values.h"

typedef struct {
    const double *samples, *sum; /* [n], [n+1] running integral */
    int n;
    double period;
} curve;

static void integrate(double *sum, const double *samples, int n, double period)
{
    double h = period / n;
    sum[0] = 0.0;
    for (int i = 0; i < n; i++)
        sum[i + 1] = sum[i] + 0.5 * h * (samples[i] + samples[(i + 1) % n]);
}

/* Integral from 0 to t (0 <= t <= period), exact for the piecewise linear curve. */
static double integral(curve c, double t)
{
    double h = c.period / c.n, x = t / h;
    int i = whole(x, c.n);
    if (i >= c.n)
        return c.sum[c.n];
    double f = x - i, a = c.samples[i], b = c.samples[(i + 1) % c.n];
    return c.sum[i] + h * f * (a + 0.5 * f * (b - a));
}

static double value(curve c, double t)
{
    double x = t / c.period * c.n;
    int m = whole(x, c.n);
    double f = x - m;
    return (1.0 - f) * c.samples[m % c.n] + f * c.samples[(m + 1) % c.n];
}

static double time_of(const zoo_sim *s, int step)
{
    return step == s->n_steps ? s->problem->inlet.period : step * s->dt;
}

/* The running integrals of the samples. */
void zoo_curve_sum(zoo_sim *s)
{
    const zoo_inlet *in = &s->problem->inlet;
    const zoo_outlet *out = &s->problem->outlet;
    integrate(s->curve_sum, in->curve, in->n_samples, in->period);
    for (ptrdiff_t t = 0; t < s->outlets.count && out->n_wave > 0; t++)
        integrate(s->outlets.wave_sum + t * (out->n_wave + 1), out->wave + (ptrdiff_t)s->outlets.vessel[t] * out->n_wave,
                  out->n_wave, in->period);
}

void zoo_curve_step(zoo_sim *s)
{
    const zoo_inlet *in = &s->problem->inlet;
    const curve c = {in->curve, s->curve_sum, in->n_samples, in->period};
    double before = 0.0;
    for (int i = 0; i <= s->n_steps; i++) {
        double t = time_of(s, i), now = integral(c, t);
        s->curve_node[i] = value(c, t);
        if (i > 0)
            s->curve_mean[i - 1] = (now - before) / s->dt;
        before = now;
    }
}

/* What is added to the pressures behind the outlets in a step. */
void zoo_curve_behind(zoo_sim *s, int step)
{
    const zoo_outlet *out = &s->problem->outlet;
    zoo_terminals *ou = &s->outlets;
    const double from = time_of(s, step), to = time_of(s, step + 1);
    for (ptrdiff_t t = 0; t < ou->count; t++) {
        const curve c = {out->wave + (ptrdiff_t)ou->vessel[t] * out->n_wave, ou->wave_sum + t * (out->n_wave + 1),
                         out->n_wave, s->problem->inlet.period};
        ou->wave_now[t] = value(c, from);
        ou->wave_then[t] = value(c, to);
        ou->wave_mean[t] = (integral(c, to) - integral(c, from)) / s->dt;
    }
}
