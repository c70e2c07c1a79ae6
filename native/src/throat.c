/* A throat (stenosis): rest radius times 1 - severity (1 + cos(2 pi (x - x0)/l))/2 for |x - x0| < l/2,
 * and a loss K_t rho/2 (A0/A0_throat - 1)^2 (q/A0)^2 of pressure (Young & Tsai 1973,
 * doi 10.1016/0021-9290(73)90099-7). */
#include "internal.h"

/* 1 at the narrowest place of vessel k, 0 outside its throat; x in cm from the inlet. */
static double part_at(const zoo_sim *s, int k, double x)
{
    const zoo_throat *throat = &s->problem->throat;
    if (!throat->severity || throat->severity[k] == 0.0)
        return 0.0;
    double from = x - throat->position[k] * s->problem->network.length[k], l = throat->length[k];
    return fabs(from) < 0.5 * l ? 0.5 * (1.0 + cos(2.0 * ZOO_PI * from / l)) : 0.0;
}

/* Rest radius of vessel k at x, where it would be r without its throat. */
double zoo_narrowed(const zoo_sim *s, int k, double x, double r)
{
    double part = part_at(s, k, x);
    return part > 0.0 ? r * (1.0 - s->problem->throat.severity[k] * part) : r;
}

/* Friction of the throat per A q|q|.  The whole loss is spread along the throat with the weight
 * (1 + cos)/l, which is smooth, so that the order of the scheme stays. */
double zoo_throat_loss(const zoo_sim *s, int k, double x, double r)
{
    const zoo_throat *throat = &s->problem->throat;
    double part = part_at(s, k, x), A0 = ZOO_PI * r * r;
    if (part <= 0.0)
        return 0.0;
    double open = 1.0 - throat->severity[k], ratio = 1.0 / (open * open) - 1.0;
    return throat->loss * ratio * ratio * part / (throat->length[k] * A0 * A0);
}
