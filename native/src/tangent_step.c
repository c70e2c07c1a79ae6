/* One step of the run and of its directional derivatives.
 *
 * Everything here and in tangent_plain.c is scheme.h, junction.h, junction_total_pressure.h and the outlets
 * differentiated by hand.  What a step makes of a small change of the state is linear; its coefficients are the same
 * for all directions and computed once.  Junctions and outlets are differentiated at the root that the step found
 * (implicit function), whatever way led to it.
 *
 * Without additions the coefficients of a beat's steps are kept and serve every further beat (tangent_plain.c).  With
 * them pressures depend on more than the area: their own changes are carried, and each beat computes the run again. */
#include <math.h>
#include <string.h>

#include "outlet.h"
#include "inlet.h"
#include "tangent.h"

enum { D = ZOO_DIRECTIONS };

#define EACH_DIRECTION ZOO_SIMD for (int d = 0; d < D; d++)

/* Slope of the wall's pressure with the area, and how it changes with the law's coefficients; derivatives of
 * M = alpha q^2/A and, without additions, G = (f_s sqrt(A/A0) + f_c) q/A. */
ZOO_INLINE void partials_of(const int wall, const zoo_sim *s, const double *restrict A, const double *restrict q,
                            const double *restrict K, const double *restrict inv_A0, const double *restrict f_s,
                            const double *restrict f_c, double stiff, int n, int shapes, zoo_partials *p)
{
    const ptrdiff_t stride = s->n_nodes;
    const double alpha = s->momentum;
    const double *restrict th = s->coefficient, *restrict elastic = p->elastic;
    double *restrict slope = p->slope, *restrict M_A = p->M_A, *restrict M_q = p->M_q, *restrict G_A = p->G_A,
                     *restrict G_q = p->G_q;
    ZOO_SIMD for (int j = 0; j < n; j++) {
        const double a = A[j] * inv_A0[j], y = fast_rsqrt(a), root = a * y, per = inv_A0[j] * y * y, u = q[j] * per;
        const double stick = f_s[j] * root, drift = alpha * u;
        slope[j] = wall_slope_area(wall, stiff * K[j], (wall_shape){th + j, stride, s->wall_function}, elastic[j], root, per, inv_A0[j]);
        M_A[j] = -drift * u;
        M_q[j] = 2.0 * drift;
        G_A[j] = -(0.5 * stick + f_c[j]) * u * per;
        G_q[j] = (stick + f_c[j]) * per;
    }
    for (int m = 0; m < shapes; m++) {
        double *restrict by = p->shape + m * stride;
        ZOO_SIMD for (int j = 0; j < n; j++) {
            const double a = A[j] * inv_A0[j];
            by[j] = wall_by(wall, stiff * K[j], (wall_shape){th + j, stride, s->wall_function}, elastic[j], a, sqrt(a), m);
        }
    }
}

#define PARTIALS_OF(number, name)                                                                                    \
    ZOO_CLONES static void partials_##name(const zoo_sim *s, const double *A, const double *q, const double *K,      \
                                           const double *inv_A0, const double *f_s, const double *f_c, double stiff, \
                                           int n, int shapes, zoo_partials *p)                                       \
    {                                                                                                                \
        partials_of(number, s, A, q, K, inv_A0, f_s, f_c, stiff, n, shapes, p);                                      \
    }
