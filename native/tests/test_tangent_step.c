/* One step of the derivatives against differences of one step of the run, for every wall, outlet, junction and inlet, and
 * without additions once more by the coefficients that were kept. */
#include "check.h"
#include "../src/tangent.h"

enum { D = ZOO_DIRECTIONS };
static tree one;
static additions x;
static double pressure[NSAMPLES];

/* A number in (-1, 1) that is another one for every i. */
static double any(int i)
{
    return sin(12.9898 * i + 1.0) * cos(78.233 * i);
}

/* NaN when one is. */
static double larger(double a, double b)
{
    return isnan(a) || a > b ? a : b;
}

static const double wall_values[5] = {0.01, -0.005, 0.0, 0.01, 0.03}, friction_values[4] = {1.0, 1.4, 1.2, 2.0},
                    loss_values[4] = {-300.0, 100.0, 0.0, 500.0};

static void step(int wall, int added, int coupled, int windkessel, int functions, int inlet, const int32_t *cells)
{
    tree_make(&one, wall);
    if (inlet == ZOO_INLET_PRESSURE) {
        tree_pressure(pressure);
        one.problem.inlet = (zoo_inlet){inlet, 0.11, NSAMPLES, pressure};
    }
    one.problem.network.n_cells = cells;
    if (added) {
        tree_add(&one, &x);
        if (!coupled)
            one.problem.junction.total_pressure = one.problem.junction.loss = 0.0;
        if (windkessel)
            one.problem.outlet.kind = ZOO_OUTLET_WINDKESSEL;
    }
    if (functions) {
        one.problem.wall.function = (zoo_function){5, 0.8, 1.3, wall_values};
        one.problem.fluid.friction_function = (zoo_function){4, 0.0, 60.0, friction_values};
        if (coupled)
            one.problem.junction.function = (zoo_function){4, -20.0, 80.0, loss_values};
    }
    tree_open(&one, 4096);
    zoo_sim *s = &one.sim;
    zoo_start(s);
    s->stuck = 0;
    memset(s->outlets.volume, 0, (size_t)s->outlets.count * sizeof(double));
    const int before = 750, n = s->n_state; /* where no flow changes its sign: q|q| of a throat has a kink */
    for (int i = 0; i < before; i++)
        CHECK(zoo_step(s, i) == 0);
    zoo_tangent t = {.s = s, .n_blocks = 1};
    zoo_block block;
    t.block = &block;
    const size_t bytes = zoo_tangent_layout(&t, NULL);
    char *memory = aligned_alloc(64, bytes);
    memset(memory, 0, bytes);
    zoo_tangent_layout(&t, memory);
    double *at = malloc(n * sizeof *at), *moved = malloc(n * sizeof *moved), *end[4];
    for (int k = 0; k < 4; k++)
        end[k] = malloc(n * sizeof(double));
    zoo_pack(s, at);
    for (int i = 0; i < n * D; i++)
        block.state[i] = any(i) * (fabs(at[i / D]) + 1e-3 * (i / D >= s->n_nodes));
    double *start = malloc((size_t)n * D * sizeof *start);
    memcpy(start, block.state, (size_t)n * D * sizeof *start);
    double *kept = malloc((size_t)(before + 1) * zoo_tangent_kept(&t) * sizeof *kept);
    t.kept = s->extra ? NULL : kept;
    for (int again = s->extra; again < 2; again++) { /* with the run, and by what was kept of it */
        t.done = again && !s->extra;
        memset(t.one, 0, t.size * sizeof *t.one);
        memcpy(block.state, start, (size_t)n * D * sizeof *start);
        zoo_unpack(s, at);
        zoo_refresh_at(s, before);
        zoo_tangent_begin(&t);
        CHECK(zoo_tangent_step(&t, before) == 0);
        for (int d = 0; d < D; d++) {
            const double h = 1e-5;
            for (int k = 0; k < 4; k++) {
                const double by = h * (k == 0 ? 1 : k == 1 ? -1 : k == 2 ? 2 : -2);
                for (int i = 0; i < n; i++)
                    moved[i] = at[i] + by * start[i * D + d];
                zoo_unpack(s, moved);
                zoo_refresh_at(s, before);
                CHECK(zoo_step(s, before) == 0);
                zoo_pack(s, end[k]);
            }
            /* areas, flows, pressures of outlets, of walls, flows of outlets */
            const int nodes = s->n_nodes, to[] = {nodes, 2 * nodes, 2 * nodes + s->outlets.rows.pressures * s->outlets.count,
                                                  n - s->outlets.rows.flows * s->outlets.count, n};
            for (int part = 0, i = 0; part < 5; part++) {
                double most = 0.0, worst = 0.0;
                for (; i < to[part]; i++) {
                    const double found = (8.0 * (end[0][i] - end[1][i]) - (end[2][i] - end[3][i])) / (12.0 * h);
                    most = fmax(most, fabs(found));
                    worst = larger(worst, fabs(found - block.state[i * D + d]));
                }
                if (!(worst <= 1e-7 * most))
                    printf("wall %d added %d coupled %d windkessel %d functions %d inlet %d again %d direction %d part %d: %g of %g\n", wall, added, coupled, windkessel, functions, inlet, again, d, part, worst, most);
                CHECK(worst <= 1e-7 * most);
            }
        }
    }
    for (int k = 0; k < 4; k++)
        free(end[k]);
    free(start);
    free(moved);
    free(kept);
    free(at);
    free(memory);
    tree_close(&one);
}

int main(void)
{
    for (int wall = 0; wall < ZOO_N_WALLS; wall++)
        for (int single = 0; single < 2; single++) {
            const int32_t *cells = single ? tree_single_cells : tree_cells;
            for (int inlet = 0; inlet < ZOO_N_INLETS; inlet++)
                step(wall, 0, 0, 1, 0, inlet, cells);
            for (int functions = 0; functions < 2; functions++)
                step(wall, 1, functions, 1, functions, ZOO_INLET_PRESSURE, cells);
            for (int coupled = 0; coupled < 2; coupled++)
                for (int windkessel = 0; windkessel < 2; windkessel++)
                    for (int functions = 0; functions < 2; functions++)
                        step(wall, 1, coupled, windkessel, functions, ZOO_INLET_FLOW, cells);
        }
    return finish("tangent step");
}
