/* The parameters of each lane's set, at the nodes. */
#include <string.h>

#include "outlet.h"
#include "values.h"

/* What a junction needs of its walls' K. */
void zoo_set_softness(zoo_sim *s, zoo_junction_group *ju, int l)
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

/* Shape parameters of vessel k in the set of lane l. */
static wall_shape given_shape(const zoo_sim *s, const zoo_parameters *pa, int l, int k)
{
    ptrdiff_t nv = s->n_vessels, per_set = wall_shapes(s->wall) * nv;
    return (wall_shape){.at = per_set ? pa->shape + s->set_of[l] * per_set + k : NULL, .stride = nv, .function = s->wall_function};
}

/* The first vessel whose pressure, with a function added to the law, does not rise with its area, or -1. */
static int first_falling(const zoo_sim *s, const zoo_parameters *pa, int l)
{
    const int n = wall_shapes(s->wall);
    for (int k = 0; k < s->n_vessels && wall_has_function(s->wall); k++) {
        const wall_shape given = given_shape(s, pa, l, k), last = given_shape(s, pa, l, k ? k - 1 : 0);
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
static void vary_stiffness(zoo_sim *s, int k, int l)
{
    const int W = s->lanes;
    for (int j = s->first[k]; j <= s->last[k]; j++)
        s->K[j * W + l] *= s->stiffening[j];
    for (int j = s->first[k]; j < s->last[k]; j++) {
        double here = s->A0[j], next = s->A0[j + 1];
        s->K_mid[j * W + l] = (here + next) / (here / s->K[j * W + l] + next / s->K[(j + 1) * W + l]);
    }
    s->K_mid[s->last[k] * W + l] = s->K[s->last[k] * W + l];
    s->uniform = 0;
}

/* Spreads the parameters of each lane's set over the nodes.  A lane whose set
 * is out of range is reported and given the parameters of a good one, so that
 * it computes something harmless; returns the number of good lanes. */
int zoo_set_parameters(zoo_sim *s, const zoo_parameters *pa)
{
    const zoo_outlet *out = &s->problem->outlet;
    int W = s->lanes, nv = s->n_vessels, good = 0, any = -1;
    for (int l = 0; l < W; l++) {
        int64_t row = s->set_of[l] * nv;
        int wrong = -1;
        for (int k = 0; k < nv && wrong < 0; k++)
            if (value_bad(pa->stiffness[row + k]) || !wall_usable(s->wall, given_shape(s, pa, l, k)) ||
                value_extreme(wall_scale(s->wall, s->problem->wall.factor, pa->stiffness[row + k], given_shape(s, pa, l, k))))
                wrong = k;
        for (int t = 0; t < s->outlets.count && wrong < 0; t++) {
            int k = s->outlets.vessel[t];
            if (value_bad(pa->psi1[row + k]) || value_bad(pa->psi2[row + k]) || value_bad(pa->c[row + k]) ||
                !circuit_passive(s->problem, k, out->R1[k] * pa->psi1[row + k], out->R2[k] * pa->psi2[row + k]))
                wrong = k;
        }
        memset(&s->report[l], 0, sizeof s->report[l]);
        s->report[l].status = wrong < 0 ? ZOO_OK : ZOO_BAD_ARGUMENT;
        if (wrong < 0) {
            wrong = first_falling(s, pa, l);
            s->report[l].status = wrong < 0 ? ZOO_OK : ZOO_WALL_FALLS;
        }
        s->report[l].vessel = wrong;
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
            const wall_shape given = given_shape(s, pa, s->live[l] ? l : any, k);
            double K = wall_scale(s->wall, s->problem->wall.factor, pa->stiffness[row + k], given);
            for (int j = s->first[k]; j <= s->last[k]; j++)
                s->K[j * W + l] = K;
            s->uniform &= K == s->K[l];
            for (int m = 0; m < wall_shapes(s->wall); m++) {
                double *row_m = s->coefficient + (ptrdiff_t)m * s->n_nodes * W;
                double value = wall_coefficient(s->wall, given, m);
                for (int j = s->first[k]; j <= s->last[k]; j++)
                    row_m[j * W + l] = value;
                s->uniform &= value == row_m[l];
            }
            if (s->varying)
                vary_stiffness(s, k, l);
        }
        for (int t = 0; t < s->outlets.count; t++) {
            int k = s->outlets.vessel[t];
            s->outlets.R1[t * W + l] = out->R1[k] * pa->psi1[row + k];
            s->outlets.R2[t * W + l] = out->R2[k] * pa->psi2[row + k];
            s->outlets.C[t * W + l] = out->C[k] * pa->c[row + k];
        }
    }
    for (int g = 0; g < s->n_groups; g++)
        for (int l = 0; l < W; l++)
            zoo_set_softness(s, &s->groups[g], l);
    return good;
}
