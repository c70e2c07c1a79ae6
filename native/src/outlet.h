/* At the end of a terminal vessel: a three-element Windkessel,
 *
 *   p = v + R1 q,   C dv/dt = q - v/R2      (eq. 3.7 with v the pressure on C).
 *
 * Over a step with mean outflow Q: v' = e v + R2 (1 - e) Q, e = exp(-dt/(R2 C)),
 * exact for constant Q.  Mass balance of the last half cell, w (A' - A) =
 * dt (q_mid - Q), and the mean of the Windkessel's first equation over the
 * step, (p + p')/2 - (v + v')/2 = R1 Q, leave one equation for A':
 *
 *   p(A') = -p + (1 + e) v + E Q(A'),   E = 2 R1 + R2 (1 - e).
 *
 * For the linear wall it is a quadratic in sqrt(A'/A0).
 */
#ifndef ZOO_OUTLET_H
#define ZOO_OUTLET_H

#include "internal.h"

/* Newton for the area ratio of a tangent wall. */
ZOO_INLINE void outlet_newton(const int wall, const int W, zoo_sim *s)
{
    zoo_outlets *ou = &s->outlets;
    const int n = ou->count;
    const int *restrict node = ou->node;
    const double *restrict per_w = ou->per_w, *restrict A0 = ou->A0, *restrict E = ou->E,
                           *restrict decay = ou->decay, *restrict v = ou->v;
    const double *restrict A = s->A, *restrict P = s->P, *restrict K = s->K, *restrict th = s->theta,
                 *restrict qh = s->qh;
    double *restrict a = ou->a, *restrict p = ou->p;
    ZOO_LOOP(W, i, t, l, 0, n, {
        const ptrdiff_t o = (ptrdiff_t)node[t] * W + l;
        a[i] = A[o] / A0[t];
        p[i] = P[o];
    });
    for (int iteration = 0; iteration < 30; iteration++) {
        int unfinished = 0;
        ZOO_LOOP(W, i, t, l, 0, n, {
            const ptrdiff_t o = (ptrdiff_t)node[t] * W + l;
            const double Q = qh[o - W] - (a[i] * A0[t] - A[o]) / per_w[t];
            const double miss = p[i] + P[o] - (1.0 + decay[i]) * v[i] - E[i] * Q;
            const double slope = wall_slope(wall, K[o], th[o], p[i], sqrt(a[i])) + E[i] * A0[t] / per_w[t];
            const double room = 0.5 * (wall_limit(wall, th[o]) - a[i]);
            double move = -miss / slope;
            const double fall = 0.5 * (wall_floor(wall, th[o]) - a[i]);
            move = move > room ? room : move < fall ? fall : move;
            a[i] += move;
            p[i] = wall_p(wall, K[o], th[o], a[i], sqrt(a[i]));
            unfinished |= fabs(move) > 1e-8;
        });
        if (!unfinished)
            return;
    }
    s->no_root = 1;
    for (int l = 0; l < W; l++)
        for (ptrdiff_t t = 0; t < n; t++) {
            const ptrdiff_t i = t * W + l, o = (ptrdiff_t)node[t] * W + l;
            const double Q = qh[o - W] - (a[i] * A0[t] - A[o]) / per_w[t];
            const double target = (1.0 + decay[i]) * v[i] + E[i] * Q - P[o];
            s->stuck[l] |= !(fabs(target - p[i]) <= 1e-6 * (fabs(target) + fabs(P[o])));
        }
}

ZOO_INLINE void outlet_body(const int wall, const int W, zoo_sim *s)
{
    zoo_outlets *ou = &s->outlets;
    const int n = ou->count;
    const int *restrict node = ou->node;
    const double *restrict per_w = ou->per_w, *restrict A0 = ou->A0, *restrict E = ou->E,
                           *restrict decay = ou->decay, *restrict fill = ou->fill,
                           *restrict inv_R1 = ou->inv_R1, *restrict found = ou->a;
    const double *restrict P = s->P, *restrict K = s->K, *restrict qh = s->qh;
    double *restrict A = s->A, *restrict q = s->q, *restrict v = ou->v, *restrict volume = ou->volume;
    const double dt = s->dt;
    if (wall == ZOO_WALL_TANGENT)
        outlet_newton(wall, W, s);
    ZOO_LOOP(W, i, t, l, 0, n, {
        const ptrdiff_t o = (ptrdiff_t)node[t] * W + l;
        const double now = A[o], q_mid = qh[o - W], base = (1.0 + decay[i]) * v[i] - P[o];
        /* linear wall: k2 r^2 + K r = k0 for r = sqrt(A'/A0) */
        const double k2 = E[i] * A0[t] / per_w[t];
        const double k0 = K[o] + base + E[i] * (q_mid + now / per_w[t]);
        const double r = 2.0 * k0 / (K[o] + sqrt(K[o] * K[o] + 4.0 * k2 * k0));
        const double then = A0[t] * (wall == ZOO_WALL_LINEAR ? r * r : found[i]);
        const double Q = q_mid - (then - now) / per_w[t];
        v[i] = decay[i] * v[i] + fill[i] * Q;
        A[o] = then;
        q[o] = (base + E[i] * Q - v[i]) * inv_R1[i];
        volume[i] += dt * Q;
    });
}

#endif
