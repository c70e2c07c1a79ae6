/* At the end of a terminal vessel: behind R1 an inertance beside a resistance R_p, and
 * several parallel RC pairs (sections),
 *
 *   p = p_out + R1 q + p_L + sum_k v_k,     C_k dv_k/dt = q - v_k/R_k,
 *   p_L = L dq_L/dt = R_p (q - q_L),     R_p = 6 rho c/A0 of the vessel's end at rest.
 *
 * R_p lets the fastest waves out, which an inertance alone would send back whole.  They
 * must leave: a vessel that shares the static pressure of its junction returns waves
 * amplified by up to (c + u)/(c - u), so with an outlet that returns all of them every
 * harmonic grows, those of the shortest vessels first, and the equations have no solution
 * for a scheme to converge to.
 *
 * Each pair is integrated as in outlet_windkessel.h.  In the mean over the step, with mean flow Q,
 * and c the inertance's flow by the trapezoidal rule (stable for any L),
 *
 *   p_L = I (Q - c),   c' = c + dt/L p_L,   I = 2 L/(dt + 2 L/R_p),
 *   p(A') = 2 p_out - p + sum_k (1 + e_k) v_k - 2 I c + E Q(A'),   E = 2 R1 + sum_k R_k (1 - e_k) + 2 I.
 *
 * The node's own flow follows from y = p - p_out - sum_k v_k, linear over the step, exactly:
 * L (1 + R1/R_p) dq_L/dt + R1 q_L = y gives q_L' = keep q_L + now y' + before y, and
 * q = (R_p q_L + y)/(R1 + R_p) = share q_L + direct y.  Unlike c this has no memory of a
 * sawtooth when L is small, and without L it is y'/R1 as in outlet_windkessel.h.
 *
 * Resistances and compliances may depend on the pressure v = p_out + sum_k v_k of the sections behind R1, R_k exp(f(v)) and C_k exp(g(v)),
 * with dv_k/dt as above, so that C is dV/dv: e_k, their resistances and E are then made anew for each step, with v half
 * a step on.
 *
 * Where p_out changes over the beat, its mean is p_out above and the rest, f, acts behind the resistances: the
 * compliances rest on the tissue and not on the veins,
 *
 *   C_k dv_k/dt = q - (v_k - s_k f)/R_k,   s_k = R_k/sum R,
 *
 * of which a step adds pull_k f to v_k', pull_k = s_k (1 - e_k) and f its mean over the step.  An outlet without
 * sections has f in front of its resistance, p = p_out + f + R1 q: `straight` is 1 there.
 *
 * A section may be negative, R_k < 0 and C_k < 0: its pressure decays as that of a positive one.  R1 larger than all of
 * these together keeps the real part of the impedance positive, since that of R_k/(1 + i w R_k C_k) is at least R_k.
 *
 * Modes, damped oscillations of the impulse response, are pairs of a complex time constant.  Each is the real part of a
 * complex pressure w, dw/dt = (i f - s) w + (a - i b) q, and integrated as a pair is: w' = e w + fill Q with complex e
 * and fill.  They are as passive as the caller makes them.
 *
 * A Windkessel in a tree with additions runs these loops too, with one section and no
 * inertance; then neither is read.  outlet.h says what each function is for.
 */
#ifndef ZOO_OUTLET_CIRCUIT_H
#define ZOO_OUTLET_CIRCUIT_H

enum {
    circuit_loops = OUTLET_ADDED,
    CIRCUIT_PARALLEL = 6 /* R_p in rho c/A0 at rest */
};

/* E; 2 I; c' = c + gain (Q - c); q_L' = keep q_L + now y' + before y; q = share q_L + direct y; straight; then e of
 * the sections, their R (1 - e), their pull, then of each mode the real and imaginary parts of e and of its fill */
