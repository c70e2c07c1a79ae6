/* What depends on the time step: factors of the scheme at nodes, junctions and outlets, walls that change
 * in time, and the inlet's curve. */
#include "outlet.h"
#include "values.h"

/* Factor of the stiffness at time t, 0 <= t <= period. */
static double stiffness_at(const zoo_sim *s, double t)
{
    const zoo_wall *wall = &s->problem->wall;
    double x = t / s->problem->inlet.period * wall->n_wave;
    int m = whole(x, wall->n_wave);
    double f = x - m;
    return (1.0 - f) * wall->stiffness_wave[m % wall->n_wave] + f * wall->stiffness_wave[(m + 1) % wall->n_wave];
}

/* Walls with a memory, and stiffnesses that change. */
static void set_wall_step(zoo_sim *s)
{
    const zoo_wall *wall = &s->problem->wall;
    s->relax = wall->viscoelastic_time ? exp(-s->dt / wall->relaxation_time) : 0.0;
    s->relax_half = wall->viscoelastic_time ? exp(-0.5 * s->dt / wall->relaxation_time) : 0.0;
    for (int i = 0; i < wall->n_wave; i++)
        s->stiffest = i == 0 || wall->stiffness_wave[i] > s->stiffest ? wall->stiffness_wave[i] : s->stiffest;
    for (int i = 0; i <= s->n_steps && wall->n_wave > 0; i++) {
        s->wave_node[i] = stiffness_at(s, i == s->n_steps ? 0.0 : i * s->dt);
        if (i < s->n_steps)
            s->wave_half[i] = stiffness_at(s, (i + 0.5) * s->dt);
    }
}

void zoo_set_step(zoo_sim *s, int n_steps)
{
    s->n_steps = n_steps;
    s->dt = s->problem->inlet.period / n_steps;
    for (int k = 0; k < s->n_vessels; k++)
        for (int j = s->first[k]; j <= s->last[k]; j++) {
            int inside = j > s->first[k] && j < s->last[k];
            s->lam_mid[j] = j < s->last[k] ? s->dt / s->dx[k] : 0.0;
            s->lam[j] = inside ? s->dt / s->dx[k] : 0.0;
            s->half_dt[j] = inside ? 0.5 * s->dt : 0.0;
        }
    for (int g = 0; g < s->n_groups; g++) {
        zoo_junction_group *ju = &s->groups[g];
        for (int x = 0; x < ju->branches * ju->count; x++)
            ju->per_w[x] = s->dt / ju->w[x];
    }
    s->inlet_cell[1] = s->dt / s->inlet_cell[0];
    for (int t = 0; t < s->outlets.count; t++)
        s->outlets.per_w[t] = 2.0 * s->dt / s->dx[s->outlets.vessel[t]];
    if (s->extra)
        set_wall_step(s);
    outlet_set_step(s);
    zoo_curve_step(s);
}
