/* Entry points: how much memory a solve needs, and the solve. */
#include <math.h>

#include "inlet.h"
#include "outlet.h"

int32_t zoo_workspace_size(const zoo_problem *problem, int64_t *bytes)
{
    zoo_sim sim;
    if (!problem || !bytes)
        return ZOO_BAD_ARGUMENT;
    const int32_t status = zoo_check_problem(problem);
    if (status != ZOO_OK)
        return status;
    const int64_t used = zoo_layout(problem, &sim, NULL);
    if (used < 0)
        return ZOO_WORKSPACE;
    *bytes = used + 64;
    return ZOO_OK;
}

/* Whether an array that will be read or written is not there. */
static int pointer_missing(const zoo_problem *problem, const zoo_parameters *parameters, const double *pressure,
                           const double *flow, const double *area, const zoo_report *report)
{
    const int samples = problem->outputs.n_series > 0 && problem->outputs.n_times > 0;
    return !parameters || !report || !parameters->stiffness || !parameters->psi1 || !parameters->psi2 ||
           !parameters->c || (wall_shapes(problem->wall.law) > 0 && !parameters->shape) ||
           (samples && (!pressure || !flow || !area));
}

int32_t zoo_solve(const zoo_problem *problem, const zoo_parameters *parameters, void *workspace,
                  int64_t workspace_bytes, double *pressure, double *flow, double *area, double *fastest,
                  zoo_report *report)
{
    int64_t bytes;
    const int32_t status = zoo_workspace_size(problem, &bytes);
    if (status != ZOO_OK)
        return status;
    if (pointer_missing(problem, parameters, pressure, flow, area, report))
        return ZOO_BAD_ARGUMENT;
    if (workspace == NULL || workspace_bytes < bytes)
        return ZOO_WORKSPACE;
    char *base = (char *)workspace + (64 - (uintptr_t)workspace % 64) % 64;
    zoo_sim sim;
    if (zoo_layout(problem, &sim, base) < 0)
        return ZOO_WORKSPACE;
    zoo_set_grid(&sim);
    if (zoo_set_parameters(&sim, parameters) == ZOO_OK)
        zoo_periodic(&sim, NULL, pressure, flow, area);
    zoo_tell(&sim, pressure, flow, area, fastest, report);
    return ZOO_OK;
}

/* The report of a run that ended, its speeds, and NaN for the samples of one that failed. */
void zoo_tell(const zoo_sim *s, double *pressure, double *flow, double *area, double *fastest, zoo_report *report)
{
    *report = s->report;
    if (report->status != ZOO_OK)
        zoo_output_store(s, pressure, flow, area);
    for (int k = 0; k < s->n_vessels && fastest; k++)
        fastest[k] = report->status == ZOO_OK ? s->fastest[k] : NAN;
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
    case ZOO_INLET_AREA:
        return "the wall at the root's inlet has no area at the pressure that is given there";
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