enum {
    CIRCUIT_E,
    CIRCUIT_INERTIA,
    CIRCUIT_GAIN,
    CIRCUIT_KEEP,
    CIRCUIT_NOW,
    CIRCUIT_BEFORE,
    CIRCUIT_SHARE,
    CIRCUIT_DIRECT,
    CIRCUIT_STRAIGHT,
    CIRCUIT_DECAY
};
enum { CIRCUIT_BASE, CIRCUIT_Q_MID, CIRCUIT_Y, CIRCUIT_BACK, CIRCUIT_A, CIRCUIT_P, CIRCUIT_SCRATCH };

/* Sections that the caller gave; 0: one of R2 and C. */
ZOO_INLINE int circuit_given(const zoo_problem *pr)
{
    return pr->outlet.kind == ZOO_OUTLET_WINDKESSEL ? 0 : pr->outlet.n_sections;
}

ZOO_INLINE int circuit_sections(const zoo_problem *pr)
{
    return circuit_given(pr) > 0 ? circuit_given(pr) : 1;
}

ZOO_INLINE int circuit_modes(const zoo_problem *pr)
{
    return pr->outlet.kind == ZOO_OUTLET_WINDKESSEL ? 0 : pr->outlet.n_modes;
}

/* Rows of a mode: its state's real part, the imaginary one after it; and its coefficients. */
ZOO_INLINE int circuit_mode_state(int sections, int mode)
{
    return sections + 2 * mode;
}

ZOO_INLINE int circuit_mode_row(int sections, int mode)
{
    return CIRCUIT_DECAY + 3 * sections + 4 * mode;
}

/* A mode's part in the impedance of vessel k for steady flow, over psi1: (a s + b w)/(s^2 + w^2). */
static inline double circuit_mode_steady(const zoo_problem *pr, int m, int k)
{
    const zoo_outlet *out = &pr->outlet;
    const ptrdiff_t i = (ptrdiff_t)k * out->n_modes + m;
    const double rate = out->mode_rate, w = out->mode_frequency[m];
    return (out->mode_cosine[i] * rate + out->mode_sine[i] * w) / (rate * rate + w * w);
}

static inline double circuit_inertance(const zoo_problem *pr, int k)
{
    return pr->outlet.kind == ZOO_OUTLET_WINDKESSEL ? 0.0 : value_or_zero(pr->outlet.inertance, k);
}

/* R and C of section m of terminal t; R = 0: the section is absent. */
static inline double circuit_R(const zoo_sim *s, int m, int t)
{
    const int n = circuit_given(s->problem);
    const double R2 = s->outlets.R2[t];
    return n ? R2 * s->problem->outlet.section_resistance[(ptrdiff_t)s->outlets.vessel[t] * n + m] : R2;
}

static inline double circuit_C(const zoo_sim *s, int m, int t)
{
    const int n = circuit_given(s->problem);
    const double C = s->outlets.C[t];
    return n ? C * s->problem->outlet.section_compliance[(ptrdiff_t)s->outlets.vessel[t] * n + m] : C;
}

/* s of a section. */
static inline double circuit_part(const zoo_sim *s, int m, int t)
{
    double all = 0.0;
    for (int i = 0; i < circuit_sections(s->problem); i++)
        all += circuit_R(s, i, t);
    return all > 0.0 ? circuit_R(s, m, t) / all : 0.0;
}

/* s f in this step: where the section's pressure goes without flow. */
static inline double circuit_rest(const zoo_sim *s, int m, int t)
{
    return s->problem->outlet.n_wave > 0 ? circuit_part(s, m, t) * s->outlets.wave_mean[t] : 0.0;
}

