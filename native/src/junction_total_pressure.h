/* Where vessels meet, with total pressure or losses: the balances of junction.h, but
 *
 *   p_b + tau rho u_b^2/2 = P - [b a daughter] D,     D = K rho/2 u_0 |u_0| + f(u_0),     u_b = q_b/A_b,
 *
 * at the new time.  Pressure and flow of the branches' ends then depend on each
 * other, and strongly so: a step changes p through u by K u/c times what it
 * changes u through p, more than one for a large loss, so nothing explicit is
 * stable.  Newton's method solves for all at once: areas A_b' and flows q_b' of
 * the branches, shared pressures P at the new time and H at mid-step, and D,
 *
 *   F1_b = p(A_b') + tau rho u_b'^2/2 - P + [daughter] D = 0
 *   F2_b = momentum of the half cell, with H and the mean of d_b = p_b - P = 0
 *   sum_b w_b A_b' = volume,     sum_b s_b q_b' = 0,     D = K rho/2 u_0' |u_0'| + f(u_0').
 *
 * Each branch's two equations are eliminated, dA_b = a0 + aP dP_b + aH dH_b and
 * dq_b alike with dP_b = dP, dH_b = dH at the parent and dP - dD, dH - dD/2 at
 * daughters; two equations for dP and dH remain.  It starts from the old time,
 * which is near: two or three rounds.  f, and a factor of the friction, are only there with `tables`.
 */
#ifndef ZOO_JUNCTION_TOTAL_PRESSURE_H
#define ZOO_JUNCTION_TOTAL_PRESSURE_H

#include "internal.h"

