/* Entry point of the derivatives: the solve, what changes in each direction, and what follows from it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "outlet.h"
#include "tangent.h"
#include "values.h"

enum { D = ZOO_DIRECTIONS };

static int parameters_missing(const zoo_problem *problem, const zoo_parameters *pa)
{
    return !pa || !pa->stiffness || !pa->psi1 || !pa->psi2 || !pa->c || (wall_shapes(problem->wall.law) > 0 && !pa->shape);
}

/* Checks the directions; the solve has additions when a point has. */
static int32_t check_directions(zoo_problem *problem, int n, const zoo_direction *directions, int *n_points, zoo_tangent_report *report)
{
    *n_points = 0;
    for (int i = 0; i < n; i++) {
        const zoo_direction *d = &directions[i];
        report->direction = i;
        if (d->n_points < 1 || d->n_points > 64 || !d->weight || !d->parameters)
            return ZOO_BAD_ARGUMENT;
        for (int m = 0; m < d->n_points; m++) {
            const zoo_problem *given = d->problem ? d->problem[m] : NULL;
            if (parameters_missing(problem, d->parameters[m]) || !isfinite(d->weight[m]))
                return ZOO_BAD_ARGUMENT;
            (*n_points)++;
            if (!given)
                continue;
            const int32_t status = zoo_check_problem(given);
            if (status != ZOO_OK)
                return status;
            if (given->wall.law != problem->wall.law || given->network.n_vessels != problem->network.n_vessels)
                return ZOO_NO_DERIVATIVE;
            int *children = zoo_count_children(&given->network);
            if (!children)
                return ZOO_WORKSPACE;
            problem->numerics.additions |= zoo_has_additions(given, children);
            free(children);
        }
    }
    report->direction = -1;
    return ZOO_OK;
}

/* Arrays one after the other; with `at` NULL only counted. */
static double *reals(char *at, size_t *used, size_t count)
{
    const size_t from = *used;
    *used = from + (count * sizeof(double) + 63) / 64 * 64;
    return at ? (double *)(at + from) : NULL;
}

static void set_partials(zoo_partials *p, char *at, size_t *used, size_t n, size_t shapes)
{
    double **arrays[] = {&p->slope, &p->M_A, &p->M_q, &p->G_A, &p->G_q, &p->G_P, &p->by_K};
    for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++)
        *arrays[i] = reals(at, used, n);
    p->shape = reals(at, used, n * shapes);
}

size_t zoo_tangent_layout(zoo_tangent *t, char *at)
{
    const zoo_sim *s = t->s;
    const zoo_outputs *out = &s->problem->outputs;
    const size_t n = (size_t)s->n_nodes, nt = (size_t)s->outlets.count, shapes = (size_t)wall_shapes(s->wall);
    size_t used = 0, branches = 2;
    for (int g = 0; g < s->n_groups; g++)
        branches = (size_t)s->groups[g].branches > branches ? (size_t)s->groups[g].branches : branches;
    set_partials(&t->now, at, &used, n, shapes);
    set_partials(&t->next, at, &used, n, shapes);
    set_partials(&t->mid, at, &used, n, shapes);
    double **nodes[] = {&t->mid_elastic, &t->old_A, &t->old_q, &t->old_P, &t->old_off, &t->hP0, &t->hP1, &t->fP0, &t->fP1};
    for (size_t i = 0; i < sizeof nodes / sizeof *nodes; i++)
        *nodes[i] = reals(at, &used, n);
    t->old_v = reals(at, &used, (size_t)s->outlets.rows.pressures * nt);
    t->old_carry = reals(at, &used, (size_t)s->outlets.rows.flows * nt);
    const size_t rows = (size_t)s->outlets.rows.coefficients * nt;
    t->zero = reals(at, &used, (rows > n ? rows : n) * D);
    t->branch = reals(at, &used, 4 * branches * D);
    t->part = reals(at, &used, 8 * branches);
    t->rows = reals(at, &used, (size_t)s->outlets.rows.coefficients * D);
    t->size = zoo_tangent_place(t, NULL);
    t->one = reals(at, &used, t->size);
    t->seen_first = reals(at, &used, 4 * (size_t)out->n_series);
    if (at)
        zoo_tangent_place(t, t->one);
    for (int k = 0; k < t->n_blocks; k++) {
        zoo_block x = {0};
        x.state = reals(at, &used, (size_t)s->n_state * D);
        x.pe = reals(at, &used, n * D);
        x.Ah = reals(at, &used, (n + 1) * D);
        x.qh = reals(at, &used, (n + 1) * D);
        x.Ph = reals(at, &used, (n + 1) * D);
        x.K = reals(at, &used, n * D);
        x.K_mid = reals(at, &used, n * D);
        x.coefficient = reals(at, &used, shapes * n * D);
        x.row = reals(at, &used, (size_t)s->outlets.rows.coefficients * nt * D);
        x.behind = reals(at, &used, nt * D);
        x.curve_node = reals(at, &used, ((size_t)s->n_steps + 1) * D);
        x.curve_mean = reals(at, &used, (size_t)s->n_steps * D);
        x.node_source = reals(at, &used, n * D);
        x.mid_source = reals(at, &used, n * D);
        x.out_P = reals(at, &used, n * D);
        x.ring = reals(at, &used, 4 * (size_t)out->n_series * 3 * D);
        x.sample = reals(at, &used, (size_t)out->n_times * out->n_series * 3 * D);
        if (!at)
            continue;
        x.Ah += D, x.qh += D, x.Ph += D;
        x.A = x.state;
        x.q = x.A + n * D;
        x.v = x.q + n * D;
        x.z = x.v + (size_t)s->outlets.rows.pressures * nt * D;
        x.carry = x.z + (s->extra ? n * D : 0);
        t->block[k] = x;
    }
    return used;
}

