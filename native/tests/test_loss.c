/* Stretches that lose pressure: the whole loss over a vessel at rest, wherever the nodes stand. */
#include "check.h"

static tree t;

int main(void)
{
    static const double quadratic[NV] = {0, 30, 0, 7}, linear[NV] = {0, 200, 50}, length[NV] = {0.3, 0.2, 0.1, 0.1, 0.04, 0.1, 0.1, 0.05};
    static double position[NV];
    for (int k = 0; k < NV; k++)
        position[k] = 0.5;
    tree_make(&t, ZOO_WALL_LINEAR);
    t.problem.loss = (zoo_loss){quadratic, linear, position, length};
    tree_open(&t, 1024);
    zoo_sim *s = &t.sim;
    CHECK(s->extra == 1);
    for (int k = 0; k < 4; k++) {
        double a = 0.0, b = 0.0, f_s, f_c;
        for (int j = s->first[k]; j < s->last[k]; j++) {
            const double r = sqrt(s->A0[j] / ZOO_PI);
            zoo_friction(s, k, r, &f_s, &f_c);
            a += s->dx[k] * s->loss_mid[j] / s->inv_density;
            b += s->dx[k] * (s->f_c[j] - f_c) / (s->A0[j] * s->A0[j] * s->inv_density);
        }
        /* midpoints and nodes are even, and hold the weight's integral, 1, where several of them lie in the stretch */
        NEAR(a, quadratic[k], 0.05 * quadratic[k]);
        NEAR(b, linear[k], 0.05 * linear[k]);
    }
    tree_close(&t);
    t.problem.loss.quadratic = NULL;
    tree_open(&t, 1024);
    CHECK(s->extra == 0);
    tree_close(&t);
    return finish("loss");
}
