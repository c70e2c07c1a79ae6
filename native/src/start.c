/* The state from which the first beat starts.
 *
 * First the steady flow of the mean inflow, or of the pressure that is given at
 * the start of the beat, through vessels and Windkessels (the pressure drop along
 * a vessel is the scheme's own friction). Of a flow, that state is then scaled to
 * the start of the beat, less the pressure that it has without flow: all
 * compliances in one vessel of capacity C_sum, emptied through R_sum, filled by
 * the inflow, has the periodic pressure
 *
 *   v(0) = int_0^T exp(-(T-t)/tau) q_in(t) dt / (C_sum (1 - exp(-T/tau))),  tau = R_sum C_sum.
 *
 * Its decay over a beat, exp(-T/tau), is kept as the estimate of the slowest
 * one of the whole tree; where the pressure is given, the tree also empties
 * through its inlet, and faster.
 */
#include <math.h>
#include <string.h>

#include "inlet.h"
#include "outlet.h"

enum { START_SWEEPS = 6 };

/* Pressure of the wall where the blood's stands in P; a start needs no wall that is nearly shut. */
static double wall_pressure(const zoo_sim *s, int j)
{
    if (!s->extra)
        return s->P[j];
    double p = s->P[j] - s->offset[j], least = -0.3 * zoo_K(s, j);
    return p > least ? p : least;
}

/* What leaks out of vessel k, ml/s per dyn/cm^2. */
static double leaks(const zoo_sim *s, int k)
{
    return s->extra ? s->leak[s->first[k]] * s->problem->network.length[k] : 0.0;
}

/* Steady resistance of one vessel at the pressures that stand in P. */
static double vessel_resistance(const zoo_sim *s, int k)
{
    double sum = 0.0;
    for (int j = s->first[k]; j <= s->last[k]; j++) {
        double a = wall_area_ratio(s->wall, zoo_K(s, j), zoo_shape(s, j), wall_pressure(s, j));
        double A = a * s->A0[j], end = j == s->first[k] || j == s->last[k] ? 0.5 : 1.0;
        sum += end * (s->f_s[j] * sqrt(a) + s->f_c[j]) / (A * A * s->inv_density);
    }
    return sum * s->dx[k];
}

/* dA/dp integrated over one vessel. */
static double vessel_compliance(const zoo_sim *s, int k)
{
    double sum = 0.0;
    for (int j = s->first[k]; j <= s->last[k]; j++) {
        double p = wall_pressure(s, j), a = wall_area_ratio(s->wall, zoo_K(s, j), zoo_shape(s, j), p);
        double end = j == s->first[k] || j == s->last[k] ? 0.5 : 1.0;
        sum += end * s->A0[j] / wall_slope(s->wall, zoo_K(s, j), zoo_shape(s, j), p, a, sqrt(a));
    }
    return sum * s->dx[k];
}

/* Equivalent resistance of the tree; `own`, `below` and `source` are scratch [n_vessels], and then hold each
 * vessel's own resistance, the conductance at its outlet, and the pressure that this leads to.  Half of a
 * leak sits at either end.  `against` is the pressure without flow. */
static double resistance_from(const zoo_sim *s, double *own, double *below, double *source, double *against)
{
    const int32_t *parent = s->problem->network.parent;
    for (int k = 0; k < s->n_vessels; k++)
        below[k] = 0.5 * leaks(s, k), source[k] = 0.0; /* conductance of what hangs on k */
    for (int t = 0; t < s->outlets.count; t++) {
        int k = s->outlets.vessel[t];
        below[k] += 1.0 / outlet_resistance(s, t);
        source[k] += s->outlets.behind[t] / outlet_resistance(s, t); /* conductance times pressure, so far */
    }
    for (int k = s->n_vessels - 1; k >= 0; k--) {
        own[k] = vessel_resistance(s, k);
        source[k] /= below[k];
        if (k > 0) {
            double through = 1.0 / (own[k] + 1.0 / below[k]);
            below[parent[k]] += through + 0.5 * leaks(s, k);
            source[parent[k]] += through * source[k];
        }
    }
    double rest = own[0] + 1.0 / below[0], lost = s->extra ? 1.0 + 0.5 * leaks(s, 0) * rest : 1.0;
    *against = source[0] / lost;
    return s->extra ? rest / lost : rest;
}

/* Steady pressures into P and flows into q, for the mean inflow, which is returned, with the root's pressure without flow
 * and the tree's resistance. */
