/* A stretch of a vessel that loses pressure, a q|q| + b q (A0/A)^2, A0 the area at rest: a stenosis by its empirical
 * law (Young & Tsai 1973, doi 10.1016/0021-9290(73)90099-7), whose vessel keeps its radius.  As in throat.c all of it is
 * spread along the stretch with the weight w = (1 + cos)/l, which is smooth, so that the order of the scheme stays:
 *
 *   q_t + ... = -(a |q| + b (A0/A)^2) w A/rho q. */
#include "internal.h"

/* w at x cm from the inlet of vessel k, 1/cm. */
static double weight(const zoo_sim *s, int k, double x)
{
    const zoo_loss *loss = &s->problem->loss;
    double from = x - loss->position[k] * s->problem->network.length[k], l = loss->length[k];
    return fabs(from) < 0.5 * l ? (1.0 + cos(2.0 * ZOO_PI * from / l)) / l : 0.0;
}

/* Friction per A q|q|. */
double zoo_loss_quadratic(const zoo_sim *s, int k, double x)
{
    const zoo_loss *loss = &s->problem->loss;
    return loss->quadratic && loss->quadratic[k] > 0.0 ? loss->quadratic[k] * weight(s, k, x) * s->inv_density : 0.0;
}

/* Friction per q/A, where the radius at rest is r. */
double zoo_loss_linear(const zoo_sim *s, int k, double x, double r)
{
    const zoo_loss *loss = &s->problem->loss;
    const double A0 = ZOO_PI * r * r;
    return loss->linear && loss->linear[k] > 0.0 ? loss->linear[k] * A0 * A0 * weight(s, k, x) * s->inv_density : 0.0;
}
