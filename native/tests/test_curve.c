/* The inlet's curve on the steps of a beat. */
#include "check.h"

static tree t;

int main(void)
{
    tree_make(&t, ZOO_WALL_LINEAR);
    tree_open(&t, 1024);
    zoo_sim *s = &t.sim;
    /* the mean inflow of the steps adds up to the exact integral, whatever the number of steps */
    double exact = 0.0;
    for (int i = 0; i < NSAMPLES; i++)
        exact += t.flow[i] * 0.11 / NSAMPLES;
    for (int n = 64; n < 1000; n += 97) {
        zoo_set_step(s, n);
        double sum = 0.0;
        for (int i = 0; i < n; i++)
            sum += s->curve_mean[i] * s->dt;
        NEAR(sum, exact, 1e-15);
        NEAR(s->curve_node[0], s->curve_node[n], 1e-15);
    }
    /* on the samples the curve is the samples, between them their mean */
    zoo_set_step(s, 2 * NSAMPLES);
    for (int i = 0; i < NSAMPLES; i++) {
        NEAR(s->curve_node[2 * i], t.flow[i], 1e-12);
        NEAR(s->curve_node[2 * i + 1], 0.5 * (t.flow[i] + t.flow[(i + 1) % NSAMPLES]), 1e-12);
        NEAR(s->curve_mean[2 * i], 0.5 * (s->curve_node[2 * i] + s->curve_node[2 * i + 1]), 1e-10);
    }
    tree_close(&t);
    /* and so do the pressures that are added behind the outlets, whose every step begins where the last one ended */
    static double veins[5 * NV];
    for (int i = 0; i < 5 * NV; i++)
        veins[i] = cos(3.0 * i);
    t.problem.outlet.n_wave = 5;
    t.problem.outlet.wave = veins;
    for (int n = 64; n < 1000; n += 97) {
        tree_open(&t, n);
        const zoo_terminals *ou = &s->outlets;
        for (int i = 0; i < ou->count; i++) {
            double sum = 0.0, whole = 0.0, end = veins[5 * ou->vessel[i]];
            for (int m = 0; m < 5; m++)
                whole += 0.11 / 5 * veins[5 * ou->vessel[i] + m];
            for (int step = 0; step < n; step++) {
                zoo_curve_behind(s, step);
                NEAR(ou->wave_now[i], end, 1e-12);
                end = ou->wave_then[i];
                sum += ou->wave_mean[i] * s->dt;
            }
            NEAR(sum, whole, 1e-14);
            NEAR(end, veins[5 * ou->vessel[i]], 1e-12);
        }
        tree_close(&t);
    }
    return finish("curve");
}
