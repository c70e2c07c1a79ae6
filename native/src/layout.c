/* Memory and grid: what depends on the network, and on the parameters, but not on time. */
#include <math.h>
#include <string.h>

#include "internal.h"

/* Takes `count` elements off the workspace, aligned to a cache line. */
static void *carve(char **at, int64_t *used, int64_t count, int64_t size)
{
    void *here = *at ? *at + *used : NULL;
    *used += (count * size + 63) / 64 * 64;
    return here;
}

static int bad(double x)
{
    return !(x > 0.0) || isinf(x);
}

static int count_children(const zoo_network *net, int vessel)
{
    int n = 0;
    for (int k = vessel + 1; k < net->n_vessels; k++)
        n += net->parent[k] == vessel;
    return n;
}

/* 1 when an array is there and a value lies outside [low, high] or is not finite. */
static int outside(const double *values, int64_t n, double low, double high)
{
    for (int64_t i = 0; values && i < n; i++)
        if (!(values[i] >= low && values[i] <= high) || isinf(values[i]))
            return 1;
    return 0;
}

static int bad_extras(const zoo_problem *pr)
{
    const zoo_network *net = &pr->network;
    const zoo_extras *ex = &pr->extras;
    int64_t nv = net->n_vessels, ns = ex->n_sections;
    if (outside(ex->viscosity_factor, nv, 1e-300, INFINITY) ||
        outside(ex->offset_in, nv, -INFINITY, INFINITY) || outside(ex->offset_out, nv, -INFINITY, INFINITY) ||
        outside(ex->viscoelastic_time, nv, 0.0, INFINITY) || outside(ex->leak, nv, 0.0, INFINITY) ||
        outside(ex->inertance, nv, 0.0, INFINITY) || outside(ex->throat_severity, nv, 0.0, 1.0 - 1e-9) ||
        outside(ex->throat_position, nv, 0.0, 1.0) || outside(ex->throat_length, nv, 1e-300, INFINITY))
        return 1;
    if (outside(&ex->total_pressure, 1, 0.0, INFINITY) || outside(&ex->junction_loss, 1, 0.0, INFINITY) ||
        outside(&ex->throat_loss, 1, 0.0, INFINITY) || (ex->viscoelastic_time && bad(ex->relaxation_time)))
        return 1;
    if (ex->n_wave < 0 || (ex->n_wave > 0 && !ex->stiffness_wave) ||
        outside(ex->stiffness_wave, ex->n_wave, 1e-300, INFINITY))
        return 1;
    if (!ex->offset_in != !ex->offset_out)
        return 1;
    if (ex->throat_severity && (!ex->throat_position || !ex->throat_length))
        return 1;
    if (ns < 0 || (ns > 0 && (!ex->section_resistance || !ex->section_compliance)))
        return 1;
    for (int k = 0; k < nv && ns > 0; k++) {
        double sum = 0.0;
        for (int64_t i = k * ns; i < (k + 1) * ns && count_children(net, k) == 0; i++) {
            double rho = ex->section_resistance[i];
            if (!(rho >= 0.0) || isinf(rho) || (rho > 0.0 && bad(ex->section_compliance[i])))
                return 1;
            sum += rho;
        }
        if (count_children(net, k) == 0 && !(sum > 0.0))
            return 1;
    }
    return 0;
}

static int any_nonzero(const double *values, int64_t n)
{
    for (int64_t i = 0; values && i < n; i++)
        if (values[i] != 0.0)
            return 1;
    return 0;
}

/* Whether something is added that only the loops with additions have.  Other
 * frictions and a throat's narrower radius need none: they change the grid. */
int zoo_has_extras(const zoo_problem *pr)
{
    const zoo_network *net = &pr->network;
    const zoo_extras *ex = &pr->extras;
    int nv = net->n_vessels, ns = ex->n_sections;
    if (ex->force || ex->total_pressure != 0.0 || ex->junction_loss != 0.0 ||
        any_nonzero(ex->offset_in, nv) || any_nonzero(ex->offset_out, nv) ||
        any_nonzero(ex->viscoelastic_time, nv) || any_nonzero(ex->leak, nv) ||
        (ex->throat_loss != 0.0 && any_nonzero(ex->throat_severity, nv)))
        return 1;
    for (int i = 0; i < ex->n_wave; i++)
        if (ex->stiffness_wave[i] != 1.0)
            return 1;
    for (int k = 0; k < nv; k++) {
        if (count_children(net, k) > 0)
            continue;
        if (ex->inertance && ex->inertance[k] != 0.0)
            return 1;
        int there = 0;
        for (int i = k * ns; i < (k + 1) * ns; i++) {
            double rho = ex->section_resistance[i];
            there += rho != 0.0;
            if (rho != 0.0 && (rho != 1.0 || ex->section_compliance[i] != 1.0))
                return 1;
        }
        if (there > 1)
            return 1;
    }
    return 0;
}

