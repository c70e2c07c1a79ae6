/* What zoo_extras adds: rest, balances, the junction's and the outlet's relations, lanes, and bad values. */
#include "check.h"

static tree one, many;
static double on[NV], off_in[NV], off_out[NV], tau[NV], leak[NV], inertance[NV], severity[NV], middle[NV], l[NV];
static double rho[3 * NV], kappa[3 * NV], wave[5];

/* Everything at once, different in every vessel. */
static void add(tree *t)
{
    for (int k = 0; k < NV; k++) {
        on[k] = 1.0 + 0.1 * k;
        off_in[k] = 500.0 * k;
        off_out[k] = 500.0 * k - 300.0;
        tau[k] = 3e-4 * (k % 3);
        leak[k] = 1e-7 * (k % 2);
        inertance[k] = 20.0 * (k % 2);
        severity[k] = k % 3 ? 0.0 : 0.2;
        middle[k] = 0.5;
        l[k] = 0.8 * tree_length[k];
        for (int m = 0; m < 3; m++) {
            rho[3 * k + m] = m == k % 3 ? 0.0 : 0.3 + 0.2 * m;
            kappa[3 * k + m] = 0.2 + 0.4 * m;
        }
    }
    for (int i = 0; i < 5; i++)
        wave[i] = 0.9 + 0.1 * i;
    t->problem.extras = (zoo_extras){on, off_in, off_out, tau, 3e-4, leak, 1.0, 2.0, inertance, 3, rho, kappa,
                                     severity, middle, l, 1.52, 5, wave, 0};
}

/* With all of it zero the loops with additions compute what the plain ones do. */
static void nothing(int wall, int lanes)
{
    for (int unlike = 0; unlike < 2; unlike++) {
        tree_make(&one, wall);
        tree_make(&many, wall);
        for (int i = 0; i < 64 * NV && !unlike; i++) {
            one.stiffness[i] = many.stiffness[i] = 5e4;
            one.gamma[i] = many.gamma[i] = 4.0;
        }
        many.problem.extras.force = 1;
        many.problem.extras.total_pressure = unlike * 1e-100; /* Newton's method at junctions as well */
        tree_open(&one, lanes, 1600);
        tree_open(&many, lanes, 1600);
        CHECK(!one.sim.extra && many.sim.extra);
        zoo_start(&one.sim);
        zoo_start(&many.sim);
        for (int i = 0; i < 800; i++) {
            CHECK(zoo_step(&one.sim, i) == 0);
            CHECK(zoo_step(&many.sim, i) == 0);
        }
        for (int i = 0; i < one.sim.n_nodes * lanes; i++) {
            NEAR(many.sim.P[i], one.sim.P[i], 1e-7);
            NEAR(many.sim.q[i], one.sim.q[i], 1e-12);
        }
        tree_close(&one);
        tree_close(&many);
    }
}

/* Blood at rest with throats and a viscoelastic wall stays at rest: to rounding where a vessel has one
 * offset, to second order where the offset falls along it (then A/A0 is not linear between nodes). */
static void rest(int wall, int falls, int coupled)
{
    tree_make(&one, wall);
    memset(one.flow, 0, sizeof one.flow);
    add(&one);
    if (!falls)
        memcpy(off_out, off_in, sizeof off_in);
    one.problem.extras.leak = NULL;
    one.problem.extras.n_wave = 0;
    if (!coupled)
        one.problem.extras.total_pressure = one.problem.extras.junction_loss = 0.0;
    tree_open(&one, 1, 4096);
    zoo_sim *s = &one.sim;
    for (int j = 0; j < s->n_nodes; j++) {
        double p = 8000.0 - s->offset[j];
        s->A[j] = s->A0[j] * wall_area_ratio(wall, s->K[j], s->theta[j], p);
        s->q[j] = 0.0;
        s->z[j] = -s->kappa[j] * p;
    }
    for (int t = 0; t < s->outlets.count; t++) {
        double sum = 0.0;
        for (int m = 0; m < 3; m++)
            sum += zoo_section_resistance(s, m, t, 0);
        for (int m = 0; m < 3; m++)
            s->outlets.v[m * s->outlets.count + t] = 8000.0 * zoo_section_resistance(s, m, t, 0) / sum;
        s->outlets.C[t] = 1e9; /* so large that nothing drains */
        s->outlets.carry[t] = 0.0;
    }
    zoo_set_step(s, 4096);
    zoo_refresh_nodes(s);
    for (int i = 0; i < 200; i++)
        CHECK(zoo_step(s, i) == 0);
    for (int j = 0; j < s->n_nodes; j++) {
        NEAR(s->P[j], 8000.0, falls ? 20.0 : 1e-6);
        NEAR(s->q[j], 0.0, falls ? 3e-5 : 1e-10);
    }
    tree_close(&one);
}