static inline int circuit_bad(const zoo_problem *pr, const int *children)
{
    const zoo_outlet *out = &pr->outlet;
    int64_t nv = pr->network.n_vessels, ns = out->n_sections, nm = out->n_modes;
    if (nm < 0 || (nm > 0 && (value_extreme(out->mode_rate) || !out->mode_frequency || !out->mode_cosine || !out->mode_sine ||
                              values_outside(out->mode_frequency, nm, 0.0, ZOO_MOST_VALUE))))
        return 1;
    for (int64_t k = 0; k < nv && nm > 0; k++)
        if (children[k] == 0 && (values_outside(out->mode_cosine + k * nm, nm, -ZOO_MOST_VALUE, ZOO_MOST_VALUE) ||
                                 values_outside(out->mode_sine + k * nm, nm, -ZOO_MOST_VALUE, ZOO_MOST_VALUE)))
            return 1;
    if (values_outside(out->inertance, nv, 0.0, INFINITY) || ns < 0 ||
        (ns > 0 && (!out->section_resistance || !out->section_compliance)))
        return 1;
    for (int64_t k = 0; k < nv && ns > 0; k++) {
        if (children[k] > 0)
            continue;
        double sum = 0.0, time = 0.0;
        for (int64_t i = k * ns; i < (k + 1) * ns; i++) {
            double rho = out->section_resistance[i], along = rho < 0.0 ? -1.0 : 1.0;
            if (!isfinite(rho) || (rho != 0.0 && value_bad(along * out->section_compliance[i])))
                return 1;
            sum += rho;
            time += rho != 0.0 ? rho * (rho * out->section_compliance[i]) : 0.0;
        }
        if (value_bad(sum) || !(time > 0.0)) /* the mean time is positive, from which a first beat starts */
            return 1;
    }
    return 0;
}

/* Whether a terminal's R1 outweighs its negative sections of R2, and all together lets steady flow fall with pressure. */
static inline int circuit_passive(const zoo_problem *pr, int k, double R1, double R2)
{
    const int64_t ns = pr->outlet.kind == ZOO_OUTLET_CIRCUIT ? pr->outlet.n_sections : 0;
    double below = 0.0;
    for (int64_t i = k * ns; i < (k + 1) * ns; i++)
        below -= fmin(pr->outlet.section_resistance[i], 0.0);
    double behind = 0.0; /* of the modes over psi1 */
    for (int m = 0; m < circuit_modes(pr); m++)
        behind += circuit_mode_steady(pr, m, k);
    double sections = circuit_given(pr) ? 0.0 : 1.0;
    for (int64_t i = k * ns; i < (k + 1) * ns; i++)
        sections += pr->outlet.section_resistance[i];
    return (below == 0.0 || R1 > below * R2) && (circuit_modes(pr) == 0 || R1 + sections * R2 + behind * R1 / pr->outlet.R1[k] > 0.0);
}

/* Unless every terminal is a Windkessel. */
static inline int circuit_adds(const zoo_problem *pr, const int *children)
{
    const zoo_outlet *out = &pr->outlet;
    const int64_t ns = out->n_sections;
    for (int k = 0; k < pr->network.n_vessels; k++) {
        if (children[k] > 0)
            continue;
        for (int64_t i = k * out->n_modes; i < (k + 1) * out->n_modes; i++)
            if (out->mode_cosine[i] != 0.0 || out->mode_sine[i] != 0.0)
                return 1;
        int there = 0;
        for (int64_t i = k * ns; i < (k + 1) * ns; i++) {
            double rho = out->section_resistance[i];
            there += rho != 0.0;
            if (rho != 0.0 && (rho != 1.0 || out->section_compliance[i] != 1.0))
                return 1;
        }
        if (there > 1 || value_or_zero(out->inertance, k) != 0.0)
            return 1;
    }
    return 0;
}

static inline zoo_rows circuit_rows(const zoo_problem *pr)
{
    int n = circuit_sections(pr), modes = circuit_modes(pr);
    return (zoo_rows){.coefficients = circuit_mode_row(n, modes), .pressures = circuit_mode_state(n, modes), .flows = 1, .scratch = CIRCUIT_SCRATCH};
}

static inline double circuit_parallel(const zoo_sim *s, int t)
{
    int j = s->outlets.node[t];
    double p = wall_p(s->wall, s->K[j], zoo_shape(s, j), 1.0, 1.0);
    double slope = wall_slope(s->wall, s->K[j], zoo_shape(s, j), p, 1.0, 1.0); /* rho c^2 at rest */
    return CIRCUIT_PARALLEL * sqrt(slope / s->inv_density) / s->A0[j];
}

