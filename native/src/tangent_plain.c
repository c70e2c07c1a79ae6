/* Directional derivatives of a step without additions.
 *
 * A step is a linear map of the change of the state, whose coefficients are the same for all directions and, on the
 * periodic state, for all beats: zoo_plain_keep makes them while the run is computed, and zoo_plain_step takes a
 * block through the step with them, once or many times.  Pressures are slope times area; where the arguments of the
 * walls change (`forced`), what they add to the pressures is made from the partials of this very step.
 *
 * With A, q at the nodes, h at the midpoints, eight directions take 15 vector instructions at a node; at a junction's
 * branch 9,
 *
 *   P = sum_b (volume A_b + inflow qh_b),   A_b' = softness P,
 *   e_b = q_b + was A_b + is A_b' + area_h Ah_b + flow_h qh_b,   q_b' = e_b - push sum_b (balance e_b),
 *
 * where what is under the sums has the pressure P' and the mid-step pressure H of junction.h eliminated. */
#include <math.h>

#include "inlet.h"
#include "outlet.h"
#include "tangent.h"

enum { D = ZOO_DIRECTIONS };
typedef double directions __attribute__((vector_size(ZOO_DIRECTIONS * sizeof(double)), may_alias));

/* Rows of coefficients of the junctions' branches and of the outlets. */
enum { VOLUME, INFLOW, SOFTNESS, WAS, IS, AREA_H, FLOW_H, BALANCE, PUSH };
enum { OUTLET_BEFORE, OUTLET_GIVE };

/* Element j of an array of directions. */
ZOO_INLINE directions *of(double *array, ptrdiff_t j)
{
    return (directions *)array + j;
}

/* What makes the walls' arguments add to the pressures at nodes, or midpoints: all by value, since the compiler must
 * take it that the vectors' stores change whatever is behind a pointer. */
typedef struct {
    const double *by_K, *shape;
    double *K, *coefficient;
    ptrdiff_t stride;
    int shapes;
} walls_change;

ZOO_INLINE walls_change change_of(const zoo_tangent *t, const zoo_block *b, const zoo_partials *p, double *K)
{
    return (walls_change){p->by_K, p->shape, K, b->coefficient, t->s->n_nodes, t->shapes};
}

ZOO_INLINE directions source(const walls_change c, ptrdiff_t j)
{
    directions sum = c.by_K[j] * *of(c.K, j);
    for (int m = 0; m < c.shapes; m++)
        sum += c.shape[m * c.stride + j] * *of(c.coefficient, m * c.stride + j);
    return sum;
}

/* Inside the vessels, midpoints and nodes in one sweep; of the midpoints only the ends' are stored. */
ZOO_INLINE void vessels(const zoo_tangent *t, zoo_block *b, const int forced)
{
    const zoo_sim *s = t->s;
    const double *restrict hA0 = t->hA0, *restrict hA1 = t->hA1, *restrict hq0 = t->hq0, *restrict hq1 = t->hq1,
                 *restrict fA0 = t->fA0, *restrict fA1 = t->fA1, *restrict fq0 = t->fq0, *restrict fq1 = t->fq1,
                 *restrict hP0 = t->hP0, *restrict fP0 = t->fP0; /* of the pressure after, the same with the other sign */
    const walls_change now = change_of(t, b, &t->now, b->K), mid = change_of(t, b, &t->mid, b->K_mid);
    const char *ahead = t->ahead;
    const size_t ahead_by = t->ahead_by;
    double *A = b->A, *q = b->q;
    for (int k = 0; k < s->n_vessels; k++) {
        const ptrdiff_t first = s->first[k], last = s->last[k];
        const double lam = s->lam_mid[first], l = 0.5 * lam;
        directions A0 = *of(A, first), q0 = *of(q, first), before_A = {0}, before_q = {0}, P0 = {0}, before_P = {0};
        if (forced)
            P0 = source(now, first);
        for (ptrdiff_t j = first; j < last; j++) {
            if (!forced)
                __builtin_prefetch(ahead + ahead_by * j);
            const directions A1 = *of(A, j + 1), q1 = *of(q, j + 1);
            const directions Ah = 0.5 * (A0 + A1) - l * (q1 - q0);
            directions qh = hA0[j] * A0 + hA1[j] * A1 + hq0[j] * q0 + hq1[j] * q1, Ph = {0};
            if (forced) {
                const directions P1 = source(now, j + 1);
                qh += hP0[j] * (P0 - P1);
                Ph = source(mid, j);
                P0 = P1;
            }
            if (j > first) {
                *of(A, j) = A0 - lam * (qh - before_q);
                q0 += fA0[j] * before_A + fA1[j] * Ah + fq0[j] * before_q + fq1[j] * qh;
                if (forced)
                    q0 += fP0[j] * (before_P - Ph);
                *of(q, j) = q0;
            } else {
                *of(b->Ah, j) = Ah;
                *of(b->qh, j) = qh;
            }
            A0 = A1, q0 = q1, before_A = Ah, before_q = qh, before_P = Ph;
        }
        *of(b->Ah, last - 1) = before_A;
        *of(b->qh, last - 1) = before_q;
    }
}

