/* What depends on the time step. */
#include "check.h"

static tree t;
static additions x;

int main(void)
{
    tree_make(&t, ZOO_WALL_TANGENT);
    tree_add(&t, &x);
    tree_open(&t, 1000);
    zoo_sim *s = &t.sim;
    NEAR(s->dt, 0.11 / 1000, 1e-18);
    for (int k = 0; k < NV; k++)
        for (int j = s->first[k]; j <= s->last[k]; j++) {
            int end = j == s->first[k] || j == s->last[k];
            NEAR(s->lam[j] * s->dx[k], end ? 0.0 : s->dt, 1e-18);
            NEAR(s->half_dt[j], end ? 0.0 : 0.5 * s->dt, 1e-18);
            NEAR(s->lam_mid[j] * s->dx[k], j == s->last[k] ? 0.0 : s->dt, 1e-18);
        }
    NEAR(s->relax, exp(-s->dt / 3e-4), 1e-15);
    NEAR(s->relax_half * s->relax_half, s->relax, 1e-15);
    /* five samples: those stand at every 200th step, halfway between them is their mean */
    for (int i = 0; i < 5; i++) {
        NEAR(s->wave_node[200 * i], x.wave[i], 1e-12);
        NEAR(s->wave_node[200 * i + 100], 0.5 * (x.wave[i] + x.wave[(i + 1) % 5]), 1e-12);
        NEAR(s->wave_half[200 * i + 50], 0.5 * (s->wave_node[200 * i + 50] + s->wave_node[200 * i + 51]), 1e-12);
    }
    NEAR(s->wave_node[1000], s->wave_node[0], 0.0);
    NEAR(s->stiffest, 1.3, 1e-15);
    tree_close(&t);
    return finish("time_step");
}
