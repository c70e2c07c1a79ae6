/* The grid: nodes of the vessels, and their ends. */
#include "check.h"

static tree t;

int main(void)
{
    tree_make(&t, ZOO_WALL_LINEAR);
    tree_open(&t, 1024);
    zoo_sim *s = &t.sim;
    int nodes = 0;
    for (int k = 0; k < NV; k++) {
        CHECK(s->first[k] == nodes);
        nodes += tree_cells[k] + 1;
        CHECK(s->last[k] == nodes - 1);
        NEAR(s->A0[s->last[k]], ZOO_PI * tree_out[k] * tree_out[k], 1e-15);
    }
    CHECK(s->n_nodes == nodes);
    CHECK(s->n_groups == 3 && s->outlets.count == 4);
    int ends = 1; /* every end of a vessel belongs to the inlet, a junction or an outlet, once */
    for (int g = 0; g < s->n_groups; g++)
        ends += s->groups[g].count * s->groups[g].branches;
    CHECK(ends + s->outlets.count == 2 * NV);
    for (int g = 0; g < s->n_groups; g++) {
        const zoo_junction_group *ju = &s->groups[g];
        for (int x = ju->count; x < ju->branches * ju->count; x++) {
            int parent = s->vessel_of[ju->node[x % ju->count]], child = s->vessel_of[ju->node[x]];
            CHECK(tree_parent[child] == parent && ju->node[x] == s->first[child]);
            CHECK(ju->node[x % ju->count] == s->last[parent] && s->children[parent] == ju->branches - 1);
        }
    }
    tree_close(&t);
    return finish("grid");
}
