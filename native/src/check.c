/* Which problems can be solved at all: every argument in its range, whatever the parameters.
 *
 * Counts are refused above ZOO_MOST, and so are those whose products ints would not hold, which index the arrays of
 * a run. */
#include <limits.h>
#include <stdlib.h>

#include "inlet.h"
#include "outlet.h"
#include "tangent.h"
#include "values.h"

static int bad_radius(double r)
{
    return !(r > 0.0) || value_extreme(r * r);
}

static int bad_network(const zoo_network *net)
{
    if (net->n_vessels < 1 || net->n_vessels > ZOO_MOST || !net->parent || !net->n_cells || !net->length ||
        !net->radius_in || !net->radius_out || net->parent[0] != -1)
        return 1;
    for (int k = 0; k < net->n_vessels; k++) {
        if (k > 0 && (net->parent[k] < 0 || net->parent[k] >= k))
            return 1;
        if (net->n_cells[k] < 1 || value_bad(net->length[k]) || bad_radius(net->radius_in[k]) ||
            bad_radius(net->radius_out[k]))
            return 1;
    }
    return 0;
}

static int bad_fluid(const zoo_fluid *fluid, int nv)
{
    if (fluid->friction < ZOO_FRICTION_CURRENT || fluid->friction > ZOO_FRICTION_FIXED)
        return 1;
    if (fluid->friction == ZOO_FRICTION_FIXED && value_bad(fluid->friction_radius))
        return 1;
    return value_bad(fluid->density) || value_bad(fluid->viscosity) || values_outside(&fluid->momentum_correction, 1, 0.0, INFINITY) ||
           values_outside(&fluid->stokes_friction, 1, 0.0, INFINITY) ||
           values_outside(&fluid->viscous_friction, 1, 0.0, INFINITY) ||
           values_outside(fluid->viscosity_factor, nv, 1e-300, INFINITY) ||
           values_outside(fluid->leak, nv, 0.0, INFINITY) || zoo_function_bad(&fluid->friction_function, 0.0, 0.0, ZOO_MOST_VALUE);
}

static int bad_wall(const zoo_wall *wall, int nv)
{
    if (wall->law < 0 || wall->law >= ZOO_N_WALLS || value_bad(wall->factor))
        return 1;
    if (!wall->offset_in != !wall->offset_out || values_outside(wall->offset_in, nv, -INFINITY, INFINITY) ||
        values_outside(wall->offset_out, nv, -INFINITY, INFINITY))
        return 1;
    if (zoo_function_bad(&wall->function, ZOO_LEAST_STRETCH, -ZOO_MOST_VALUE, ZOO_MOST_VALUE))
        return 1;
    if (values_outside(wall->stiffness_ratio, nv, 1e-300, INFINITY) ||
        values_outside(wall->stiffness_exponent, nv, -INFINITY, INFINITY))
        return 1;
    if (values_outside(wall->viscoelastic_time, nv, 0.0, INFINITY) ||
        (wall->viscoelastic_time && value_bad(wall->relaxation_time)))
        return 1;
    return wall->n_wave < 0 || wall->n_wave > ZOO_MOST || (wall->n_wave > 0 && !wall->stiffness_wave) ||
           values_outside(wall->stiffness_wave, wall->n_wave, 1e-300, INFINITY);
}

static int bad_throat(const zoo_throat *throat, int nv)
{
    if (throat->severity && (!throat->position || !throat->length))
        return 1;
    return values_outside(throat->severity, nv, 0.0, 1.0 - 1e-9) || values_outside(throat->position, nv, 0.0, 1.0) ||
           values_outside(throat->length, nv, 1e-300, INFINITY) || values_outside(&throat->loss, 1, 0.0, INFINITY);
}

static int bad_loss(const zoo_loss *loss, int nv)
{
    if ((loss->quadratic || loss->linear) && (!loss->position || !loss->length))
        return 1;
    return values_outside(loss->quadratic, nv, 0.0, ZOO_MOST_VALUE) || values_outside(loss->linear, nv, 0.0, ZOO_MOST_VALUE) ||
           values_outside(loss->position, nv, 0.0, 1.0) || values_outside(loss->length, nv, 1e-300, INFINITY);
}

