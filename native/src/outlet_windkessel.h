/* At the end of a terminal vessel: a three-element Windkessel,
 *
 *   p = v + R1 q,   C dv/dt = q - (v - p_out)/R2      (eq. 3.7 with v the pressure before C),
 *
 * or a single resistance, R2 = 0.  Over a step with mean outflow Q:
 * v' = e v + (1 - e) p_out + R2 (1 - e) Q, e = exp(-dt/(R2 C)), exact for constant Q.  Mass balance of the last half cell, w (A' - A) =
 * dt (q_mid - Q), and the mean of the Windkessel's first equation over the
 * step, (p + p')/2 - (v + v')/2 = R1 Q, leave one equation for A':
 *
 *   p(A') = -p + (1 + e) v + (1 - e) p_out + E Q(A'),   E = 2 R1 + R2 (1 - e).
 *
 * For the linear wall it is a quadratic in sqrt(A'/A0).  outlet.h says what each function is for.
 */
#ifndef ZOO_OUTLET_WINDKESSEL_H
#define ZOO_OUTLET_WINDKESSEL_H

enum { windkessel_loops = OUTLET_PLAIN };

/* e, R2 (1 - e), 2 R1 + R2 (1 - e), 1/R1, (1 - e) p_out */
enum { WINDKESSEL_DECAY, WINDKESSEL_FILL, WINDKESSEL_E, WINDKESSEL_INV_R1, WINDKESSEL_REST, WINDKESSEL_COEFFICIENTS };

static inline int windkessel_bad(const zoo_problem *pr, const int *children)
{
    (void)pr, (void)children;
    return 0;
}

static inline int windkessel_adds(const zoo_problem *pr, const int *children)
{
    (void)pr, (void)children;
    return 0;
}

static inline zoo_rows windkessel_rows(const zoo_problem *pr)
{
    (void)pr;
    return (zoo_rows){.coefficients = WINDKESSEL_COEFFICIENTS, .pressures = 1, .scratch = 2};
}

static inline void windkessel_set_step(zoo_sim *s)
{
    zoo_terminals *ou = &s->outlets;
    double *decay = outlet_row(s, ou->coefficient, WINDKESSEL_DECAY),
           *fill = outlet_row(s, ou->coefficient, WINDKESSEL_FILL), *E = outlet_row(s, ou->coefficient, WINDKESSEL_E),
           *inv_R1 = outlet_row(s, ou->coefficient, WINDKESSEL_INV_R1),
           *rest = outlet_row(s, ou->coefficient, WINDKESSEL_REST);
    for (int i = 0; i < ou->count * s->lanes; i++) {
        const int there = ou->R2[i] > 0.0;
        decay[i] = there ? exp(-s->dt / (ou->R2[i] * ou->C[i])) : 0.0;
        fill[i] = there ? -ou->R2[i] * expm1(-s->dt / (ou->R2[i] * ou->C[i])) : 0.0;
        rest[i] = (1.0 - decay[i]) * ou->behind[i / s->lanes];
        E[i] = 2.0 * ou->R1[i] + fill[i];
        inv_R1[i] = 1.0 / ou->R1[i];
    }
}

static inline double windkessel_resistance(const zoo_sim *s, int t, int l)
{
    return s->outlets.R1[t * s->lanes + l] + s->outlets.R2[t * s->lanes + l];
}

static inline double windkessel_capacity(const zoo_sim *s, int t, int l)
{
    return s->outlets.C[t * s->lanes + l];
}

static inline void windkessel_start(zoo_sim *s, int t, int l)
{
    int i = s->outlets.node[t] * s->lanes + l;
    s->outlets.v[t * s->lanes + l] = s->outlets.R2[t * s->lanes + l] > 0.0
                                         ? s->P[i] - s->outlets.R1[t * s->lanes + l] * s->q[i]
                                         : s->outlets.behind[t];
}

