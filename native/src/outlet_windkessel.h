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
    for (int i = 0; i < ou->count; i++) {
        const int there = ou->R2[i] > 0.0;
        decay[i] = there ? exp(-s->dt / (ou->R2[i] * ou->C[i])) : 0.0;
        fill[i] = there ? -ou->R2[i] * expm1(-s->dt / (ou->R2[i] * ou->C[i])) : 0.0;
        rest[i] = (1.0 - decay[i]) * ou->behind[i];
        E[i] = 2.0 * ou->R1[i] + fill[i];
        inv_R1[i] = 1.0 / ou->R1[i];
    }
}

static inline double windkessel_resistance(const zoo_sim *s, int t)
{
    return s->outlets.R1[t] + s->outlets.R2[t];
}

static inline double windkessel_capacity(const zoo_sim *s, int t)
{
    return s->outlets.C[t];
}

static inline void windkessel_start(zoo_sim *s, int t)
{
    int j = s->outlets.node[t];
    s->outlets.v[t] = s->outlets.R2[t] > 0.0 ? s->P[j] - s->outlets.R1[t] * s->q[j] : s->outlets.behind[t];
}

/* Newton for the area ratio of a wall without a closed form. */
ZOO_INLINE void windkessel_newton(const int wall, zoo_sim *s)
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
    const ptrdiff_t stride = s->n_nodes;
    const zoo_spline added = s->wall_function;
    double *restrict a = ou->scratch, *restrict p = outlet_row(s, ou->scratch, 1);
    ZOO_LOOP(t, n, {
        const ptrdiff_t o = node[t];
        a[t] = A[o] / A0[t];
        p[t] = P[o];
    });
    for (int iteration = 0; iteration < 30; iteration++) {
        int unfinished = 0;
        ZOO_LOOP(t, n, {
            const ptrdiff_t o = node[t];
            const double Q = qh[o - 1] - (a[t] * A0[t] - A[o]) / per_w[t];
            const double miss = p[t] + P[o] - (1.0 + decay[t]) * v[t] - E[t] * Q - rest[t];
            const double slope = wall_slope(wall, K[o], (wall_shape){th + o, stride, added}, p[t], a[t], sqrt(a[t])) + E[t] * A0[t] / per_w[t];
            const double room = 0.5 * (wall_limit(wall, (wall_shape){th + o, stride, added}) - a[t]);
            double move = -miss / slope;
            const double fall = 0.5 * (wall_floor(wall, (wall_shape){th + o, stride, added}) - a[t]);
            move = move > room ? room : move < fall ? fall : move;
            a[t] += move;
            p[t] = wall_p(wall, K[o], (wall_shape){th + o, stride, added}, a[t], sqrt(a[t]));
            unfinished |= fabs(move) > 1e-8;
        });
        if (!unfinished)
            return;
    }
    s->no_root = 1;
    for (ptrdiff_t t = 0; t < n; t++) {
        const ptrdiff_t o = node[t];
        const double Q = qh[o - 1] - (a[t] * A0[t] - A[o]) / per_w[t];
        const double target = (1.0 + decay[t]) * v[t] + E[t] * Q - P[o] + rest[t];
        s->stuck |= !(fabs(target - p[t]) <= 1e-6 * (fabs(target) + fabs(P[o])));
    }
}

ZOO_INLINE void windkessel_advance(const int wall, const int extra, zoo_sim *s)
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
        windkessel_newton(wall, s);
    ZOO_LOOP(t, n, {
        const ptrdiff_t o = node[t];
        const double now = A[o], q_mid = qh[o - 1], base = (1.0 + decay[t]) * v[t] - P[o] + rest[t];
        /* a wall linear in the root: k2 r^2 + K r = k0 for r = sqrt(A'/A0) */
        const double k2 = E[t] * A0[t] / per_w[t];
        const double k0 = K[o] + base + E[t] * (q_mid + now / per_w[t]);
        const double r = 2.0 * k0 / (K[o] + sqrt(K[o] * K[o] + 4.0 * k2 * k0));
        const double then = A0[t] * (wall_in_root(wall) ? r * r : found[t]);
        const double Q = q_mid - (then - now) / per_w[t];
        v[t] = decay[t] * v[t] + fill[t] * Q + rest[t];
        A[o] = then;
        q[o] = (base + E[t] * Q - v[t]) * inv_R1[t];
        volume[t] += dt * Q;
    });
}

#endif
