/* A throat: its narrowest radius, where it ends, and its whole loss of pressure. */
#include "check.h"

static tree t;
static additions x;

int main(void)
{
    tree_make(&t, ZOO_WALL_LINEAR);
    tree_add(&t, &x);
    t.sim.problem = &t.problem;
    const double L = tree_length[0], l = x.length[0], r = 0.047, A0 = ZOO_PI * r * r;
    NEAR(zoo_narrowed(&t.sim, 0, 0.5 * L, r), 0.8 * r, 1e-15);
    NEAR(zoo_narrowed(&t.sim, 0, 0.5 * L + 0.25 * l, r), 0.9 * r, 1e-15);
    NEAR(zoo_narrowed(&t.sim, 0, 0.5 * L + 0.51 * l, r), r, 0.0);
    NEAR(zoo_narrowed(&t.sim, 1, 0.5 * tree_length[1], r), r, 0.0); /* no throat there */
    CHECK(zoo_throat_loss(&t.sim, 0, 0.5 * L - 0.51 * l, r) == 0.0 && zoo_throat_loss(&t.sim, 1, 0.15, r) == 0.0);
    /* friction is loss A q|q|, so that rho/A of it along the throat is a fall of pressure, rho times the integral of
     * loss q^2, which is K_t rho/2 (A0/A0_throat - 1)^2 (q/A0)^2 */
    const int n = 4000;
    double sum = 0.0, ratio = 1.0 / (0.8 * 0.8) - 1.0;
    for (int i = 0; i < n; i++)
        sum += zoo_throat_loss(&t.sim, 0, L * (i + 0.5) / n, r) * L / n;
    NEAR(sum, 1.52 / 2.0 * ratio * ratio / (A0 * A0), 1e-5 * sum);
    return finish("throat");
}
