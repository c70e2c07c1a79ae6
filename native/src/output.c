/* Samples of the wanted series, taken while the beat runs.
 *
 * In space: the cubic through the four nearest nodes of the vessel (the parabola
 * through all three of a vessel of two cells, the line through both of a single cell).  In time:
 * the cubic through four successive steps, centred where it can be and
 * one-sided in the first and last step of the beat, so that no sample needs
 * anything from outside it.  Both are of higher order than the scheme.
 */
#include <math.h>
#include <string.h>

#include "internal.h"
#include "values.h"

/* Weights of the cubic through four neighbouring nodes (fewer, where a vessel has no four). */
void zoo_output_weights(zoo_sim *s, int series)
{
    const zoo_outputs *out = &s->problem->outputs;
    int k = out->vessel[series], n = s->last[k] - s->first[k]; /* n cells */
    double x = out->position[series] * n;
    int points = n >= 3 ? 4 : n + 1;
    int j0 = whole(x, n) - 1;
    j0 = j0 < 0 ? 0 : j0 > n + 1 - points ? n + 1 - points : j0;
    for (int i = 0; i < 4; i++) {
        double w = i < points ? 1.0 : 0.0;
        for (int m = 0; m < points && i < points; m++)
            if (m != i)
                w *= (x - (j0 + m)) / (double)(i - m);
        s->out_node[series * 4 + i] = s->first[k] + (i < points ? j0 + i : j0);
        s->out_weight[series * 4 + i] = w;
    }
}

static void record(zoo_sim *s, int step)
{
    const int n = s->problem->outputs.n_series;
    double *to = s->ring + (size_t)(step & 3) * n * 3;
    for (int i = 0; i < n; i++) {
        const int *node = s->out_node + 4 * i;
        const double *w = s->out_weight + 4 * i;
        double p = 0.0, q = 0.0, A = 0.0;
        for (int m = 0; m < 4; m++) {
            p += w[m] * s->P[node[m]];
            q += w[m] * s->q[node[m]];
            A += w[m] * s->A[node[m]];
        }
        to[i * 3 + 0] = p;
        to[i * 3 + 1] = q;
        to[i * 3 + 2] = A;
    }
}

int zoo_output_emit(const zoo_sim *s, int step, int width, const double *ring, double *sample, int next)
{
    const zoo_outputs *out = &s->problem->outputs;
    const double until = step == s->n_steps ? step * (1.0 + 1e-9) : step - 1.0;
    const int size = out->n_series * 3 * width;
    for (; step >= 3 && next < out->n_times; next++) {
        double x = out->times[next] / s->dt;
        if (x > until)
            break;
        double y = x - (step - 3);
        double w[4] = {-(y - 1) * (y - 2) * (y - 3) / 6.0, y * (y - 2) * (y - 3) / 2.0,
                       -y * (y - 1) * (y - 3) / 2.0, y * (y - 1) * (y - 2) / 6.0};
        double *to = sample + (size_t)next * size;
        const double *at[4]; /* the four steps up to this one */
        for (int i = 0; i < 4; i++)
            at[i] = ring + (size_t)((step - 3 + i) & 3) * size;
        for (int i = 0; i < size; i++)
            to[i] = w[0] * at[0][i] + w[1] * at[1][i] + w[2] * at[2][i] + w[3] * at[3][i];
    }
    return next;
}

/* The state at the start of the beat stands in the nodes. */
void zoo_output_begin(zoo_sim *s)
{
    s->next_time = 0;
    record(s, 0);
}

/* The state after `step` steps of this beat stands in the nodes. */
void zoo_output_step(zoo_sim *s, int step)
{
    if (s->problem->outputs.n_series == 0)
        return;
    record(s, step);
    s->next_time = zoo_output_emit(s, step, 1, s->ring, s->sample, s->next_time);
}

/* Whether the samples of a run that was solved are numbers; from finite states they may still overflow. */
int zoo_output_finite(const zoo_sim *s)
{
    const zoo_outputs *out = &s->problem->outputs;
    const size_t n = (size_t)out->n_series * 3 * (size_t)out->n_times;
    for (size_t i = 0; i < n; i++)
        if (!isfinite(s->sample[i]))
            return 0;
    return 1;
}

void zoo_output_store(const zoo_sim *s, double *pressure, double *flow, double *area)
{
    const zoo_outputs *out = &s->problem->outputs;
    double *to[3] = {pressure, flow, area};
    for (int part = 0; part < 3; part++)
        for (int i = 0; i < out->n_series; i++)
            for (int t = 0; t < out->n_times; t++)
                to[part][(int64_t)i * out->n_times + t] =
                    s->report.status == ZOO_OK ? s->sample[((size_t)t * out->n_series + i) * 3 + part] : NAN;
}