/* Returns 0 when the problem can be solved at all, else 1. */
int zoo_check_problem(const zoo_problem *pr)
{
    const zoo_network *net = &pr->network;
    const zoo_outputs *out = &pr->outputs;
    const zoo_numerics *num = &pr->numerics;
    if (net->n_vessels < 1 || net->parent[0] != -1)
        return 1;
    for (int k = 0; k < net->n_vessels; k++) {
        if (k > 0 && (net->parent[k] < 0 || net->parent[k] >= k))
            return 1;
        if (net->n_cells[k] < 2 || bad(net->length[k]) || bad(net->radius_in[k]) ||
            bad(net->radius_out[k]))
            return 1;
        if (count_children(net, k) == 0 && (bad(net->R1[k]) || bad(net->R2[k]) || bad(net->C[k])))
            return 1;
    }
    if (bad(pr->physics.density) || bad(pr->physics.viscosity) || bad(pr->physics.wall_factor) ||
        !(pr->physics.momentum_correction >= 0.0) || !(pr->physics.stokes_friction >= 0.0) ||
        !(pr->physics.viscous_friction >= 0.0))
        return 1;
    if (bad_extras(pr))
        return 1;
    if (pr->physics.wall != ZOO_WALL_LINEAR && pr->physics.wall != ZOO_WALL_TANGENT)
        return 1;
    if (pr->physics.friction < ZOO_FRICTION_CURRENT || pr->physics.friction > ZOO_FRICTION_FIXED)
        return 1;
    if (pr->physics.friction == ZOO_FRICTION_FIXED && bad(pr->physics.friction_radius))
        return 1;
    if (bad(pr->inflow.period) || pr->inflow.n_samples < 4)
        return 1;
    double mean = 0.0;
    for (int i = 0; i < pr->inflow.n_samples; i++) {
        if (!isfinite(pr->inflow.flow[i]))
            return 1;
        mean += pr->inflow.flow[i];
    }
    if (!(mean > 0.0))
        return 1;
    if (out->n_series < 0 || out->n_times < 0)
        return 1;
    for (int i = 0; i < out->n_series; i++)
        if (out->vessel[i] < 0 || out->vessel[i] >= net->n_vessels || !(out->position[i] >= 0.0) ||
            !(out->position[i] <= 1.0))
            return 1;
    for (int i = 0; i < out->n_times; i++)
        if (!(out->times[i] >= (i ? out->times[i - 1] : 0.0)) ||
            !(out->times[i] <= pr->inflow.period * (1.0 + 1e-12)))
            return 1;
    if (!(num->cfl > 0.0) || !(num->cfl < 1.0) || num->max_steps < ZOO_STEP_UNIT ||
        num->max_beats < 1 || bad(num->tolerance) || num->steps_per_beat < 0 ||
        num->steps_per_beat > num->max_steps)
        return 1;
    if (num->steps_per_beat != 0 && num->steps_per_beat < ZOO_CHECKS)
        return 1;
    return 0;
}

