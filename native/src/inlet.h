/* The kinds of inlets, at the root's node 0.
 *
 * A kind is a header inlet_NAME.h, included below, and an entry in ZOO_INLETS; its number is its place
 * there.  Its curve stands at the steps and as a mean over each of them (curve.c).  The header holds, for a
 * kind called `flow`,
 *
 *   flow_bad(pr)           1 if the curve, whose samples are finite, or another argument is out of range
 *   flow_mean(s, resistance, against)   mean flow into the root, ml/s, from which the first beat starts: may be a
 *                          guess; it makes the root's pressure resistance times flow + against
 *   flow_sample(s, i)      flow at sample i of the curve; NaN where it is not given
 *   flow_volume(s)         ml that entered in a beat
 *   flow_advance(wall, extra, s, step)   area and flow of node 0 at the end of the step: one condition,
 *                          and the mass balance of the half cell
 */
#ifndef ZOO_INLET_H
#define ZOO_INLET_H

#include "internal.h"
#include "values.h"

/* The half cell at node 0 as the one branch of a junction. */
ZOO_INLINE zoo_junction_group inlet_branch(const zoo_sim *s)
{
    int *zero = s->first; /* node, midpoint and junction 0 */
    double *own = s->inlet_cell;
    return (zoo_junction_group){.count = 1, .branches = 1, .node = zero, .mid = zero, .junction = zero, .w = own,
                                .per_w = own + 1, .sign = own + 2, .sum_c = own + 3, .A0 = s->A0, .f_s = s->f_s,
                                .f_c = s->f_c};
}

#include "inlet_flow.h"
#include "inlet_pressure.h"
#define ZOO_INLETS(KIND, ...)     \
    KIND(FLOW, flow, __VA_ARGS__) \
    KIND(PRESSURE, pressure, __VA_ARGS__)

#define INLET_NUMBER(NAME, name, ...) ZOO_INLET_##NAME,
#define INLET_CASE(NAME, name, function, ...) \
    case ZOO_INLET_##NAME:                    \
        return name##_##function(__VA_ARGS__);
#define INLET_RETURN(kind, otherwise, ...)  \
    switch (kind) {                         \
        ZOO_INLETS(INLET_CASE, __VA_ARGS__) \
    default:                                \
        return otherwise;                   \
    }

enum { ZOO_INLETS(INLET_NUMBER, ) ZOO_N_INLETS };

static inline int inlet_bad(const zoo_problem *pr)
{
    if (value_bad(pr->inlet.period) || pr->inlet.n_samples < 4 || pr->inlet.n_samples > ZOO_MOST || !pr->inlet.curve ||
        values_outside(pr->inlet.curve, pr->inlet.n_samples, -INFINITY, INFINITY))
        return 1;
    INLET_RETURN(pr->inlet.kind, 1, bad, pr)
}

static inline double inlet_mean(const zoo_sim *s, double resistance, double against)
{
    INLET_RETURN(s->problem->inlet.kind, NAN, mean, s, resistance, against)
}

static inline double inlet_sample(const zoo_sim *s, int i)
{
    INLET_RETURN(s->problem->inlet.kind, NAN, sample, s, i)
}

static inline double inlet_volume(const zoo_sim *s)
{
    INLET_RETURN(s->problem->inlet.kind, NAN, volume, s)
}

#define INLET_ADVANCE(NAME, name, ...) \
    case ZOO_INLET_##NAME:             \
        name##_advance(__VA_ARGS__);   \
        break;

ZOO_INLINE void inlet_advance(const int wall, const int extra, zoo_sim *s, int step)
{
    switch (s->problem->inlet.kind) {
        ZOO_INLETS(INLET_ADVANCE, wall, extra, s, step)
    }
}

#endif