/* Blood: what enters less what leaves and leaks is what stays, to rounding, and every end obeys its law. */
static void balance(int wall, int coupled)
{
    tree_make(&one, wall);
    add(&one);
    if (!coupled)
        one.problem.extras.total_pressure = one.problem.extras.junction_loss = 0.0;
    tree_open(&one, 1, 4096);
    zoo_sim *s = &one.sim;
    zoo_start(s);
    memset(s->outlets.volume, 0, (size_t)s->outlets.count * sizeof(double));
    double before = tree_volume(s, 0), in = 0.0, out = 0.0, leaked = 0.0;
    for (int i = 0; i < 4096; i++) {
        CHECK(zoo_step(s, i) == 0);
        in += s->dt * s->flow_mean[i];
        for (int j = 0; j < s->n_nodes; j++)
            leaked += s->dt * s->dx[s->vessel_of[j]] * s->leak_mid[j] * s->Ph[j];
        CHECK(zoo_junction_defect(s, 0) < 1e-13);
    }
    for (int t = 0; t < s->outlets.count; t++)
        out += s->outlets.volume[t];
    CHECK(in > 0.01 && out > 0.01 && leaked > 1e-4);
    NEAR(tree_volume(s, 0) - before, in - out - leaked, 1e-13);
    for (int g = 0; g < s->n_groups; g++) {
        const zoo_junctions *ju = &s->groups[g];
        for (int x = 0; x < ju->branches * ju->count; x++) {
            int up = ju->node[x % ju->count], o = ju->node[x];
            double u0 = s->q[up] / s->A[up], u = s->q[o] / s->A[o];
            double half_rho = coupled ? 0.5 * 1.055 : 0.0, shared = s->P[up] + half_rho * u0 * u0;
            double lost = x < ju->count ? 0.0 : 2.0 * half_rho * u0 * fabs(u0); /* K = 2 */
            NEAR(s->P[o] + half_rho * u * u, shared - lost, 1e-4);
        }
    }
    tree_close(&one);
}

static void lanes(int wall)
{
    tree_make(&many, wall);
    add(&many);
    tree_open(&many, ZOO_LANES, 4096);
    zoo_start(&many.sim);
    for (int i = 0; i < 800; i++)
        zoo_step(&many.sim, i);
    for (int lane = 0; lane < ZOO_LANES; lane += 5) {
        tree_make(&one, wall);
        add(&one);
        one.parameters = (zoo_parameters){one.stiffness + lane * NV, one.gamma + lane * NV, one.psi1 + lane * NV,
                                          one.psi2 + lane * NV, one.c + lane * NV};
        tree_open(&one, 1, 4096);
        zoo_start(&one.sim);
        for (int i = 0; i < 800; i++)
            zoo_step(&one.sim, i);
        for (int j = 0; j < one.sim.n_nodes; j++) {
            NEAR(many.sim.P[j * ZOO_LANES + lane], one.sim.P[j], 1e-6);
            NEAR(many.sim.q[j * ZOO_LANES + lane], one.sim.q[j], 1e-10);
        }
        tree_close(&one);
    }
    tree_close(&many);
}

/* To the periodic state through the entry point, in memory that is exactly as large as it says. */
static void solve(int wall, int n)
{
    static double p[5 * NSERIES * NTIMES], q[5 * NSERIES * NTIMES], A[5 * NSERIES * NTIMES];
    zoo_report reports[5];
    int64_t bytes = 0;
    tree_make(&one, wall);
    add(&one);
    if (n > 1)
        one.stiffness[NV] = NAN; /* a bad set beside good ones */
    CHECK(zoo_workspace_size(&one.problem, n, &bytes) == ZOO_OK);
    char *memory = malloc((size_t)bytes);
    memset(memory, 0xff, (size_t)bytes);
    CHECK(zoo_solve(&one.problem, n, &one.parameters, memory, bytes, p, q, A, reports) == ZOO_OK);
    for (int i = 0; i < n; i++) {
        CHECK(reports[i].status == (i == 1 ? ZOO_BAD_ARGUMENT : ZOO_OK));
        CHECK(isnan(p[i * NSERIES * NTIMES]) == (i == 1));
    }
    free(memory);
}

