/* At the end of a terminal vessel, with what zoo_extras adds: behind R1 an inertance
 * beside a resistance R_p, and several parallel RC pairs,
 *
 *   p = R1 q + p_L + sum_k v_k,     C_k dv_k/dt = q - v_k/R_k,
 *   p_L = L dq_L/dt = R_p (q - q_L),     R_p = 6 rho c/A0 of the vessel's end at rest.
 *
 * R_p lets the fastest waves out, which an inertance alone would send back whole.  They
 * must leave: a vessel that shares the static pressure of its junction returns waves
 * amplified by up to (c + u)/(c - u), so with an outlet that returns all of them every
 * harmonic grows, those of the shortest vessels first, and the equations have no solution
 * for a scheme to converge to.
 *
 * Each pair is integrated as in outlet.h.  In the mean over the step, with mean flow Q,
 * and c the inertance's flow by the trapezoidal rule (stable for any L),
 *
 *   p_L = I (Q - c),   c' = c + dt/L p_L,   I = 2 L/(dt + 2 L/R_p),
 *   p(A') = -p + sum_k (1 + e_k) v_k - 2 I c + E Q(A'),   E = 2 R1 + sum_k R_k (1 - e_k) + 2 I.
 *
 * The node's own flow follows from y = p - sum_k v_k, linear over the step, exactly:
 * L (1 + R1/R_p) dq_L/dt + R1 q_L = y gives q_L' = keep q_L + now y' + before y, and
 * q = (R_p q_L + y)/(R1 + R_p) = share q_L + direct y.  Unlike c this has no memory of a
 * sawtooth when L is small, and without L it is y'/R1 as in outlet.h.
 */
#ifndef ZOO_OUTLET_EXTRA_H
#define ZOO_OUTLET_EXTRA_H

#include "internal.h"

ZOO_INLINE void outlet_extra(const int wall, const int W, zoo_sim *s)
{
    enum { ROUNDS = 30 };
    zoo_outlets *ou = &s->outlets;
    const int n = ou->count;
    const double dt = s->dt, later = 0.5 * (1.0 + s->relax), stiff = s->stiff;
    const int *restrict node = ou->node;
    const double *restrict per_w = ou->per_w, *restrict A0 = ou->A0, *restrict E = ou->E,
                           *restrict decay = ou->decay, *restrict fill = ou->fill,
                           *restrict inertia = ou->inertia, *restrict keep = ou->keep,
                           *restrict after = ou->now, *restrict before = ou->before, *restrict gain = ou->gain,
                           *restrict share = ou->share, *restrict direct = ou->direct;
    const double *restrict P = s->P, *restrict K = s->K, *restrict th = s->theta, *restrict qh = s->qh,
                           *restrict Ph = s->Ph, *restrict off = s->off, *restrict kappa = s->kappa,
                           *restrict leak = s->leak;
    double *restrict A = s->A, *restrict q = s->q, *restrict v = ou->v, *restrict volume = ou->volume,
                     *restrict carry = ou->carry, *restrict base = ou->base, *restrict q_mid = ou->q_mid,
                     *restrict y = ou->y, *restrict back = ou->back, *restrict a = ou->a, *restrict p = ou->p;
    ZOO_LOOP(W, i, t, l, 0, n, {
        const ptrdiff_t o = (ptrdiff_t)node[t] * W + l;
        y[i] = P[o];
        base[i] = -P[o] - inertia[i] * carry[i];
        /* the half cell's leak is w leak p* */
        q_mid[i] = qh[o - W] - dt / per_w[t] * leak[node[t]] * Ph[o - W];
        a[i] = A[o] / A0[t];
    });
    for (int m = 0; m < ou->n_sections; m++) {
        const ptrdiff_t from = (ptrdiff_t)m * n * W;
        ZOO_LOOP(W, i, t, l, 0, n, {
            y[i] -= v[from + i];
            base[i] += (1.0 + decay[from + i]) * v[from + i];
        });
    }
    if (wall == ZOO_WALL_LINEAR)
        /* k2 r^2 + K1 r = k0 for r = sqrt(A'/A0) */
        ZOO_LOOP(W, i, t, l, 0, n, {
            const ptrdiff_t o = (ptrdiff_t)node[t] * W + l;
            const double K1 = wall_stiffened(K[o], stiff, later, kappa[node[t]]), k2 = E[i] * A0[t] / per_w[t];
            const double k0 = K1 - off[o] + base[i] + E[i] * (q_mid[i] + A[o] / per_w[t]);
            const double r = 2.0 * k0 / (K1 + sqrt(K1 * K1 + 4.0 * k2 * k0));
            a[i] = r * r;
        });
    else
        for (int round = 0; round < ROUNDS; round++) {
            int unfinished = 0;
            ZOO_LOOP(W, i, t, l, 0, n, {
                const ptrdiff_t o = (ptrdiff_t)node[t] * W + l;
                const double K1 = wall_stiffened(K[o], stiff, later, kappa[node[t]]), root = sqrt(a[i]);
                const double elastic = wall_p(wall, K1, th[o], a[i], root);
                const double Q = q_mid[i] - (a[i] * A0[t] - A[o]) / per_w[t];
                const double slope = wall_slope(wall, K1, th[o], elastic, root) + E[i] * A0[t] / per_w[t];
                const double room = 0.5 * (wall_limit(wall, th[o]) - a[i]);
                const double fall = 0.5 * (wall_floor(wall, th[o]) - a[i]);
                double move = -(elastic + off[o] - base[i] - E[i] * Q) / slope;
                move = move > room ? room : move < fall ? fall : move;
                a[i] += move;
                p[i] = move;
                unfinished |= fabs(move) > 1e-8;
            });
            if (!unfinished)
                break;
            if (round + 1 == ROUNDS) {
                s->no_root = 1;
                for (int l = 0; l < W; l++)
                    for (ptrdiff_t t = 0; t < n; t++)
                        s->stuck[l] |= !(fabs(p[t * W + l]) <= 1e-6);
            }
        }
    ZOO_LOOP(W, i, t, l, 0, n, {
        const ptrdiff_t o = (ptrdiff_t)node[t] * W + l;
        const double then = A0[t] * a[i], Q = q_mid[i] - (then - A[o]) / per_w[t];
        A[o] = then;
        q[o] = keep[i] * (q[o] - direct[i] * y[i]) + share[i] * before[i] * y[i];
        y[i] = base[i] + E[i] * Q; /* the new pressure, less the sections' below */
        back[i] = Q;
        carry[i] += gain[i] * (Q - carry[i]);
        volume[i] += dt * Q;
    });
    for (int m = 0; m < ou->n_sections; m++) {
        const ptrdiff_t from = (ptrdiff_t)m * n * W;
        ZOO_LOOP(W, i, t, l, 0, n, {
            v[from + i] = decay[from + i] * v[from + i] + fill[from + i] * back[i];
            y[i] -= v[from + i];
        });
    }
    ZOO_LOOP(W, i, t, l, 0, n, { q[(ptrdiff_t)node[t] * W + l] += (share[i] * after[i] + direct[i]) * y[i]; });
}

#endif
