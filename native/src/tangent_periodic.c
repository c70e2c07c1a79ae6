/* Derivatives of the periodic state.
 *
 * With J the derivative of one beat's end by its start, and b that of the end by the arguments, the derivative x of the
 * periodic state solves (I - J) x = b; samples depend on x and the arguments linearly.  One beat with changed arguments
 * and an unchanged start gives b and the arguments' own part of the samples.  Each further beat takes vectors v through
 * the beat: w = v - J v, and the samples c of v.  What is left of all b is made least by combinations of all w (GCR, with
 * the directions' vectors pooled), and the samples follow by the same combinations of c: x itself is not needed.
 * New vectors are what is left of the b's, as far as they differ; places that the directions leave empty in the first beat
 * take the changes of the run's own last beats, in which the slowest decays are, and later what a beat made of these.
 * Norms weight the state as pressures (periodic.c). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tangent.h"

enum { D = ZOO_DIRECTIONS };

/* The run's state into that of a point. */
static void copy_state(zoo_sim *to, const zoo_sim *from)
{
    const size_t n = (size_t)from->n_nodes * sizeof(double), nt = (size_t)from->outlets.count * sizeof(double);
    memcpy(to->A, from->A, n);
    memcpy(to->q, from->q, n);
    if (from->extra)
        memcpy(to->z, from->z, n);
    memcpy(to->outlets.v, from->outlets.v, nt * (size_t)from->outlets.rows.pressures);
    memcpy(to->outlets.carry, from->outlets.carry, nt * (size_t)from->outlets.rows.flows);
}

/* What the walls' pressure changes while the state is left alone, of all points. */
static void set_points(zoo_tangent *t, int step)
{
    const zoo_sim *s = t->s;
    for (int i = 0; i < t->n_points; i++)
        memset(t->block[t->points[i].direction / D].out_P, 0, (size_t)s->n_nodes * D * sizeof(double));
    for (int i = 0; i < t->n_points; i++) {
        zoo_point *p = &t->points[i];
        copy_state(&p->sim, s);
        zoo_refresh_at(&p->sim, step);
        double *P = t->block[p->direction / D].out_P + p->direction % D;
        for (ptrdiff_t j = 0; j < s->n_nodes; j++)
            P[j * D] += p->weight * (p->sim.P[j] - s->P[j]);
    }
}

/* What a step of the points adds to the blocks.  Returns the direction of a point that fails, or -1. */
static int step_points(zoo_tangent *t, int step)
{
    const zoo_sim *s = t->s;
    const ptrdiff_t size = (ptrdiff_t)s->n_state * D;
    double *change = t->scratch, *x = change + t->n_blocks * size, *own = x + s->n_state;
    memset(change, 0, (size_t)(t->n_blocks * size) * sizeof *change);
    zoo_pack(s, own);
    for (int i = 0; i < t->n_points; i++) {
        zoo_point *p = &t->points[i];
        if (zoo_step(&p->sim, step) || p->sim.no_root)
            return p->direction;
        zoo_pack(&p->sim, x);
        double *to = change + p->direction / D * size + p->direction % D;
        for (ptrdiff_t j = 0; j < s->n_state; j++)
            to[j * D] += p->weight * (x[j] - own[j]);
    }
    for (int b = 0; b < t->n_blocks; b++)
        zoo_tangent_add(t, b, change + b * size);
    return -1;
}

static void emit(zoo_tangent *t, int step)
{
    for (int k = 0; k < t->n_blocks; k++) {
        zoo_block *b = &t->block[k];
        b->next_time = zoo_output_emit(t->s, step, D, b->ring, b->sample, b->next_time);
    }
}

/* The start of a beat from the run's state and from what stands in the blocks. */
static void begin(zoo_tangent *t)
{
    for (int k = 0; k < t->n_blocks; k++)
        t->block[k].next_time = 0;
    zoo_tangent_begin(t);
    if (t->forced)
        set_points(t, 0);
    if (t->s->problem->outputs.n_series > 0)
        zoo_tangent_record(t, 0);
}

int32_t zoo_tangent_advance(zoo_tangent *t, int step, zoo_tangent_report *report)
{
    if (zoo_tangent_step(t, step) || t->s->no_root)
        return ZOO_COLLAPSE;
    if (t->forced && t->n_points > 0) {
        const int failed = step_points(t, step);
        if (failed >= 0) {
            report->direction = failed;
            return ZOO_NO_DERIVATIVE;
        }
        set_points(t, step + 1);
    }
    if (t->s->problem->outputs.n_series > 0) {
        zoo_tangent_record(t, step + 1);
        emit(t, step + 1);
    }
    return ZOO_OK;
}