static inline void circuit_set_step(zoo_sim *s)
{
    zoo_terminals *ou = &s->outlets;
    const int ns = circuit_sections(s->problem);
    double *row[CIRCUIT_DECAY], *decay = outlet_row(s, ou->coefficient, CIRCUIT_DECAY);
    double *fill = outlet_row(s, decay, ns), *pull = outlet_row(s, fill, ns);
    for (int m = 0; m < CIRCUIT_DECAY; m++)
        row[m] = outlet_row(s, ou->coefficient, m);
    for (int t = 0; t < ou->count; t++) {
        double L = circuit_inertance(s->problem, ou->vessel[t]), filled = 0.0, R1 = ou->R1[t], all = 0.0;
        for (int m = 0; m < ns; m++)
            all += circuit_R(s, m, t);
        for (int m = 0; m < ns; m++) {
            int o = m * ou->count + t;
            double R = circuit_R(s, m, t), RC = R * circuit_C(s, m, t);
            decay[o] = R != 0.0 ? exp(-s->dt / RC) : 0.0;
            fill[o] = R != 0.0 ? -R * expm1(-s->dt / RC) : 0.0;
            pull[o] = R != 0.0 ? fill[o] / all : 0.0;
            filled += fill[o];
        }
        for (int m = 0; m < circuit_modes(s->problem); m++) {
            const zoo_outlet *out = &s->problem->outlet;
            const ptrdiff_t i = (ptrdiff_t)ou->vessel[t] * out->n_modes + m;
            double *row_m = outlet_row(s, ou->coefficient, circuit_mode_row(ns, m)) + t;
            const double rate = out->mode_rate, w = out->mode_frequency[m], size = ou->psi1[t] / (rate * rate + w * w);
            const double a = out->mode_cosine[i], b = out->mode_sine[i], half = sin(0.5 * w * s->dt), keep = exp(-rate * s->dt);
            /* e - 1, without cancellation; fill = psi1 (a - i b) (e - 1)/(i w - rate) */
            const double less = expm1(-rate * s->dt) - 2.0 * keep * half * half, turn = keep * sin(w * s->dt);
            const double re = size * (turn * w - less * rate), im = -size * (less * w + turn * rate);
            row_m[0] = 1.0 + less;
            row_m[ou->count] = turn;
            row_m[2 * ou->count] = a * re + b * im;
            row_m[3 * ou->count] = a * im - b * re;
            filled += row_m[2 * ou->count];
        }
        /* the inertance's pressure in the mean over the step is inertia/2 (Q - c) */
        double Rp = circuit_parallel(s, t), ease = s->dt + 2.0 * L / Rp;
        double inertia = 4.0 * L / ease, share = L > 0.0 ? Rp / (R1 + Rp) : 1.0;
        row[CIRCUIT_INERTIA][t] = inertia;
        row[CIRCUIT_STRAIGHT][t] = all > 0.0 ? 0.0 : 1.0;
        row[CIRCUIT_GAIN][t] = L > 0.0 ? 2.0 * s->dt / ease : 1.0;
        row[CIRCUIT_E][t] = 2.0 * R1 + filled + inertia;
        row[CIRCUIT_DIRECT][t] = L > 0.0 ? 1.0 / (R1 + Rp) : 0.0;
        row[CIRCUIT_SHARE][t] = share;
        /* L (1 + R1/R_p) dq_L/dt + R1 q_L = y is integrated exactly for y linear over the step */
        double x = L > 0.0 ? R1 * s->dt / L * share : INFINITY, keep = exp(-x);
        double mean = x < 1e-3 ? 1.0 - x / 2.0 + x * x / 6.0 : isinf(x) ? 0.0 : -expm1(-x) / x;
        row[CIRCUIT_KEEP][t] = keep;
        row[CIRCUIT_NOW][t] = (x < 1e-3 ? x / 2.0 - x * x / 6.0 : 1.0 - mean) / R1;
        row[CIRCUIT_BEFORE][t] = (x < 1e-3 ? x / 2.0 - x * x / 3.0 : mean - keep) / R1;
    }
}

