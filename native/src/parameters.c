/* The parameters, at the nodes. */
#include "outlet.h"
#include "values.h"

/* What a junction needs of its walls' K. */
static void set_softness(zoo_sim *s, zoo_junction_group *ju)
{
    for (int j = 0; j < ju->count; j++)
        ju->soft1[j] = ju->soft2[j] = 0.0;
    for (int x = 0; x < ju->branches * ju->count; x++) {
        double soft = 1.0 / s->K[ju->node[x]], size = ju->w[x] * ju->A0[x];
        ju->soft[x] = soft;
        ju->soft1[ju->junction[x]] += size * soft;
        ju->soft2[ju->junction[x]] += size * soft * soft;
    }
}

/* Shape parameters of vessel k. */
static wall_shape given_shape(const zoo_sim *s, const zoo_parameters *pa, int k)
{
    return (wall_shape){.at = wall_shapes(s->wall) > 0 ? pa->shape + k : NULL, .stride = s->n_vessels, .function = s->wall_function};
}

/* The first vessel whose pressure, with a function added to the law, does not rise with its area, or -1. */
static int first_falling(const zoo_sim *s, const zoo_parameters *pa)
{
    const int n = wall_shapes(s->wall);
    for (int k = 0; k < s->n_vessels && wall_has_function(s->wall); k++) {
        const wall_shape given = given_shape(s, pa, k), last = given_shape(s, pa, k ? k - 1 : 0);
        double made[ZOO_MOST_SHAPES] = {0.0};
        int same = k > 0; /* as the vessel before */
        for (int m = 0; m < n; m++) {
            made[m] = wall_coefficient(s->wall, given, m);
            same &= shape(given, m) == shape(last, m);
        }
        if (!same && !wall_rises(s->wall, (wall_shape){made, 1, s->wall_function}))
            return k;
    }
    return -1;
}

int zoo_stiffness_varies(const zoo_problem *pr)
{
    const zoo_wall *wall = &pr->wall;
    const zoo_network *net = &pr->network;
    if (values_differ(wall->stiffness_ratio, net->n_vessels, 1.0))
        return 1;
    for (int k = 0; k < net->n_vessels; k++)
        if (value_or_zero(wall->stiffness_exponent, k) != 0.0 && net->radius_in[k] != net->radius_out[k])
            return 1;
    return 0;
}

/* K along vessel k, and at its midpoints
 *
 *   K_mid = (A0 + A0')/(A0/K + A0'/K'),
 *
 * so that a midpoint between two nodes of one pressure p, whose area is the mean of theirs, has that pressure too, but
 * for what is of the order of (p/K)^2 times the square of what a cell changes: blood at rest stays at rest. */
static void vary_stiffness(zoo_sim *s, int k)
{
    for (int j = s->first[k]; j <= s->last[k]; j++)
        s->K[j] *= s->stiffening[j];
    for (int j = s->first[k]; j < s->last[k]; j++) {
        double here = s->A0[j], next = s->A0[j + 1];
        s->K_mid[j] = (here + next) / (here / s->K[j] + next / s->K[j + 1]);
    }
    s->K_mid[s->last[k]] = s->K[s->last[k]];
    s->uniform = 0;
}

/* Spreads the parameters over the nodes, unless one is out of range; the report says which. */
int32_t zoo_set_parameters(zoo_sim *s, const zoo_parameters *pa)
{
    const zoo_outlet *out = &s->problem->outlet;
    int nv = s->n_vessels, wrong = -1;
    for (int k = 0; k < nv && wrong < 0; k++)
        if (value_bad(pa->stiffness[k]) || !wall_usable(s->wall, given_shape(s, pa, k)) ||
            value_extreme(wall_scale(s->wall, s->problem->wall.factor, pa->stiffness[k], given_shape(s, pa, k))))
            wrong = k;
    for (int t = 0; t < s->outlets.count && wrong < 0; t++) {
        int k = s->outlets.vessel[t];
        if (value_bad(pa->psi1[k]) || value_bad(pa->psi2[k]) || value_bad(pa->c[k]) ||
            !circuit_passive(s->problem, k, out->R1[k] * pa->psi1[k], out->R2[k] * pa->psi2[k]))
            wrong = k;
    }
    s->report = (zoo_report){.status = wrong < 0 ? ZOO_OK : ZOO_BAD_ARGUMENT, .vessel = wrong};
    if (wrong < 0 && (wrong = first_falling(s, pa)) >= 0)
        s->report = (zoo_report){.status = ZOO_WALL_FALLS, .vessel = wrong};
    if (wrong >= 0)
        return s->report.status;
    s->uniform = 1;
    for (int k = 0; k < nv; k++) {
        const wall_shape given = given_shape(s, pa, k);
        double K = wall_scale(s->wall, s->problem->wall.factor, pa->stiffness[k], given);
        for (int j = s->first[k]; j <= s->last[k]; j++)
            s->K[j] = K;
        s->uniform &= K == s->K[0];
        for (int m = 0; m < wall_shapes(s->wall); m++) {
            double *row = s->coefficient + (ptrdiff_t)m * s->n_nodes;
            double value = wall_coefficient(s->wall, given, m);
            for (int j = s->first[k]; j <= s->last[k]; j++)
                row[j] = value;
            s->uniform &= value == row[0];
        }
        if (s->varying)
            vary_stiffness(s, k);
    }
    for (int t = 0; t < s->outlets.count; t++) {
        int k = s->outlets.vessel[t];
        s->outlets.R1[t] = out->R1[k] * pa->psi1[k];
        s->outlets.R2[t] = out->R2[k] * pa->psi2[k];
        s->outlets.C[t] = out->C[k] * pa->c[k];
        s->outlets.psi1[t] = pa->psi1[k];
    }
    for (int g = 0; g < s->n_groups; g++)
        set_softness(s, &s->groups[g]);
    return ZOO_OK;
}