int64_t zoo_layout(const zoo_problem *pr, int lanes, zoo_sim *s, void *base)
{
    const zoo_network *net = &pr->network;
    char *at = base;
    int64_t used = 0, nv = net->n_vessels, n = 0, nt = 0, W = lanes;
    int64_t ns = pr->outputs.n_series, ntime = pr->outputs.n_times;
    memset(s, 0, sizeof *s);
    for (int k = 0; k < nv; k++)
        n += net->n_cells[k] + 1;

    s->problem = pr;
    s->lanes = lanes;
    s->wall = pr->physics.wall;
    s->n_vessels = (int)nv;
    s->n_nodes = (int)n;
    s->momentum = pr->physics.momentum_correction;
    s->inv_density = 1.0 / pr->physics.density;
    s->extra = zoo_has_extras(pr);
    s->stiff = s->stiff_half = s->stiffest = 1.0;
    s->coupled = pr->extras.total_pressure != 0.0 || pr->extras.junction_loss != 0.0;
    int64_t sections = s->extra && pr->extras.n_sections > 0 ? pr->extras.n_sections : 1;
    int64_t x = s->extra ? 1 : 0; /* no memory for what is not added */
    int64_t wave = s->extra && pr->extras.n_wave > 0 ? pr->numerics.max_steps : 0;

#define INTS(name, count) name = carve(&at, &used, count, sizeof(int))
#define REALS(name, count) name = carve(&at, &used, count, sizeof(double))
/* midpoints have one more in front of node 0, so that no loop needs a special case for it */
#define MIDS(name)                \
    do {                          \
        REALS(name, (n + 1) * W); \
        if (base)                 \
            name += W;            \
    } while (0)
    /* how many junctions there are of each size */
    s->groups = carve(&at, &used, nv, sizeof *s->groups);
    int n_groups = 0;
    for (int b = 1; b < nv; b++) { /* b children */
        int count = 0;
        for (int k = 0; k < nv; k++)
            count += count_children(net, k) == b;
        if (count == 0)
            continue;
        int64_t size = (int64_t)(b + 1) * count;
        zoo_junctions g = {.count = count, .branches = b + 1};
        INTS(g.node, size);
        INTS(g.mid, size);
        INTS(g.junction, size);
        REALS(g.w, size);
        REALS(g.per_w, size);
        REALS(g.sign, size);
        REALS(g.A0, size);
        REALS(g.f_s, size);
        REALS(g.f_c, size);
        REALS(g.soft, size * W);
        REALS(g.rest, count);
        REALS(g.soft1, count * W);
        REALS(g.soft2, count * W);
        REALS(g.area, size * W);
        REALS(g.c, size * W);
        REALS(g.beta, size * W);
        REALS(g.volume, count * W);
        REALS(g.sum_c, count * W);
        REALS(g.sum_beta, count * W);
        double **per_branch[] = {&g.flow, &g.old, &g.a0, &g.aP, &g.aH, &g.q0, &g.qP, &g.qH};
        double **per_junction[] = {&g.P,  &g.H,  &g.D,  &g.g0, &g.gP, &g.gH,
                                   &g.m0, &g.mP, &g.mH, &g.f0, &g.fP, &g.fH};
        for (size_t i = 0; i < sizeof per_branch / sizeof *per_branch; i++)
            REALS(*per_branch[i], x * size * W);
        for (size_t i = 0; i < sizeof per_junction / sizeof *per_junction; i++)
            REALS(*per_junction[i], x * count * W);
        if (base)
            s->groups[n_groups] = g;
        n_groups++;
    }
    for (int k = 0; k < nv; k++)
        nt += count_children(net, k) == 0;
    s->n_groups = n_groups;
    s->n_state = (int)(2 * n + sections * nt + x * (n + nt));

    zoo_outlets *ou = &s->outlets;
    ou->count = (int)nt;
    ou->n_sections = (int)sections;
    INTS(ou->vessel, nt);
    INTS(ou->node, nt);
    REALS(ou->per_w, nt);
    REALS(ou->A0, nt);
    REALS(ou->R1, nt * W);
    REALS(ou->R2, nt * W);
    REALS(ou->C, nt * W);
    REALS(ou->decay, sections * nt * W);
    REALS(ou->fill, sections * nt * W);
    REALS(ou->E, nt * W);
    REALS(ou->inv_R1, nt * W);
    REALS(ou->v, sections * nt * W);
    REALS(ou->volume, nt * W);
    REALS(ou->a, nt * W);
    REALS(ou->p, nt * W);
    double **outlet_extra[] = {&ou->inertia, &ou->gain, &ou->keep, &ou->now,   &ou->before, &ou->share,
                               &ou->direct,  &ou->carry, &ou->base, &ou->q_mid, &ou->y,      &ou->back};
    for (size_t i = 0; i < sizeof outlet_extra / sizeof *outlet_extra; i++)
        REALS(*outlet_extra[i], x * nt * W);

    INTS(s->first, nv);
    INTS(s->last, nv);
    INTS(s->vessel_of, n);
    INTS(s->out_node, 4 * ns);
    INTS(s->live, W);
    INTS(s->stuck, W);
    INTS(s->outran, W);
    REALS(s->dx, nv);
    REALS(s->A0, n);
    REALS(s->inv_A0, n);
    REALS(s->inv_A0_mid, n);
    REALS(s->f_s, n);
    REALS(s->f_c, n);
    REALS(s->f_s_mid, n);
    REALS(s->f_c_mid, n);
    REALS(s->lam_mid, n);
    REALS(s->lam, n);
    REALS(s->half_dt, n);
    REALS(s->K, n * W);
    REALS(s->theta, n * W);
    REALS(s->A, n * W);
    REALS(s->q, n * W);
    REALS(s->P, n * W);
    REALS(s->M, n * W);
    REALS(s->G, n * W);
    REALS(s->wave_node, wave + 1);
    REALS(s->wave_half, wave);
    REALS(s->offset, x * n);
    REALS(s->kappa, x * n);
    REALS(s->leak, x * n);
    REALS(s->leak_mid, x * n);
    REALS(s->loss, x * n);
    REALS(s->loss_mid, x * n);
    REALS(s->z, x * n * W);
    REALS(s->pe, x * n * W);
    REALS(s->off, x * n * W);
    REALS(s->off_half, x * n * W);
    MIDS(s->Ah);
    MIDS(s->qh);
    MIDS(s->Ph);
    MIDS(s->Mh);
    MIDS(s->Gh);
    REALS(s->flow_node, (int64_t)pr->numerics.max_steps + 1);
    REALS(s->flow_mean, pr->numerics.max_steps);
    REALS(s->flow_sum, (int64_t)pr->inflow.n_samples + 1);
    REALS(s->out_weight, 4 * ns);
    REALS(s->ring, 4 * ns * 3 * W);
    REALS(s->sample, ntime * ns * 3 * W);
    REALS(s->start, s->n_state * W);
    REALS(s->states, ZOO_HISTORY * s->n_state * W);
    REALS(s->ends, ZOO_HISTORY * s->n_state * W);
    REALS(s->weight, s->n_state * W);
    REALS(s->slow, W);
#undef INTS
#undef REALS
#undef MIDS
    s->report = carve(&at, &used, W, sizeof *s->report);
    s->set_of = carve(&at, &used, W, sizeof *s->set_of);
    return used;
}