/* One beat from what stands in the blocks, and from `start` where the run goes along. */
static int32_t beat(zoo_tangent *t, zoo_tangent_report *report)
{
    zoo_sim *s = t->s;
    int32_t status = ZOO_OK;
    if (!t->done)
        zoo_unpack(s, t->start);
    s->no_root = 0;
    begin(t);
    for (int step = 0; step < s->n_steps && status == ZOO_OK; step++)
        status = zoo_tangent_advance(t, step, report);
    report->beats++;
    return status;
}

ZOO_CLONES static double dot(const double *weight, const double *a, const double *b, ptrdiff_t n)
{
    double part[8] = {0.0}, sum = 0.0; /* apart, so that they need not wait for each other */
    for (ptrdiff_t i = n / 8 * 8; i < n; i++)
        sum += weight[i] * weight[i] * a[i] * b[i];
    for (ptrdiff_t i = 0; i + 8 <= n; i += 8)
        ZOO_SIMD for (int k = 0; k < 8; k++)
            part[k] += weight[i + k] * weight[i + k] * a[i + k] * b[i + k];
    for (int k = 0; k < 8; k++)
        sum += part[k];
    return sum;
}

ZOO_CLONES static void add(double *restrict to, double factor, const double *restrict from, ptrdiff_t n)
{
    ZOO_SIMD for (ptrdiff_t i = 0; i < n; i++)
        to[i] += factor * from[i];
}

/* State or samples of direction d: from its place in a block, or into it. */
static void take(const double *block, int d, double *to, ptrdiff_t n)
{
    for (ptrdiff_t i = 0; i < n; i++)
        to[i] = block[i * D + d];
}

static void put(double *block, int d, const double *from, ptrdiff_t n)
{
    for (ptrdiff_t i = 0; i < n; i++)
        block[i * D + d] = from ? from[i] : 0.0;
}

/* Largest weighted element; NaN if there is one. */
static double largest(const double *weight, const double *a, ptrdiff_t n)
{
    double most = 0.0;
    for (ptrdiff_t i = 0; i < n; i++) {
        const double x = fabs(weight[i] * a[i]);
        if (isnan(x))
            return x;
        if (x > most)
            most = x;
    }
    return most;
}

/* Orthogonal directions of what is left, as far as it counts: `left` [m][n] is copied to `to` [m][n], with the largest
 * one first.  Returns how many. */
static int new_vectors(const double *weight, const double *left, const double *scale, const int *open, int m, ptrdiff_t n,
                       double least, double *to, double *size)
{
    int found = 0;
    for (int d = 0; d < m; d++) {
        memcpy(to + d * n, left + d * n, (size_t)n * sizeof *to);
        size[d] = open[d] ? sqrt(dot(weight, to + d * n, to + d * n, n)) / scale[d] : 0.0;
    }
    for (; found < m; found++) {
        int best = found;
        for (int d = found; d < m; d++)
            best = size[d] > size[best] ? d : best;
        if (!(size[best] > least))
            break;
        double *a = to + found * n, *b = to + best * n, norm;
        for (ptrdiff_t i = 0; i < n && best != found; i++) {
            const double x = a[i];
            a[i] = b[i];
            b[i] = x;
        }
        const double s = size[found];
        size[found] = size[best];
        size[best] = s;
        norm = sqrt(dot(weight, a, a, n));
        for (ptrdiff_t i = 0; i < n; i++)
            a[i] /= norm;
        for (int d = found + 1; d < m; d++) {
            if (size[d] == 0.0)
                continue;
            double *c = to + d * n, before = sqrt(dot(weight, c, c, n));
            add(c, -dot(weight, a, c, n), a, n);
            size[d] = before > 0.0 ? size[d] * sqrt(dot(weight, c, c, n)) / before : 0.0;
        }
    }
    return found;
}

/* Vector number `found` of `to`, made orthogonal to those before it and of length 1.  Returns how many there are then: as
 * many as before where next to nothing is left of it. */
