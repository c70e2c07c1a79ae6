/* What only the loops with additions have: whether there is any, and its values at the nodes. */
#include "outlet.h"
#include "values.h"

/* Other frictions and a throat's narrower radius need no further loops: they change the grid. */
int zoo_has_additions(const zoo_problem *pr, const int *children)
{
    int nv = pr->network.n_vessels;
    return pr->numerics.additions || pr->junction.total_pressure != 0.0 || pr->junction.loss != 0.0 ||
           pr->wall.function.n_knots || pr->junction.function.n_knots || pr->fluid.friction_function.n_knots ||
           values_differ(pr->wall.offset_in, nv, 0.0) || values_differ(pr->wall.offset_out, nv, 0.0) ||
           values_differ(pr->wall.viscoelastic_time, nv, 0.0) || values_differ(pr->fluid.leak, nv, 0.0) ||
           (pr->throat.loss != 0.0 && values_differ(pr->throat.severity, nv, 0.0)) ||
           values_differ(pr->loss.quadratic, nv, 0.0) ||
           values_differ(pr->wall.stiffness_wave, pr->wall.n_wave, 1.0) || outlet_adds(pr, children);
}

/* At the nodes of vessel k. */
void zoo_set_additions(zoo_sim *s, int k)
{
    const zoo_network *net = &s->problem->network;
    const zoo_wall *wall = &s->problem->wall;
    int n = net->n_cells[k];
    double tau = value_or_zero(wall->viscoelastic_time, k);
    for (int j = 0; j <= n; j++) {
        int node = s->first[k] + j;
        double part = (double)j / n, step = (net->radius_out[k] - net->radius_in[k]) / n;
        double r = net->radius_in[k] + step * j, mid = j < n ? 0.5 : 0.0;
        s->offset[node] =
            (1.0 - part) * value_or_zero(wall->offset_in, k) + part * value_or_zero(wall->offset_out, k);
        s->kappa[node] = tau > 0.0 ? tau / wall->relaxation_time : 0.0;
        s->leak[node] = value_or_zero(s->problem->fluid.leak, k);
        s->leak_mid[node] = j < n ? s->leak[node] : 0.0;
        s->loss[node] = zoo_throat_loss(s, k, s->dx[k] * j, r) + zoo_loss_quadratic(s, k, s->dx[k] * j);
        s->loss_mid[node] = zoo_throat_loss(s, k, s->dx[k] * (j + mid), r + step * mid) + zoo_loss_quadratic(s, k, s->dx[k] * (j + mid));
    }
}