/* Friction = (f_s sqrt(A/A0) + f_c) q/A in vessel k at rest radius r0: the Stokes layer's
 * -(2 pi nu r/delta) q/A, delta = sqrt(nu T/(2 pi)), and a viscous -k pi nu q/A. */
static void friction(const zoo_sim *s, int k, double r0, double *f_s, double *f_c)
{
    const zoo_physics *ph = &s->problem->physics;
    const double *factor = s->problem->extras.viscosity_factor;
    double nu = ph->viscosity / ph->density * (factor ? factor[k] : 1.0);
    double delta = sqrt(nu * s->problem->inflow.period / (2.0 * ZOO_PI));
    double per_radius = 2.0 * ZOO_PI * nu / delta * ph->stokes_friction;
    *f_s = ph->friction == ZOO_FRICTION_CURRENT ? per_radius * r0 : 0.0;
    *f_c = ph->friction == ZOO_FRICTION_REST    ? per_radius * r0
           : ph->friction == ZOO_FRICTION_FIXED ? per_radius * ph->friction_radius
                                                : 0.0;
    *f_c += ph->viscous_friction * ZOO_PI * nu;
}

/* The throat of vessel k: 1 at its narrowest place, 0 outside; x in cm from the inlet. */
static double throat(const zoo_sim *s, int k, double x)
{
    const zoo_extras *ex = &s->problem->extras;
    if (!ex->throat_severity || ex->throat_severity[k] == 0.0)
        return 0.0;
    double from = x - ex->throat_position[k] * s->problem->network.length[k], l = ex->throat_length[k];
    return fabs(from) < 0.5 * l ? 0.5 * (1.0 + cos(2.0 * ZOO_PI * from / l)) : 0.0;
}