static int join(const double *weight, double *to, int found, ptrdiff_t n)
{
    double *v = to + found * n;
    const double before = sqrt(dot(weight, v, v, n));
    for (int again = 0; again < 2; again++)
        for (int u = 0; u < found; u++)
            add(v, -dot(weight, v, to + u * n, n), to + u * n, n);
    const double norm = sqrt(dot(weight, v, v, n));
    if (!(norm > 1e-6 * before))
        return found;
    for (ptrdiff_t i = 0; i < n; i++)
        v[i] /= norm;
    return found + 1;
}

/* Changes of the run over its last beats, orthogonal and of length 1, at most `most`; how many.  The oldest of them come
 * first: of the newest, rounding is a larger part.  Those before them are of a run that is far from periodic. */
static int run_changes(const zoo_sim *s, int most, double *to)
{
    const ptrdiff_t n = s->n_state;
    const int beats = s->report.beats, past = beats < ZOO_HISTORY ? beats : ZOO_HISTORY;
    int found = 0;
    for (int k = (past < most ? past : most) - 1; k >= 0; k--) {
        for (ptrdiff_t i = 0; i < n; i++)
            to[found * n + i] = s->ends[k * n + i] - s->states[k * n + i];
        found = join(s->weight, to, found, n);
    }
    return found;
}

/* More vectors for places that would stand empty: what a beat made of those that filled such places before, up to `most`
 * with the `found` that are there.  Returns how many there are then. */
static int fill_vectors(const double *weight, const double *spare, int n_spare, int found, int most, ptrdiff_t n, double *to)
{
    for (int k = 0; k < n_spare && found < most; k++) {
        memcpy(to + found * n, spare + k * n, (size_t)n * sizeof *to);
        found = join(weight, to, found, n);
    }
    return found;
}

/* After a beat in which `found` vectors stood in the places from `place` on: w = v - J v orthogonal to all that are kept,
 * and of length 1, with the samples that belong to it; and what is left of the directions without its part. */
static double *absorb(const zoo_tangent *t, const double *vectors, int place, int found, double *const *kept, const int *count,
                      int round, ptrdiff_t m, double *left, double *samples)
{
    const zoo_sim *s = t->s;
    const zoo_outputs *out = &s->problem->outputs;
    const ptrdiff_t n = s->n_state, n_out = (ptrdiff_t)out->n_series * 3 * out->n_times;
    double *w = malloc((size_t)(found * (n + n_out) + 1) * sizeof *w);
    for (int v = 0; v < found && w; v++) {
        double *a = w + v * (n + n_out);
        take(t->block[(place + v) / D].state, (place + v) % D, a, n);
        take(t->block[(place + v) / D].sample, (place + v) % D, a + n, n_out);
        for (ptrdiff_t i = 0; i < n; i++)
            a[i] = vectors[v * n + i] - a[i];
        for (int again = 0; again < 2; again++)
            for (int r = 0; r <= round; r++)
                for (int u = 0; u < (r < round ? count[r] : v); u++) {
                    const double *b = (r < round ? kept[r] : w) + u * (n + n_out);
                    add(a, -dot(s->weight, a, b, n), b, n + n_out);
                }
        const double norm = sqrt(dot(s->weight, a, a, n));
        for (ptrdiff_t i = 0; i < n + n_out; i++)
            a[i] = norm > 1e-12 ? a[i] / norm : 0.0;
        for (ptrdiff_t d = 0; d < m; d++) {
            const double part = dot(s->weight, a, left + d * n, n);
            add(left + d * n, -part, a, n);
            add(samples + d * n_out, part, a + n, n_out);
        }
    }
    return w;
}

int32_t zoo_tangent_first(zoo_tangent *t)
{
    const zoo_sim *s = t->s;
    const size_t n = (size_t)s->n_state, places = (size_t)t->n_blocks * D;
    t->start = malloc(n * sizeof *t->start);
    t->seeds = malloc(places * n * sizeof *t->seeds);
    t->scratch = malloc((t->n_points > 0 ? places * n + 2 * n : 1) * sizeof *t->scratch);
    if (!t->start || !t->seeds || !t->scratch)
        return ZOO_WORKSPACE;
    zoo_pack(s, t->start);
    for (int k = 0; k < t->n_blocks; k++)
        memset(t->block[k].state, 0, n * D * sizeof(double));
    t->n_seeds = run_changes(s, (int)places - t->n_directions, t->seeds);
    for (int v = 0, place = t->n_directions; v < t->n_seeds; v++, place++)
        put(t->block[place / D].state, place % D, t->seeds + (size_t)v * n, s->n_state);
    t->forced = 1;
    begin(t);
    return ZOO_OK;
}