static double steady(zoo_sim *s, double *own, double *below, double *source, double *against, double *resistance)
{
    double mean_flow = 0.0;
    const int32_t *parent = s->problem->network.parent;
    for (int j = 0; j < s->n_nodes; j++)
        s->P[j] = 0.0;
    for (int sweep = 0; sweep < START_SWEEPS; sweep++) {
        *resistance = resistance_from(s, own, below, source, against);
        mean_flow = inlet_mean(s, *resistance, *against);
        double root = mean_flow * *resistance + *against;
        for (int k = 0; k < s->n_vessels; k++) {
            double p_in = k ? s->P[s->last[parent[k]]] : root;
            double flow = k || s->extra ? (p_in - source[k]) / (own[k] + 1.0 / below[k]) : mean_flow;
            for (int j = s->first[k]; j <= s->last[k]; j++) {
                double part = (double)(j - s->first[k]) / (s->last[k] - s->first[k]);
                s->P[j] = p_in - part * flow * own[k];
                s->q[j] = flow;
            }
        }
    }
    return mean_flow;
}

/* Scales the steady state of the mean inflow to the start of the beat; `capacity` is each vessel's, `source` scratch. */
static void scale(zoo_sim *s, double mean_flow, double against, double total, double tau, double *capacity, double *source)
{
    const zoo_inlet *in = &s->problem->inlet;
    const int32_t *parent = s->problem->network.parent;
    const int nv = s->n_vessels;
    double h = in->period / in->n_samples, filled = 0.0, vessels = 0.0;
    for (int k = 0; k < nv; k++)
        vessels += capacity[k];
    for (int i = 0; i < in->n_samples; i++)
        filled += h * inlet_sample(s, i) * exp(-(in->period - i * h) / tau);
    double ratio = filled / (total * (1.0 - exp(-in->period / tau))) / (s->P[0] - against);

    /* flow out of the terminals now, less the inflow, comes out of the vessels */
    for (int j = 0; j < s->n_nodes; j++) {
        s->P[j] = against + (s->P[j] - against) * ratio;
        s->q[j] *= ratio;
    }
    double surplus = (ratio * mean_flow - inlet_sample(s, 0)) / vessels;
    for (int k = nv - 1; k > 0; k--)
        capacity[parent[k]] += capacity[k];
    memcpy(source, capacity, (size_t)nv * sizeof *source); /* without that below the outlet */
    for (int d = 1; d < nv; d++)
        source[parent[d]] -= capacity[d];
    for (int k = 0; k < nv; k++) {
        for (int j = s->first[k]; j <= s->last[k]; j++) {
            double part = (double)(j - s->first[k]) / (s->last[k] - s->first[k]);
            s->q[j] -= surplus * (capacity[k] - part * source[k]);
        }
    }
}

void zoo_start(zoo_sim *s)
{
    const zoo_inlet *in = &s->problem->inlet;
    int nv = s->n_vessels;
    if (s->extra && s->problem->wall.n_wave > 0)
        s->stiff = s->wave_node[0];
    /* vessel by vessel scratch, borrowed from the history that is not in use yet */
    double *own = s->states, *below = own + nv, *capacity = below + nv, *source = capacity + nv;
    double against, resistance, total = 0.0;
    const double mean_flow = steady(s, own, below, source, &against, &resistance);
    for (int k = 0; k < nv; k++)
        total += capacity[k] = vessel_compliance(s, k);
    for (int t = 0; t < s->outlets.count; t++)
        total += outlet_capacity(s, t);
    const double tau = resistance * total;
    s->slow = exp(-in->period / tau);
    if (circuit_modes(s->problem) > 0)
        s->slow = fmax(s->slow, exp(-s->problem->outlet.mode_rate * in->period));
    if (!isnan(inlet_sample(s, 0)))
        scale(s, mean_flow, against, total, tau, capacity, source);
    for (int j = 0; j < s->n_nodes; j++) {
        double p = wall_pressure(s, j);
        s->A[j] = s->A0[j] * wall_area_ratio(s->wall, zoo_K(s, j), zoo_shape(s, j), p);
        if (s->extra)
            s->z[j] = -s->kappa[j] * p;
    }
    for (int t = 0; t < s->outlets.count; t++)
        outlet_start(s, t);
    zoo_refresh_nodes(s);
}

/* Largest (|u| + c)/dx that the first beat is likely to meet, 1/s: at twice the
 * starting pressure, with the largest inflow. */
double zoo_start_speed(const zoo_sim *s)
{
    const zoo_inlet *in = &s->problem->inlet;
    double peak = fmax(s->q[0], 0.0), worst = 0.0;
    for (int i = 0; i < in->n_samples; i++)
        peak = fmax(inlet_sample(s, i), peak);
    for (int j = 0; j < s->n_nodes; j++) {
        double p = 2.0 * wall_pressure(s, j), a = wall_area_ratio(s->wall, zoo_K(s, j), zoo_shape(s, j), p);
        double c = sqrt(a * wall_slope(s->wall, zoo_K(s, j), zoo_shape(s, j), p, a, sqrt(a)) * s->inv_density);
        if (s->extra)
            c *= sqrt((1.0 + s->kappa[j]) * s->stiffest / s->stiff);
        double u = s->vessel_of[j] == 0 ? peak * s->inv_A0[j] / a : 0.0;
        double speed = (u + c) / s->dx[s->vessel_of[j]];
        worst = speed > worst ? speed : worst;
    }
    return worst;
}
