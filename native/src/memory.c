/* Memory: where each array of a run stands in the workspace. */
#include <stdlib.h>
#include <string.h>

#include "outlet.h"

/* Takes `count` elements off the workspace, aligned to a cache line.  `used` becomes and stays -1 when the bytes
 * are more than a pointer can tell apart. */
static void *carve(char *at, int64_t *used, int64_t count, int64_t size)
{
    int64_t from = *used, bytes, to;
    if (from < 0 || __builtin_mul_overflow(count, size, &bytes) || __builtin_add_overflow(from, bytes, &to) ||
        to > PTRDIFF_MAX - 127) { /* 63 to round up, 64 to align the first */
        *used = -1;
        return NULL;
    }
    *used = (to + 63) / 64 * 64;
    return at ? at + from : NULL;
}

int *zoo_count_children(const zoo_network *net)
{
    int *children = calloc((size_t)net->n_vessels, sizeof *children);
    for (int k = 1; k < net->n_vessels && children; k++)
        children[net->parent[k]]++;
    return children;
}

int64_t zoo_layout(const zoo_problem *pr, zoo_sim *s, void *base)
{
    const zoo_network *net = &pr->network;
    int *children = zoo_count_children(net), *junctions = calloc((size_t)net->n_vessels, sizeof *junctions);
    memset(s, 0, sizeof *s);
    if (!children || !junctions) {
        free(children);
        free(junctions);
        return -1;
    }
    char *at = base;
    int64_t used = 0, nv = net->n_vessels, n = 0, nt = 0;
    int64_t ns = pr->outputs.n_series, ntime = pr->outputs.n_times;
    for (int k = 0; k < nv; k++) {
        n += (int64_t)net->n_cells[k] + 1;
        nt += children[k] == 0;
        junctions[children[k]]++;
    }

    s->problem = pr;
    s->wall = pr->wall.function.n_knots ? wall_with_function(pr->wall.law) : pr->wall.law;
    s->n_vessels = (int)nv;
    s->n_nodes = (int)n;
    s->momentum = pr->fluid.momentum_correction;
    s->inv_density = 1.0 / pr->fluid.density;
    s->extra = zoo_has_additions(pr, children);
    s->stiff = s->stiff_half = s->stiffest = 1.0;
    s->varying = zoo_stiffness_varies(pr);
    s->coupled = pr->junction.total_pressure != 0.0 || pr->junction.loss != 0.0 ||
                 pr->junction.function.n_knots != 0;
    s->tables = pr->fluid.friction_function.n_knots != 0 || pr->junction.function.n_knots != 0;
    int64_t x = s->extra ? 1 : 0; /* no memory for what is not added */
    int64_t wave = s->extra && pr->wall.n_wave > 0 ? pr->numerics.max_steps : 0;

#define INTS(name, count) name = carve(at, &used, count, sizeof(int))
#define REALS(name, count) name = carve(at, &used, count, sizeof(double))
/* midpoints have one more in front of node 0, so that no loop needs a special case for it */
#define MIDS(name)                \
    do {                          \
        REALS(name, n + 1); \
        if (base)                 \
            name += 1;        \
    } while (0)
    /* how many junctions there are of each size */
    s->groups = carve(at, &used, nv, sizeof *s->groups);
    int n_groups = 0;
    for (int b = 1; b < nv; b++) { /* b children */
        const int count = junctions[b];
        if (count == 0)
            continue;
        int64_t size = (int64_t)(b + 1) * count;
        zoo_junction_group g = {.count = count, .branches = b + 1};
        INTS(g.node, size);
        INTS(g.mid, size);
        INTS(g.junction, size);
        REALS(g.w, size);
        REALS(g.per_w, size);
        REALS(g.sign, size);
        REALS(g.A0, size);
        REALS(g.f_s, size);
        REALS(g.f_c, size);
        REALS(g.soft, size);
        REALS(g.rest, count);
        REALS(g.soft1, count);
        REALS(g.soft2, count);
        REALS(g.area, size);
        REALS(g.c, size);
        REALS(g.beta, size);
        REALS(g.volume, count);
        REALS(g.sum_c, count);
        REALS(g.sum_beta, count);
        double **per_branch[] = {&g.flow, &g.old, &g.a0, &g.aP, &g.aH, &g.q0, &g.qP, &g.qH};
        double **per_junction[] = {&g.P,  &g.H,  &g.D,  &g.g0, &g.gP, &g.gH,
                                   &g.m0, &g.mP, &g.mH, &g.f0, &g.fP, &g.fH};
        for (size_t i = 0; i < sizeof per_branch / sizeof *per_branch; i++)
            REALS(*per_branch[i], x * size);
        for (size_t i = 0; i < sizeof per_junction / sizeof *per_junction; i++)
            REALS(*per_junction[i], x * count);
        if (base)
            s->groups[n_groups] = g;
        n_groups++;
    }
    s->n_groups = n_groups;

    zoo_terminals *ou = &s->outlets;
    ou->count = (int)nt;
    ou->kind = outlet_kind(pr, s->extra);
    ou->rows = outlet_rows(ou->kind, pr);
    s->n_state = (int)((2 + x) * n + (ou->rows.pressures + ou->rows.flows) * nt);
    INTS(ou->vessel, nt);
    INTS(ou->node, nt);
    REALS(ou->per_w, nt);
    REALS(ou->A0, nt);
    REALS(ou->R1, nt);
    REALS(ou->R2, nt);
    REALS(ou->C, nt);
    REALS(ou->psi1, nt);
    REALS(ou->behind, nt);
    const int64_t waves = pr->outlet.n_wave > 0 ? nt : 0;
    REALS(ou->wave_sum, waves * ((int64_t)pr->outlet.n_wave + 1));
    REALS(ou->wave_now, waves);
    REALS(ou->wave_then, waves);
    REALS(ou->wave_mean, waves);
    REALS(ou->volume, nt);
    REALS(ou->coefficient, ou->rows.coefficients * nt);
    REALS(ou->v, ou->rows.pressures * nt);
    REALS(ou->carry, ou->rows.flows * nt);
    REALS(ou->scratch, ou->rows.scratch * nt);

    INTS(s->first, nv);
    INTS(s->last, nv);
    INTS(s->vessel_of, n);
    INTS(s->children, nv);
    INTS(s->place, nv);
    INTS(s->out_node, 4 * ns);
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
    REALS(s->K, n);
    s->K_mid = s->K;
    if (s->varying)
        REALS(s->K_mid, n);
    REALS(s->stiffening, s->varying ? n : 0);
    REALS(s->coefficient, wall_shapes(s->wall) * n);
    REALS(s->wall_piece, zoo_function_size(&pr->wall.function));
    REALS(s->friction_piece, zoo_function_size(&pr->fluid.friction_function));
    REALS(s->junction_piece, zoo_function_size(&pr->junction.function));
    REALS(s->resistance_piece, zoo_function_size(&pr->outlet.resistance_function));
    REALS(s->compliance_piece, zoo_function_size(&pr->outlet.compliance_function));
    REALS(s->A, n);
    REALS(s->q, n);
    REALS(s->P, n);
    REALS(s->M, n);
    REALS(s->G, n);
    REALS(s->wave_node, wave + 1);
    REALS(s->wave_half, wave);
    REALS(s->offset, x * n);
    REALS(s->kappa, x * n);
    REALS(s->leak, x * n);
    REALS(s->leak_mid, x * n);
    REALS(s->loss, x * n);
    REALS(s->loss_mid, x * n);
    REALS(s->z, x * n);
    REALS(s->pe, x * n);
    REALS(s->off, x * n);
    REALS(s->off_half, x * n);
    MIDS(s->Ah);
    MIDS(s->qh);
    MIDS(s->Ph);
    MIDS(s->Mh);
    MIDS(s->Gh);
    REALS(s->curve_node, (int64_t)pr->numerics.max_steps + 1);
    REALS(s->curve_mean, pr->numerics.max_steps);
    REALS(s->curve_sum, (int64_t)pr->inlet.n_samples + 1);
    REALS(s->inlet_cell, 4);
    REALS(s->out_weight, 4 * ns);
    REALS(s->ring, 4 * ns * 3);
    REALS(s->sample, ntime * ns * 3);
    const int64_t state = s->n_state;
    REALS(s->start, state);
    REALS(s->states, ZOO_HISTORY * state);
    REALS(s->ends, ZOO_HISTORY * state);
    REALS(s->weight, state);
    REALS(s->fastest, nv);
#undef INTS
#undef REALS
#undef MIDS
    if (base && used > 0)
        memcpy(s->children, children, (size_t)nv * sizeof *children);
    free(children);
    free(junctions);
    return used;
}