static int bad_outputs(const zoo_outputs *out, int nv, double period)
{
    if (out->n_series < 0 || out->n_series > ZOO_MOST || out->n_times < 0 || out->n_times > ZOO_MOST ||
        (out->n_series > 0 && (!out->vessel || !out->position)) || (out->n_times > 0 && !out->times))
        return 1;
    for (int i = 0; i < out->n_series; i++)
        if (out->vessel[i] < 0 || out->vessel[i] >= nv || !(out->position[i] >= 0.0) || !(out->position[i] <= 1.0))
            return 1;
    for (int i = 0; i < out->n_times; i++)
        if (!(out->times[i] >= (i ? out->times[i - 1] : 0.0)) || !(out->times[i] <= period * (1.0 + 1e-12)))
            return 1;
    return 0;
}

static int bad_numerics(const zoo_numerics *num)
{
    return !(num->cfl > 0.0) || !(num->cfl < 1.0) || num->max_steps < ZOO_STEP_UNIT || num->max_steps > ZOO_MOST ||
           num->max_beats < 1 || num->max_beats > ZOO_MOST ||
           value_bad(num->tolerance) || !(num->relative >= 0.0) || !(num->relative < 1.0) || num->steps_per_beat < 0 || num->least_steps < 0 || num->least_steps > num->max_steps ||
           num->steps_per_beat > num->max_steps ||
           (num->steps_per_beat != 0 && num->steps_per_beat < ZOO_CHECKS);
}

/* Whether a step, or the time between two samples, is too short for its inverse to be a number. */
static int bad_clock(const zoo_problem *pr)
{
    const double most = fmax(pr->numerics.max_steps, fmax(pr->inlet.n_samples, fmax(pr->wall.n_wave, pr->outlet.n_wave)));
    return !(pr->inlet.period / most > 1e-300);
}

/* Whether the largest arrays of a run, [rows][nodes or terminals], have more elements than an int holds; where it is
 * differentiated there are ZOO_DIRECTIONS of each. */
static int too_large(const zoo_problem *pr)
{
    const int64_t nv = pr->network.n_vessels, sections = (int64_t)pr->outlet.n_sections + 2 * (int64_t)pr->outlet.n_modes;
    int64_t nodes = 0;
    for (int64_t k = 0; k < nv; k++)
        nodes += (int64_t)pr->network.n_cells[k] + 1;
    /* the state; the outlets' coefficients, of which no kind has more beside its sections' and modes'; the samples of a step */
    enum { COEFFICIENTS = 16, STATE = 4, SAMPLES = 4 * 3 };
    const int64_t rows[] = {(STATE + ZOO_MOST_SHAPES) * nodes + (sections + 2) * nv, (COEFFICIENTS + 3 * sections) * nv,
                            (int64_t)SAMPLES * pr->outputs.n_series};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        if (rows[i] > INT_MAX / ZOO_DIRECTIONS)
            return 1;
    return 0;
}

int32_t zoo_check_problem(const zoo_problem *pr)
{
    int nv = pr->network.n_vessels;
    if (bad_network(&pr->network) || bad_fluid(&pr->fluid, nv) || bad_wall(&pr->wall, nv) ||
        bad_throat(&pr->throat, nv) || bad_loss(&pr->loss, nv) || values_outside(&pr->junction.total_pressure, 1, 0.0, INFINITY) ||
        values_outside(&pr->junction.loss, 1, 0.0, INFINITY) ||
        zoo_function_bad(&pr->junction.function, -ZOO_MOST_VALUE, -ZOO_MOST_VALUE, ZOO_MOST_VALUE) || inlet_bad(pr) ||
        bad_outputs(&pr->outputs, nv, pr->inlet.period) || bad_numerics(&pr->numerics) || bad_clock(pr) ||
        too_large(pr))
        return ZOO_BAD_ARGUMENT;
    int *children = zoo_count_children(&pr->network);
    if (!children)
        return ZOO_WORKSPACE;
    int bad = outlet_bad(pr, children);
    free(children);
    return bad ? ZOO_BAD_ARGUMENT : ZOO_OK;
}