/* Newton for the area ratio of a wall without a closed form. */
ZOO_INLINE void windkessel_newton(const int wall, const int W, zoo_sim *s)
{
    zoo_terminals *ou = &s->outlets;
    const int n = ou->count;
    const int *restrict node = ou->node;
    const double *restrict per_w = ou->per_w, *restrict A0 = ou->A0, *restrict v = ou->v,
                           *restrict E = outlet_row(s, ou->coefficient, WINDKESSEL_E),
                           *restrict rest = outlet_row(s, ou->coefficient, WINDKESSEL_REST),
                           *restrict decay = outlet_row(s, ou->coefficient, WINDKESSEL_DECAY);
    const double *restrict A = s->A, *restrict P = s->P, *restrict K = s->K, *restrict qh = s->qh;
    const double *restrict th = s->coefficient;
    const ptrdiff_t stride = (ptrdiff_t)s->n_nodes * W;
    const zoo_spline added = s->wall_function;
    double *restrict a = ou->scratch, *restrict p = outlet_row(s, ou->scratch, 1);
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
            const double miss = p[i] + P[o] - (1.0 + decay[i]) * v[i] - E[i] * Q - rest[i];
            const double slope = wall_slope(wall, K[o], (wall_shape){th + o, stride, added}, p[i], a[i], sqrt(a[i])) + E[i] * A0[t] / per_w[t];
            const double room = 0.5 * (wall_limit(wall, (wall_shape){th + o, stride, added}) - a[i]);
            double move = -miss / slope;
            const double fall = 0.5 * (wall_floor(wall, (wall_shape){th + o, stride, added}) - a[i]);
            move = move > room ? room : move < fall ? fall : move;
            a[i] += move;
            p[i] = wall_p(wall, K[o], (wall_shape){th + o, stride, added}, a[i], sqrt(a[i]));
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
            const double target = (1.0 + decay[i]) * v[i] + E[i] * Q - P[o] + rest[i];
            s->stuck[l] |= !(fabs(target - p[i]) <= 1e-6 * (fabs(target) + fabs(P[o])));
        }
}

ZOO_INLINE void windkessel_advance(const int wall, const int W, const int extra, zoo_sim *s)
{
    (void)extra;
    zoo_terminals *ou = &s->outlets;
    const int n = ou->count;
    const int *restrict node = ou->node;
    const double *restrict per_w = ou->per_w, *restrict A0 = ou->A0, *restrict found = ou->scratch,
                           *restrict E = outlet_row(s, ou->coefficient, WINDKESSEL_E),
                           *restrict decay = outlet_row(s, ou->coefficient, WINDKESSEL_DECAY),
                           *restrict fill = outlet_row(s, ou->coefficient, WINDKESSEL_FILL),
                           *restrict inv_R1 = outlet_row(s, ou->coefficient, WINDKESSEL_INV_R1),
                           *restrict rest = outlet_row(s, ou->coefficient, WINDKESSEL_REST);
    const double *restrict P = s->P, *restrict K = s->K, *restrict qh = s->qh;
    double *restrict A = s->A, *restrict q = s->q, *restrict v = ou->v, *restrict volume = ou->volume;
    const double dt = s->dt;
    if (!wall_in_root(wall))
        windkessel_newton(wall, W, s);
    ZOO_LOOP(W, i, t, l, 0, n, {
        const ptrdiff_t o = (ptrdiff_t)node[t] * W + l;
        const double now = A[o], q_mid = qh[o - W], base = (1.0 + decay[i]) * v[i] - P[o] + rest[i];
        /* a wall linear in the root: k2 r^2 + K r = k0 for r = sqrt(A'/A0) */
        const double k2 = E[i] * A0[t] / per_w[t];
        const double k0 = K[o] + base + E[i] * (q_mid + now / per_w[t]);
        const double r = 2.0 * k0 / (K[o] + sqrt(K[o] * K[o] + 4.0 * k2 * k0));
        const double then = A0[t] * (wall_in_root(wall) ? r * r : found[i]);
        const double Q = q_mid - (then - now) / per_w[t];
        v[i] = decay[i] * v[i] + fill[i] * Q + rest[i];
        A[o] = then;
        q[o] = (base + E[i] * Q - v[i]) * inv_R1[i];
        volume[i] += dt * Q;
    });
}

#endif
