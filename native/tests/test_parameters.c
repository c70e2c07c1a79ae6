/* Parameters at the nodes, those out of range, and when all vessels are alike. */
#include "check.h"

static tree t;

/* A value out of range is refused with its vessel; one that is not read is not. */
static void bad(double *value, double wrong, int vessel)
{
    zoo_sim *s = &t.sim;
    const double good = *value;
    const int32_t expected = vessel < 0 ? ZOO_OK : ZOO_BAD_ARGUMENT;
    *value = wrong;
    CHECK(zoo_set_parameters(s, &t.parameters) == expected && s->report.status == expected && s->report.vessel == vessel);
    *value = good;
}

static void spread(int law)
{
    const int n = wall_shapes(law);
    tree_make(&t, law);
    tree_open(&t, 1024);
    zoo_sim *s = &t.sim;
    CHECK(!s->uniform);
    for (int k = 0; k < NV; k++) {
        const wall_shape given = {.at = t.shape + k, .stride = NV};
        for (int j = s->first[k]; j <= s->last[k]; j++) {
            NEAR(s->K[j], wall_scale(law, 1.0, t.stiffness[k], given), 0.0);
            for (int m = 0; m < n; m++)
                NEAR(shape(zoo_shape(s, j), m), wall_coefficient(law, given, m), 0.0);
        }
    }
    for (int i = 0; i < s->outlets.count; i++) {
        int k = s->outlets.vessel[i];
        NEAR(s->outlets.R1[i], tree_R1[k] * t.psi1[k], 0.0);
        NEAR(s->outlets.R2[i], tree_R2[k] * t.psi2[k], 0.0);
        NEAR(s->outlets.C[i], tree_C[k] * t.c[k], 0.0);
    }
    bad(&t.stiffness[5], -1.0, 5);
    bad(&t.stiffness[0], NAN, 0);
    bad(&t.c[7], 0.0, 7);
    bad(&t.c[0], 0.0, -1); /* vessel 0 is no terminal: not read */
    if (n)
        bad(&t.shape[(n - 1) * NV + 1], NAN, 1);
    for (int k = 0; k < NV; k++) {
        t.stiffness[k] = 5e4;
        for (int m = 0; m < n; m++)
            t.shape[m * NV + k] = wall_shape_parameter(law, m).typical;
    }
    CHECK(zoo_set_parameters(s, &t.parameters) == ZOO_OK && s->uniform);
    if (n)
        t.shape[(n - 1) * NV + 2] *= 1.01;
    CHECK(zoo_set_parameters(s, &t.parameters) == ZOO_OK && s->uniform == (n == 0));
    tree_close(&t);
}

int main(void)
{
    for (int law = 0; law < ZOO_N_WALLS; law++)
        spread(law);
    return finish("parameters");
}