/* Rest radius of vessel k at x, where it would be r without its throat. */
static double narrowed(const zoo_sim *s, int k, double x, double r)
{
    double part = throat(s, k, x);
    return part > 0.0 ? r * (1.0 - s->problem->extras.throat_severity[k] * part) : r;
}

/* Friction of the throat per A q|q|.  The whole loss K_t/2 (A0/A0_throat - 1)^2 (q/A0)^2 is spread
 * along the throat with the weight (1 + cos)/l, which is smooth, so that the order of the scheme stays. */
static double throat_loss(const zoo_sim *s, int k, double x, double r)
{
    const zoo_extras *ex = &s->problem->extras;
    double part = throat(s, k, x), A0 = ZOO_PI * r * r;
    if (part <= 0.0)
        return 0.0;
    double open = 1.0 - ex->throat_severity[k], ratio = 1.0 / (open * open) - 1.0;
    return ex->throat_loss * ratio * ratio * part / (ex->throat_length[k] * A0 * A0);
}

static double value_or_zero(const double *values, int k)
{
    return values ? values[k] : 0.0;
}

/* What is added at the nodes of vessel k. */
static void set_extras(zoo_sim *s, int k)
{
    const zoo_network *net = &s->problem->network;
    const zoo_extras *ex = &s->problem->extras;
    int n = net->n_cells[k];
    double tau = value_or_zero(ex->viscoelastic_time, k);
    for (int j = 0; j <= n; j++) {
        int node = s->first[k] + j;
        double part = (double)j / n, step = (net->radius_out[k] - net->radius_in[k]) / n;
        double r = net->radius_in[k] + step * j, mid = j < n ? 0.5 : 0.0;
        s->offset[node] = (1.0 - part) * value_or_zero(ex->offset_in, k) +
                          part * value_or_zero(ex->offset_out, k);
        s->kappa[node] = tau > 0.0 ? tau / ex->relaxation_time : 0.0;
        s->leak[node] = value_or_zero(ex->leak, k);
        s->leak_mid[node] = j < n ? s->leak[node] : 0.0;
        s->loss[node] = throat_loss(s, k, s->dx[k] * j, r);
        s->loss_mid[node] = throat_loss(s, k, s->dx[k] * (j + mid), r + step * mid);
    }
}

/* Weights of the cubic through four neighbouring nodes (three, where a vessel has no four). */
static void output_weights(zoo_sim *s, int series)
{
    const zoo_outputs *out = &s->problem->outputs;
    int k = out->vessel[series], n = s->last[k] - s->first[k]; /* n cells */
    double x = out->position[series] * n;
    int points = n >= 3 ? 4 : 3;
    int j0 = (int)floor(x) - 1;
    j0 = j0 < 0 ? 0 : j0 > n + 1 - points ? n + 1 - points : j0;
    for (int i = 0; i < 4; i++) {
        double w = i < points ? 1.0 : 0.0;
        for (int m = 0; m < points && i < points; m++)
            if (m != i)
                w *= (x - (j0 + m)) / (double)(i - m);
        s->out_node[series * 4 + i] = s->first[k] + (i < points ? j0 + i : j0);
        s->out_weight[series * 4 + i] = w;
    }
}