ZOO_INLINE void junctions(const zoo_tangent *t, zoo_block *b, const int forced)
{
    const zoo_sim *s = t->s;
    const double *row = t->row;
    const walls_change next = change_of(t, b, &t->next, b->K), mid = change_of(t, b, &t->mid, b->K_mid);
    double *A = b->A, *q = b->q, *Ah = b->Ah, *qh = b->qh;
    for (int g = 0; g < s->n_groups; g++) {
        const zoo_junction_group *ju = &s->groups[g];
        const int count = ju->count, n = count * ju->branches, *restrict nodes = ju->node, *restrict mids = ju->mid;
        for (int j = 0; j < count; j++) {
            directions P = {0}, half = {0};
            for (int x = j; x < n; x += count) {
                P += row[VOLUME * n + x] * *of(A, nodes[x]) + row[INFLOW * n + x] * *of(qh, mids[x]);
                if (forced)
                    P += row[VOLUME * n + x] * row[SOFTNESS * n + x] * source(next, nodes[x]);
            }
            for (int x = j; x < n; x += count) {
                const ptrdiff_t o = nodes[x], m = mids[x];
                directions then = row[SOFTNESS * n + x] * P;
                if (forced)
                    then -= row[SOFTNESS * n + x] * source(next, o);
                directions sum = *of(q, o) + row[WAS * n + x] * *of(A, o) + row[IS * n + x] * then +
                            row[AREA_H * n + x] * *of(Ah, m) + row[FLOW_H * n + x] * *of(qh, m);
                if (forced)
                    sum += row[PUSH * n + x] * source(mid, m);
                half += row[BALANCE * n + x] * sum;
                *of(A, o) = then;
                *of(q, o) = sum;
            }
            for (int x = j; x < n; x += count)
                *of(q, nodes[x]) -= row[PUSH * n + x] * half;
        }
        row += ZOO_PLAIN_ROWS * n;
    }
}