#define PARTIALS_OF_LAW(NAME, name, ...)  \
    PARTIALS_OF(ZOO_WALL_##NAME, name) \
    PARTIALS_OF(ZOO_WALL_##NAME + ZOO_N_WALLS, name##_function)
ZOO_WALLS(PARTIALS_OF_LAW, )
#define PARTIALS_CASE(NAME, name, ...)  \
    case ZOO_WALL_##NAME:               \
        partials_##name(__VA_ARGS__);   \
        break;                          \
    case ZOO_WALL_##NAME + ZOO_N_WALLS: \
        partials_##name##_function(__VA_ARGS__); \
        break;

/* More of G, (leak P + loss A^2 |q|) q/A. */
ZOO_CLONES static void added_partials(int n, const double *restrict A, const double *restrict q, const double *restrict P,
                                      const double *restrict leak, const double *restrict loss, zoo_partials *p)
{
    double *restrict G_A = p->G_A, *restrict G_q = p->G_q, *restrict G_P = p->G_P;
    ZOO_SIMD for (int j = 0; j < n; j++) {
        const double per = 1.0 / A[j], u = q[j] * per;
        G_A[j] += loss[j] * fabs(q[j]) * q[j] - leak[j] * P[j] * u * per;
        G_q[j] += leak[j] * P[j] * per + 2.0 * loss[j] * A[j] * fabs(q[j]);
        G_P[j] = leak[j] * u;
    }
}

/* More of G where friction has a factor that is a function of the velocity. */
static void friction_partials(const zoo_sim *s, int n, const double *A, const double *q, const double *inv_A0,
                              const double *f_s, const double *f_c, zoo_partials *p)
{
    for (int j = 0; j < n && s->problem->fluid.friction_function.n_knots > 0; j++) {
        double faster;
        const double per = 1.0 / A[j], u = q[j] * per, root = sqrt(A[j] * inv_A0[j]), hold = f_s[j] * root + f_c[j];
        const double by = spline_at(s->friction_function, fabs(u), &faster) - 1.0;
        p->G_A[j] -= (by * (0.5 * f_s[j] * root + f_c[j]) + faster * fabs(u) * hold) * u * per;
        p->G_q[j] += (by + faster * fabs(u)) * hold * per;
    }
}

/* Whether a direction changes the walls. */
static int walls_change(const zoo_tangent *t)
{
    int walls = 0;
    for (int b = 0; b < t->n_blocks && t->forced; b++)
        walls |= t->block[b].walls;
    return walls;
}

/* How the walls' pressures change with K at n nodes or midpoints. */
static void scale_partials(const double *restrict K, int n, zoo_partials *p)
{
    ZOO_SIMD for (int j = 0; j < n; j++)
        p->by_K[j] = p->elastic[j] / K[j];
}

static void node_partials(zoo_tangent *t, zoo_partials *p)
{
    const zoo_sim *s = t->s;
    p->elastic = s->extra ? s->pe : s->P;
    switch (s->wall) {
        ZOO_WALLS(PARTIALS_CASE, s, s->A, s->q, s->K, s->inv_A0, s->f_s, s->f_c, s->stiff, s->n_nodes, t->shapes, p)
    }
    if (walls_change(t))
        scale_partials(s->K, s->n_nodes, p);
    if (s->extra)
        added_partials(s->n_nodes, s->A, s->q, s->P, s->leak, s->loss, p);
    friction_partials(s, s->n_nodes, s->A, s->q, s->inv_A0, s->f_s, s->f_c, p);
}

/* How the midpoints follow from the nodes. */
ZOO_CLONES static void half_coefficients(zoo_tangent *t)
{
    const zoo_sim *s = t->s;
    const zoo_partials *p = &t->now;
    const int n = s->n_nodes - 1, extra = s->extra;
    const double alone = extra ? 0.0 : 1.0; /* then pressures are slope times area */
    const double quarter_dt = 0.25 * s->dt, inv_rho = s->inv_density;
    const double *restrict A = s->A, *restrict P = s->P, *restrict lam = s->lam_mid, *restrict M_A = p->M_A,
                           *restrict M_q = p->M_q, *restrict G_A = p->G_A, *restrict G_q = p->G_q,
                           *restrict G_P = p->G_P, *restrict slope = p->slope;
    double *restrict hA0 = t->hA0, *restrict hA1 = t->hA1, *restrict hq0 = t->hq0, *restrict hq1 = t->hq1,
                     *restrict hP0 = t->hP0, *restrict hP1 = t->hP1;
    ZOO_SIMD for (int j = 0; j < n; j++) {
        const double l = 0.5 * lam[j], m = 0.5 * l * inv_rho * (A[j] + A[j + 1]), tilt = 0.5 * l * inv_rho * (P[j + 1] - P[j]);
        hA0[j] = l * M_A[j] - tilt - quarter_dt * G_A[j] + alone * m * slope[j];
        hA1[j] = -l * M_A[j + 1] - tilt - quarter_dt * G_A[j + 1] - alone * m * slope[j + 1];
        hq0[j] = 0.5 + l * M_q[j] - quarter_dt * G_q[j];
        hq1[j] = 0.5 - l * M_q[j + 1] - quarter_dt * G_q[j + 1];
        hP0[j] = m;
        hP1[j] = -m;
    }
    if (extra)
        ZOO_SIMD for (int j = 0; j < n; j++) {
            hP0[j] -= quarter_dt * G_P[j];
            hP1[j] -= quarter_dt * G_P[j + 1];
        }
}

/* How the nodes follow from the midpoints; midpoint -1 exists. */
ZOO_CLONES static void full_coefficients(zoo_tangent *t)
{
    const zoo_sim *s = t->s;
    const zoo_partials *p = &t->mid;
    const int n = s->n_nodes, extra = s->extra;
    const double alone = extra ? 0.0 : 1.0;
    const double half_inv_rho = 0.5 * s->inv_density;
    const double *restrict Ah = s->Ah, *restrict Ph = s->Ph, *restrict lam = s->lam, *restrict half_dt = s->half_dt,
                           *restrict M_A = p->M_A, *restrict M_q = p->M_q, *restrict G_A = p->G_A,
                           *restrict G_q = p->G_q, *restrict G_P = p->G_P, *restrict slope = p->slope;
    double *restrict fA0 = t->fA0, *restrict fA1 = t->fA1, *restrict fq0 = t->fq0, *restrict fq1 = t->fq1,
                     *restrict fP0 = t->fP0, *restrict fP1 = t->fP1;
    ZOO_SIMD for (int j = 1; j < n; j++) {
        const double m = half_inv_rho * lam[j] * (Ah[j] + Ah[j - 1]), tilt = half_inv_rho * lam[j] * (Ph[j] - Ph[j - 1]);
        fA0[j] = lam[j] * M_A[j - 1] - tilt - half_dt[j] * G_A[j - 1] + alone * m * slope[j - 1];
        fA1[j] = -lam[j] * M_A[j] - tilt - half_dt[j] * G_A[j] - alone * m * slope[j];
        fq0[j] = lam[j] * M_q[j - 1] - half_dt[j] * G_q[j - 1];
        fq1[j] = -lam[j] * M_q[j] - half_dt[j] * G_q[j];
        fP0[j] = m;
        fP1[j] = -m;
    }
    if (extra)
        ZOO_SIMD for (int j = 1; j < n; j++) {
            fP0[j] -= half_dt[j] * G_P[j - 1];
            fP1[j] -= half_dt[j] * G_P[j];
        }
}

/* The wall's pressure at n nodes or midpoints with their areas left alone. */
ZOO_CLONES static void wall_source(const zoo_tangent *t, const zoo_block *b, const zoo_partials *p, const double *restrict dK,
                                   int n, double *restrict to)
{
    const ptrdiff_t stride = t->s->n_nodes;
    for (ptrdiff_t j = 0; j < n; j++) {
        const double by = p->by_K[j];
        EACH_DIRECTION to[j * D + d] = by * dK[j * D + d];
    }
    for (int m = 0; m < t->shapes; m++) {
        const double *restrict change = b->coefficient + m * stride * D, *restrict slope = p->shape + m * stride;
        for (ptrdiff_t j = 0; j < n; j++) {
            const double by = slope[j];
            EACH_DIRECTION to[j * D + d] += by * change[j * D + d];
        }
    }
}

/* The same, or zeros where no direction changes the walls. */
static const double *node_source(const zoo_tangent *t, const zoo_block *b)
{
    return t->forced && b->walls ? b->node_source : t->zero;
}

static const double *mid_source(const zoo_tangent *t, const zoo_block *b)
{
    return t->forced && b->walls ? b->mid_source : t->zero;
}

/* P = (1 + kappa) pe + z at a node. */
ZOO_CLONES static void half_of(const zoo_tangent *t, zoo_block *b)
{
    const zoo_sim *s = t->s;
    const int n = s->n_nodes - 1;
    const double quarter_dt = 0.25 * s->dt, later = 0.5 * (1.0 + s->relax_half), keep = s->relax_half;
    const double *restrict sources = mid_source(t, b);
    for (ptrdiff_t j = 0; j < n; j++) {
        const double l = 0.5 * s->lam_mid[j], cA0 = t->hA0[j], cA1 = t->hA1[j], cq0 = t->hq0[j], cq1 = t->hq1[j],
                     cP0 = t->hP0[j], cP1 = t->hP1[j], slope = t->mid.slope[j];
        const double *restrict A0 = b->A + j * D, *restrict A1 = A0 + D, *restrict q0 = b->q + j * D,
                     *restrict q1 = q0 + D, *restrict e0 = b->pe + j * D, *restrict e1 = e0 + D;
        double *restrict to_A = b->Ah + j * D, *restrict to_q = b->qh + j * D, *restrict to_P = b->Ph + j * D;
        const double *restrict source = sources + j * D, *restrict z0 = b->z + j * D, *restrict z1 = z0 + D;
        const double k0 = s->kappa[j], k1 = s->kappa[j + 1], leak = quarter_dt * s->leak_mid[j];
        const double f0 = 0.5 * k0 * (1.0 - keep), f1 = 0.5 * k1 * (1.0 - keep), stiffer = 1.0 + later * k0;
        EACH_DIRECTION {
            const double P0 = (1.0 + k0) * e0[d] + z0[d], P1 = (1.0 + k1) * e1[d] + z1[d];
            to_A[d] = 0.5 * (A0[d] + A1[d]) - l * (q1[d] - q0[d]) - leak * (P0 + P1);
            to_q[d] = cA0 * A0[d] + cA1 * A1[d] + cq0 * q0[d] + cq1 * q1[d] + cP0 * P0 + cP1 * P1;
            to_P[d] = stiffer * (slope * to_A[d] + source[d]) +
                      0.5 * (keep * (z0[d] + z1[d]) - f0 * e0[d] - f1 * e1[d]);
        }
    }
}

ZOO_CLONES static void full_of(const zoo_tangent *t, zoo_block *b)
{
    const zoo_sim *s = t->s;
    const int n = s->n_nodes;
    const double *restrict sources = node_source(t, b);
    for (ptrdiff_t j = 0; j < n; j++) {
        const double *restrict source = sources + j * D;
        const double l = s->lam[j], cA0 = t->fA0[j], cA1 = t->fA1[j], cq0 = t->fq0[j], cq1 = t->fq1[j],
                     cP0 = t->fP0[j], cP1 = t->fP1[j], slope = t->next.slope[j];
        const double leak = s->half_dt[j] * s->leak[j], e = s->relax, g = 0.5 * s->kappa[j] * (1.0 - e);
        const double *restrict A1 = b->Ah + j * D, *restrict A0 = A1 - D, *restrict q1 = b->qh + j * D,
                     *restrict q0 = q1 - D, *restrict P1 = b->Ph + j * D, *restrict P0 = P1 - D;
        double *restrict to_A = b->A + j * D, *restrict to_q = b->q + j * D, *restrict pe = b->pe + j * D, *restrict z = b->z + j * D;
        EACH_DIRECTION {
            double now = to_A[d] - l * (q1[d] - q0[d]) - leak * (P0[d] + P1[d]);
            to_A[d] = now;
            to_q[d] += cA0 * A0[d] + cA1 * A1[d] + cq0 * q0[d] + cq1 * q1[d] + cP0 * P0[d] + cP1 * P1[d];
            now = slope * now + source[d];
            z[d] = e * z[d] - g * (pe[d] + now);
            pe[d] = now;
        }
    }
}

/* Part of a boundary node's new pressure that its new area does not make: what is known, and what the wall's own
 * arguments add. */
ZOO_INLINE void known_P(const zoo_tangent *t, const zoo_block *b, ptrdiff_t o, double stiffer, double *restrict to)
{
    const zoo_sim *s = t->s;
    const double keep = s->relax, g = 0.5 * s->kappa[o] * (1.0 - keep);
    const double *restrict source = node_source(t, b) + o * D, *restrict z = b->z + o * D, *restrict pe = b->pe + o * D;
    EACH_DIRECTION to[d] = stiffer * source[d] + keep * z[d] - g * pe[d];
}

ZOO_INLINE double stiffer_at(const zoo_sim *s, ptrdiff_t o)
{
    return 1.0 + 0.5 * (1.0 + s->relax) * s->kappa[o];
}

/* What the directions at a branch of a junction have in common. */
enum {
    BRANCH_PER_SLOPE, BRANCH_PART, BRANCH_STIFFER, BRANCH_U, BRANCH_FLUX, BRANCH_PER_HALF, BRANCH_HANG, BRANCH_HOLD,
    BRANCH_SUNK, BRANCH_PUSH, BRANCH_BACK
};

ZOO_CLONES static void branches_of(const zoo_tangent *t, const zoo_junction_group *ju, double *restrict row)
{
    const zoo_sim *s = t->s;
    const int n = ju->count * ju->branches;
    const double inv_rho = s->inv_density;
    const zoo_spline factor = s->friction_function;
    const int *restrict node = ju->node, *restrict mid = ju->mid;
    const double *restrict old_A = t->old_A, *restrict A = s->A, *restrict qh = s->qh, *restrict Ph = s->Ph,
                           *restrict Ah = s->Ah, *restrict slopes = t->next.slope, *restrict leaks = s->leak,
                           *restrict losses = s->loss, *restrict kappa = s->kappa;
    const double more = 0.5 * (1.0 + s->relax);
    ZOO_SIMD for (ptrdiff_t x = 0; x < n; x++) {
        const ptrdiff_t o = node[x], m = mid[x];
        const double w = ju->w[x], is = ju->sign[x], back = 1.0 / ju->per_w[x], stiffer = 1.0 + more * kappa[o];
        const double per_slope = 1.0 / (stiffer * slopes[o]);
        const double leak = leaks[o], loss = losses[o];
        const double half = 0.5 * (old_A[o] + A[o]), per_half = 1.0 / half, ratio = half / ju->A0[x];
        const double flux = qh[m] - is * ((A[o] - old_A[o]) * back + w * leak * Ph[m]), u = flux * per_half;
        double faster;
        const double by = spline_at(factor, fabs(u), &faster), all = ju->f_s[x] * sqrt(ratio) + ju->f_c[x];
        const double stick = by * (all - ju->f_c[x]);
        row[BRANCH_PER_SLOPE * n + x] = per_slope;
        row[BRANCH_PART * n + x] = w * per_slope;
        row[BRANCH_STIFFER * n + x] = stiffer;
        row[BRANCH_U * n + x] = u;
        row[BRANCH_FLUX * n + x] = flux;
        row[BRANCH_PER_HALF * n + x] = per_half;
        row[BRANCH_HANG * n + x] = (0.5 * stick * per_half + 2.0 * loss * half * fabs(flux)) * u;
        row[BRANCH_HOLD * n + x] = (by + faster * fabs(u)) * all + leak * Ph[m] + loss * half * half * fabs(flux);
        row[BRANCH_SUNK * n + x] = loss * half * half * (flux < 0.0 ? -1.0 : 1.0);
        row[BRANCH_PUSH * n + x] = 0.5 * ju->per_w[x] * (half + Ah[m]) * inv_rho;
        row[BRANCH_BACK * n + x] = back;
    }
}

/* The half cell of branch x at a pressure P': the area then, and the flow q = to - is (pushed H + push dH) with the pressure
 * H at mid-step. */
ZOO_INLINE void branch_of(const zoo_tangent *t, const zoo_block *b, const zoo_junction_group *ju, const double *restrict row, int x,
                          const double *restrict P, const double *restrict own, double *restrict then, double *restrict pushed,
                          double *restrict to)
{
    const zoo_sim *s = t->s;
    const int n = ju->count * ju->branches;
    const ptrdiff_t o = ju->node[x], m = ju->mid[x];
    const double dt = s->dt, inv_rho = s->inv_density, alpha = s->momentum;
    const double w = ju->w[x], is = ju->sign[x], per_w = ju->per_w[x], per_slope = row[BRANCH_PER_SLOPE * n + x];
    const double leak = s->leak[o], Ph = s->Ph[m], wet = w * leak, back = row[BRANCH_BACK * n + x];
    const double flux = row[BRANCH_FLUX * n + x], u = row[BRANCH_U * n + x], per_half = row[BRANCH_PER_HALF * n + x];
    const double hang = row[BRANCH_HANG * n + x], hold = row[BRANCH_HOLD * n + x], sunk = row[BRANCH_SUNK * n + x],
                 push = row[BRANCH_PUSH * n + x];
    const double M_A = t->mid.M_A[m], M_q = t->mid.M_q[m], G_A = t->mid.G_A[m], G_q = t->mid.G_q[m], G_P = t->mid.G_P[m];
    const double *restrict A = b->A + o * D, *restrict q = b->q + o * D, *restrict Ah = b->Ah + m * D,
                 *restrict qh = b->qh + m * D, *restrict Pm = b->Ph + m * D;
    EACH_DIRECTION {
        const double after = (P[d] - own[d]) * per_slope, mean = 0.5 * (A[d] + after);
        const double through = qh[d] - is * ((after - A[d]) * back + wet * Pm[d]), du = (through - u * mean) * per_half;
        const double drag = hang * mean + (leak * Pm[d] + sunk * through) * u + hold * du;
        const double more = 0.5 * per_w * inv_rho * (mean + Ah[d]);
        const double moved = M_A * Ah[d] + M_q * qh[d], held = G_A * Ah[d] + G_q * qh[d] + G_P * Pm[d];
        then[d] = after;
        pushed[d] = more;
        to[d] = q[d] - is * (per_w * (alpha * (through * u + flux * du) - moved) - more * Ph - push * Pm[d]) -
                0.5 * dt * (drag + held);
    }
}

/* junction.h: one pressure P' for all branches, H at mid-step. */
ZOO_INLINE void junction_of(const zoo_tangent *t, zoo_block *b, const zoo_junction_group *ju, const double *restrict row, int j)
{
    const zoo_sim *s = t->s;
    const int nb = ju->branches, n = ju->count * nb;
    const double dt = s->dt, H = ju->sum_c[j];
    double *restrict known = t->branch, *restrict c = known + nb * D, *restrict push_of = c + nb * D,
                     *restrict area = push_of + nb * D;
    double P[D] = {0.0}, dH[D] = {0.0}, soft = 0.0, stiff = 0.0;
    for (int k = 0; k < nb; k++) {
        const int x = k * ju->count + j;
        const ptrdiff_t o = ju->node[x], m = ju->mid[x];
        const double w = ju->w[x], part = row[BRANCH_PART * n + x], is = ju->sign[x] * dt;
        const double leak = dt * w * s->leak[o];
        const double *restrict A = b->A + o * D, *restrict qh = b->qh + m * D, *restrict Ph = b->Ph + m * D;
        double *restrict own = known + k * D;
        soft += part;
        known_P(t, b, o, row[BRANCH_STIFFER * n + x], own);
        EACH_DIRECTION P[d] += w * A[d] + is * qh[d] + part * own[d] - leak * Ph[d];
    }
    const double per_soft = 1.0 / soft;
    EACH_DIRECTION P[d] *= per_soft;
    for (int k = 0; k < nb; k++) {
        const int x = k * ju->count + j;
        const double is = ju->sign[x];
        double *restrict pushed = push_of + k * D, *restrict to = c + k * D;
        stiff += row[BRANCH_PUSH * n + x];
        branch_of(t, b, ju, row, x, P, known + k * D, area + k * D, pushed, to);
        EACH_DIRECTION dH[d] += is * to[d] - H * pushed[d];
    }
    const double per_stiff = 1.0 / stiff;
    EACH_DIRECTION dH[d] *= per_stiff;
    for (int k = 0; k < nb; k++) {
        const int x = k * ju->count + j;
        const ptrdiff_t o = ju->node[x];
        const double is = ju->sign[x], push = row[BRANCH_PUSH * n + x];
        const double *restrict from = c + k * D, *restrict pushed = push_of + k * D, *restrict then = area + k * D;
        double *restrict A = b->A + o * D, *restrict q = b->q + o * D;
        EACH_DIRECTION {
            q[d] = from[d] - is * (pushed[d] * H + push * dH[d]);
            A[d] = then[d];
        }
    }
}

/* junction_total_pressure.h: the last round of its Newton's method, with what changes on the right. */
ZOO_INLINE void coupled_of(const zoo_tangent *t, zoo_block *b, const zoo_junction_group *ju, int j)
{
    const zoo_sim *s = t->s;
    const int nb = ju->branches, count = ju->count;
    const double dt = s->dt, inv_rho = s->inv_density, alpha = s->momentum, rho = 1.0 / inv_rho, per_dt = 1.0 / dt;
    const double dynamic = rho * s->problem->junction.total_pressure, lossy = rho * s->problem->junction.loss;
    const double H = ju->H[j];
    double *restrict a0 = t->branch, *restrict q0 = a0 + nb * D;
    double *restrict aP = t->part, *restrict aH = aP + nb, *restrict qP = aH + nb, *restrict qH = qP + nb;
    double g0[D] = {0.0}, m0[D] = {0.0}, f0[D] = {0.0}, dP[D], dH[D], dD[D], old_D[D];
    double gP = 0.0, gH = 0.0, mP = 0.0, mH = 0.0, fP = 0.0, fH = 0.0;
    {
        const ptrdiff_t o = ju->node[j];
        const double u = t->old_q[o] / t->old_A[o];
        double rise;
        (void)spline_at(s->junction_function, u, &rise);
        EACH_DIRECTION old_D[d] = (lossy * fabs(u) + rise) * (b->q[o * D + d] - u * b->A[o * D + d]) / t->old_A[o];
    }
    for (int k = 0; k < nb; k++) {
        const int x = k * count + j;
        const ptrdiff_t o = ju->node[x], m = ju->mid[x];
        const double is = ju->sign[x], w = ju->w[x], per_w = ju->per_w[x], more = stiffer_at(s, o), down = 0.5 * (1.0 - is);
        const double leak = s->leak[o], loss = s->loss[o], Ph = s->Ph[m], A = s->A[o], q = s->q[o];
        const double was_A = t->old_A[o], was_u = t->old_q[o] / was_A;
        const double per_area = 1.0 / A, u = q * per_area, at_u = dynamic * u * per_area;
        const double F1_a = more * t->next.slope[o] - at_u * u, F1_q = at_u;
        const double half = 0.5 * (was_A + A), per_half = 1.0 / half, root = sqrt(half * s->inv_A0[o]);
        const double flux = s->qh[m] - is * w * ((A - was_A) * per_dt + leak * Ph), flux_a = -is * w * per_dt;
        const double mean_u = flux * per_half, sink = loss * half;
        double faster, rise;
        const double by = spline_at(s->friction_function, fabs(mean_u), &faster), all = ju->f_s[x] * root + ju->f_c[x];
        const double drag = (by * all + leak * Ph) * per_half, drag_flux = faster * all * per_half * copysign(per_half, mean_u);
        const double drag_half = -(drag - 0.5 * by * ju->f_s[x] * root * per_half) * per_half - drag_flux * mean_u;
        const double push = 0.5 * per_w * (half + s->Ah[m]) * inv_rho, push_a = 0.25 * per_w * inv_rho;
        const double under = 0.5 * (ju->old[x] + 0.5 * dynamic * u * u + down * ju->D[j]), over = H - under - Ph;
        const double F2_a = is * (per_w * alpha * mean_u * (2.0 * flux_a - 0.5 * mean_u) + push_a * over + 0.5 * push * at_u * u) +
                            0.5 * dt * ((0.5 * drag_half + drag_flux * flux_a) * flux + drag * flux_a + (0.5 * loss * flux + 2.0 * sink * flux_a) * fabs(flux));
        const double F2_q = 1.0 - 0.5 * is * push * at_u, inv = 1.0 / (F1_a * F2_q - F1_q * F2_a);
        aP[k] = F2_q * inv;
        qP[k] = -F2_a * inv;
        aH[k] = F1_q * is * push * inv;
        qH[k] = -F1_a * is * push * inv;
        const double aD = aP[k] + 0.5 * aH[k], qD = qP[k] + 0.5 * qH[k];
        (void)spline_at(s->junction_function, u, &rise);
        const double slope = (lossy * fabs(u) + rise) * per_area;
        if (k == 0) {
            gP = slope * (qP[0] - u * aP[0]);
            gH = slope * (qH[0] - u * aH[0]);
            mP = w * aP[0], mH = w * aH[0], fP = qP[0], fH = qH[0];
        } else {
            mP += w * (aP[k] - aD * gP), mH += w * (aH[k] - aD * gH);
            fP -= qP[k] - qD * gP, fH -= qH[k] - qD * gH;
        }
        const double *restrict Pm = b->Ph + m * D;
        double own[D];
        known_P(t, b, o, more, own);
        EACH_DIRECTION {
            const double dA = b->A[o * D + d], dq = b->q[o * D + d], Ahm = b->Ah[m * D + d], qhm = b->qh[m * D + d],
                         Phm = Pm[d];
            const double old = dynamic * was_u * (dq - was_u * dA) / was_A + down * old_D[d];
            const double through = qhm - is * w * (leak * Phm - dA * per_dt), mean = 0.5 * dA;
            const double moved = t->mid.M_A[m] * Ahm + t->mid.M_q[m] * qhm;
            const double held = t->mid.G_A[m] * Ahm + t->mid.G_q[m] * qhm + t->mid.G_P[m] * Phm;
            const double r1 = own[d];
            const double r2 =
                -dq + is * (per_w * (alpha * mean_u * (2.0 * through - mean_u * mean) - moved) +
                            0.5 * per_w * inv_rho * (mean + Ahm) * over - push * (Phm + 0.5 * old)) +
                0.5 * dt * ((drag_half * mean + drag_flux * through + leak * per_half * Phm) * flux + drag * through +
                            (loss * mean * flux + 2.0 * sink * through) * fabs(flux) + held);
            a0[k * D + d] = (F1_q * r2 - F2_q * r1) * inv;
            q0[k * D + d] = (F2_a * r1 - F1_a * r2) * inv;
            m0[d] -= w * dA + dt * (is * qhm - w * leak * Phm); /* the change of the volume */
            if (k == 0) {
                g0[d] = slope * (q0[d] - u * a0[d]);
                m0[d] += w * a0[d];
                f0[d] = q0[d];
            } else {
                m0[d] += w * (a0[k * D + d] - aD * g0[d]);
                f0[d] -= q0[k * D + d] - qD * g0[d];
            }
        }
    }
    const double inv = 1.0 / (mP * fH - mH * fP);
    EACH_DIRECTION {
        dP[d] = (mH * f0[d] - fH * m0[d]) * inv;
        dH[d] = (fP * m0[d] - mP * f0[d]) * inv;
        dD[d] = g0[d] + gP * dP[d] + gH * dH[d];
    }
    for (int k = 0; k < nb; k++) {
        const ptrdiff_t o = ju->node[k * count + j];
        const double down = k == 0 ? 0.0 : 1.0;
        EACH_DIRECTION {
            const double P = dP[d] - down * dD[d], half = dH[d] - 0.5 * down * dD[d];
            b->A[o * D + d] = a0[k * D + d] + aP[k] * P + aH[k] * half;
            b->q[o * D + d] = q0[k * D + d] + qP[k] * P + qH[k] * half;
        }
    }
}

ZOO_CLONES static void junctions_of(const zoo_tangent *t, zoo_block *b)
{
    const zoo_sim *s = t->s;
    const double *row = t->row;
    for (int g = 0; g < s->n_groups; g++) {
        for (int j = 0; j < s->groups[g].count; j++)
            if (s->coupled)
                coupled_of(t, b, &s->groups[g], j);
            else
                junction_of(t, b, &s->groups[g], row, j);
        row += ZOO_ADDED_ROWS * s->groups[g].count * s->groups[g].branches;
    }
}

/* Changes of row m of the outlets' coefficients at terminal i. */
ZOO_INLINE const double *row_of(const zoo_tangent *t, const zoo_block *b, int m, int i)
{
    return (t->forced && b->outlets ? b->row : t->zero) + ((ptrdiff_t)m * t->s->outlets.count + i) * D;
}

/* How decays, fills and E of terminal i, rows [coefficients][D], change with the state: with the pressure behind R1 half
 * a step on, as circuit_set_pressure has it. */
static void pressure_rows(const zoo_tangent *t, const zoo_block *b, int i, double *rows)
{
    const zoo_sim *s = t->s;
    const zoo_terminals *ou = &s->outlets;
    const int n = ou->count, ns = circuit_sections(s->problem);
    const double q = t->old_q[ou->node[i]], half_dt = 0.5 * s->dt;
    double v = ou->behind[i], rate = 0.0, all = 0.0, flow = 0.0, faster_R, faster_C, dv[D] = {0.0}, now[D];
    for (int m = 0; m < ns; m++)
        v += t->old_v[m * n + i];
    double more_R = exp(spline_at(s->resistance_function, v, &faster_R)),
           more_C = exp(spline_at(s->compliance_function, v, &faster_C));
    EACH_DIRECTION now[d] = 0.0;
    for (int m = 0; m < ns; m++) {
        const double R = more_R * circuit_R(s, m, i), C = more_C * circuit_C(s, m, i);
        const double leaves = R != 0.0 ? (t->old_v[m * n + i] - circuit_rest(s, m, i)) / R : 0.0;
        EACH_DIRECTION dv[d] += b->v[(m * n + i) * D + d];
        if (R == 0.0)
            continue;
        rate += (q - leaves) / C;
        flow += 1.0 / C;
        all += (leaves * faster_R - (q - leaves) * faster_C) / C;
        EACH_DIRECTION now[d] -= half_dt / (R * C) * b->v[(m * n + i) * D + d];
    }
    EACH_DIRECTION now[d] += (1.0 + half_dt * all) * dv[d] + half_dt * flow * b->q[(ptrdiff_t)ou->node[i] * D + d];
    more_R = exp(spline_at(s->resistance_function, v + half_dt * rate, &faster_R));
    more_C = exp(spline_at(s->compliance_function, v + half_dt * rate, &faster_C));
    double *restrict E = rows + CIRCUIT_E * D;
    for (int m = 0; m < ns; m++) {
        const double R = more_R * circuit_R(s, m, i), C = more_C * circuit_C(s, m, i);
        if (R == 0.0)
            continue;
        const double keep = exp(-s->dt / (R * C)), by = keep * s->dt / (R * C) * (faster_R + faster_C);
        const double filled = -R * expm1(-s->dt / (R * C)) * faster_R - R * by;
        double *restrict decay = rows + (CIRCUIT_DECAY + m) * D, *restrict fill = decay + ns * D, *restrict pull = fill + ns * D;
        const double part = circuit_part(s, m, i);
        EACH_DIRECTION {
            decay[d] += by * now[d];
            fill[d] += filled * now[d];
            pull[d] -= part * by * now[d];
            E[d] += filled * now[d];
        }
    }
}

/* outlet_circuit.h */
ZOO_CLONES static void circuit_of(const zoo_tangent *t, zoo_block *b)
{
    const zoo_sim *s = t->s;
    const zoo_terminals *ou = &s->outlets;
    const int n = ou->count, sections = circuit_sections(s->problem), modes = circuit_modes(s->problem),
              forced = t->forced && b->outlets;
#define ROW(name) const double name = outlet_row(s, ou->coefficient, row_##name)[i]
    enum {
        row_E = CIRCUIT_E, row_inertia = CIRCUIT_INERTIA, row_gain = CIRCUIT_GAIN, row_keep = CIRCUIT_KEEP,
        row_after = CIRCUIT_NOW, row_before = CIRCUIT_BEFORE, row_share = CIRCUIT_SHARE, row_direct = CIRCUIT_DIRECT
    };
    for (int i = 0; i < n; i++) {
        const ptrdiff_t o = ou->node[i];
        const double p_out = ou->behind[i], per_w = ou->per_w[i], leak = s->dt / per_w * s->leak[o];
        ROW(E);
        ROW(inertia);
        ROW(gain);
        ROW(keep);
        ROW(after);
        ROW(before);
        ROW(share);
        ROW(direct);
        const int waves = s->problem->outlet.n_wave > 0;
        const double f = waves ? ou->wave_mean[i] : 0.0, straight = outlet_row(s, ou->coefficient, CIRCUIT_STRAIGHT)[i];
        const double f_now = waves ? straight * ou->wave_now[i] : 0.0, f_then = waves ? straight * ou->wave_then[i] : 0.0;
        double y = t->old_P[o] - p_out - f_now, then_v = f_then;
        double base = 2.0 * p_out + f_now + f_then - t->old_P[o] - inertia * t->old_carry[i];
        for (int m = 0; m < sections; m++) {
            y -= t->old_v[m * n + i];
            base += (1.0 + outlet_row(s, ou->coefficient, CIRCUIT_DECAY + m)[i]) * t->old_v[m * n + i] +
                    outlet_row(s, ou->coefficient, CIRCUIT_DECAY + 2 * sections + m)[i] * f;
            then_v += outlet_row(s, ou->v, m)[i];
        }
        for (int m = 0; m < modes; m++) {
            const double *keeps = outlet_row(s, ou->coefficient, circuit_mode_row(sections, m)) + i;
            const ptrdiff_t w = (ptrdiff_t)circuit_mode_state(sections, m) * n + i;
            y -= t->old_v[w];
            base += (1.0 + keeps[0]) * t->old_v[w] - keeps[n] * t->old_v[w + n];
            then_v += ou->v[w];
        }
        const double Q = s->qh[o - 1] - leak * s->Ph[o - 1] - (s->A[o] - t->old_A[o]) / per_w;
        const double y_new = base + E * Q - p_out - then_v;
        const double more = stiffer_at(s, o), inv = 1.0 / (more * t->next.slope[o] + E / per_w);
        const double *restrict Pm = b->Ph + (o - 1) * D;
        double own[D];
        const double *change = row_of(t, b, 0, i); /* of all coefficients */
        ptrdiff_t stride = (ptrdiff_t)n * D;
        if (outlet_depends(s->problem)) {
            memset(t->rows, 0, (size_t)ou->rows.coefficients * D * sizeof(double));
            pressure_rows(t, b, i, t->rows);
            change = t->rows;
            stride = D;
        }
        known_P(t, b, o, more, own);
        EACH_DIRECTION {
            const double dA = b->A[o * D + d], d_out = forced ? b->behind[i * D + d] : 0.0;
            const double old_P = (1.0 + s->kappa[o]) * b->pe[o * D + d] + b->z[o * D + d], d_E = change[CIRCUIT_E * stride + d];
            const double carry = b->carry[i * D + d];
            double dy = old_P - d_out, d_base = 2.0 * d_out - old_P - inertia * carry - change[CIRCUIT_INERTIA * stride + d] * t->old_carry[i];
            for (int m = 0; m < sections; m++) {
                const double dv = b->v[(m * n + i) * D + d];
                dy -= dv;
                d_base += (1.0 + outlet_row(s, ou->coefficient, CIRCUIT_DECAY + m)[i]) * dv +
                          change[(CIRCUIT_DECAY + m) * stride + d] * t->old_v[m * n + i] +
                          change[(CIRCUIT_DECAY + 2 * sections + m) * stride + d] * f;
            }
            for (int m = 0; m < modes; m++) {
                const int row = circuit_mode_row(sections, m);
                const double *keeps = outlet_row(s, ou->coefficient, row) + i;
                const ptrdiff_t w = (ptrdiff_t)circuit_mode_state(sections, m) * n + i;
                dy -= b->v[w * D + d];
                d_base += (1.0 + keeps[0]) * b->v[w * D + d] - keeps[n] * b->v[(w + n) * D + d] +
                          change[row * stride + d] * t->old_v[w] - change[(row + 1) * stride + d] * t->old_v[w + n];
            }
            const double come = b->qh[(o - 1) * D + d] - leak * Pm[d] + dA / per_w;
            const double then = (d_base + E * come + d_E * Q - own[d]) * inv, dQ = come - then / per_w;
            double q = keep * (b->q[o * D + d] - direct * dy - change[CIRCUIT_DIRECT * stride + d] * y) +
                       change[CIRCUIT_KEEP * stride + d] * (t->old_q[o] - direct * y) + share * before * dy +
                       (change[CIRCUIT_SHARE * stride + d] * before + share * change[CIRCUIT_BEFORE * stride + d]) * y;
            double dy_new = d_base + E * dQ + d_E * Q - d_out;
            for (int m = 0; m < sections; m++) {
                double *v = &b->v[(m * n + i) * D + d];
                *v = outlet_row(s, ou->coefficient, CIRCUIT_DECAY + m)[i] * *v + change[(CIRCUIT_DECAY + m) * stride + d] * t->old_v[m * n + i] +
                     outlet_row(s, ou->coefficient, CIRCUIT_DECAY + sections + m)[i] * dQ +
                     change[(CIRCUIT_DECAY + sections + m) * stride + d] * Q +
                     change[(CIRCUIT_DECAY + 2 * sections + m) * stride + d] * f;
                dy_new -= *v;
            }
            for (int m = 0; m < modes; m++) {
                const int row = circuit_mode_row(sections, m);
                const double *keeps = outlet_row(s, ou->coefficient, row) + i;
                const ptrdiff_t w = (ptrdiff_t)circuit_mode_state(sections, m) * n + i;
                const double re = b->v[w * D + d], im = b->v[(w + n) * D + d], was = t->old_v[w], was_im = t->old_v[w + n];
                b->v[w * D + d] = keeps[0] * re - keeps[n] * im + keeps[2 * n] * dQ + change[row * stride + d] * was -
                                  change[(row + 1) * stride + d] * was_im + change[(row + 2) * stride + d] * Q;
                b->v[(w + n) * D + d] = keeps[n] * re + keeps[0] * im + keeps[3 * n] * dQ + change[(row + 1) * stride + d] * was +
                                        change[row * stride + d] * was_im + change[(row + 3) * stride + d] * Q;
                dy_new -= b->v[w * D + d];
            }
            q += (share * after + direct) * dy_new + (change[CIRCUIT_SHARE * stride + d] * after +
                  share * change[CIRCUIT_NOW * stride + d] + change[CIRCUIT_DIRECT * stride + d]) * y_new;
            b->A[o * D + d] = then;
            b->q[o * D + d] = q;
            b->carry[i * D + d] = carry + gain * (dQ - carry) + change[CIRCUIT_GAIN * stride + d] * (Q - t->old_carry[i]);
        }
    }
#undef ROW
}

/* inlet_flow.h and inlet_pressure.h */
static void inlet_of(const zoo_tangent *t, zoo_block *b, int step)
{
    const zoo_sim *s = t->s;
    const double per_w = 2.0 * s->dt / s->dx[0], leak = s->dt * s->leak[0];
    const int forced = t->forced && b->inlet;
    const double *mean = forced ? b->curve_mean + (ptrdiff_t)step * D : t->zero,
                 *given = forced ? b->curve_node + ((ptrdiff_t)step + 1) * D : t->zero;
    if (s->problem->inlet.kind == ZOO_INLET_FLOW) {
        for (int d = 0; d < D; d++) {
            b->A[d] -= per_w * (b->qh[d] - mean[d]) + leak * b->Ph[d];
            b->q[d] = given[d];
        }
        return;
    }
    const zoo_junction_group in = inlet_branch(s);
    double own[D], then[D], pushed[D], to[D];
    known_P(t, b, 0, t->inlet[BRANCH_STIFFER], own);
    branch_of(t, b, &in, t->inlet, 0, given, own, then, pushed, to);
    for (int d = 0; d < D; d++) {
        b->A[d] = then[d];
        b->q[d] = to[d] + pushed[d] * *in.sum_c + t->inlet[BRANCH_PUSH] * mean[d];
    }
}

/* The walls' slope where outputs are taken. */
static void see(const zoo_tangent *t, double *to)
{
    for (int i = 0; i < 4 * t->s->problem->outputs.n_series; i++)
        to[i] = t->now.slope[t->s->out_node[i]];
}

/* The wall's pressures at the start of a beat, of what stands in the blocks. */
void zoo_tangent_begin(zoo_tangent *t)
{
    const zoo_sim *s = t->s;
    if (t->done) {
        memcpy(t->seen, t->seen_first, 4 * (size_t)s->problem->outputs.n_series * sizeof(double));
        return;
    }
    t->shapes = walls_change(t) ? wall_shapes(s->wall) : 0;
    node_partials(t, &t->now);
    see(t, t->seen);
    see(t, t->seen_first);
    for (int k = 0; k < t->n_blocks && s->extra; k++) {
        zoo_block *b = &t->block[k];
        if (t->forced && b->walls)
            wall_source(t, b, &t->now, b->K, s->n_nodes, b->node_source);
        const double *source = node_source(t, b);
        for (ptrdiff_t j = 0; j < s->n_nodes; j++)
            for (int d = 0; d < D; d++)
                b->pe[j * D + d] = t->now.slope[j] * b->A[j * D + d] + source[j * D + d];
    }
}

/* A block through the step, with additions. */
static void added_step(const zoo_tangent *t, zoo_block *b, int step)
{
    const zoo_sim *s = t->s;
    if (t->forced && b->walls) {
        wall_source(t, b, &t->mid, b->K_mid, s->n_nodes - 1, b->mid_source);
        wall_source(t, b, &t->next, b->K, s->n_nodes, b->node_source);
    }
    half_of(t, b);
    junctions_of(t, b);
    circuit_of(t, b);
    inlet_of(t, b, step);
    full_of(t, b);
}

int zoo_tangent_step(zoo_tangent *t, int step)
{
    zoo_sim *s = t->s;
    const zoo_terminals *ou = &s->outlets;
    const size_t n = (size_t)s->n_nodes;
    if (t->done) {
        zoo_tangent_recall(t, step);
        for (int k = 0; k < t->n_blocks; k++)
            zoo_plain_step(t, &t->block[k], step);
        return 0;
    }
    memcpy(t->old_A, s->A, n * sizeof(double));
    memcpy(t->old_P, s->P, n * sizeof(double));
    if (s->extra) {
        memcpy(t->old_q, s->q, n * sizeof(double));
        memcpy(t->old_off, s->off_half, n * sizeof(double));
    }
    memcpy(t->old_v, ou->v, (size_t)ou->rows.pressures * ou->count * sizeof(double));
    memcpy(t->old_carry, ou->carry, (size_t)ou->rows.flows * ou->count * sizeof(double));
    half_coefficients(t);
    const int wrong = zoo_step(s, step);
    /* the wall's own pressure at the midpoints */
    t->mid.elastic = s->extra ? t->mid_elastic : s->Ph;
    for (size_t j = 0; j + 1 < n && s->extra; j++)
        t->mid_elastic[j] = (s->Ph[j] - 0.5 * (t->old_off[j] + t->old_off[j + 1])) /
                            (1.0 + 0.5 * (1.0 + s->relax_half) * s->kappa[j]);
    switch (s->wall) {
        ZOO_WALLS(PARTIALS_CASE, s, s->Ah, s->qh, s->K_mid, s->inv_A0_mid, s->f_s_mid, s->f_c_mid,
                  s->extra ? s->stiff_half : 1.0, s->n_nodes - 1, t->shapes, &t->mid)
    }
    if (walls_change(t))
        scale_partials(s->K_mid, s->n_nodes - 1, &t->mid);
    if (s->extra)
        added_partials(s->n_nodes - 1, s->Ah, s->qh, s->Ph, s->leak_mid, s->loss_mid, &t->mid);
    friction_partials(s, s->n_nodes - 1, s->Ah, s->qh, s->inv_A0_mid, s->f_s_mid, s->f_c_mid, &t->mid);
    full_coefficients(t);
    node_partials(t, &t->next);
    double *row = t->row;
    for (int g = 0; g < s->n_groups && s->extra && !s->coupled; g++) {
        branches_of(t, &s->groups[g], row);
        row += ZOO_ADDED_ROWS * s->groups[g].count * s->groups[g].branches;
    }
    if (s->extra && s->problem->inlet.kind == ZOO_INLET_PRESSURE) {
        const zoo_junction_group in = inlet_branch(s);
        branches_of(t, &in, t->inlet);
    }
    if (!s->extra)
        zoo_plain_keep(t);
    for (int k = 0; k < t->n_blocks; k++)
        if (s->extra)
            added_step(t, &t->block[k], step);
        else
            zoo_plain_step(t, &t->block[k], step);
    const zoo_partials swap = t->now;
    t->now = t->next;
    t->next = swap;
    see(t, t->seen);
    if (t->kept && !wrong)
        zoo_tangent_keep(t, step);
    return wrong;
}

/* Adds a change of the state, [n_state][D], to block k after a step. */
void zoo_tangent_add(zoo_tangent *t, int k, const double *change)
{
    const zoo_sim *s = t->s;
    zoo_block *b = &t->block[k];
    for (ptrdiff_t i = 0; i < (ptrdiff_t)s->n_state * D; i++)
        b->state[i] += change[i];
    for (ptrdiff_t j = 0; j < s->n_nodes && s->extra; j++)
        for (int d = 0; d < D; d++)
            b->pe[j * D + d] += t->now.slope[j] * change[j * D + d];
}

/* Into the ring of the outputs, as output.c does. */
ZOO_CLONES static void record_of(const zoo_tangent *t, const zoo_block *b, int step)
{
    const zoo_sim *s = t->s;
    const int n = s->problem->outputs.n_series;
    double *to = b->ring + (ptrdiff_t)(step & 3) * n * 3 * D;
    for (int i = 0; i < n; i++) {
        double P[D] = {0.0}, q[D] = {0.0}, A[D] = {0.0}, p[D];
        for (int m = 0; m < 4; m++) {
            const ptrdiff_t o = s->out_node[4 * i + m];
            const double w = s->out_weight[4 * i + m], slope = t->seen[4 * i + m], stiffer = s->extra ? 1.0 + s->kappa[o] : 1.0;
            const double *restrict A_of = b->A + o * D, *restrict q_of = b->q + o * D, *restrict out = b->out_P + o * D;
            if (s->extra)
                EACH_DIRECTION p[d] = stiffer * b->pe[o * D + d] + b->z[o * D + d];
            else
                EACH_DIRECTION p[d] = slope * A_of[d];
            if (!s->extra && t->forced && b->walls)
                zoo_plain_source(t, b, o, p);
            if (t->forced)
                EACH_DIRECTION p[d] += out[d];
            EACH_DIRECTION {
                P[d] += w * p[d];
                q[d] += w * q_of[d];
                A[d] += w * A_of[d];
            }
        }
        memcpy(to + (i * 3 + 0) * D, P, sizeof P);
        memcpy(to + (i * 3 + 1) * D, q, sizeof q);
        memcpy(to + (i * 3 + 2) * D, A, sizeof A);
    }
}

void zoo_tangent_record(zoo_tangent *t, int step)
{
    for (int k = 0; k < t->n_blocks; k++)
        record_of(t, &t->block[k], step);
}
