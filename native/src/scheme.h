/* Inside the vessels: Richtmyer's two-step form of Lax-Wendroff for
 *
 *   A_t + q_x = 0,
 *   q_t + (alpha q^2/A)_x + (A/rho) p_x = -f(A) q,      f(A) = (f_s sqrt(A/A0) + f_c)/A.
 *
 * First to the midpoints, half a step on, then from the midpoints over the
 * whole step.  The pressure term is kept as A p_x: it is second order like the
 * flux form, holds fluid at rest in a tapered vessel exactly, and needs no
 * integral of the wall law.  Where the stiffness varies along a vessel, p is the pressure of each
 * place's own wall, so that p_x holds what its change adds.
 *
 * With `extra`, A_t + q_x = -leak p, and p = p_e + p_v + offset, where p_e is the
 * wall's at its stiffness of the time (K is multiplied by `stiff`) and p_v follows from it with a memory,
 *
 *   tau_r dp_v/dt + p_v = tau dp_e/dt,   or   p_v = kappa p_e + z,  tau_r dz/dt = -(z + kappa p_e).
 *
 * Over a step, exact for p_e as its mean: z' = e z - kappa (1 - e)/2 (p_e + p_e'), so p' is a
 * stiffer wall, (1 + kappa (1 + e)/2) p_e', and `off`, which is known before the step.
 */
#ifndef ZOO_SCHEME_H
#define ZOO_SCHEME_H

#include "internal.h"

/* Areas, flows, pressures, fluxes and friction at the midpoints, half a step on. */
ZOO_INLINE void scheme_half(const int wall, const int extra, zoo_sim *s)
{
    const double *restrict A = s->A, *restrict q = s->q, *restrict K = s->K_mid;
    const double *restrict th = s->coefficient;
    const ptrdiff_t stride = s->n_nodes;
    const zoo_spline added = s->wall_function;
    const double *restrict P = s->P, *restrict M = s->M, *restrict G = s->G;
    const double *restrict lam = s->lam_mid, *restrict inv_A0 = s->inv_A0_mid;
    const double *restrict f_s = s->f_s_mid, *restrict f_c = s->f_c_mid;
    double *restrict Ah = s->Ah, *restrict qh = s->qh, *restrict Ph = s->Ph, *restrict Mh = s->Mh,
                     *restrict Gh = s->Gh;
    const double alpha = s->momentum, inv_rho = s->inv_density, quarter_dt = 0.25 * s->dt;
    const double *restrict kappa = s->kappa, *restrict off = s->off_half, *restrict leak = s->leak_mid,
                 *restrict loss = s->loss_mid;
    const double later = 0.5 * (1.0 + s->relax_half), stiff = s->stiff_half;
    const int n = s->n_nodes - 1;
    ZOO_LOOP(j, n, {
        const ptrdiff_t k = j + 1;
        double mean = 0.5 * (A[j] + A[k]);
        double Am = mean - 0.5 * lam[j] * (q[k] - q[j]);
        double qm = 0.5 * (q[j] + q[k]) -
                    0.5 * lam[j] * (M[k] - M[j] + mean * inv_rho * (P[k] - P[j])) -
                    quarter_dt * (G[j] + G[k]);
        if (extra)
            Am -= quarter_dt * leak[j] * (P[j] + P[k]);
        double a = Am * inv_A0[j], y = fast_rsqrt(a), r = a * y, u = qm * inv_A0[j] * y * y;
        Ah[j] = Am;
        qh[j] = qm;
        Ph[j] = wall_p(wall, extra ? stiff * K[j] : K[j], (wall_shape){th + j, stride, added}, a, r);
        Mh[j] = alpha * qm * u;
        Gh[j] = (f_s[j] * r + f_c[j]) * u;
        if (extra) {
            Ph[j] = (1.0 + later * kappa[j]) * Ph[j] + 0.5 * (off[j] + off[k]);
            Gh[j] += (leak[j] * Ph[j] + loss[j] * Am * Am * fabs(qm)) * u;
        }
    });
}

/* Friction whose factor is a function of the velocity, over that of the loops, G += (f(|u|) - 1) (f_s r + f_c) q/A, at n
 * nodes or midpoints.  A loop of its own: most trees have none. */