/* outlet_windkessel.h and the inlet; `walls` and `outlets` say what changes beside the state. */
ZOO_INLINE void ends(const zoo_tangent *t, zoo_block *b, int step, const int walls, const int outlets)
{
    const zoo_sim *s = t->s;
    const zoo_terminals *ou = &s->outlets;
    const ptrdiff_t n = ou->count;
    for (ptrdiff_t i = 0; i < n; i++) {
        const ptrdiff_t o = ou->node[i];
        const double decay = outlet_row(s, ou->coefficient, WINDKESSEL_DECAY)[i], fill = outlet_row(s, ou->coefficient, WINDKESSEL_FILL)[i],
                     E = outlet_row(s, ou->coefficient, WINDKESSEL_E)[i], inv_R1 = outlet_row(s, ou->coefficient, WINDKESSEL_INV_R1)[i];
        const double give = t->outlet[OUTLET_GIVE * n + i], back = 1.0 / ou->per_w[i];
        directions base = (1.0 + decay) * *of(b->v, i) - t->outlet[OUTLET_BEFORE * n + i] * *of(b->A, o);
        directions after = decay * *of(b->v, i), own = {0}, raised = {0}, driven = {0};
        if (walls) {
            base -= source(change_of(t, b, &t->now, b->K), o);
            own = source(change_of(t, b, &t->next, b->K), o);
        }
        if (outlets) {
            const double was = t->old_v[i], Q = s->qh[o - 1] - (s->A[o] - t->old_A[o]) * back;
            const double above = (1.0 + decay) * was - t->old_P[o] + outlet_row(s, ou->coefficient, WINDKESSEL_REST)[i] + E * Q - ou->v[i];
            const directions more = *of(b->row, WINDKESSEL_DECAY * n + i) * was + *of(b->row, WINDKESSEL_REST * n + i);
            base += more;
            after += more + *of(b->row, WINDKESSEL_FILL * n + i) * Q;
            driven = *of(b->row, WINDKESSEL_E * n + i) * Q;
            raised = *of(b->row, WINDKESSEL_INV_R1 * n + i) * above;
        }
        const directions come = *of(b->qh, o - 1) + back * *of(b->A, o);
        const directions then = (base + E * come + driven - own) * give, Q = come - then * back;
        after += fill * Q;
        *of(b->A, o) = then;
        *of(b->v, i) = after;
        *of(b->q, o) = (base + E * Q + driven - after) * inv_R1 + raised;
    }
    const double per_w = 2.0 * s->dt / s->dx[0];
    const int moves = t->forced && b->inlet;
    const directions none = {0}, mean = moves ? *of(b->curve_mean, step) : none, given = moves ? *of(b->curve_node, step + 1) : none;
    if (s->problem->inlet.kind == ZOO_INLET_FLOW) {
        *of(b->A, 0) -= per_w * (*of(b->qh, 0) - mean);
        *of(b->q, 0) = given;
        return;
    }
    /* a junction's branch at known pressures */
    const double *row = t->inlet;
    directions above = given, push = mean;
    if (walls) {
        above -= source(change_of(t, b, &t->next, b->K), 0);
        push -= source(change_of(t, b, &t->mid, b->K_mid), 0);
    }
    const directions then = row[SOFTNESS] * above;
    *of(b->q, 0) += row[WAS] * *of(b->A, 0) + row[IS] * then + row[AREA_H] * *of(b->Ah, 0) + row[FLOW_H] * *of(b->qh, 0) - row[PUSH] * push;
    *of(b->A, 0) = then;
}

#define STEP_OF(name, walls, outlets)                                            \
    ZOO_CLONES static void name(const zoo_tangent *t, zoo_block *b, int step)    \
    {                                                                            \
        vessels(t, b, walls);                                                    \
        junctions(t, b, walls);                                                  \
        ends(t, b, step, walls, outlets);                                        \
    }
STEP_OF(free_step, 0, 0)
STEP_OF(outlets_step, 0, 1)
STEP_OF(walls_step, 1, 1)

void zoo_plain_step(const zoo_tangent *t, zoo_block *b, int step)
{
    if (t->forced && b->walls)
        walls_step(t, b, step);
    else if (t->forced && b->outlets)
        outlets_step(t, b, step);
    else
        free_step(t, b, step);
}