void zoo_set_grid(zoo_sim *s)
{
    const zoo_network *net = &s->problem->network;
    int node = 0, nt = 0;
    double *mids[] = {s->Ah, s->qh, s->Ph, s->Mh, s->Gh};
    for (int a = 0; a < 5; a++)
        memset(mids[a] - s->lanes, 0, (size_t)(s->n_nodes + 1) * s->lanes * sizeof(double));
    for (int k = 0; k < s->n_vessels; k++) {
        int n = net->n_cells[k];
        s->first[k] = node;
        s->last[k] = node + n;
        s->dx[k] = net->length[k] / n;
        for (int j = 0; j <= n; j++, node++) {
            double step = (net->radius_out[k] - net->radius_in[k]) / n;
            double r = net->radius_in[k] + step * j;
            double r_mid = j < n ? r + 0.5 * step : r, next = j < n ? r + step : r;
            r = narrowed(s, k, s->dx[k] * j, r);
            r_mid = narrowed(s, k, s->dx[k] * (j + (j < n ? 0.5 : 0.0)), r_mid);
            next = narrowed(s, k, s->dx[k] * (j < n ? j + 1 : j), next);
            s->vessel_of[node] = k;
            s->A0[node] = ZOO_PI * r * r;
            s->inv_A0[node] = 1.0 / s->A0[node];
            /* the mean of the nodes', so that equal A/A0 at the nodes gives the same at the midpoint */
            s->inv_A0_mid[node] = 2.0 / (s->A0[node] + ZOO_PI * pow(next, 2));
            friction(s, k, r, &s->f_s[node], &s->f_c[node]);
            friction(s, k, r_mid, &s->f_s_mid[node], &s->f_c_mid[node]);
        }
        if (s->extra)
            set_extras(s, k);
        if (count_children(net, k) == 0)
            s->outlets.vessel[nt++] = k;
    }
    const zoo_extras *ex = &s->problem->extras;
    for (int i = 0; i < ex->n_wave; i++)
        s->stiffest = i == 0 || ex->stiffness_wave[i] > s->stiffest ? ex->stiffness_wave[i] : s->stiffest;
    for (int t = 0; t < s->outlets.count; t++) {
        s->outlets.node[t] = s->last[s->outlets.vessel[t]];
        s->outlets.A0[t] = s->A0[s->outlets.node[t]];
    }
    for (int g = 0; g < s->n_groups; g++) {
        zoo_junctions *ju = &s->groups[g];
        int i = 0;
        for (int k = 0; k < s->n_vessels; k++) {
            if (count_children(net, k) + 1 != ju->branches)
                continue;
            ju->node[i] = s->last[k];
            ju->mid[i] = s->last[k] - 1;
            int b = 1;
            for (int d = k + 1; d < s->n_vessels; d++)
                if (net->parent[d] == k) {
                    ju->node[b * ju->count + i] = s->first[d];
                    ju->mid[b * ju->count + i] = s->first[d];
                    b++;
                }
            i++;
        }
        for (int x = 0; x < ju->branches * ju->count; x++) {
            int node = ju->node[x];
            ju->junction[x] = x % ju->count;
            ju->sign[x] = x < ju->count ? 1.0 : -1.0;
            ju->w[x] = 0.5 * s->dx[s->vessel_of[node]];
            ju->A0[x] = s->A0[node];
            ju->f_s[x] = s->f_s[node];
            ju->f_c[x] = s->f_c[node];
            ju->rest[x % ju->count] = (x < ju->count ? 0.0 : ju->rest[x % ju->count]) + ju->w[x] * ju->A0[x];
        }
    }
    for (int i = 0; i < s->problem->outputs.n_series; i++)
        output_weights(s, i);
    const zoo_inflow *in = &s->problem->inflow;
    double h = in->period / in->n_samples;
    s->flow_sum[0] = 0.0;
    for (int i = 0; i < in->n_samples; i++)
        s->flow_sum[i + 1] = s->flow_sum[i] +
                             0.5 * h * (in->flow[i] + in->flow[(i + 1) % in->n_samples]);
}

/* What a junction needs of its walls' K. */
void zoo_set_softness(zoo_sim *s, zoo_junctions *ju, int l)
{
    int W = s->lanes;
    for (int j = 0; j < ju->count; j++)
        ju->soft1[j * W + l] = ju->soft2[j * W + l] = 0.0;
    for (int x = 0; x < ju->branches * ju->count; x++) {
        double soft = 1.0 / s->K[ju->node[x] * W + l], size = ju->w[x] * ju->A0[x];
        ju->soft[x * W + l] = soft;
        ju->soft1[ju->junction[x] * W + l] += size * soft;
        ju->soft2[ju->junction[x] * W + l] += size * soft * soft;
    }
}

/* Spreads the parameters of each lane's set over the nodes.  A lane whose set
 * is out of range is reported and given the parameters of a good one, so that
 * it computes something harmless; returns the number of good lanes. */
