/* The kinds of outlets, at the ends of the terminal vessels.
 *
 * A kind is a header outlet_NAME.h, included below, and an entry in ZOO_OUTLETS; its number is its place
 * there.  The header holds, for a kind called `windkessel`,
 *
 *   windkessel_loops                 in which loops of step.c it can run: OUTLET_PLAIN, OUTLET_ADDED, or both
 *   windkessel_bad(pr, children)     1 if an argument is out of range (R1 is positive already, R2 and C positive or R2 zero)
 *   windkessel_adds(pr, children)    1 if it needs the loops with additions
 *   windkessel_rows(pr)              how many rows of [count] it has of coefficients, of pressures and flows
 *                                    in its state, and of scratch
 *   windkessel_set_step(s)           the coefficients, for a time step
 *   windkessel_resistance(s, t)      dyn s/cm^5, of terminal t in steady flow
 *   windkessel_capacity(s, t)        cm^5/dyn; both for the start of the first beat
 *   windkessel_start(s, t)           the state, from pressure and flow of the vessel's end
 *   windkessel_advance(wall, extra, s) area and flow of the vessels' ends and the state over a step, and what
 *                                    left in it: one condition, and the mass balance of the half cell
 *
 * Rows are numbered by enums of the kind; outlet_row is the start of one.
 */
#ifndef ZOO_OUTLET_H
#define ZOO_OUTLET_H

#include "internal.h"
#include "values.h"

enum { OUTLET_PLAIN = 1, OUTLET_ADDED = 2 };
#define OUTLET_MOST_LOG 30.0 /* of the logarithm of a factor */

/* Row m of a block, [count]. */
ZOO_INLINE double *outlet_row(const zoo_sim *s, double *block, int m)
{
    return block + (ptrdiff_t)m * s->outlets.count;
}

#define ZOO_OUTLETS(KIND, ...)                \
    KIND(WINDKESSEL, windkessel, __VA_ARGS__) \
    KIND(CIRCUIT, circuit, __VA_ARGS__)

#define OUTLET_NUMBER(NAME, name, ...) ZOO_OUTLET_##NAME,
enum { ZOO_OUTLETS(OUTLET_NUMBER, ) ZOO_N_OUTLETS };

#include "outlet_windkessel.h"
#include "outlet_circuit.h"

/* What the kind's own function returns; `otherwise` for a number that is not in the list. */
#define OUTLET_CASE(NAME, name, function, ...) \
    case ZOO_OUTLET_##NAME:                    \
        return name##_##function(__VA_ARGS__);
#define OUTLET_RETURN(kind, otherwise, ...)   \
    switch (kind) {                           \
        ZOO_OUTLETS(OUTLET_CASE, __VA_ARGS__) \
    default:                                  \
        return otherwise;                     \
    }
/* The same for functions that return nothing. */
#define OUTLET_CASE_DO(NAME, name, function, ...) \
    case ZOO_OUTLET_##NAME:                       \
        name##_##function(__VA_ARGS__);           \
        break;
#define OUTLET_DO(kind, ...)                     \
    switch (kind) {                              \
        ZOO_OUTLETS(OUTLET_CASE_DO, __VA_ARGS__) \
    }

static inline int outlet_bad(const zoo_problem *pr, const int *children)
{
    const zoo_outlet *out = &pr->outlet;
    if (!out->R1 || !out->R2 || !out->C ||
        zoo_function_bad(&out->resistance_function, -ZOO_MOST_VALUE, -OUTLET_MOST_LOG, OUTLET_MOST_LOG) ||
        zoo_function_bad(&out->compliance_function, -ZOO_MOST_VALUE, -OUTLET_MOST_LOG, OUTLET_MOST_LOG))
        return 1;
    if (out->n_wave < 0 || out->n_wave > ZOO_MOST || (out->n_wave > 0 && !out->wave))
        return 1;
    for (ptrdiff_t k = 0; k < pr->network.n_vessels && out->n_wave > 0; k++)
        if (children[k] == 0 && values_outside(out->wave + k * out->n_wave, out->n_wave, -ZOO_MOST_VALUE, ZOO_MOST_VALUE))
            return 1;
    for (int k = 0; k < pr->network.n_vessels; k++)
        if (children[k] == 0 &&
            (value_bad(out->R1[k]) || (out->R2[k] != 0.0 && (value_bad(out->R2[k]) || value_bad(out->C[k]))) ||
             !isfinite(value_or_zero(out->pressure, k))))
            return 1;
    OUTLET_RETURN(pr->outlet.kind, 1, bad, pr, children)
}

/* Whether resistances or compliances depend on the pressure behind R1; then they have the loops of circuits. */
ZOO_INLINE int outlet_depends(const zoo_problem *pr)
{
    return pr->outlet.resistance_function.n_knots || pr->outlet.compliance_function.n_knots;
}

static inline int outlet_adds(const zoo_problem *pr, const int *children)
{
    if (outlet_depends(pr) || pr->outlet.n_wave > 0)
        return 1;
    OUTLET_RETURN(pr->outlet.kind, 0, adds, pr, children)
}

/* The kind whose loops are run.  A circuit without inertance and with one section is the Windkessel, whose
 * own loops are for vessels without additions. */
static inline int outlet_kind(const zoo_problem *pr, int extra)
{
    if (pr->outlet.kind == ZOO_OUTLET_WINDKESSEL || pr->outlet.kind == ZOO_OUTLET_CIRCUIT)
        return extra ? ZOO_OUTLET_CIRCUIT : ZOO_OUTLET_WINDKESSEL;
    return pr->outlet.kind;
}

static inline zoo_rows outlet_rows(int kind, const zoo_problem *pr)
{
    OUTLET_RETURN(kind, (zoo_rows){0}, rows, pr)
}

static inline void outlet_set_step(zoo_sim *s)
{
    OUTLET_DO(s->outlets.kind, set_step, s)
}

static inline double outlet_resistance(const zoo_sim *s, int t)
{
    OUTLET_RETURN(s->outlets.kind, NAN, resistance, s, t)
}

static inline double outlet_capacity(const zoo_sim *s, int t)
{
    OUTLET_RETURN(s->outlets.kind, NAN, capacity, s, t)
}

static inline void outlet_start(zoo_sim *s, int t)
{
    OUTLET_DO(s->outlets.kind, start, s, t)
}

#define OUTLET_ADVANCE(NAME, name, ...)                              \
    case ZOO_OUTLET_##NAME:                                          \
        if (name##_loops & (extra ? OUTLET_ADDED : OUTLET_PLAIN)) \
            name##_advance(__VA_ARGS__);                             \
        break;

ZOO_INLINE void outlet_advance(const int wall, const int extra, zoo_sim *s)
{
    switch (s->outlets.kind) {
        ZOO_OUTLETS(OUTLET_ADVANCE, wall, extra, s)
    }
}

#endif