/* The state packed and unpacked is the state, and another state in between leaves nothing behind. */
static void packing(void)
{
    tree_make(&one, ZOO_WALL_TANGENT);
    add(&one);
    tree_open(&one, 1, 4096);
    zoo_sim *s = &one.sim;
    zoo_start(s);
    double *x = malloc((size_t)s->n_state * sizeof *x), *y = malloc((size_t)s->n_state * sizeof *y);
    for (int i = 0; i < 100; i++)
        zoo_step(s, i);
    zoo_pack(s, x);
    zoo_refresh_nodes(s); /* a state is that of a beat's start: with the stiffness of that time */
    for (int i = 0; i < 50; i++)
        zoo_step(s, i);
    double P = s->P[20], q = s->q[40];
    zoo_start(s);
    zoo_unpack(s, x);
    zoo_pack(s, y);
    CHECK(memcmp(x, y, (size_t)s->n_state * sizeof *x) == 0);
    for (int i = 0; i < 50; i++)
        zoo_step(s, i);
    NEAR(s->P[20], P, 1e-6);
    NEAR(s->q[40], q, 1e-10);
    free(x);
    free(y);
    tree_close(&one);
}

#define REJECTS(change)                            \
    do {                                           \
        tree_make(&one, ZOO_WALL_LINEAR);          \
        add(&one);                                 \
        CHECK(zoo_check_problem(&one.problem) == 0); \
        change;                                    \
        CHECK(zoo_check_problem(&one.problem) == 1); \
    } while (0)

static void checks_of_values(void)
{
    REJECTS(on[3] = 0.0);
    REJECTS(off_in[3] = NAN);
    REJECTS(off_out[3] = INFINITY);
    REJECTS(tau[1] = -1e-3);
    REJECTS(leak[2] = -1e-9);
    REJECTS(inertance[7] = NAN);
    REJECTS(severity[0] = 1.0);
    REJECTS(middle[0] = 1.1);
    REJECTS(l[0] = 0.0);
    REJECTS(rho[3 * 7] = -0.1);
    REJECTS(kappa[3 * 7] = 0.0);
    REJECTS(wave[4] = 0.0);
    REJECTS(wave[0] = NAN);
    REJECTS(one.problem.extras.n_wave = -1);
    REJECTS(one.problem.extras.stiffness_wave = NULL);
    REJECTS(memset(rho, 0, sizeof rho));
    REJECTS(one.problem.extras.relaxation_time = 0.0);
    REJECTS(one.problem.extras.total_pressure = -1.0);
    REJECTS(one.problem.extras.junction_loss = NAN);
    REJECTS(one.problem.extras.throat_loss = INFINITY);
    REJECTS(one.problem.extras.offset_out = NULL);
    REJECTS(one.problem.extras.throat_length = NULL);
    REJECTS(one.problem.extras.section_compliance = NULL);
    REJECTS(one.problem.physics.stokes_friction = -1.0);
    REJECTS(one.problem.physics.viscous_friction = NAN);
    /* what changes the grid only, or nothing, needs no other loops */
    static const double zero[NV], single[NV] = {1, 1, 1, 1, 1, 1, 1, 1};
    tree_make(&one, ZOO_WALL_LINEAR);
    one.problem.physics.viscous_friction = 8.0;
    one.problem.extras = (zoo_extras){on, zero, zero, zero, 3e-4, zero, 0.0, 0.0, zero, 1, single, single,
                                      zero, middle, l, 1.52, 2, single, 0};
    on[0] = on[3] = middle[0] = l[0] = 1.0;
    CHECK(zoo_check_problem(&one.problem) == 0 && zoo_has_extras(&one.problem) == 0);
    severity[0] = 0.3;
    one.problem.extras.throat_severity = severity;
    one.problem.extras.throat_loss = 0.0;
    CHECK(zoo_has_extras(&one.problem) == 0);
}

int main(void)
{
    for (int wall = ZOO_WALL_LINEAR; wall <= ZOO_WALL_TANGENT; wall++) {
        nothing(wall, 1);
        nothing(wall, ZOO_LANES);
        for (int i = 0; i < 4; i++)
            rest(wall, i & 1, i >> 1);
        balance(wall, 0);
        balance(wall, 1);
        lanes(wall);
        solve(wall, 1);
        solve(wall, 5);
    }
    packing();
    checks_of_values();
    return finish("extra");
}
