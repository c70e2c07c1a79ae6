/* The grid: nodes of the vessels, their ends at junctions and outlets; it depends on neither parameters nor time. */
#include <string.h>

#include "internal.h"
#include "values.h"

/* The ends of the vessels that meet at the junctions of one size. */
static void set_junctions(zoo_sim *s, zoo_junction_group *ju)
{
    const zoo_network *net = &s->problem->network;
    int i = 0;
    for (int k = 0; k < s->n_vessels; k++) {
        if (s->children[k] + 1 != ju->branches)
            continue;
        ju->node[i] = s->last[k];
        ju->mid[i] = s->last[k] - 1;
        s->place[k] = i++;
    }
    for (int d = 1; d < s->n_vessels; d++) {
        int k = net->parent[d];
        if (s->children[k] + 1 != ju->branches)
            continue;
        s->place[k] += ju->count; /* the next branch */
        ju->node[s->place[k]] = s->first[d];
        ju->mid[s->place[k]] = s->first[d];
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

void zoo_set_grid(zoo_sim *s)
{
    const zoo_network *net = &s->problem->network;
    int node = 0, nt = 0;
    const zoo_problem *pr = s->problem;
    s->wall_function = zoo_function_spline(&pr->wall.function, ZOO_BEYOND_WALL, 0.0, s->wall_piece);
    s->friction_function =
        zoo_function_spline(&pr->fluid.friction_function, ZOO_BEYOND_CONSTANT, 1.0, s->friction_piece);
    s->junction_function = zoo_function_spline(&pr->junction.function, ZOO_BEYOND_LINEAR, 0.0, s->junction_piece);
    s->resistance_function =
        zoo_function_spline(&pr->outlet.resistance_function, ZOO_BEYOND_CONSTANT, 0.0, s->resistance_piece);
    s->compliance_function =
        zoo_function_spline(&pr->outlet.compliance_function, ZOO_BEYOND_CONSTANT, 0.0, s->compliance_piece);
    s->junction_curvature = zoo_function_curvature(s->junction_function);
    double *mids[] = {s->Ah, s->qh, s->Ph, s->Mh, s->Gh};
    for (int a = 0; a < 5; a++)
        memset(mids[a] - 1, 0, (size_t)(s->n_nodes + 1) * sizeof(double));
    for (int k = 0; k < s->n_vessels; k++) {
        int n = net->n_cells[k];
        s->first[k] = node;
        s->last[k] = node + n;
        s->dx[k] = net->length[k] / n;
        for (int j = 0; j <= n; j++, node++) {
            double step = (net->radius_out[k] - net->radius_in[k]) / n;
            double r = net->radius_in[k] + step * j;
            double r_mid = j < n ? r + 0.5 * step : r, next = j < n ? r + step : r;
            r = zoo_narrowed(s, k, s->dx[k] * j, r);
            r_mid = zoo_narrowed(s, k, s->dx[k] * (j + (j < n ? 0.5 : 0.0)), r_mid);
            next = zoo_narrowed(s, k, s->dx[k] * (j < n ? j + 1 : j), next);
            s->vessel_of[node] = k;
            s->A0[node] = ZOO_PI * r * r;
            s->inv_A0[node] = 1.0 / s->A0[node];
            /* the mean of the nodes', so that equal A/A0 at the nodes gives the same at the midpoint */
            s->inv_A0_mid[node] = 2.0 / (s->A0[node] + ZOO_PI * pow(next, 2));
            zoo_friction(s, k, r, &s->f_s[node], &s->f_c[node]);
            zoo_friction(s, k, r_mid, &s->f_s_mid[node], &s->f_c_mid[node]);
            s->f_c[node] += zoo_loss_linear(s, k, s->dx[k] * j, r);
            s->f_c_mid[node] += zoo_loss_linear(s, k, s->dx[k] * (j + (j < n ? 0.5 : 0.0)), r_mid);
            if (s->varying) {
                const zoo_wall *wall = &s->problem->wall;
                double ratio = wall->stiffness_ratio ? wall->stiffness_ratio[k] : 1.0, part = (double)j / n;
                double wider = net->radius_in[k] / (net->radius_in[k] + step * j); /* a throat is as stiff as its vessel */
                s->stiffening[node] = (1.0 + (ratio - 1.0) * part) * pow(wider, value_or_zero(wall->stiffness_exponent, k));
            }
        }
        if (s->extra)
            zoo_set_additions(s, k);
        if (s->children[k] == 0)
            s->outlets.vessel[nt++] = k;
    }
    for (int t = 0; t < s->outlets.count; t++) {
        s->outlets.node[t] = s->last[s->outlets.vessel[t]];
        s->outlets.A0[t] = s->A0[s->outlets.node[t]];
        s->outlets.behind[t] = value_or_zero(s->problem->outlet.pressure, s->outlets.vessel[t]);
    }
    for (int g = 0; g < s->n_groups; g++)
        set_junctions(s, &s->groups[g]);
    for (int i = 0; i < s->problem->outputs.n_series; i++)
        zoo_output_weights(s, i);
    s->inlet_cell[0] = 0.5 * s->dx[0];
    s->inlet_cell[2] = -1.0;
    zoo_curve_sum(s);
}
