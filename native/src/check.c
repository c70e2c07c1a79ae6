/* Which problems can be solved at all: every argument in its range, whatever the parameters. */
#include "inlet.h"
#include "outlet.h"
#include "values.h"

static int bad_network(const zoo_network *net)
{
    if (net->n_vessels < 1 || net->parent[0] != -1)
        return 1;
    for (int k = 0; k < net->n_vessels; k++) {
        if (k > 0 && (net->parent[k] < 0 || net->parent[k] >= k))
            return 1;
        if (net->n_cells[k] < 1 || value_bad(net->length[k]) || value_bad(net->radius_in[k]) ||
            value_bad(net->radius_out[k]))
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
    return value_bad(fluid->density) || value_bad(fluid->viscosity) || !(fluid->momentum_correction >= 0.0) ||
           !(fluid->stokes_friction >= 0.0) || !(fluid->viscous_friction >= 0.0) ||
           values_outside(fluid->viscosity_factor, nv, 1e-300, INFINITY) ||
           values_outside(fluid->leak, nv, 0.0, INFINITY);
}

static int bad_wall(const zoo_wall *wall, int nv)
{
    if (wall->law < 0 || wall->law >= ZOO_N_WALLS || value_bad(wall->factor))
        return 1;
    if (!wall->offset_in != !wall->offset_out || values_outside(wall->offset_in, nv, -INFINITY, INFINITY) ||
        values_outside(wall->offset_out, nv, -INFINITY, INFINITY))
        return 1;
    if (values_outside(wall->stiffness_ratio, nv, 1e-300, INFINITY) ||
        values_outside(wall->stiffness_exponent, nv, -INFINITY, INFINITY))
        return 1;
    if (values_outside(wall->viscoelastic_time, nv, 0.0, INFINITY) ||
        (wall->viscoelastic_time && value_bad(wall->relaxation_time)))
        return 1;
    return wall->n_wave < 0 || (wall->n_wave > 0 && !wall->stiffness_wave) ||
           values_outside(wall->stiffness_wave, wall->n_wave, 1e-300, INFINITY);
}

static int bad_throat(const zoo_throat *throat, int nv)
{
    if (throat->severity && (!throat->position || !throat->length))
        return 1;
    return values_outside(throat->severity, nv, 0.0, 1.0 - 1e-9) || values_outside(throat->position, nv, 0.0, 1.0) ||
           values_outside(throat->length, nv, 1e-300, INFINITY) || values_outside(&throat->loss, 1, 0.0, INFINITY);
}

static int bad_outputs(const zoo_outputs *out, int nv, double period)
{
    if (out->n_series < 0 || out->n_times < 0)
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
    return !(num->cfl > 0.0) || !(num->cfl < 1.0) || num->max_steps < ZOO_STEP_UNIT || num->max_beats < 1 ||
           value_bad(num->tolerance) || num->steps_per_beat < 0 || num->least_steps < 0 || num->least_steps > num->max_steps ||
           num->steps_per_beat > num->max_steps ||
           (num->steps_per_beat != 0 && num->steps_per_beat < ZOO_CHECKS);
}

int zoo_check_problem(const zoo_problem *pr)
{
    int nv = pr->network.n_vessels;
    return bad_network(&pr->network) || bad_fluid(&pr->fluid, nv) || bad_wall(&pr->wall, nv) ||
           bad_throat(&pr->throat, nv) || values_outside(&pr->junction.total_pressure, 1, 0.0, INFINITY) ||
           values_outside(&pr->junction.loss, 1, 0.0, INFINITY) || inlet_bad(pr) || outlet_bad(pr) ||
           bad_outputs(&pr->outputs, nv, pr->inlet.period) || bad_numerics(&pr->numerics);
}