int zoo_set_parameters(zoo_sim *s, const zoo_parameters *pa)
{
    const zoo_network *net = &s->problem->network;
    int W = s->lanes, nv = s->n_vessels, good = 0, any = -1;
    for (int l = 0; l < W; l++) {
        int64_t row = s->set_of[l] * nv;
        int wrong = -1;
        for (int k = 0; k < nv && wrong < 0; k++)
            if (bad(pa->stiffness[row + k]) ||
                (s->wall == ZOO_WALL_TANGENT && bad(pa->gamma[row + k])))
                wrong = k;
        for (int t = 0; t < s->outlets.count && wrong < 0; t++) {
            int k = s->outlets.vessel[t];
            if (bad(pa->psi1[row + k]) || bad(pa->psi2[row + k]) || bad(pa->c[row + k]))
                wrong = k;
        }
        memset(&s->report[l], 0, sizeof s->report[l]);
        s->report[l].vessel = wrong;
        s->report[l].status = wrong < 0 ? ZOO_OK : ZOO_BAD_ARGUMENT;
        s->live[l] = wrong < 0;
        good += wrong < 0;
        if (wrong < 0 && any < 0)
            any = l;
    }
    if (any < 0)
        return 0;
    s->uniform = 1;
    for (int l = 0; l < W; l++) {
        int64_t row = s->set_of[s->live[l] ? l : any] * nv;
        for (int k = 0; k < nv; k++) {
            double gamma = s->wall == ZOO_WALL_TANGENT ? pa->gamma[row + k] : 1.0;
            double K = wall_scale(s->wall, s->problem->physics.wall_factor, pa->stiffness[row + k]);
            for (int j = s->first[k]; j <= s->last[k]; j++) {
                s->K[j * W + l] = K;
                s->theta[j * W + l] = wall_theta(s->wall, gamma);
            }
            if (s->K[s->first[k] * W + l] != s->K[l] || s->theta[s->first[k] * W + l] != s->theta[l])
                s->uniform = 0;
        }
        for (int t = 0; t < s->outlets.count; t++) {
            int k = s->outlets.vessel[t];
            s->outlets.R1[t * W + l] = net->R1[k] * pa->psi1[row + k];
            s->outlets.R2[t * W + l] = net->R2[k] * pa->psi2[row + k];
            s->outlets.C[t * W + l] = net->C[k] * pa->c[row + k];
        }
    }
    for (int g = 0; g < s->n_groups; g++)
        for (int l = 0; l < W; l++)
            zoo_set_softness(s, &s->groups[g], l);
    return good;
}

/* Integral of the inflow from 0 to t (0 <= t <= period), exact for the piecewise linear curve. */
static double flow_integral(const zoo_sim *s, double t)
{
    const zoo_inflow *in = &s->problem->inflow;
    double h = in->period / in->n_samples, x = t / h;
    int i = (int)x;
    if (i >= in->n_samples)
        return s->flow_sum[in->n_samples];
    double f = x - i, a = in->flow[i], b = in->flow[(i + 1) % in->n_samples];
    return s->flow_sum[i] + h * f * (a + 0.5 * f * (b - a));
}

/* Factor of the stiffness at time t, 0 <= t <= period. */
static double stiffness_at(const zoo_sim *s, double t)
{
    const zoo_extras *ex = &s->problem->extras;
    double x = t / s->problem->inflow.period * ex->n_wave;
    int m = (int)x;
    double f = x - m;
    return (1.0 - f) * ex->stiffness_wave[m % ex->n_wave] + f * ex->stiffness_wave[(m + 1) % ex->n_wave];
}

/* The resistance parallel to an inertance, outlet_extra.h. */
static double parallel_resistance(const zoo_sim *s, int t, int l)
{
    int j = s->outlets.node[t], i = j * s->lanes + l;
    double slope = wall_slope(s->wall, s->K[i], s->theta[i], 0.0, 1.0); /* rho c^2 at rest */
    return ZOO_PARALLEL * sqrt(slope / s->inv_density) / s->A0[j];
}

