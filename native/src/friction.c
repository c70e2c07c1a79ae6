/* Friction = (f_s sqrt(A/A0) + f_c) q/A: the Stokes layer's -(2 pi nu r/delta) q/A,
 * delta = sqrt(nu T/(2 pi)), with r the current, the rest or one fixed radius, and a viscous
 * -k pi nu q/A. */
#include "internal.h"

void zoo_friction(const zoo_sim *s, int k, double r0, double *f_s, double *f_c)
{
    const zoo_fluid *fluid = &s->problem->fluid;
    double nu = fluid->viscosity / fluid->density * (fluid->viscosity_factor ? fluid->viscosity_factor[k] : 1.0);
    double delta = sqrt(nu * s->problem->inlet.period / (2.0 * ZOO_PI));
    double per_radius = 2.0 * ZOO_PI * nu / delta * fluid->stokes_friction;
    *f_s = fluid->friction == ZOO_FRICTION_CURRENT ? per_radius * r0 : 0.0;
    *f_c = fluid->friction == ZOO_FRICTION_REST    ? per_radius * r0
           : fluid->friction == ZOO_FRICTION_FIXED ? per_radius * fluid->friction_radius
                                                   : 0.0;
    *f_c += fluid->viscous_friction * ZOO_PI * nu;
}
