/* Inside the vessels: Richtmyer's two-step form of Lax-Wendroff for
 *
 *   A_t + q_x = 0,
 *   q_t + (alpha q^2/A)_x + (A/rho) p_x = -f(A) q,      f(A) = (f_s sqrt(A/A0) + f_c)/A.
 *
 * First to the midpoints, half a step on, then from the midpoints over the
 * whole step.  The pressure term is kept as A p_x: it is second order like the
 * flux form, holds fluid at rest in a tapered vessel exactly, and needs no
 * integral of the wall law.
 */
#ifndef ZOO_SCHEME_H
#define ZOO_SCHEME_H

#include "internal.h"

/* Areas, flows, pressures, fluxes and friction at the midpoints, half a step on. */
ZOO_INLINE void scheme_half(const int wall, const int W, zoo_sim *s)
{
    const double *restrict A = s->A, *restrict q = s->q, *restrict K = s->K, *restrict th = s->theta;
    const double *restrict P = s->P, *restrict M = s->M, *restrict G = s->G;
    const double *restrict lam = s->lam_mid, *restrict inv_A0 = s->inv_A0_mid;
    const double *restrict f_s = s->f_s_mid, *restrict f_c = s->f_c_mid;
    double *restrict Ah = s->Ah, *restrict qh = s->qh, *restrict Ph = s->Ph, *restrict Mh = s->Mh,
                     *restrict Gh = s->Gh;
    const double alpha = s->momentum, inv_rho = s->inv_density, quarter_dt = 0.25 * s->dt;
    const int n = s->n_nodes - 1;
    ZOO_LOOP(W, i, j, l, 0, n, {
        const ptrdiff_t k = i + W;
        double mean = 0.5 * (A[i] + A[k]);
        double Am = mean - 0.5 * lam[j] * (q[k] - q[i]);
        double qm = 0.5 * (q[i] + q[k]) -
                    0.5 * lam[j] * (M[k] - M[i] + mean * inv_rho * (P[k] - P[i])) -
                    quarter_dt * (G[i] + G[k]);
        double a = Am * inv_A0[j], y = wall_rsqrt(a), r = a * y, u = qm * inv_A0[j] * y * y;
        Ah[i] = Am;
        qh[i] = qm;
        Ph[i] = wall_p(wall, K[i], th[i], a, r);
        Mh[i] = alpha * qm * u;
        Gh[i] = (f_s[j] * r + f_c[j]) * u;
    });
}

/* Over the whole step at inner nodes (lam and half_dt are 0 at boundary nodes,
 * which stay as they are), then P, M = alpha q^2/A and G = f q at all nodes;
 * without `advance` only the latter.  Returns 1 if an area is not positive,
 * not a number or beyond the wall's limit. */
ZOO_INLINE int scheme_full(const int wall, const int W, const int advance, zoo_sim *s)
{
    const double *restrict Ah = s->Ah, *restrict qh = s->qh, *restrict Ph = s->Ph,
                           *restrict Mh = s->Mh, *restrict Gh = s->Gh;
    const double *restrict lam = s->lam, *restrict half_dt = s->half_dt, *restrict inv_A0 = s->inv_A0,
                 *restrict f_s = s->f_s, *restrict f_c = s->f_c;
    const double *restrict K = s->K, *restrict th = s->theta;
    double *restrict A = s->A, *restrict q = s->q, *restrict P = s->P, *restrict M = s->M,
                     *restrict G = s->G;
    const double half_inv_rho = 0.5 * s->inv_density, alpha = s->momentum;
    const int n = s->n_nodes;
    int wrong = 0;
    /* midpoint -1 exists and holds finite numbers: see zoo_set_grid */
    ZOO_LOOP(W, i, j, l, 0, n, {
        const ptrdiff_t k = i - W;
        double An = A[i], qn = q[i];
        if (advance) {
            An -= lam[j] * (qh[i] - qh[k]);
            qn -= lam[j] * (Mh[i] - Mh[k] + half_inv_rho * (Ah[i] + Ah[k]) * (Ph[i] - Ph[k])) +
                  half_dt[j] * (Gh[i] + Gh[k]);
            A[i] = An;
            q[i] = qn;
        }
        double a = An * inv_A0[j], y = wall_rsqrt(a), r = a * y, u = qn * inv_A0[j] * y * y;
        P[i] = wall_p(wall, K[i], th[i], a, r);
        M[i] = alpha * qn * u;
        G[i] = (f_s[j] * r + f_c[j]) * u;
        double good = An > 0.0 ? 1.0 : 0.0;
        if (wall == ZOO_WALL_TANGENT)
            good = fabs(th[i] * (a - 1.0)) < 0.5 * ZOO_PI ? good : 0.0;
        wrong |= good != 1.0;
    });
    return wrong;
}

#endif
