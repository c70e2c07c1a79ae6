/* What changes in each direction: the arrays that the time loop reads are set up at every point of the direction and
 * compared with the run's own.
 *
 * Walls' scales and coefficients, outlets' coefficients and the inlet's curve have places in the blocks.  A point that
 * differs in anything else (geometry, blood, additions) is kept, and its steps are compared with the run's; so is one
 * that differs in outlets whose coefficients depend on the pressure. */
#include <stdlib.h>
#include <string.h>

#include "outlet.h"
#include "tangent.h"

enum { D = ZOO_DIRECTIONS };

/* sum += weight (here - there), element by element; whether any differs. */
static int differ(double *sum, int d, ptrdiff_t n, double weight, const double *here, const double *there)
{
    int any = 0;
    for (ptrdiff_t i = 0; i < n; i++) {
        any |= here[i] != there[i];
        sum[i * D + d] += weight * (here[i] - there[i]);
    }
    return any;
}

static void compare_parameters(const zoo_sim *s, const zoo_sim *x, zoo_block *b, int d, double weight)
{
    const ptrdiff_t n = s->n_nodes, nt = s->outlets.count;
    b->walls |= differ(b->K, d, n, weight, x->K, s->K);
    b->walls |= differ(b->K_mid, d, n - 1, weight, x->K_mid, s->K_mid);
    b->walls |= differ(b->coefficient, d, wall_shapes(s->wall) * n, weight, x->coefficient, s->coefficient);
    if (outlet_depends(s->problem))
        return;
    b->outlets |= differ(b->row, d, s->outlets.rows.coefficients * nt, weight, x->outlets.coefficient, s->outlets.coefficient);
    b->outlets |= differ(b->behind, d, nt, weight, x->outlets.behind, s->outlets.behind);
}

/* Whether only inlet and outlets may differ. */
static int same_tree(const zoo_problem *a, const zoo_problem *b)
{
    return memcmp(&a->network, &b->network, sizeof a->network) == 0 && memcmp(&a->fluid, &b->fluid, sizeof a->fluid) == 0 &&
           memcmp(&a->wall, &b->wall, sizeof a->wall) == 0 && memcmp(&a->throat, &b->throat, sizeof a->throat) == 0 &&
           memcmp(&a->loss, &b->loss, sizeof a->loss) == 0 && memcmp(&a->junction, &b->junction, sizeof a->junction) == 0 &&
           a->outlet.n_wave == b->outlet.n_wave && a->outlet.wave == b->outlet.wave && !outlet_depends(a) && !outlet_depends(b);
}

/* Whether outlets whose coefficients depend on the pressure are the same, walls being part of them beside an inertance. */
static int same_loads(const zoo_sim *a, const zoo_sim *b)
{
    const zoo_terminals *x = &a->outlets, *y = &b->outlets;
    const size_t bytes = (size_t)x->count * sizeof(double), rows = CIRCUIT_DECAY - CIRCUIT_INERTIA;
    return memcmp(x->R1, y->R1, bytes) == 0 && memcmp(x->R2, y->R2, bytes) == 0 && memcmp(x->C, y->C, bytes) == 0 &&
           memcmp(outlet_row(a, x->coefficient, CIRCUIT_INERTIA), outlet_row(b, y->coefficient, CIRCUIT_INERTIA), rows * bytes) == 0;
}

/* A run of the point's arguments, set up for the steps of the run itself. */
static int32_t build(zoo_point *p, const zoo_tangent *t, const zoo_problem *given, const zoo_parameters *parameters)
{
    const zoo_sim *s = t->s;
    const zoo_problem *own = s->problem;
    if (given->network.n_vessels != own->network.n_vessels || given->inlet.period != own->inlet.period ||
        given->inlet.kind != own->inlet.kind)
        return ZOO_NO_DERIVATIVE;
    p->problem = *given;
    p->problem.numerics = own->numerics;
    p->problem.numerics.additions = s->extra;
    p->problem.numerics.steps_per_beat = p->problem.numerics.max_steps = s->n_steps;
    p->problem.numerics.least_steps = 0;
    p->problem.outputs = own->outputs;
    int32_t status = zoo_check_problem(&p->problem);
    if (status != ZOO_OK)
        return status == ZOO_WORKSPACE ? status : ZOO_NO_DERIVATIVE;
    for (int k = 0; k < own->network.n_vessels; k++)
        if (given->network.parent[k] != own->network.parent[k] || given->network.n_cells[k] != own->network.n_cells[k])
            return ZOO_NO_DERIVATIVE;
    const int64_t bytes = zoo_layout(&p->problem, &p->sim, NULL);
    if (bytes < 0 || !(p->memory = aligned_alloc(64, (size_t)(bytes + 63) / 64 * 64)))
        return ZOO_WORKSPACE;
    zoo_layout(&p->problem, &p->sim, p->memory);
    zoo_sim *x = &p->sim;
    if (x->n_state != s->n_state || x->wall != s->wall || x->extra != s->extra || x->outlets.kind != s->outlets.kind ||
        x->outlets.rows.pressures != s->outlets.rows.pressures ||
        circuit_sections(&p->problem) != circuit_sections(own))
        return ZOO_NO_DERIVATIVE;
    zoo_set_grid(x);
    if (zoo_set_parameters(x, parameters) != ZOO_OK)
        return ZOO_NO_DERIVATIVE;
    zoo_set_step(x, s->n_steps);
    x->no_root = x->stuck = 0;
    memset(x->outlets.volume, 0, (size_t)x->outlets.count * sizeof(double));
    return ZOO_OK;
}

int32_t zoo_tangent_directions(zoo_tangent *t, const zoo_parameters *parameters, const zoo_direction *directions,
                               zoo_tangent_report *report)
{
    const zoo_sim *s = t->s;
    zoo_point scratch = {0}; /* a run of the same problem, whose parameters alone are changed */
    int32_t status = build(&scratch, t, s->problem, parameters);
    for (int i = 0; i < t->n_directions && status == ZOO_OK; i++) {
        const zoo_direction *direction = &directions[i];
        zoo_block *b = &t->block[i / D];
        const int d = i % D;
        for (int m = 0; m < direction->n_points && status == ZOO_OK; m++) {
            const zoo_problem *given = direction->problem ? direction->problem[m] : NULL;
            const double weight = direction->weight[m];
            report->direction = i;
            if (!given) {
                status = zoo_set_parameters(&scratch.sim, direction->parameters[m]) == ZOO_OK ? ZOO_OK : ZOO_NO_DERIVATIVE;
                outlet_set_step(&scratch.sim);
                if (status != ZOO_OK)
                    continue;
                if (!outlet_depends(s->problem) || same_loads(&scratch.sim, s)) {
                    compare_parameters(s, &scratch.sim, b, d, weight);
                    continue;
                }
                given = s->problem;
            }
            zoo_point *p = &t->points[t->n_points];
            *p = (zoo_point){.direction = i, .weight = weight};
            status = build(p, t, given, direction->parameters[m]);
            t->n_points++; /* its memory is freed with the others' */
            if (status != ZOO_OK || !same_tree(&p->problem, s->problem))
                continue;
            compare_parameters(s, &p->sim, b, d, weight);
            b->inlet |= differ(b->curve_node, d, s->n_steps + 1, weight, p->sim.curve_node, s->curve_node);
            b->inlet |= differ(b->curve_mean, d, s->n_steps, weight, p->sim.curve_mean, s->curve_mean);
            free(p->memory);
            t->n_points--;
        }
    }
    free(scratch.memory);
    if (status == ZOO_OK)
        report->direction = -1;
    report->stepped = t->n_points;
    return status;
}