/* Time step of sections, inertances, walls with a memory and stiffnesses that change. */
static void set_extra_step(zoo_sim *s)
{
    zoo_outlets *ou = &s->outlets;
    const zoo_extras *ex = &s->problem->extras;
    int W = s->lanes;
    s->relax = ex->viscoelastic_time ? exp(-s->dt / ex->relaxation_time) : 0.0;
    s->relax_half = ex->viscoelastic_time ? exp(-0.5 * s->dt / ex->relaxation_time) : 0.0;
    for (int i = 0; i <= s->n_steps && ex->n_wave > 0; i++) {
        s->wave_node[i] = stiffness_at(s, i == s->n_steps ? 0.0 : i * s->dt);
        if (i < s->n_steps)
            s->wave_half[i] = stiffness_at(s, (i + 0.5) * s->dt);
    }
    for (int t = 0; t < ou->count; t++)
        for (int l = 0; l < W; l++) {
            int i = t * W + l, k = ou->vessel[t];
            double L = value_or_zero(ex->inertance, k), fill = 0.0, R1 = ou->R1[i];
            for (int m = 0; m < ou->n_sections; m++) {
                int o = (m * ou->count + t) * W + l;
                double R = zoo_section_resistance(s, m, t, l), RC = R * zoo_section_compliance(s, m, t, l);
                ou->decay[o] = R > 0.0 ? exp(-s->dt / RC) : 0.0;
                ou->fill[o] = R > 0.0 ? -R * expm1(-s->dt / RC) : 0.0;
                fill += ou->fill[o];
            }
            /* the inertance's pressure in the mean over the step is inertia/2 (Q - c), see outlet_extra.h */
            double Rp = parallel_resistance(s, t, l), ease = s->dt + 2.0 * L / Rp;
            ou->inertia[i] = 4.0 * L / ease;
            ou->gain[i] = L > 0.0 ? 2.0 * s->dt / ease : 1.0;
            ou->E[i] = 2.0 * R1 + fill + ou->inertia[i];
            ou->direct[i] = L > 0.0 ? 1.0 / (R1 + Rp) : 0.0;
            ou->share[i] = L > 0.0 ? Rp / (R1 + Rp) : 1.0;
            /* L (1 + R1/R_p) dq_L/dt + R1 q_L = y is integrated exactly for y linear over the step */
            double x = L > 0.0 ? R1 * s->dt / L * ou->share[i] : INFINITY;
            double mean = x < 1e-3 ? 1.0 - x / 2.0 + x * x / 6.0 : isinf(x) ? 0.0 : -expm1(-x) / x;
            ou->keep[i] = exp(-x);
            ou->now[i] = (x < 1e-3 ? x / 2.0 - x * x / 6.0 : 1.0 - mean) / R1;
            ou->before[i] = (x < 1e-3 ? x / 2.0 - x * x / 3.0 : mean - ou->keep[i]) / R1;
        }
}

/* Sets the time step to period/n_steps and everything that depends on it. */
void zoo_set_step(zoo_sim *s, int n_steps)
{
    const zoo_inflow *in = &s->problem->inflow;
    int W = s->lanes;
    s->n_steps = n_steps;
    s->dt = in->period / n_steps;
    for (int k = 0; k < s->n_vessels; k++)
        for (int j = s->first[k]; j <= s->last[k]; j++) {
            int inside = j > s->first[k] && j < s->last[k];
            s->lam_mid[j] = j < s->last[k] ? s->dt / s->dx[k] : 0.0;
            s->lam[j] = inside ? s->dt / s->dx[k] : 0.0;
            s->half_dt[j] = inside ? 0.5 * s->dt : 0.0;
        }
    for (int g = 0; g < s->n_groups; g++) {
        zoo_junctions *ju = &s->groups[g];
        for (int x = 0; x < ju->branches * ju->count; x++)
            ju->per_w[x] = s->dt / ju->w[x];
    }
    zoo_outlets *ou = &s->outlets;
    for (int t = 0; t < ou->count; t++)
        ou->per_w[t] = 2.0 * s->dt / s->dx[ou->vessel[t]];
    for (int i = 0; i < ou->count * W; i++) {
        ou->decay[i] = exp(-s->dt / (ou->R2[i] * ou->C[i]));
        ou->fill[i] = -ou->R2[i] * expm1(-s->dt / (ou->R2[i] * ou->C[i]));
        ou->E[i] = 2.0 * ou->R1[i] + ou->fill[i];
        ou->inv_R1[i] = 1.0 / ou->R1[i];
    }
    if (s->extra)
        set_extra_step(s);
    double before = 0.0;
    for (int i = 0; i <= n_steps; i++) {
        double t = i == n_steps ? in->period : i * s->dt, x = t / in->period * in->n_samples;
        int m = (int)x;
        double f = x - m, now = flow_integral(s, t);
        s->flow_node[i] = (1.0 - f) * in->flow[m % in->n_samples] + f * in->flow[(m + 1) % in->n_samples];
        if (i > 0)
            s->flow_mean[i - 1] = (now - before) / s->dt;
        before = now;
    }
}
