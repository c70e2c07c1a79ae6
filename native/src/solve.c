/* Entry points: split the sets of parameters into groups of lanes and run them. */
#include <math.h>

#include "inlet.h"
#include "outlet.h"

enum { FEWEST_FOR_LANES = 3 }; /* below this the lanes would mostly be empty */

/* No loops over lanes are made for functions (step.c). */
static int lanes_for(const zoo_problem *pr, int64_t n_sets)
{
    const int functions =
        pr->wall.function.n_knots || pr->fluid.friction_function.n_knots || pr->junction.function.n_knots;
    return n_sets >= FEWEST_FOR_LANES && !functions ? ZOO_LANES : 1;
}

/* Whether the caller's arrays of n_sets rows, of parameters or of samples, are longer than memory can be. */
static int rows_too_long(const zoo_problem *pr, int64_t n_sets)
{
    const int64_t nv = pr->network.n_vessels, samples = (int64_t)pr->outputs.n_series * pr->outputs.n_times;
    const int64_t row = nv * ZOO_MOST_SHAPES > samples ? nv * ZOO_MOST_SHAPES : samples;
    return n_sets > (int64_t)(PTRDIFF_MAX / sizeof(double)) / row || n_sets > (int64_t)(PTRDIFF_MAX / sizeof(zoo_report));
}

int32_t zoo_workspace_size(const zoo_problem *problem, int64_t n_sets, int64_t *bytes)
{
    zoo_sim sim;
    if (!problem || !bytes || n_sets < 1)
        return ZOO_BAD_ARGUMENT;
    const int32_t status = zoo_check_problem(problem);
    if (status != ZOO_OK)
        return status;
    if (rows_too_long(problem, n_sets))
        return ZOO_BAD_ARGUMENT;
    const int64_t used = zoo_layout(problem, lanes_for(problem, n_sets), &sim, NULL);
    if (used < 0)
        return ZOO_WORKSPACE;
    *bytes = used + 64;
    return ZOO_OK;
}

/* Whether an array that will be read or written is not there. */
static int pointer_missing(const zoo_problem *problem, const zoo_parameters *parameters, const double *pressure,
                           const double *flow, const double *area, const zoo_report *reports)
{
    const int samples = problem->outputs.n_series > 0 && problem->outputs.n_times > 0;
    return !parameters || !reports || !parameters->stiffness || !parameters->psi1 || !parameters->psi2 ||
           !parameters->c || (wall_shapes(problem->wall.law) > 0 && !parameters->shape) ||
           (samples && (!pressure || !flow || !area));
}

int32_t zoo_solve(const zoo_problem *problem, int64_t n_sets, const zoo_parameters *parameters,
                  void *workspace, int64_t workspace_bytes, double *pressure, double *flow,
                  double *area, double *fastest, zoo_report *reports)
{
    int64_t bytes;
    const int32_t status = zoo_workspace_size(problem, n_sets, &bytes);
    if (status != ZOO_OK)
        return status;
    if (pointer_missing(problem, parameters, pressure, flow, area, reports))
        return ZOO_BAD_ARGUMENT;
    if (workspace == NULL || workspace_bytes < bytes)
        return ZOO_WORKSPACE;
    char *base = (char *)workspace + (64 - (uintptr_t)workspace % 64) % 64;
    int64_t done = 0;
    zoo_sim sim;
    int built = 0;
    while (done < n_sets) {
        int lanes = lanes_for(problem, n_sets - done);
        if (lanes != built) {
            if (zoo_layout(problem, lanes, &sim, base) < 0)
                return ZOO_WORKSPACE;
            zoo_set_grid(&sim);
            built = lanes;
        }
        /* lanes past the last set repeat it, and are not stored */
        int used = n_sets - done < lanes ? (int)(n_sets - done) : lanes;
        for (int l = 0; l < lanes; l++)
            sim.set_of[l] = done + (l < used ? l : used - 1);
        int good = zoo_set_parameters(&sim, parameters);
        for (int l = used; l < lanes; l++)
            sim.live[l] = 0;
        sim.no_root = 0;
        if (good > 0)
            zoo_periodic(&sim, NULL, pressure, flow, area);
        for (int l = 0; l < used; l++) {
            reports[done + l] = sim.report[l];
            for (int k = 0; k < sim.n_vessels && fastest; k++)
                fastest[(done + l) * sim.n_vessels + k] =
                    sim.report[l].status == ZOO_OK ? sim.fastest[k * lanes + l] : NAN;
            if (sim.report[l].status != ZOO_OK)
                zoo_output_store(&sim, l, pressure, flow, area);
        }
        done += used;
    }
    return ZOO_OK;
}

const char *zoo_status_text(int32_t status)
{
    switch (status) {
    case ZOO_OK:
        return "solved to the periodic state";
    case ZOO_BAD_ARGUMENT:
        return "an input is not a positive finite number, or out of its range";
    case ZOO_CFL:
        return "the time step is too long for the wave speed (CFL)";
    case ZOO_COLLAPSE:
        return "a vessel collapsed: its cross-section fell to zero";
    case ZOO_WALL_LIMIT:
        return "a vessel grew beyond the largest area of its wall law";
    case ZOO_NO_ROOT:
        return "no pressure satisfies a junction or an outlet";
    case ZOO_NOT_PERIODIC:
        return "the beats did not become periodic within the limit";
    case ZOO_WORKSPACE:
        return "the workspace is too small, or memory is lacking";
    case ZOO_WALL_FALLS:
        return "with the function added to its wall a vessel's pressure does not rise with its area";
    case ZOO_NO_DERIVATIVE:
        return "no derivative: the changed arguments cannot be solved beside the given ones";
    default:
        return "unknown status";
    }
}

#define KIND_NAME(NAME, name, family) \
    case family##_##NAME:             \
        return #name;

const char *zoo_inlet_name(int32_t kind)
{
    switch (kind) {
        ZOO_INLETS(KIND_NAME, ZOO_INLET)
    default:
        return NULL;
    }
}

const char *zoo_outlet_name(int32_t kind)
{
    switch (kind) {
        ZOO_OUTLETS(KIND_NAME, ZOO_OUTLET)
    default:
        return NULL;
    }
}
