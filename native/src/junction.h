/* Where vessels meet: equal pressure, and no flow lost.
 *
 * Each branch brings the half cell (width w = dx/2) between its end and its
 * last midpoint.  Mass balance of the joined half cells over a step,
 *
 *   sum_b w_b (A_b' - A_b) = dt sum_b s_b q_mid,b     (s = 1 parent, -1 daughter),
 *
 * with A_b' = A_b(P'), is one equation for the one pressure P' of the junction.
 * It is solved in closed form for the linear wall (a quadratic in P') and for
 * equal walls (then A'/A0 is one ratio for all); otherwise by Newton.  Each
 * half cell's own balance gives the flow through its end at mid-step, and
 * these sum to zero exactly.  The momentum balance of each half cell is linear
 * in the mid-step pressure P_h, which is the one that makes the flows at the
 * new time sum to zero.
 *
 * A junction's branches are numbered branch-major: branch b of junction j is
 * x = b*count + j, so that each loop runs over all junctions of the group.
 *
 * With `extra` (see scheme.h) A_b(P') is that of the stiffer wall at P' - off, and
 * the half cells leak w leak p_mid; with `tables` friction has a factor that is given as a function.  Total pressure and losses: junction_total_pressure.h.
 */
#ifndef ZOO_JUNCTION_H
#define ZOO_JUNCTION_H

#include "internal.h"

/* Newton for the area ratios of walls that differ and have no closed form: the branches'
 * pressures are set equal, and the volume to the given one, both linearised. */
ZOO_INLINE void junction_newton(const int wall, const int extra, zoo_sim *s, zoo_junction_group *ju)
{
    const int n = ju->count, nb = ju->branches;
    const int *restrict node = ju->node;
    const double *restrict w = ju->w, *restrict A0 = ju->A0, *restrict volume = ju->volume;
    const double *restrict A = s->A, *restrict P = s->P, *restrict K = s->K;
    const double *restrict th = s->coefficient;
    const ptrdiff_t stride = s->n_nodes;
    const zoo_spline added = s->wall_function;
    double *restrict a = ju->area, *restrict p = ju->c, *restrict slope = ju->beta;
    double *restrict have = ju->sum_c, *restrict soft = ju->sum_beta;
    const double *restrict kappa = s->kappa, *restrict off = s->off;
    const double later = 0.5 * (1.0 + s->relax), stiff = s->stiff;
    /* the pressure of the old time is known already */
    ZOO_LOOP(x, n * nb, {
        const ptrdiff_t o = node[x];
        a[x] = A[o] / A0[x];
        p[x] = P[o];
        if (extra) /* but not that of the wall with a memory, or of another stiffness: see scheme.h */
            p[x] = wall_p(wall, wall_stiffened(K[o], stiff, later, kappa[node[x]]), (wall_shape){th + o, stride, added}, a[x], sqrt(a[x])) + off[o];
    });
    for (int iteration = 0; iteration < 30; iteration++) {
        int unfinished = 0;
        ZOO_LOOP(x, n * nb, {
            const ptrdiff_t o = node[x];
            slope[x] = extra ? wall_slope(wall, wall_stiffened(K[o], stiff, later, kappa[node[x]]), (wall_shape){th + o, stride, added},
                                          p[x] - off[o], a[x], sqrt(a[x]))
                             : wall_slope(wall, K[o], (wall_shape){th + o, stride, added}, p[x], a[x], sqrt(a[x]));
        });
        ZOO_LOOP(j, n, {
            have[j] = volume[j];
            soft[j] = 0.0;
        });
        for (int b = 0; b < nb; b++) {
            const ptrdiff_t from = (ptrdiff_t)b * n;
            ZOO_LOOP(j, n, {
                const double size = w[from + j] * A0[from + j];
                const ptrdiff_t y = from + j;
                have[j] -= size * (a[y] - p[y] / slope[y]);
                soft[j] += size / slope[y];
            });
        }
        for (int b = 0; b < nb; b++) {
            const ptrdiff_t from = (ptrdiff_t)b * n;
            ZOO_LOOP(j, n, {
                const ptrdiff_t y = from + j, o = node[from + j];
                /* never more than halfway to the wall's limits */
                const double room = 0.5 * (wall_limit(wall, (wall_shape){th + o, stride, added}) - a[y]);
                double move = (have[j] / soft[j] - p[y]) / slope[y];
                const double fall = 0.5 * (wall_floor(wall, (wall_shape){th + o, stride, added}) - a[y]);
                move = move > room ? room : move < fall ? fall : move;
                a[y] += move;
                p[y] = extra ? wall_p(wall, wall_stiffened(K[o], stiff, later, kappa[node[from + j]]), (wall_shape){th + o, stride, added}, a[y], sqrt(a[y])) + off[o]
                             : wall_p(wall, K[o], (wall_shape){th + o, stride, added}, a[y], sqrt(a[y]));
                unfinished |= fabs(move) > 1e-8; /* quadratic: the next move would be below rounding */
            });
        }
        if (!unfinished)
            return;
    }
    s->no_root = 1;
    for (ptrdiff_t y = 0; y < (ptrdiff_t)n * nb; y++) {
        const double target = have[ju->junction[y]] / soft[ju->junction[y]];
        s->stuck |= !(fabs(target - p[y]) <= 1e-6 * fabs(target));
    }
}

