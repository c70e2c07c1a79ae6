/* Parameters at the nodes, lanes with bad ones, and when all vessels are alike. */
#include "check.h"

static tree t;

static void spread(int law)
{
    const int W = ZOO_LANES, n = wall_shapes(law);
    tree_make(&t, law);
    tree_open(&t, W, 1024);
    zoo_sim *s = &t.sim;
    CHECK(!s->uniform);
    for (int l = 0; l < W; l++)
        for (int k = 0; k < NV; k++) {
            const wall_shape given = {.at = t.shape + l * n * NV + k, .stride = NV};
            for (int j = s->first[k]; j <= s->last[k]; j++) {
                NEAR(s->K[j * W + l], wall_scale(law, 1.0, t.stiffness[l * NV + k], given), 0.0);
                for (int m = 0; m < n; m++)
                    NEAR(shape(zoo_shape(s, j * W + l), m), wall_coefficient(law, given, m), 0.0);
            }
        }
    for (int i = 0; i < s->outlets.count; i++) {
        int k = s->outlets.vessel[i];
        NEAR(s->outlets.R1[i * W + 3], tree_R1[k] * t.psi1[3 * NV + k], 0.0);
        NEAR(s->outlets.R2[i * W + 3], tree_R2[k] * t.psi2[3 * NV + k], 0.0);
        NEAR(s->outlets.C[i * W + 3], tree_C[k] * t.c[3 * NV + k], 0.0);
    }
    /* a bad set is reported with its vessel, and its lane computes another one */
    t.stiffness[2 * NV + 5] = -1.0;
    t.c[4 * NV + 7] = 0.0;
    t.c[5 * NV + 0] = 0.0; /* vessel 0 is no terminal: not read */
    if (n)
        t.shape[(6 * n + n - 1) * NV + 1] = NAN;
    CHECK(zoo_set_parameters(s, &t.parameters) == W - (n ? 3 : 2));
    CHECK(s->report[2].status == ZOO_BAD_ARGUMENT && s->report[2].vessel == 5 && !s->live[2]);
    CHECK(s->report[4].status == ZOO_BAD_ARGUMENT && s->report[4].vessel == 7 && s->live[5]);
    CHECK(!n || (s->report[6].status == ZOO_BAD_ARGUMENT && s->report[6].vessel == 1));
    NEAR(s->K[2], s->K[0], 0.0);
    for (int l = 0; l < W; l++)
        for (int k = 0; k < NV; k++) {
            t.stiffness[l * NV + k] = 5e4 + l;
            for (int m = 0; m < n; m++)
                t.shape[(l * n + m) * NV + k] = wall_shape_parameter(law, m).typical * (1.0 + 0.01 * l);
        }
    zoo_set_parameters(s, &t.parameters);
    CHECK(s->uniform);
    for (int l = 0; n && l < W; l++)
        t.shape[(l * n + n - 1) * NV + 2] *= 1.01;
    zoo_set_parameters(s, &t.parameters);
    CHECK(s->uniform == (n == 0));
    for (int l = 0; l < W; l++)
        t.stiffness[l * NV] = NAN;
    CHECK(zoo_set_parameters(s, &t.parameters) == 0);
    tree_close(&t);
}

int main(void)
{
    for (int law = 0; law < ZOO_N_WALLS; law++)
        spread(law);
    return finish("parameters");
}