int32_t zoo_tangent_periodic(zoo_tangent *t, double tolerance, double *samples, zoo_tangent_report *report)
{
    const zoo_sim *s = t->s;
    const zoo_outputs *out = &s->problem->outputs;
    const ptrdiff_t n = s->n_state, n_out = (ptrdiff_t)out->n_series * 3 * out->n_times, m = t->n_directions;
    const int n_blocks = t->n_blocks, max_beats = s->problem->numerics.max_beats;
    int n_spare = t->n_seeds;
    double *left = malloc((size_t)(m * n) * sizeof *left), *vectors = malloc((size_t)((m + D) * n) * sizeof *vectors),
           *spare = malloc((size_t)(D * n) * sizeof *spare), *size = malloc((size_t)m * sizeof *size),
           *scale = malloc((size_t)m * sizeof *scale);
    int *open = malloc((size_t)m * sizeof *open);
    double **kept = calloc((size_t)max_beats + 1, sizeof *kept); /* of each beat, [found][n + n_out] */
    int *count = calloc((size_t)max_beats + 1, sizeof *count);
    int32_t status = left && vectors && spare && size && scale && open && kept && count ? ZOO_OK : ZOO_WORKSPACE;
    report->beats++;
    for (ptrdiff_t d = 0; d < m && status == ZOO_OK; d++) {
        take(t->block[d / D].state, (int)(d % D), left + d * n, n);
        take(t->block[d / D].sample, (int)(d % D), samples + d * n_out, n_out);
    }
    if (status == ZOO_OK && n_spare > 0) {
        count[0] = n_spare;
        kept[0] = absorb(t, t->seeds, (int)m, n_spare, kept, count, 0, m, left, samples);
        status = kept[0] ? ZOO_OK : ZOO_WORKSPACE;
        for (ptrdiff_t v = 0; v < n_spare; v++)
            take(t->block[(m + v) / D].state, (int)((m + v) % D), spare + v * n, n);
    }
    t->forced = 0;
    t->done = t->kept != NULL;
    for (int round = 1; status == ZOO_OK; round++) {
        int unfinished = 0;
        report->residual = 0.0;
        for (int d = 0; d < m; d++) {
            double most = n_out > 0 ? 0.0 : largest(s->weight, left + d * n, n);
            for (ptrdiff_t i = 0; i < n_out && !isnan(most); i += 3) {
                const double p = fabs(samples[d * n_out + i]);
                most = p > most || isnan(p) ? p : most;
            }
            const double error = largest(s->weight, left + d * n, n) / (1.0 - s->slow);
            if (!isfinite(error) || !isfinite(most)) {
                status = ZOO_NO_DERIVATIVE;
                report->direction = d;
                break;
            }
            scale[d] = most > 0.0 ? most : 1.0;
            open[d] = error > tolerance * scale[d];
            unfinished |= open[d];
            report->residual = fmax(report->residual, error / scale[d]);
        }
        if (status != ZOO_OK || !unfinished)
            break;
        if (round > max_beats) {
            status = ZOO_NOT_PERIODIC;
            break;
        }
        int found = new_vectors(s->weight, left, scale, open, (int)m, n, 0.1 * tolerance * (1.0 - s->slow), vectors, size);
        const int filled = found;
        t->n_blocks = (found + D - 1) / D;
        found = fill_vectors(s->weight, spare, n_spare, found, t->n_blocks * D, n, vectors);
        for (int v = 0; v < t->n_blocks * D; v++)
            put(t->block[v / D].state, v % D, v < found ? vectors + v * n : NULL, n);
        status = beat(t, report);
        if (status != ZOO_OK)
            break;
        n_spare = found - filled;
        for (int v = 0; v < n_spare; v++)
            take(t->block[(filled + v) / D].state, (filled + v) % D, spare + v * n, n);
        report->vectors += filled;
        count[round] = found;
        if (!(kept[round] = absorb(t, vectors, 0, found, kept, count, round, m, left, samples)))
            status = ZOO_WORKSPACE;
    }
    t->n_blocks = n_blocks;
    for (int r = 0; r <= max_beats && kept; r++)
        free(kept[r]);
    double *reals[] = {left, vectors, spare, size, scale};
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        free(reals[i]);
    free(open);
    free(kept);
    free(count);
    return status;
}