ZOO_INLINE void junction_body(const int wall, const int extra, const int tables, zoo_sim *s,
                              zoo_junction_group *ju)
{
    const int n = ju->count, nb = ju->branches;
    const int newton = !wall_in_root(wall) && (extra || !s->uniform);
    const double dt = s->dt, inv_rho = s->inv_density, alpha = s->momentum;
    const int *restrict node = ju->node, *restrict mid = ju->mid, *restrict junction = ju->junction;
    const double *restrict w = ju->w, *restrict per_w = ju->per_w, *restrict A0 = ju->A0,
                           *restrict f_s = ju->f_s, *restrict f_c = ju->f_c, *restrict sign = ju->sign;
    const double *restrict soft = ju->soft, *restrict rest = ju->rest, *restrict k1 = ju->soft1,
                 *restrict k2 = ju->soft2;
    double *restrict volume = ju->volume, *restrict area = ju->area, *restrict c = ju->c,
                     *restrict beta = ju->beta, *restrict sum_c = ju->sum_c, *restrict sum_beta = ju->sum_beta;
    double *restrict A = s->A, *restrict q = s->q;
    const double *restrict Ah = s->Ah, *restrict qh = s->qh, *restrict Ph = s->Ph,
                           *restrict Mh = s->Mh, *restrict Gh = s->Gh;
    const double *restrict kappa = s->kappa, *restrict off = s->off, *restrict leak = s->leak,
                 *restrict loss = s->loss, *restrict K = s->K;
    double *restrict k0 = ju->m0, *restrict e1 = ju->mP, *restrict e2 = ju->mH, *restrict per_K = ju->a0;
    const double later = 0.5 * (1.0 + s->relax), stiff = s->stiff;
    const zoo_spline factor = s->friction_function;

    ZOO_LOOP(j, n, {
        volume[j] = w[j] * A[node[j]] + dt * qh[mid[j]];
        if (extra) {
            volume[j] -= dt * w[j] * leak[node[j]] * Ph[mid[j]];
            k0[j] = e1[j] = e2[j] = 0.0;
        }
    });
    for (int b = 1; b < nb; b++) {
        const ptrdiff_t from = (ptrdiff_t)b * n;
        ZOO_LOOP(j, n, {
                volume[j] += w[from + j] * A[node[from + j]] - dt * qh[mid[from + j]];
                if (extra)
                    volume[j] -= dt * w[from + j] * leak[node[from + j]] * Ph[mid[from + j]];
        });
    }
    if (newton)
        junction_newton(wall, extra, s, ju);
    else if (extra) { /* sum w A0 (1 + (P - off)/K)^2 = volume, K of the stiffer wall */
        for (int b = 0; b < nb; b++) {
            const ptrdiff_t from = (ptrdiff_t)b * n;
            ZOO_LOOP(j, n, {
                const ptrdiff_t x = from + j, o = node[x];
                const double one = fast_reciprocal(wall_stiffened(K[o], stiff, later, kappa[node[x]]));
                const double at_0 = 1.0 - off[o] * one, size = w[x] * A0[x];
                per_K[from + j] = one;
                k0[j] += size * at_0 * at_0;
                e1[j] += size * at_0 * one;
                e2[j] += size * one * one;
            });
        }
        ZOO_LOOP(j, n, {
            const double excess = volume[j] - k0[j];
            volume[j] = excess / (e1[j] + sqrt(e1[j] * e1[j] + e2[j] * excess));
        });
    }
    else if (wall_in_root(wall)) /* sum w A0 (1 + P/K)^2 = volume; P takes volume's place */
        ZOO_LOOP(j, n, {
            const double excess = volume[j] - rest[j];
            volume[j] = excess / (k1[j] + sqrt(k1[j] * k1[j] + k2[j] * excess));
        });
    else
        ZOO_LOOP(j, n, { volume[j] /= rest[j]; });
    ZOO_LOOP(j, n, { sum_c[j] = sum_beta[j] = 0.0; });

    ZOO_LOOP(x, n * nb, {
        const ptrdiff_t o = node[x], m = mid[x];
        const double found = volume[junction[x]], root = 1.0 + (extra ? (found - off[o]) * per_K[x] : found * soft[x]);
        const double a = newton ? area[x] : wall_in_root(wall) ? root * root : found;
        const double now = A[o], then = a * A0[x], half = 0.5 * (now + then);
        const double lost = extra ? w[x] * leak[node[x]] * Ph[m] : 0.0;
        const double flux = qh[m] - sign[x] * (extra ? (then - now) / per_w[x] + lost : (then - now) / per_w[x]);
        const double u = flux / half, plain = f_s[x] * sqrt(half / A0[x]) + f_c[x];
        const double stick = tables ? spline_value(factor, fabs(u)) * plain : plain;
        const double drag = (extra ? stick + leak[node[x]] * Ph[m] + loss[node[x]] * half * half * fabs(flux) : stick) * u;
        const double push = 0.5 * per_w[x] * (half + Ah[m]) * inv_rho;
        area[x] = then;
        beta[x] = push;
        c[x] = q[o] - sign[x] * (per_w[x] * (alpha * flux * u - Mh[m]) - push * Ph[m]) -
               0.5 * dt * (drag + Gh[m]);
    });
    for (int b = 0; b < nb; b++) {
        const ptrdiff_t from = (ptrdiff_t)b * n;
        ZOO_LOOP(j, n, {
            sum_c[j] += sign[from + j] * c[from + j];
            sum_beta[j] += beta[from + j];
        });
    }
    ZOO_LOOP(j, n, { sum_c[j] /= sum_beta[j]; }); /* P_h */
    ZOO_LOOP(x, n * nb, {
        const ptrdiff_t o = node[x];
        q[o] = c[x] - sign[x] * beta[x] * sum_c[junction[x]];
        A[o] = area[x];
    });
}

#endif
