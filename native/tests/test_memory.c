/* The workspace: every array has its own place in it, and the bytes that are counted are those that are used. */
#include "check.h"

static tree t;
static additions x;

static void places(int added)
{
    tree_make(&t, ZOO_WALL_TANGENT);
    if (added)
        tree_add(&t, &x);
    tree_open(&t, 1024);
    zoo_sim *s = &t.sim;
    const int64_t bytes = zoo_layout(&t.problem, s, NULL);
    CHECK(zoo_layout(&t.problem, s, t.memory) == bytes);
    const size_t n = (size_t)s->n_nodes, nt = (size_t)s->outlets.count;
    struct {
        double *at;
        size_t size;
    } array[] = {{s->A0, n},
                 {s->K, n},
                 {s->coefficient, n},
                 {s->A, n},
                 {s->q, n},
                 {s->P, n},
                 {s->Ah - 1, n + 1}, /* a midpoint before the first node */
                 {s->Gh - 1, n + 1},
                 {s->z, added ? n : 0},
                 {s->off_half, added ? n : 0},
                 {s->outlets.R1, nt},
                 {s->outlets.coefficient, s->outlets.rows.coefficients * nt},
                 {s->outlets.v, s->outlets.rows.pressures * nt},
                 {s->outlets.carry, s->outlets.rows.flows * nt},
                 {s->outlets.scratch, s->outlets.rows.scratch * nt},
                 {s->curve_node, (size_t)t.problem.numerics.max_steps + 1},
                 {s->states, ZOO_HISTORY * (size_t)s->n_state},
                 {s->fastest, (size_t)NV}};
    const size_t count = sizeof array / sizeof *array;
    for (size_t i = 0; i < count; i++) {
        CHECK((char *)array[i].at >= t.memory && (char *)(array[i].at + array[i].size) <= t.memory + bytes);
        for (size_t j = 0; j < array[i].size; j++)
            array[i].at[j] = (double)i;
    }
    for (size_t i = 0; i < count; i++)
        for (size_t j = 0; j < array[i].size; j++)
            CHECK(array[i].at[j] == (double)i);
    /* the state is that of the nodes and of the outlets */
    CHECK(s->n_state == (2 + added) * s->n_nodes + s->outlets.count * (added ? 3 + 2 * 2 + 1 : 1));
    tree_close(&t);
}

int main(void)
{
    places(0);
    places(1);
    return finish("memory");
}
