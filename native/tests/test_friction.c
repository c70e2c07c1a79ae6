/* Friction against its formula, with each radius. */
#include "check.h"

static tree t;

int main(void)
{
    const double nu = 0.049 / 1.055, delta = sqrt(nu * 0.11 / (2.0 * ZOO_PI)), A = 0.004, q = 0.3, r0 = 0.03;
    const double A0 = ZOO_PI * r0 * r0;
    double factor[NV];
    for (int k = 0; k < NV; k++)
        factor[k] = 1.0 + k;
    for (int friction = ZOO_FRICTION_CURRENT; friction <= ZOO_FRICTION_FIXED; friction++) {
        double radius[] = {sqrt(A / ZOO_PI), r0, 0.07}, f_s, f_c;
        tree_make(&t, ZOO_WALL_LINEAR);
        t.problem.fluid.friction = friction;
        t.sim.problem = &t.problem;
        zoo_friction(&t.sim, 0, r0, &f_s, &f_c);
        double stokes = 2.0 * ZOO_PI * nu * radius[friction] / delta * q / A;
        NEAR((f_s * sqrt(A / A0) + f_c) * q / A, stokes, 1e-12 * stokes);
        /* half of the Stokes layer's, Poiseuille's beside it, and a vessel with another viscosity */
        t.problem.fluid.stokes_friction = 0.5;
        t.problem.fluid.viscous_friction = 8.0;
        t.problem.fluid.viscosity_factor = factor;
        zoo_friction(&t.sim, 3, r0, &f_s, &f_c);
        double wanted = 0.5 * 2.0 * stokes + 8.0 * ZOO_PI * 4.0 * nu * q / A; /* delta grows as sqrt(nu) */
        NEAR((f_s * sqrt(A / A0) + f_c) * q / A, wanted, 1e-12 * wanted);
    }
    return finish("friction");
}