/* Of the sections and modes behind R1. */
static inline double circuit_behind(const zoo_sim *s, int t)
{
    double sum = 0.0;
    for (int m = 0; m < circuit_sections(s->problem); m++)
        sum += circuit_R(s, m, t);
    for (int m = 0; m < circuit_modes(s->problem); m++)
        sum += s->outlets.psi1[t] * circuit_mode_steady(s->problem, m, s->outlets.vessel[t]);
    return sum;
}

static inline double circuit_resistance(const zoo_sim *s, int t)
{
    return s->outlets.R1[t] + circuit_behind(s, t);
}

/* Of one pair of all the sections' resistance, with their mean time. */
static inline double circuit_capacity(const zoo_sim *s, int t)
{
    double sum = 0.0, all = circuit_behind(s, t);
    for (int m = 0; m < circuit_sections(s->problem); m++) {
        double part = all > 0.0 ? circuit_R(s, m, t) / all : 0.0;
        sum += part != 0.0 ? part * part * circuit_C(s, m, t) : 0.0;
    }
    return sum;
}

static inline void circuit_start(zoo_sim *s, int t)
{
    int j = s->outlets.node[t];
    double v = s->P[j] - s->outlets.behind[t] - s->outlets.R1[t] * s->q[j], R = circuit_behind(s, t);
    for (int m = 0; m < circuit_sections(s->problem); m++)
        outlet_row(s, s->outlets.v, m)[t] = R > 0.0 ? v * circuit_R(s, m, t) / R : 0.0;
    for (int m = 0; m < circuit_modes(s->problem); m++) {
        double *w = outlet_row(s, s->outlets.v, circuit_mode_state(circuit_sections(s->problem), m)) + t;
        w[0] = R > 0.0 ? v * s->outlets.psi1[t] * circuit_mode_steady(s->problem, m, s->outlets.vessel[t]) / R : 0.0;
        w[s->outlets.count] = 0.0;
    }
    s->outlets.carry[t] = s->q[j];
}

/* Coefficients of the step that begins, where they depend on the pressure behind R1. */
static inline void circuit_set_pressure(zoo_sim *s)
{
    zoo_terminals *ou = &s->outlets;
    const int ns = circuit_sections(s->problem), modes = circuit_modes(s->problem);
    double *decay = outlet_row(s, ou->coefficient, CIRCUIT_DECAY), *fill = outlet_row(s, decay, ns), *pull = outlet_row(s, fill, ns);
    double *E = outlet_row(s, ou->coefficient, CIRCUIT_E);
    const double *inertia = outlet_row(s, ou->coefficient, CIRCUIT_INERTIA);
    for (int t = 0; t < ou->count; t++) {
        const double q = s->q[ou->node[t]];
        double v = ou->behind[t], rate = 0.0, all = 0.0;
        for (int m = 0; m < ns; m++)
            v += outlet_row(s, ou->v, m)[t];
        for (int half = 0; half < 2; half++) {
            const double now = half ? v + 0.5 * s->dt * rate : v;
            const double more_R = exp(spline_value(s->resistance_function, now)),
                         more_C = exp(spline_value(s->compliance_function, now));
            for (int m = 0; m < ns; m++) {
                const double R = more_R * circuit_R(s, m, t), C = more_C * circuit_C(s, m, t);
                const int o = m * ou->count + t;
                if (R == 0.0)
                    continue;
                if (half) {
                    decay[o] = exp(-s->dt / (R * C));
                    fill[o] = -R * expm1(-s->dt / (R * C));
                    pull[o] = circuit_part(s, m, t) * (1.0 - decay[o]);
                    all += fill[o];
                } else
                    rate += (q - (ou->v[o] - circuit_rest(s, m, t)) / R) / C;
            }
        }
        for (int m = 0; m < modes; m++)
            all += outlet_row(s, ou->coefficient, circuit_mode_row(ns, m) + 2)[t];
        E[t] = 2.0 * ou->R1[t] + all + inertia[t];
    }
}