static void fill(double *to, int64_t n, double value)
{
    for (int64_t i = 0; i < n; i++)
        to[i] = value;
}

/* The derivatives of a run, from their set-up to the end of the first beat. */
typedef struct {
    zoo_tangent t;
    const zoo_parameters *parameters;
    const zoo_direction *directions;
    int n_points; /* of all directions */
    void *room;   /* the caller's */
    int64_t room_bytes;
    char *memory;
    int32_t status;
    zoo_tangent_report report;
} differential;

static void clear(differential *d)
{
    zoo_tangent *t = &d->t;
    for (int i = 0; i < t->n_points && t->points; i++)
        free(t->points[i].memory);
    double *reals[] = {t->kept == d->room ? NULL : t->kept, t->start, t->seeds, t->scratch};
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        free(reals[i]);
    free(t->points);
    free(t->block);
    free(d->memory);
    d->memory = NULL;
    d->t = (zoo_tangent){.s = t->s, .n_directions = t->n_directions};
}

/* Where the coefficients of all steps of a beat are kept, if that is not too much; NULL otherwise. */
static double *place_for_kept(differential *d)
{
    const zoo_tangent *t = &d->t;
    const size_t bytes = (size_t)t->s->n_steps * zoo_tangent_kept(t) * sizeof(double);
    if (t->s->extra || bytes > ZOO_MOST_KEPT)
        return NULL;
    d->report.room = (int64_t)bytes;
    return d->report.room <= d->room_bytes ? d->room : malloc(bytes);
}

/* All that the first beat needs, and its start, from the run's state. */
static int32_t set_up(differential *d)
{
    zoo_tangent *t = &d->t;
    t->n_blocks = (t->n_directions + D - 1) / D;
    d->report = (zoo_tangent_report){.direction = -1};
    t->block = calloc((size_t)t->n_blocks, sizeof *t->block);
    t->points = calloc((size_t)d->n_points + 1, sizeof *t->points);
    if (!t->block || !t->points || !(d->memory = calloc(1, zoo_tangent_layout(t, NULL) + 64)))
        return ZOO_WORKSPACE;
    zoo_tangent_layout(t, d->memory + (64 - (uintptr_t)d->memory % 64) % 64);
    t->kept = place_for_kept(d);
    const int32_t status = zoo_tangent_directions(t, d->parameters, d->directions, &d->report);
    return status == ZOO_OK ? zoo_tangent_first(t) : status;
}

static int begin_along(void *self)
{
    differential *d = self;
    d->status = set_up(d);
    return d->status == ZOO_OK;
}

/* What happens to the derivatives is not for the run to know: it goes on alone. */
static int step_along(void *self, int step)
{
    differential *d = self;
    if (d->status != ZOO_OK)
        return zoo_step(d->t.s, step);
    d->status = zoo_tangent_advance(&d->t, step, &d->report);
    return d->status == ZOO_COLLAPSE;
}

/* The first beat by itself, from the end of a run that is solved. */
static int32_t first_beat(differential *d)
{
    d->t.s->no_root = 0;
    int32_t status = set_up(d);
    for (int step = 0; step < d->t.s->n_steps && status == ZOO_OK; step++)
        status = zoo_tangent_advance(&d->t, step, &d->report);
    return status;
}

