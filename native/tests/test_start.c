/* The starting state: a steady flow that obeys its resistances, scaled to one moment. */
#include "check.h"

static tree t;

int main(void)
{
    for (int wall = 0; wall < N_WALLS_IN_TESTS; wall++) {
        tree_make(&t, wall);
        tree_open(&t, 1024);
        zoo_sim *s = &t.sim;
        zoo_start(s);
        CHECK(s->slow > 0.0 && s->slow < 1.0);
        for (int k = 0; k < NV; k++) {
            /* pressure falls along a vessel, and is one at a junction */
            CHECK(s->P[s->last[k]] < s->P[s->first[k]]);
            if (k)
                NEAR(s->P[s->first[k]], s->P[s->last[tree_parent[k]]], 1e-6);
        }
        NEAR(s->q[0], t.flow[0], 1e-9);
        double out = 0.0, in_sum = 0.0;
        for (int i = 0; i < s->outlets.count; i++) {
            int o = s->outlets.node[i];
            out += s->q[o];
            NEAR(s->outlets.v[i], s->P[o] - s->outlets.R1[i] * s->q[o], 1e-9);
        }
        for (int i = 0; i < NSAMPLES; i++)
            in_sum += t.flow[i] / NSAMPLES;
        /* steady outflow is in the ratio of pressure now to mean pressure: less than the mean inflow */
        CHECK(out > 0.2 * in_sum && out < in_sum);
        /* the guess is near: the first beat does not move the inlet's pressure by more than 5 mmHg */
        CHECK(zoo_start_speed(s) > 0.0);
        double before = s->P[0];
        zoo_set_step(s, 2048);
        for (int i = 0; i < 2048; i++)
            CHECK(zoo_step(s, i) == 0);
        CHECK(fabs(s->P[0] - before) < 5.0 * 1333.22);
        tree_close(&t);
    }
    return finish("start");
}