ZOO_INLINE void circuit_advance(const int wall, const int extra, zoo_sim *s)
{
    (void)extra;
    enum { ROUNDS = 30 };
    zoo_terminals *ou = &s->outlets;
    const int n = ou->count, n_sections = circuit_sections(s->problem), n_modes = circuit_modes(s->problem),
              waves = s->problem->outlet.n_wave > 0;
    const double dt = s->dt, later = 0.5 * (1.0 + s->relax), stiff = s->stiff;
    const int *restrict node = ou->node;
    const double *restrict per_w = ou->per_w, *restrict A0 = ou->A0, *restrict p_out = ou->behind,
                           *restrict E = outlet_row(s, ou->coefficient, CIRCUIT_E),
                           *restrict inertia = outlet_row(s, ou->coefficient, CIRCUIT_INERTIA),
                           *restrict gain = outlet_row(s, ou->coefficient, CIRCUIT_GAIN),
                           *restrict keep = outlet_row(s, ou->coefficient, CIRCUIT_KEEP),
                           *restrict after = outlet_row(s, ou->coefficient, CIRCUIT_NOW),
                           *restrict before = outlet_row(s, ou->coefficient, CIRCUIT_BEFORE),
                           *restrict share = outlet_row(s, ou->coefficient, CIRCUIT_SHARE),
                           *restrict direct = outlet_row(s, ou->coefficient, CIRCUIT_DIRECT),
                           *restrict decay = outlet_row(s, ou->coefficient, CIRCUIT_DECAY),
                           *restrict fill = outlet_row(s, ou->coefficient, CIRCUIT_DECAY + n_sections),
                           *restrict pull = outlet_row(s, ou->coefficient, CIRCUIT_DECAY + 2 * n_sections),
                           *restrict straight = outlet_row(s, ou->coefficient, CIRCUIT_STRAIGHT),
                           *restrict f_now = ou->wave_now, *restrict f_then = ou->wave_then, *restrict f = ou->wave_mean;
    const double *restrict P = s->P, *restrict K = s->K, *restrict qh = s->qh, *restrict Ph = s->Ph,
                           *restrict off = s->off, *restrict kappa = s->kappa, *restrict leak = s->leak;
    const double *restrict th = s->coefficient;
    const ptrdiff_t stride = s->n_nodes;
    const zoo_spline added = s->wall_function;
    double *restrict A = s->A, *restrict q = s->q, *restrict v = ou->v, *restrict volume = ou->volume,
                     *restrict carry = ou->carry, *restrict base = outlet_row(s, ou->scratch, CIRCUIT_BASE),
                     *restrict q_mid = outlet_row(s, ou->scratch, CIRCUIT_Q_MID),
                     *restrict y = outlet_row(s, ou->scratch, CIRCUIT_Y),
                     *restrict back = outlet_row(s, ou->scratch, CIRCUIT_BACK),
                     *restrict a = outlet_row(s, ou->scratch, CIRCUIT_A),
                     *restrict p = outlet_row(s, ou->scratch, CIRCUIT_P);
    ZOO_LOOP(t, n, {
        const ptrdiff_t o = node[t];
        y[t] = P[o] - p_out[t];
        base[t] = 2.0 * p_out[t] - P[o] - inertia[t] * carry[t];
        /* the half cell's leak is w leak p* */
        q_mid[t] = qh[o - 1] - dt / per_w[t] * leak[node[t]] * Ph[o - 1];
        a[t] = A[o] / A0[t];
    });
    for (int m = 0; m < n_sections; m++) {
        const ptrdiff_t from = (ptrdiff_t)m * n;
        ZOO_LOOP(t, n, {
            y[t] -= v[from + t];
            base[t] += (1.0 + decay[from + t]) * v[from + t];
        });
        if (waves)
            ZOO_LOOP(t, n, { base[t] += pull[from + t] * f[t]; });
    }
    for (int m = 0; m < n_modes; m++) {
        const double *restrict keeps = outlet_row(s, ou->coefficient, circuit_mode_row(n_sections, m));
        const double *restrict w = outlet_row(s, ou->v, circuit_mode_state(n_sections, m));
        ZOO_LOOP(t, n, {
            y[t] -= w[t];
            base[t] += (1.0 + keeps[t]) * w[t] - keeps[n + t] * w[n + t];
        });
    }
    if (waves)
        ZOO_LOOP(t, n, {
            y[t] -= straight[t] * f_now[t];
            base[t] += straight[t] * (f_now[t] + f_then[t]);
        });
    if (wall_in_root(wall))
        /* k2 r^2 + K1 r = k0 for r = sqrt(A'/A0) */
        ZOO_LOOP(t, n, {
            const ptrdiff_t o = node[t];
            const double K1 = wall_stiffened(K[o], stiff, later, kappa[node[t]]), k2 = E[t] * A0[t] / per_w[t];
            const double k0 = K1 - off[o] + base[t] + E[t] * (q_mid[t] + A[o] / per_w[t]);
            const double r = 2.0 * k0 / (K1 + sqrt(K1 * K1 + 4.0 * k2 * k0));
            a[t] = r * r;
        });
    else
        for (int round = 0; round < ROUNDS; round++) {
            int unfinished = 0;
            ZOO_LOOP(t, n, {
                const ptrdiff_t o = node[t];
                const double K1 = wall_stiffened(K[o], stiff, later, kappa[node[t]]), root = sqrt(a[t]);
                const double elastic = wall_p(wall, K1, (wall_shape){th + o, stride, added}, a[t], root);
                const double Q = q_mid[t] - (a[t] * A0[t] - A[o]) / per_w[t];
                const double slope = wall_slope(wall, K1, (wall_shape){th + o, stride, added}, elastic, a[t], root) + E[t] * A0[t] / per_w[t];
                const double room = 0.5 * (wall_limit(wall, (wall_shape){th + o, stride, added}) - a[t]);
                const double fall = 0.5 * (wall_floor(wall, (wall_shape){th + o, stride, added}) - a[t]);
                double move = -(elastic + off[o] - base[t] - E[t] * Q) / slope;
                move = move > room ? room : move < fall ? fall : move;
                a[t] += move;
                p[t] = move;
                unfinished |= fabs(move) > 1e-8;
            });
            if (!unfinished)
                break;
            if (round + 1 == ROUNDS) {
                s->no_root = 1;
                for (ptrdiff_t t = 0; t < n; t++)
                    s->stuck |= !(fabs(p[t]) <= 1e-6);
            }
        }
    ZOO_LOOP(t, n, {
        const ptrdiff_t o = node[t];
        const double then = A0[t] * a[t], Q = q_mid[t] - (then - A[o]) / per_w[t];
        A[o] = then;
        q[o] = keep[t] * (q[o] - direct[t] * y[t]) + share[t] * before[t] * y[t];
        y[t] = base[t] + E[t] * Q - p_out[t]; /* the new pressure above that behind, less the sections' below */
        back[t] = Q;
        carry[t] += gain[t] * (Q - carry[t]);
        volume[t] += dt * Q;
    });
    for (int m = 0; m < n_sections; m++) {
        const ptrdiff_t from = (ptrdiff_t)m * n;
        ZOO_LOOP(t, n, {
            v[from + t] = decay[from + t] * v[from + t] + fill[from + t] * back[t];
            y[t] -= v[from + t];
        });
        if (waves)
            ZOO_LOOP(t, n, {
                v[from + t] += pull[from + t] * f[t];
                y[t] -= pull[from + t] * f[t];
            });
    }
    for (int m = 0; m < n_modes; m++) {
        const double *restrict keeps = outlet_row(s, ou->coefficient, circuit_mode_row(n_sections, m));
        double *restrict w = outlet_row(s, ou->v, circuit_mode_state(n_sections, m));
        ZOO_LOOP(t, n, {
            const double re = w[t], im = w[n + t];
            w[t] = keeps[t] * re - keeps[n + t] * im + keeps[2 * n + t] * back[t];
            w[n + t] = keeps[n + t] * re + keeps[t] * im + keeps[3 * n + t] * back[t];
            y[t] -= w[t];
        });
    }
    if (waves)
        ZOO_LOOP(t, n, { y[t] -= straight[t] * f_then[t]; });
    ZOO_LOOP(t, n, { q[node[t]] += (share[t] * after[t] + direct[t]) * y[t]; });
}

#endif
