/* The coefficients of a beat's steps, kept for the beats after it.
 *
 * What a step's coefficients cost is their way through the memory. So those of the nodes are kept as 32-bit integers over
 * about the largest of each array, which is within 4e-10 of that; those of junctions, outlets and outputs as they are. */
#include <math.h>
#include <string.h>

#include "inlet.h"
#include "tangent.h"

static const double most_kept = 2147483647.0;
/* 1.5 2^52: the last bits of a sum with it are the other number as an integer, rounded, whatever the number was. */
static const double to_last_bits = 6755399441055744.0;

/* Elements of an array of the nodes with its padding, and of all that is not at nodes. */
static size_t stride_of(const zoo_tangent *t)
{
    return ((size_t)t->s->n_nodes + 7) / 8 * 8;
}

static size_t rest_of(const zoo_tangent *t)
{
    return t->size - ZOO_NODE_ROWS * stride_of(t);
}

size_t zoo_tangent_kept(const zoo_tangent *t)
{
    return (ZOO_NODE_ROWS + ZOO_NODE_ROWS * stride_of(t) / 2 + rest_of(t) + 7) / 8 * 8;
}

size_t zoo_tangent_place(zoo_tangent *t, double *at)
{
    const zoo_sim *s = t->s;
    const size_t series = 4 * (size_t)s->problem->outputs.n_series, outlets = ZOO_OUTLET_ROWS * (size_t)s->outlets.count;
    size_t ends = 0, used = 0;
    for (int g = 0; g < s->n_groups; g++)
        ends += (size_t)s->groups[g].count * s->groups[g].branches;
    double **rows[] = {&t->hA0, &t->hA1, &t->hq0, &t->hq1, &t->fA0, &t->fA1, &t->fq0, &t->fq1, &t->seen, &t->outlet, &t->row, &t->inlet};
    const size_t each = s->extra ? ZOO_ADDED_ROWS : ZOO_PLAIN_ROWS, inlet = s->problem->inlet.kind == ZOO_INLET_PRESSURE ? each : 0;
    const size_t sizes[] = {series, outlets, each * ends, inlet};
    for (int i = 0; i < ZOO_NODE_ROWS + 4; i++) {
        if (at)
            *rows[i] = at + used;
        used += i < ZOO_NODE_ROWS ? stride_of(t) : sizes[i - ZOO_NODE_ROWS];
    }
    return (used + 7) / 8 * 8;
}

/* As integers over `most`; returns the largest, which may be more: then they are of no use. */
ZOO_CLONES static double to_integers_over(const double *restrict from, size_t n, double most, uint32_t *restrict to)
{
    const double by = most > 0.0 && most < INFINITY ? most_kept / most : 0.0;
    double part[8] = {0.0}, largest = 0.0;
    for (size_t i = 0; i < n; i += 8)
        ZOO_SIMD for (int k = 0; k < 8; k++) {
            const double x = fabs(from[i + k]), sum = from[i + k] * by + to_last_bits;
            uint64_t bits;
            memcpy(&bits, &sum, sizeof bits);
            to[i + k] = (uint32_t)bits;
            part[k] = x > part[k] ? x : part[k];
        }
    for (int k = 0; k < 8; k++)
        largest = part[k] > largest ? part[k] : largest;
    return largest;
}

/* Over what the step before was, unless this one's largest is beyond it or far below; then with some room for the next. */
static double to_integers(const double *from, size_t n, double *over, uint32_t *to)
{
    const double largest = to_integers_over(from, n, *over, to);
    if (largest > *over || largest < 0.7 * *over) {
        *over = 1.2 * largest;
        to_integers_over(from, n, *over, to);
    }
    return *over / most_kept;
}

ZOO_CLONES static void to_reals(const int32_t *restrict from, size_t n, double scale, double *restrict to)
{
    ZOO_SIMD for (size_t i = 0; i < n; i++)
        to[i] = scale * from[i];
}

void zoo_tangent_keep(zoo_tangent *t, int step)
{
    const size_t stride = stride_of(t);
    double *at = t->kept + (size_t)step * zoo_tangent_kept(t);
    uint32_t *integers = (uint32_t *)(at + ZOO_NODE_ROWS);
    for (int i = 0; i < ZOO_NODE_ROWS; i++)
        at[i] = to_integers(t->one + i * stride, stride, &t->over[i], integers + i * stride);
    memcpy(integers + ZOO_NODE_ROWS * stride, t->one + ZOO_NODE_ROWS * stride, rest_of(t) * sizeof(double));
}

void zoo_tangent_recall(zoo_tangent *t, int step)
{
    const size_t stride = stride_of(t), kept = zoo_tangent_kept(t);
    const double *at = t->kept + (size_t)step * kept;
    const int32_t *integers = (const int32_t *)(at + ZOO_NODE_ROWS);
    for (int i = 0; i < ZOO_NODE_ROWS; i++)
        to_reals(integers + i * stride, stride, at[i], t->one + i * stride);
    memcpy(t->one + ZOO_NODE_ROWS * stride, integers + ZOO_NODE_ROWS * stride, rest_of(t) * sizeof(double));
    t->ahead = (const char *)(at + kept);
    t->ahead_by = (kept * sizeof(double) + t->s->n_nodes - 1) / t->s->n_nodes;
}
