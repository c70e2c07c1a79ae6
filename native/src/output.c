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

static double *ring_at(const zoo_sim *s, int step)
{
    return s->ring + (size_t)(step & 3) * s->problem->outputs.n_series * 3 * s->lanes;
}

static void record(zoo_sim *s, int step)
{
    int W = s->lanes, n = s->problem->outputs.n_series;
    double *to = ring_at(s, step);
    for (int i = 0; i < n; i++) {
        const int *node = s->out_node + 4 * i;
        const double *w = s->out_weight + 4 * i;
        for (int l = 0; l < W; l++) {
            double p = 0.0, q = 0.0, A = 0.0;
            for (int m = 0; m < 4; m++) {
                int o = node[m] * W + l;
                p += w[m] * s->P[o];
                q += w[m] * s->q[o];
                A += w[m] * s->A[o];
            }
            to[(i * 3 + 0) * W + l] = p;
            to[(i * 3 + 1) * W + l] = q;
            to[(i * 3 + 2) * W + l] = A;
        }
    }
}

/* All samples at or before time `until` (in steps), from the four steps first .. first+3. */
static void emit(zoo_sim *s, int first, double until)
{
    const zoo_outputs *out = &s->problem->outputs;
    int size = out->n_series * 3 * s->lanes;
    for (; s->next_time < out->n_times; s->next_time++) {
        double x = out->times[s->next_time] / s->dt;
        if (x > until)
            return;
        double y = x - first;
        double w[4] = {-(y - 1) * (y - 2) * (y - 3) / 6.0, y * (y - 2) * (y - 3) / 2.0,
                       -y * (y - 1) * (y - 3) / 2.0, y * (y - 1) * (y - 2) / 6.0};
        double *to = s->sample + (size_t)s->next_time * size;
        const double *a = ring_at(s, first), *b = ring_at(s, first + 1), *c = ring_at(s, first + 2),
                     *d = ring_at(s, first + 3);
        for (int i = 0; i < size; i++)
            to[i] = w[0] * a[i] + w[1] * b[i] + w[2] * c[i] + w[3] * d[i];
    }
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
    zoo_output_emit(s, step);
}

/* Samples that the last four steps in the ring give. */
void zoo_output_emit(zoo_sim *s, int step)
{
    if (step >= 3)
        emit(s, step - 3, step == s->n_steps ? step * (1.0 + 1e-9) : step - 1.0);
}

/* Whether the samples of a lane that was solved are numbers; from finite states they may still overflow. */
int zoo_output_finite(const zoo_sim *s, int lane)
{
    const zoo_outputs *out = &s->problem->outputs;
    const size_t n = (size_t)out->n_series * 3 * (size_t)out->n_times;
    for (size_t i = 0; i < n; i++)
        if (!isfinite(s->sample[i * s->lanes + lane]))
            return 0;
    return 1;
}

void zoo_output_store(const zoo_sim *s, int lane, double *pressure, double *flow, double *area)
{
    const zoo_outputs *out = &s->problem->outputs;
    double *to[3] = {pressure, flow, area};
    int64_t at = s->set_of[lane] * (int64_t)out->n_series * out->n_times;
    for (int part = 0; part < 3; part++)
        for (int i = 0; i < out->n_series; i++)
            for (int t = 0; t < out->n_times; t++)
                to[part][at + (int64_t)i * out->n_times + t] =
                    s->report[lane].status == ZOO_OK
                        ? s->sample[(((size_t)t * out->n_series + i) * 3 + part) * s->lanes + lane]
                        : NAN;
}