ZOO_INLINE void scheme_friction(const zoo_sim *s, int n, const double *restrict A, const double *restrict q,
                                const double *restrict inv_A0, const double *restrict f_s, const double *restrict f_c,
                                double *restrict G)
{
    const zoo_spline factor = s->friction_function;
    ZOO_LOOP(j, n, {
        const double a = A[j] * inv_A0[j], y = fast_rsqrt(a), u = q[j] * inv_A0[j] * y * y;
        G[j] += (spline_value(factor, fabs(u)) - 1.0) * (f_s[j] * a * y + f_c[j]) * u;
    });
}

/* Over the whole step at inner nodes (lam and half_dt are 0 at boundary nodes,
 * which stay as they are), then P, M = alpha q^2/A and G = f q at all nodes;
 * without `advance` only the latter.  Returns 1 if an area is not positive,
 * not a number or beyond the wall's limit. */
ZOO_INLINE int scheme_full(const int wall, const int extra, const int advance, zoo_sim *s)
{
    const double *restrict Ah = s->Ah, *restrict qh = s->qh, *restrict Ph = s->Ph,
                           *restrict Mh = s->Mh, *restrict Gh = s->Gh;
    const double *restrict lam = s->lam, *restrict half_dt = s->half_dt, *restrict inv_A0 = s->inv_A0,
                 *restrict f_s = s->f_s, *restrict f_c = s->f_c;
    const double *restrict K = s->K;
    const double *restrict th = s->coefficient;
    const ptrdiff_t stride = s->n_nodes;
    const zoo_spline added = s->wall_function;
    double *restrict A = s->A, *restrict q = s->q, *restrict P = s->P, *restrict M = s->M,
                     *restrict G = s->G;
    const double half_inv_rho = 0.5 * s->inv_density, alpha = s->momentum;
    const double *restrict kappa = s->kappa, *restrict offset = s->offset, *restrict leak = s->leak,
                 *restrict loss = s->loss;
    double *restrict z = s->z, *restrict pe = s->pe, *restrict off = s->off, *restrict off_half = s->off_half;
    const double e = s->relax, e_half = s->relax_half, stiff = s->stiff;
    const int n = s->n_nodes;
    int wrong = 0;
    /* midpoint -1 exists and holds finite numbers: see zoo_set_grid */
    ZOO_LOOP(j, n, {
        const ptrdiff_t k = j - 1;
        double An = A[j], qn = q[j];
        if (advance) {
            An -= lam[j] * (qh[j] - qh[k]);
            qn -= lam[j] * (Mh[j] - Mh[k] + half_inv_rho * (Ah[j] + Ah[k]) * (Ph[j] - Ph[k])) +
                  half_dt[j] * (Gh[j] + Gh[k]);
            if (extra)
                An -= half_dt[j] * leak[j] * (Ph[j] + Ph[k]);
            A[j] = An;
            q[j] = qn;
        }
        double a = An * inv_A0[j], y = fast_rsqrt(a), r = a * y, u = qn * inv_A0[j] * y * y;
        P[j] = wall_p(wall, extra ? stiff * K[j] : K[j], (wall_shape){th + j, stride, added}, a, r);
        M[j] = alpha * qn * u;
        G[j] = (f_s[j] * r + f_c[j]) * u;
        if (extra) {
            const double elastic = P[j], g = 0.5 * kappa[j] * (1.0 - e);
            double memory = z[j];
            if (advance)
                memory = e * memory - g * (pe[j] + elastic);
            P[j] = (1.0 + kappa[j]) * elastic + offset[j] + memory;
            G[j] += (leak[j] * P[j] + loss[j] * An * An * fabs(qn)) * u;
            z[j] = memory;
            pe[j] = elastic;
            off[j] = offset[j] + e * memory - g * elastic;
            off_half[j] = offset[j] + e_half * memory - 0.5 * kappa[j] * (1.0 - e_half) * elastic;
        }
        double good = An > 0.0 ? 1.0 : 0.0;
        good = wall_inside(wall, (wall_shape){th + j, stride, added}, a) ? good : 0.0;
        wrong |= good != 1.0;
    });
    return wrong;
}

#endif