/* Derivatives of a run that is solved, whose last beat they went along with if d->status says so. */
static int32_t differentiate(differential *d, double tolerance, double *d_pressure, double *d_flow, double *d_area)
{
    const zoo_outputs *out = &d->t.s->problem->outputs;
    const int64_t n_out = (int64_t)out->n_series * out->n_times, n = d->t.n_directions;
    double *samples = malloc((size_t)(n * n_out * 3 + 1) * sizeof *samples);
    const int along = d->status == ZOO_OK;
    if (!along) {
        clear(d);
        d->status = first_beat(d);
    }
    d->report.along = along;
    int32_t status = samples ? d->status : ZOO_WORKSPACE;
    if (status == ZOO_OK)
        status = zoo_tangent_periodic(&d->t, tolerance, samples, &d->report);
    for (int64_t k = 0; k < n && status == ZOO_OK; k++)
        for (int64_t i = 0; i < out->n_series; i++)
            for (int64_t m = 0; m < out->n_times; m++) {
                const double *from = samples + k * n_out * 3 + (m * out->n_series + i) * 3;
                const int64_t at = k * n_out + i * out->n_times + m;
                d_pressure[at] = from[0];
                d_flow[at] = from[1];
                d_area[at] = from[2];
            }
    free(samples);
    return status;
}

int32_t zoo_jacobian(const zoo_problem *problem, const zoo_parameters *parameters, int32_t n_directions,
                     const zoo_direction *directions, double tolerance, void *room, int64_t room_bytes,
                     double *pressure, double *flow, double *area, double *fastest, double *d_pressure,
                     double *d_flow, double *d_area, zoo_report *report, zoo_tangent_report *tangent)
{
    if (!problem || !report || !tangent || !directions || n_directions < 1 || n_directions > 1 << 20 || !(tolerance > 0.0) || room_bytes < 0 ||
        (room_bytes > 0 && (!room || (uintptr_t)room % sizeof(double) != 0)))
        return ZOO_BAD_ARGUMENT;
    zoo_problem own = *problem;
    int n_points;
    *tangent = (zoo_tangent_report){.direction = -1};
    int32_t status = zoo_check_problem(&own);
    const int64_t n_out = status == ZOO_OK ? (int64_t)own.outputs.n_series * own.outputs.n_times : 0;
    if (status == ZOO_OK && (parameters_missing(&own, parameters) ||
                             n_out > (int64_t)(PTRDIFF_MAX / sizeof(double)) / 4 / n_directions ||
                             (n_out > 0 && (!pressure || !flow || !area || !d_pressure || !d_flow || !d_area))))
        status = ZOO_BAD_ARGUMENT;
    if (status != ZOO_OK)
        return status;
    status = check_directions(&own, n_directions, directions, &n_points, tangent);
    if (status != ZOO_OK && status != ZOO_NO_DERIVATIVE)
        return status;
    zoo_sim s;
    const int64_t bytes = zoo_layout(&own, &s, NULL);
    void *memory = bytes < 0 ? NULL : aligned_alloc(64, (size_t)(bytes + 63) / 64 * 64);
    if (!memory)
        return ZOO_WORKSPACE;
    zoo_layout(&own, &s, memory);
    zoo_set_grid(&s);
    differential d = {.t = {.s = &s, .n_directions = n_directions}, .parameters = parameters, .directions = directions,
                      .n_points = n_points, .room = room, .room_bytes = room_bytes, .status = ZOO_WORKSPACE};
    zoo_companion with = {.begin = begin_along, .step = step_along, .self = &d};
    if (zoo_set_parameters(&s, parameters) == ZOO_OK)
        zoo_periodic(&s, status == ZOO_OK ? &with : NULL, pressure, flow, area);
    zoo_tell(&s, pressure, flow, area, fastest, report);
    tangent->status = status;
    if (report->status == ZOO_OK && status == ZOO_OK) {
        if (with.beat != report->beats)
            d.status = ZOO_NOT_PERIODIC;
        const int32_t found = differentiate(&d, tolerance, d_pressure, d_flow, d_area);
        *tangent = d.report;
        tangent->status = found;
    }
    clear(&d);
    if (report->status != ZOO_OK || tangent->status != ZOO_OK)
        for (int part = 0; part < 3; part++)
            fill((double *[]){d_pressure, d_flow, d_area}[part], n_out * n_directions, NAN);
    free(memory);
    return ZOO_OK;
}