/* The rows of a group of junctions. */
ZOO_CLONES static void keep_junctions(const zoo_tangent *t, const zoo_junction_group *ju, double *restrict row)
{
    const zoo_sim *s = t->s;
    const int count = ju->count, nb = ju->branches, n = count * nb;
    const double dt = s->dt, half_dt = 0.5 * dt, inv_rho = s->inv_density, alpha = s->momentum;
    const int *restrict node = ju->node, *restrict mid = ju->mid, *restrict junction = ju->junction;
    const double *restrict old_A = t->old_A, *restrict A = s->A, *restrict qh = s->qh, *restrict Ph = s->Ph,
                 *restrict Ah = s->Ah, *restrict next = t->next.slope, *restrict slope = t->mid.slope,
                 *restrict M_A = t->mid.M_A, *restrict M_q = t->mid.M_q, *restrict G_A = t->mid.G_A, *restrict G_q = t->mid.G_q;
    ZOO_SIMD for (ptrdiff_t x = 0; x < n; x++) {
        const ptrdiff_t o = node[x], m = mid[x];
        const double is = ju->sign[x], per_w = ju->per_w[x], back = 1.0 / per_w, H = ju->sum_c[junction[x]];
        const double half = 0.5 * (old_A[o] + A[o]), per_half = 1.0 / half;
        const double flux = qh[m] - is * (A[o] - old_A[o]) * back, u = flux * per_half;
        const double stick = ju->f_s[x] * sqrt(half / ju->A0[x]), push = 0.5 * per_w * (half + Ah[m]) * inv_rho;
        const double over = 0.5 * is * per_w * inv_rho * (Ph[m] - H);
        /* of the mean velocity, the flow through the half cell and its mean area */
        const double by_u = -is * per_w * alpha * flux - half_dt * (stick + ju->f_c[x]);
        const double by_flux = -is * per_w * alpha * u + by_u * per_half;
        const double by_area = over - by_u * u * per_half - half_dt * 0.5 * stick * u * per_half;
        row[SOFTNESS * n + x] = 1.0 / next[o];
        row[WAS * n + x] = 0.5 * by_area + is * back * by_flux;
        row[IS * n + x] = 0.5 * by_area - is * back * by_flux;
        row[AREA_H * n + x] = is * per_w * M_A[m] - half_dt * G_A[m] + over + is * push * slope[m];
        row[FLOW_H * n + x] = by_flux + is * per_w * M_q[m] - half_dt * G_q[m];
        row[PUSH * n + x] = is * push;
    }
    for (int j = 0; j < count; j++) {
        double soft = 0.0, stiff = 0.0;
        for (int x = j; x < n; x += count) {
            soft += ju->w[x] * row[SOFTNESS * n + x];
            stiff += fabs(row[PUSH * n + x]);
        }
        soft = 1.0 / soft;
        stiff = 1.0 / stiff;
        for (int x = j; x < n; x += count) {
            row[VOLUME * n + x] = ju->w[x] * soft;
            row[INFLOW * n + x] = ju->sign[x] * dt * soft;
            row[BALANCE * n + x] = ju->sign[x] * stiff;
        }
    }
}

void zoo_plain_keep(zoo_tangent *t)
{
    const zoo_sim *s = t->s;
    const zoo_terminals *ou = &s->outlets;
    double *row = t->row;
    for (int g = 0; g < s->n_groups; g++) {
        keep_junctions(t, &s->groups[g], row);
        row += ZOO_PLAIN_ROWS * s->groups[g].count * s->groups[g].branches;
    }
    if (s->problem->inlet.kind == ZOO_INLET_PRESSURE) {
        const zoo_junction_group in = inlet_branch(s);
        keep_junctions(t, &in, t->inlet);
    }
    for (ptrdiff_t i = 0; i < ou->count; i++) {
        const ptrdiff_t o = ou->node[i];
        t->outlet[OUTLET_BEFORE * ou->count + i] = t->now.slope[o];
        t->outlet[OUTLET_GIVE * ou->count + i] = 1.0 / (t->next.slope[o] + outlet_row(s, ou->coefficient, WINDKESSEL_E)[i] / ou->per_w[i]);
    }
}

/* Adds what the walls' arguments make of the pressures at a node, at the end of a step. */
void zoo_plain_source(const zoo_tangent *t, const zoo_block *b, ptrdiff_t o, double *P)
{
    const directions more = source(change_of(t, b, &t->now, b->K), o);
    for (int d = 0; d < D; d++)
        P[d] += more[d];
}