ZOO_INLINE void junction_total_pressure(const int wall, const int tables, zoo_sim *s,
                                        zoo_junction_group *ju)
{
    enum { ROUNDS = 30 };
    const int n = ju->count, nb = ju->branches;
    const double dt = s->dt, inv_rho = s->inv_density, alpha = s->momentum, rho = 1.0 / inv_rho, per_dt = 1.0 / dt;
    const double dynamic = rho * s->problem->junction.total_pressure, lossy = rho * s->problem->junction.loss;
    const double later = 0.5 * (1.0 + s->relax), stiff = s->stiff;
    const zoo_spline given = s->junction_function, factor = s->friction_function;
    const double bent = tables ? dynamic + lossy + s->junction_curvature : dynamic + lossy;
    const int *restrict node = ju->node, *restrict mid = ju->mid, *restrict junction = ju->junction;
    const double *restrict w = ju->w, *restrict per_w = ju->per_w, *restrict A0 = ju->A0,
                           *restrict f_s = ju->f_s, *restrict f_c = ju->f_c, *restrict sign = ju->sign;
    const double *restrict kappa = s->kappa, *restrict leak = s->leak, *restrict loss = s->loss,
                           *restrict off = s->off, *restrict inv_A0 = s->inv_A0, *restrict K = s->K;
    const double *restrict th = s->coefficient;
    const ptrdiff_t stride = s->n_nodes;
    const zoo_spline added = s->wall_function;
    const double *restrict Ah = s->Ah, *restrict qh = s->qh, *restrict Ph = s->Ph, *restrict Mh = s->Mh,
                           *restrict Gh = s->Gh;
    double *restrict A = s->A, *restrict q = s->q;
    double *restrict volume = ju->volume, *restrict area = ju->area, *restrict flow = ju->flow,
                     *restrict a0 = ju->a0, *restrict aP = ju->aP, *restrict aH = ju->aH,
                     *restrict q0 = ju->q0, *restrict qP = ju->qP, *restrict qH = ju->qH,
                     *restrict old = ju->old;
    double *restrict P = ju->P, *restrict H = ju->H, *restrict D = ju->D, *restrict g0 = ju->g0,
                     *restrict gP = ju->gP, *restrict gH = ju->gH, *restrict m0 = ju->m0,
                     *restrict mP = ju->mP, *restrict mH = ju->mH, *restrict f0 = ju->f0,
                     *restrict fP = ju->fP, *restrict fH = ju->fH;

    ZOO_LOOP(j, n, {
        const ptrdiff_t o = node[j];
        const double u = q[o] / A[o];
        volume[j] = 0.0;
        D[j] = 0.5 * lossy * u * fabs(u);
        if (tables)
            D[j] += spline_value(given, u);
        P[j] = H[j] = s->P[o] + 0.5 * dynamic * u * u;
    });
    ZOO_LOOP(x, n * nb, {
        const ptrdiff_t o = node[x];
        const double u = q[o] / A[o];
        area[x] = A[o];
        flow[x] = q[o];
        /* how far the branch's pressure lies below the shared one at the old time */
        old[x] = 0.5 * dynamic * u * u + 0.5 * (1.0 - sign[x]) * D[junction[x]];
    });
    for (int b = 0; b < nb; b++) {
        const ptrdiff_t from = (ptrdiff_t)b * n;
        ZOO_LOOP(j, n, {
            const ptrdiff_t o = node[from + j], m = mid[from + j];
            volume[j] += w[from + j] * A[o] +
                         dt * (sign[from + j] * qh[m] - w[from + j] * leak[node[from + j]] * Ph[m]);
        });
    }
    for (int round = 0; round < ROUNDS; round++) {
        int unfinished = 0;
        ZOO_LOOP(x, n * nb, {
            const ptrdiff_t o = node[x], m = mid[x];
            const ptrdiff_t y = junction[x];
            const int v = node[x];
            const double is = sign[x], below = 0.5 * (1.0 - is) * D[y];
            const double K1 = wall_stiffened(K[o], stiff, later, kappa[v]), a = area[x] * inv_A0[v];
            const double root = a * fast_rsqrt(a), per_area = fast_reciprocal(area[x]);
            const double elastic = wall_p(wall, K1, (wall_shape){th + o, stride, added}, a, root);
            const double slope = wall_slope_area(wall, K1, (wall_shape){th + o, stride, added}, elastic, root, per_area, inv_A0[v]);
            const double u = flow[x] * per_area, at_u = dynamic * u * per_area;
            const double F1 = elastic + off[o] + 0.5 * dynamic * u * u + below - P[y];
            const double F1_a = slope - at_u * u, F1_q = at_u;
            /* momentum of the half cell; `half` and `flux` are its end's area and flow at mid-step */
            const double half = 0.5 * (A[o] + area[x]), ratio = half * inv_A0[v];
            const double half_root = ratio * fast_rsqrt(ratio), per_half = fast_reciprocal(half);
            const double flux = qh[m] - is * w[x] * ((area[x] - A[o]) * per_dt + leak[v] * Ph[m]);
            const double flux_a = -is * w[x] * per_dt, mean_u = flux * per_half;
            double drag = (f_s[x] * half_root + f_c[x] + leak[v] * Ph[m]) * per_half;
            double drag_a = -0.5 * (drag - 0.5 * f_s[x] * half_root * per_half) * per_half;
            const double sink = loss[v] * half;
            if (tables) {
                double faster; /* how the friction's factor changes with |u| */
                const double by = spline_at(factor, fabs(mean_u), &faster), stick = f_s[x] * half_root + f_c[x];
                drag = (by * stick + leak[v] * Ph[m]) * per_half;
                drag_a = -0.5 * (drag - 0.5 * by * f_s[x] * half_root * per_half) * per_half +
                         faster * stick * per_half * copysign(per_half, mean_u) * (flux_a - 0.5 * mean_u);
            }
            const double push = 0.5 * per_w[x] * (half + Ah[m]) * inv_rho, push_a = 0.25 * per_w[x] * inv_rho;
            /* mean over the step of how far the branch's pressure lies below the shared one */
            const double under = 0.5 * (old[x] + 0.5 * dynamic * u * u + below), over = H[y] - under - Ph[m];
            const double F2 = flow[x] - q[o] + is * (per_w[x] * (alpha * flux * mean_u - Mh[m]) + push * over) +
                              0.5 * dt * (drag * flux + sink * flux * fabs(flux) + Gh[m]);
            const double F2_a =
                is * (per_w[x] * alpha * mean_u * (2.0 * flux_a - 0.5 * mean_u) + push_a * over +
                      0.5 * push * at_u * u) +
                0.5 * dt * (drag_a * flux + drag * flux_a + (0.5 * loss[v] * flux + 2.0 * sink * flux_a) * fabs(flux));
            const double F2_q = 1.0 - 0.5 * is * push * at_u;
            const double inv = fast_reciprocal(F1_a * F2_q - F1_q * F2_a);
            a0[x] = (F1_q * F2 - F2_q * F1) * inv;
            q0[x] = (F2_a * F1 - F1_a * F2) * inv;
            aP[x] = F2_q * inv;
            qP[x] = -F2_a * inv;
            aH[x] = F1_q * is * push * inv;
            qH[x] = -F1_a * is * push * inv;
        });
        /* dD = g0 + gP dP + gH dH, from the parent */
        ZOO_LOOP(j, n, {
            const double u = flow[j] / area[j];
            double slope = lossy * fabs(u) / area[j], less = 0.5 * lossy * u * fabs(u) - D[j];
            if (tables) {
                double rise;
                less += spline_at(given, u, &rise);
                slope += rise / area[j];
            }
            g0[j] = less + slope * (q0[j] - u * a0[j]);
            gP[j] = slope * (qP[j] - u * aP[j]);
            gH[j] = slope * (qH[j] - u * aH[j]);
            m0[j] = w[j] * (area[j] + a0[j]) - volume[j];
            mP[j] = w[j] * aP[j];
            mH[j] = w[j] * aH[j];
            f0[j] = flow[j] + q0[j];
            fP[j] = qP[j];
            fH[j] = qH[j];
        });
        for (int b = 1; b < nb; b++) {
            const ptrdiff_t from = (ptrdiff_t)b * n;
            ZOO_LOOP(j, n, {
                const ptrdiff_t y = from + j;
                const double aD = aP[y] + 0.5 * aH[y], qD = qP[y] + 0.5 * qH[y];
                m0[j] += w[from + j] * (area[y] + a0[y] - aD * g0[j]);
                mP[j] += w[from + j] * (aP[y] - aD * gP[j]);
                mH[j] += w[from + j] * (aH[y] - aD * gH[j]);
                f0[j] -= flow[y] + q0[y] - qD * g0[j];
                fP[j] -= qP[y] - qD * gP[j];
                fH[j] -= qH[y] - qD * gH[j];
            });
        }
        ZOO_LOOP(j, n, {
            const double inv = 1.0 / (mP[j] * fH[j] - mH[j] * fP[j]);
            const double dP = (mH[j] * f0[j] - fH[j] * m0[j]) * inv, dH = (fP[j] * m0[j] - mP[j] * f0[j]) * inv;
            const double dD = g0[j] + gP[j] * dP + gH[j] * dH;
            P[j] += dP;
            H[j] += dH;
            D[j] += dD;
            m0[j] = dP;
            mH[j] = dH;
            g0[j] = dD;
        });
        ZOO_LOOP(x, n * nb, {
            const ptrdiff_t o = node[x], y = junction[x];
            const double dD = 0.5 * (1.0 - sign[x]) * g0[y], dP = m0[y] - dD, dH = mH[y] - 0.5 * dD;
            /* never more than halfway to the wall's limits */
            const double room = 0.5 * (wall_limit(wall, (wall_shape){th + o, stride, added}) * A0[x] - area[x]);
            const double fall = 0.5 * (wall_floor(wall, (wall_shape){th + o, stride, added}) * A0[x] - area[x]);
            double move = a0[x] + aP[x] * dP + aH[x] * dH;
            move = move > room ? room : move < fall ? fall : move;
            const double turn = q0[x] + qP[x] * dP + qH[x] * dH;
            area[x] += move;
            flow[x] += turn;
            /* what is left after this round is of the order of these squares: below rounding */
            const double per_area = fast_reciprocal(area[x]), da = move * per_area, du = turn * per_area;
            unfinished |= K[o] * da * da + bent * du * du > 1e-11 * K[o];
        });
        if (!unfinished)
            break;
        if (round + 1 == ROUNDS) {
            s->no_root = 1;
            for (ptrdiff_t y = 0; y < (ptrdiff_t)n; y++)
                s->stuck |= !(fabs(m0[y]) <= 1e-6 * (fabs(P[y]) + 1.0));
        }
    }
    ZOO_LOOP(x, n * nb, {
        const ptrdiff_t o = node[x];
        q[o] = flow[x];
        A[o] = area[x];
    });
}

#endif
