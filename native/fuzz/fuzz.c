/* Calls every entry point with ordinary and with hostile arguments, and looks at what comes back.
 *
 *   fuzz [--seconds S] [--calls N] [--seed K] [--corpus FILE] [--case K]
 *
 * A case is made of one seed: a small tree, outputs, numerics and parameters that can mostly be solved, of which, in half of the cases, one to three values are then replaced by values that nobody means: numbers that are
 * none, sizes that do not fit, arrays that are absent.  Whether the call must then be refused is decided here from
 * what zoo.h says (`verdict`), not by the solver's own checks.  A case fails when
 *
 *   - a sanitizer stops it, a guard word beside an array is overwritten, or an argument is changed;
 *   - what must be refused is not, or the other way round; what is refused writes anything;
 *   - a solve that is called one holds something that is not a number, or one that failed holds numbers;
 *   - the answer depends on what stood in the workspace.
 *
 * The last line counts; the exit status is not zero when a case failed, or when no more than a third of all that were
 * handed in were solved. */
#include <signal.h>
#include <time.h>

#include "../src/inlet.h"
#include "../src/internal.h"
#include "../src/outlet.h"
#include "draw.h"

enum { MOST_VESSELS = 6, MOST_BYTES = 1 << 25, UNKNOWN = -1 };

static uint64_t case_seed;
static int64_t failures, given, by_status[ZOO_INLET_AREA + 1], refused, twice;
static int64_t calls_size, calls_solve, calls_name, calls_wall;

static void fail(const char *what)
{
    if (failures++ < 20)
        fprintf(stderr, "fuzz: %s; look at it with --case %llu\n", what, (unsigned long long)case_seed);
}

#define EXPECT(condition, what) \
    do {                        \
        if (!(condition))       \
            fail(what);         \
    } while (0)

static void last_words(void)
{
    fprintf(stderr, "fuzz: stopped in --case %llu\n", (unsigned long long)case_seed);
}

static void on_signal(int number)
{
    last_words();
    signal(number, SIG_DFL);
    raise(number);
}

/* ---- a case ---- */

typedef struct {
    zoo_problem problem;
    zoo_parameters parameters;
} trial;

/* What may be changed: numbers, counts, arrays. */
static struct {
    double *at;
    int n;
} reals[MOST_ARRAYS];
static struct {
    int32_t *at;
    int n, kind, most; /* `most`: the size of the array, where it is one */
} counts[MOST_ARRAYS];
static const void **pointers[MOST_ARRAYS];
static int n_reals, n_counts, n_pointers;
enum { SIZE_OF_ARRAY, NUMBER_OF_KIND, CELLS, STEPS, INDEX };

static double *reals_of(const double **field, int n, double low, double high)
{
    double *values = array_new((size_t)n * sizeof *values, 0, 0);
    for (int i = 0; i < n; i++)
        values[i] = low > 0.0 ? log_between(low, high) : between(low, high);
    reals[n_reals].at = values;
    reals[n_reals++].n = n;
    *field = values;
    pointers[n_pointers++] = (const void **)field;
    return values;
}

static int32_t *counts_of(const int32_t **field, int n, int kind)
{
    int32_t *values = array_new((size_t)n * sizeof *values, 0, 0);
    counts[n_counts].at = values;
    counts[n_counts].kind = kind;
    counts[n_counts].most = 0;
    counts[n_counts++].n = n;
    *field = values;
    pointers[n_pointers++] = (const void **)field;
    return values;
}

static void real_of(double *field, double value)
{
    *field = value;
    reals[n_reals].at = field;
    reals[n_reals++].n = 1;
}

static void count_of(int32_t *field, int32_t value, int kind)
{
    *field = value;
    counts[n_counts].at = field;
    counts[n_counts].kind = kind;
    counts[n_counts].most = value;
    counts[n_counts++].n = 1;
}

static void function_of(zoo_function *f, double low, double high, double least, double most)
{
    count_of(&f->n_knots, 4 + below(12), SIZE_OF_ARRAY);
    real_of(&f->low, low);
    real_of(&f->high, high);
    double *values = reals_of(&f->values, f->n_knots, 1.0, 2.0);
    for (int i = 0; i < f->n_knots; i++)
        values[i] = between(least, most);
}

static void make_additions(zoo_problem *pr, int nv)
{
    if (one_in(3))
        function_of(&pr->wall.function, 0.9, 1.4, -0.005, 0.005);
    if (one_in(3))
        function_of(&pr->fluid.friction_function, 0.0, 60.0, 0.5, 2.0);
    if (one_in(3))
        function_of(&pr->junction.function, -40.0, 60.0, -200.0, 500.0);
    if (one_in(3))
        reals_of(&pr->fluid.viscosity_factor, nv, 0.5, 2.0);
    if (one_in(3))
        reals_of(&pr->fluid.leak, nv, 1e-10, 1e-8);
    if (one_in(3)) {
        reals_of(&pr->wall.offset_in, nv, -2000.0, 2000.0);
        reals_of(&pr->wall.offset_out, nv, -2000.0, 2000.0);
    }
    if (one_in(3))
        reals_of(&pr->wall.stiffness_ratio, nv, 0.5, 2.0);
    if (one_in(3))
        reals_of(&pr->wall.stiffness_exponent, nv, -1.0, 1.0);
    if (one_in(3))
        reals_of(&pr->wall.viscoelastic_time, nv, 1e-5, 5e-4);
    if (one_in(3)) {
        count_of(&pr->wall.n_wave, 1 + below(9), SIZE_OF_ARRAY);
        reals_of(&pr->wall.stiffness_wave, pr->wall.n_wave, 0.8, 1.2);
    }
    if (one_in(3)) {
        reals_of(&pr->throat.severity, nv, 0.0, 0.4);
        reals_of(&pr->throat.position, nv, 0.0, 1.0);
        reals_of(&pr->throat.length, nv, 0.05, 1.0);
    }
    if (one_in(3)) {
        reals_of(&pr->loss.quadratic, nv, 0.0, 50.0);
        reals_of(&pr->loss.linear, nv, 0.0, 1e4);
        reals_of(&pr->loss.position, nv, 0.0, 1.0);
        reals_of(&pr->loss.length, nv, 0.05, 1.0);
    }
    if (one_in(3))
        pr->junction.total_pressure = 1.0;
    if (one_in(3))
        pr->junction.loss = between(0.0, 2.0);
    if (one_in(2))
        pr->outlet.kind = ZOO_OUTLET_CIRCUIT;
    if (one_in(3))
        reals_of(&pr->outlet.inertance, nv, 1.0, 50.0);
    if (one_in(3)) {
        count_of(&pr->outlet.n_sections, 1 + below(3), SIZE_OF_ARRAY);
        reals_of(&pr->outlet.section_resistance, nv * pr->outlet.n_sections, 0.1, 1.0);
        reals_of(&pr->outlet.section_compliance, nv * pr->outlet.n_sections, 0.5, 1.5);
        if (pr->outlet.n_sections > 1 && one_in(3)) /* a small negative section at each terminal */
            for (int k = 0; k < nv; k++) {
                ((double *)pr->outlet.section_resistance)[k * pr->outlet.n_sections] = -0.02;
                ((double *)pr->outlet.section_compliance)[k * pr->outlet.n_sections] = -1.0;
            }
    }
    if (one_in(3)) {
        count_of(&pr->outlet.n_modes, 1 + below(3), SIZE_OF_ARRAY);
        pr->outlet.mode_rate = between(5.0, 30.0);
        reals_of(&pr->outlet.mode_frequency, pr->outlet.n_modes, 0.0, 200.0);
        reals_of(&pr->outlet.mode_cosine, nv * pr->outlet.n_modes, 0.0, 1e6);
        reals_of(&pr->outlet.mode_sine, nv * pr->outlet.n_modes, -1e5, 1e6);
    }
    if (one_in(3)) {
        count_of(&pr->outlet.n_wave, 1 + below(9), SIZE_OF_ARRAY);
        reals_of(&pr->outlet.wave, nv * pr->outlet.n_wave, -2e3, 2e3);
    }
    for (int i = 0; i < 2; i++) {
        if (one_in(4))
            function_of(i ? &pr->outlet.resistance_function : &pr->outlet.compliance_function, 0.0, 4e4, -0.4, 0.4);
    }
}

/* A trial that can mostly be solved. */
static void make(trial *t)
{
    memset(t, 0, sizeof *t);
    n_reals = n_counts = n_pointers = 0;
    zoo_problem *pr = &t->problem;
    const int nv = 1 + below(MOST_VESSELS), ns = below(4), ntime = ns ? below(12) : 0, n_samples = 4 + below(20);
    count_of(&pr->network.n_vessels, nv, SIZE_OF_ARRAY);
    int32_t *parent = counts_of(&pr->network.parent, nv, INDEX), *cells = counts_of(&pr->network.n_cells, nv, CELLS);
    int terminals = nv;
    int fed[MOST_VESSELS] = {0};
    for (int k = 0; k < nv; k++) {
        parent[k] = k ? below(k) : -1;
        cells[k] = 1 + below(3);
        if (k && !fed[parent[k]]++)
            terminals--;
    }
    double *radius = reals_of(&pr->network.radius_in, nv, 0.03, 0.06), *length = reals_of(&pr->network.length, nv, 0.5, 1.5);
    double *radius_out = reals_of(&pr->network.radius_out, nv, 0.03, 0.06);
    for (int k = 0; k < nv; k++) {
        radius_out[k] = radius[k] * between(0.8, 1.0);
        length[k] = cells[k] * between(0.4, 0.8); /* steps that are not too short */
    }

    real_of(&pr->fluid.density, 1.055);
    real_of(&pr->fluid.viscosity, 0.049);
    real_of(&pr->fluid.momentum_correction, one_in(2) ? 1.0 : 4.0 / 3.0);
    count_of(&pr->fluid.friction, below(3), NUMBER_OF_KIND);
    real_of(&pr->fluid.friction_radius, 0.05);
    real_of(&pr->fluid.stokes_friction, 1.0);
    real_of(&pr->fluid.viscous_friction, one_in(3) ? 8.0 : 0.0);
    count_of(&pr->wall.law, below(ZOO_N_WALLS), NUMBER_OF_KIND);
    real_of(&pr->wall.factor, 1.0);
    real_of(&pr->wall.relaxation_time, 3e-4);
    real_of(&pr->throat.loss, 1.52);
    real_of(&pr->junction.total_pressure, 0.0);
    real_of(&pr->junction.loss, 0.0);

    const int by_pressure = n_samples % 4 == 0; /* draws no number: the corpus stays what it was */
    count_of(&pr->inlet.kind, by_pressure ? ZOO_INLET_PRESSURE : ZOO_INLET_FLOW, NUMBER_OF_KIND);
    real_of(&pr->inlet.period, between(0.04, 0.08));
    count_of(&pr->inlet.n_samples, n_samples, SIZE_OF_ARRAY);
    double *curve = reals_of(&pr->inlet.curve, n_samples, 0.0, 1.0);
    for (int i = 0; i < n_samples; i++)
        curve[i] = by_pressure ? 15000.0 + 3000.0 * sin(2.0 * ZOO_PI * i / n_samples)
                   : 2 * i < n_samples ? 0.4 * pow(sin(2.0 * ZOO_PI * i / n_samples), 2)
                                       : 0.0;
    const double mean = 0.1, total = between(3e5, 8e5) * terminals;

    count_of(&pr->outlet.kind, ZOO_OUTLET_WINDKESSEL, NUMBER_OF_KIND);
    double *R1 = reals_of(&pr->outlet.R1, nv, 0.1 * total, 0.2 * total), *R2 = reals_of(&pr->outlet.R2, nv, 0.7 * total, total);
    double *C = reals_of(&pr->outlet.C, nv, 0.05 / total, 0.2 / total);
    if (one_in(8))
        for (int k = 0; k < nv; k++)
            R1[k] += R2[k], R2[k] = 0.0, C[k] = 0.0;
    if (one_in(4))
        reals_of(&pr->outlet.pressure, nv, 0.0, 0.3 * total * mean / terminals);
    (void)R1, (void)C;

    count_of(&pr->outputs.n_series, ns, SIZE_OF_ARRAY);
    count_of(&pr->outputs.n_times, ntime, SIZE_OF_ARRAY);
    int32_t *vessel = counts_of(&pr->outputs.vessel, ns, INDEX);
    for (int i = 0; i < ns; i++)
        vessel[i] = below(nv);
    reals_of(&pr->outputs.position, ns, 0.0, 1.0);
    double *times = reals_of(&pr->outputs.times, ntime, 0.0, 1.0);
    for (int i = 0; i < ntime; i++)
        times[i] = pr->inlet.period * i / (ntime > 1 ? ntime - 1 : 1);

    real_of(&pr->numerics.cfl, between(0.5, 0.95));
    count_of(&pr->numerics.steps_per_beat, one_in(8) ? 64 + below(200) : 0, STEPS);
    count_of(&pr->numerics.least_steps, one_in(4) ? below(64) : 0, STEPS);
    count_of(&pr->numerics.max_steps, 512, STEPS);
    count_of(&pr->numerics.max_beats, 30, STEPS);
    real_of(&pr->numerics.tolerance, log_between(200.0, 5000.0));
    real_of(&pr->numerics.relative, one_in(2) ? log_between(1e-3, 0.5) : 0.0);
    count_of(&pr->numerics.accelerate, !one_in(4), NUMBER_OF_KIND);
    count_of(&pr->numerics.additions, one_in(8), NUMBER_OF_KIND);
    if (one_in(3))
        make_additions(pr, nv);

    const int shapeless = one_in(30);
    double *stiffness = reals_of(&t->parameters.stiffness, nv, 1e5, 4e5);
    for (int k = 0; k < nv && one_in(2); k++)
        stiffness[k] = stiffness[0]; /* one stiffness in all vessels */
    reals_of(&t->parameters.shape, nv * ZOO_MOST_SHAPES, 3.0, 8.0);
    if (shapeless && zoo_wall_shapes(pr->wall.law) == 0)
        t->parameters.shape = NULL;
    reals_of(&t->parameters.psi1, nv, 0.8, 1.2);
    reals_of(&t->parameters.psi2, nv, 0.8, 1.2);
    reals_of(&t->parameters.c, nv, 0.8, 1.2);
}

static void spoil(void)
{
    for (int n = 1 + below(3); n > 0; n--) {
        const int what = below(8);
        if (what < 4) {
            const int a = below(n_reals);
            if (reals[a].n > 0) {
                double *at = &reals[a].at[below(reals[a].n)];
                *at = hostile_real(*at);
            }
        } else if (what < 6) {
            const int a = below(n_counts);
            if (counts[a].n > 0) {
                int32_t *at = &counts[a].at[below(counts[a].n)];
                const int kind = counts[a].kind;
                *at = one_in(2)                ? hostile_count()
                      : kind == SIZE_OF_ARRAY  ? below(counts[a].most + 1)
                      : kind == CELLS          ? (one_in(4) ? 1000000 : below(8))
                      : kind == STEPS          ? below(1000)
                                               : below(8) - 2;
            }
        } else
            *pointers[below(n_pointers)] = NULL;
    }
}

/* ---- what zoo.h allows: 0, must be refused: 1; UNKNOWN close to the ends of the range of doubles ---- */

static int in_range(double x, double low, double high)
{
    return x >= low && x <= high;
}

static int positive(double x)
{
    return x > 0.0 && x <= DBL_MAX;
}

static int finite_all(const double *x, int64_t n, double low, double high)
{
    for (int64_t i = 0; x && i < n; i++)
        if (!in_range(x[i], low, high))
            return 0;
    return 1;
}

static int positive_all(const double *x, int64_t n, int *unknown)
{
    for (int64_t i = 0; x && i < n; i++) {
        if (!positive(x[i]))
            return 0;
        *unknown |= x[i] < 1e-290;
    }
    return 1;
}

static int function_bad(const zoo_function *f, double lowest, double least, double most, int *unknown)
{
    if (f->n_knots == 0)
        return 0;
    if (f->n_knots < 4 || f->n_knots > 4096 || !f->values || !in_range(f->low, lowest, 1e30) || !in_range(f->high, -1e30, 1e30) ||
        !(f->low < f->high))
        return 1;
    *unknown |= f->high - f->low < 1e-8 * (fabs(f->low) + fabs(f->high)) || f->high - f->low < 1e-29;
    return !finite_all(f->values, f->n_knots, least, most);
}

static int count_in(int32_t x, int32_t low)
{
    return x >= low && x <= 1 << 28;
}

static int verdict(const trial *t)
{
    const zoo_problem *pr = &t->problem;
    const zoo_network *net = &pr->network;
    const int nv = net->n_vessels;
    int unknown = 0, fed[MOST_VESSELS] = {0};
    int64_t nodes = 0;
    if (!count_in(nv, 1) || !net->parent || !net->n_cells || !net->length || !net->radius_in || !net->radius_out)
        return 1;
    for (int k = 0; k < nv; k++) {
        if (k == 0 ? net->parent[k] != -1 : net->parent[k] < 0 || net->parent[k] >= k)
            return 1;
        if (k)
            fed[net->parent[k]] = 1;
        if (net->n_cells[k] < 1 || !positive(net->length[k]))
            return 1;
        nodes += (int64_t)net->n_cells[k] + 1;
        for (int end = 0; end < 2; end++) {
            const double r = end ? net->radius_out[k] : net->radius_in[k];
            if (!positive(r) || r < 0.999e-15 || r > 1.001e15)
                return 1;
            unknown |= r < 1.001e-15 || r > 0.999e15;
        }
    }
    const zoo_fluid *fl = &pr->fluid;
    if (!positive(fl->density) || !positive(fl->viscosity) || !in_range(fl->momentum_correction, 0.0, DBL_MAX) ||
        fl->friction < 0 || fl->friction > 2 || (fl->friction == ZOO_FRICTION_FIXED && !positive(fl->friction_radius)) ||
        !in_range(fl->stokes_friction, 0.0, DBL_MAX) || !in_range(fl->viscous_friction, 0.0, DBL_MAX) ||
        !positive_all(fl->viscosity_factor, nv, &unknown) || !finite_all(fl->leak, nv, 0.0, DBL_MAX) ||
        function_bad(&fl->friction_function, 0.0, 0.0, 1e30, &unknown))
        return 1;
    const zoo_wall *wa = &pr->wall;
    if (wa->law < 0 || !zoo_wall_name(wa->law) || !positive(wa->factor) || !wa->offset_in != !wa->offset_out ||
        !finite_all(wa->offset_in, nv, -DBL_MAX, DBL_MAX) || !finite_all(wa->offset_out, nv, -DBL_MAX, DBL_MAX) ||
        !positive_all(wa->stiffness_ratio, nv, &unknown) || !finite_all(wa->stiffness_exponent, nv, -DBL_MAX, DBL_MAX) ||
        !finite_all(wa->viscoelastic_time, nv, 0.0, DBL_MAX) || (wa->viscoelastic_time && !positive(wa->relaxation_time)) ||
        !count_in(wa->n_wave, 0) || (wa->n_wave && !wa->stiffness_wave) || !positive_all(wa->stiffness_wave, wa->n_wave, &unknown) ||
        function_bad(&wa->function, 1e-3, -1e30, 1e30, &unknown))
        return 1;
    const zoo_loss *lo = &pr->loss;
    if (((lo->quadratic || lo->linear) && (!lo->position || !lo->length)) || !finite_all(lo->quadratic, nv, 0.0, 1e30) ||
        !finite_all(lo->linear, nv, 0.0, 1e30) || !finite_all(lo->position, nv, 0.0, 1.0) || !positive_all(lo->length, nv, &unknown))
        return 1;
    const zoo_throat *th = &pr->throat;
    if ((th->severity && (!th->position || !th->length)) || !finite_all(th->severity, nv, 0.0, 1.0 - 1e-9) ||
        !finite_all(th->position, nv, 0.0, 1.0) || !positive_all(th->length, nv, &unknown) ||
        !in_range(th->loss, 0.0, DBL_MAX) || !in_range(pr->junction.total_pressure, 0.0, DBL_MAX) ||
        !in_range(pr->junction.loss, 0.0, DBL_MAX) || function_bad(&pr->junction.function, -1e30, -1e30, 1e30, &unknown))
        return 1;
    const zoo_inlet *in = &pr->inlet;
    double sum = 0.0;
    if (!zoo_inlet_name(in->kind) || !positive(in->period) || !count_in(in->n_samples, 4) || !in->curve ||
        !finite_all(in->curve, in->n_samples, in->kind == ZOO_INLET_FLOW ? -DBL_MAX : -1e30, in->kind == ZOO_INLET_FLOW ? DBL_MAX : 1e30))
        return 1;
    for (int i = 0; i < in->n_samples; i++)
        sum += in->curve[i];
    if (in->kind == ZOO_INLET_FLOW && !positive(sum))
        return 1;
    unknown |= in->period < 1e-285;
    const zoo_outputs *ot = &pr->outputs;
    if (!count_in(ot->n_series, 0) || !count_in(ot->n_times, 0) || (ot->n_series && (!ot->vessel || !ot->position)) ||
        (ot->n_times && !ot->times) || !finite_all(ot->position, ot->n_series, 0.0, 1.0))
        return 1;
    for (int i = 0; i < ot->n_series; i++)
        if (ot->vessel[i] < 0 || ot->vessel[i] >= nv)
            return 1;
    for (int i = 0; i < ot->n_times; i++) {
        if (!(ot->times[i] >= (i ? ot->times[i - 1] : 0.0)) || !(ot->times[i] <= in->period * 1.000001))
            return 1;
        unknown |= ot->times[i] > in->period;
    }
    const zoo_numerics *nu = &pr->numerics;
    if (!(nu->cfl > 0.0 && nu->cfl < 1.0) || !count_in(nu->max_steps, 32) || !count_in(nu->max_beats, 1) ||
        !positive(nu->tolerance) || !(nu->relative >= 0.0 && nu->relative < 1.0) ||
        nu->steps_per_beat < 0 || nu->steps_per_beat > nu->max_steps || nu->least_steps < 0 ||
        nu->least_steps > nu->max_steps || (nu->steps_per_beat && nu->steps_per_beat < 32))
        return 1;
    if (nodes > 1 << 24) /* sizes that an int does not hold are refused, and nobody solves those in between here */
        return nodes > 1 << 28 ? 1 : UNKNOWN;
    const zoo_outlet *ou = &pr->outlet;
    if (!zoo_outlet_name(ou->kind) || !ou->R1 || !ou->R2 || !ou->C ||
        function_bad(&ou->resistance_function, -1e30, -30.0, 30.0, &unknown) ||
        function_bad(&ou->compliance_function, -1e30, -30.0, 30.0, &unknown) || !count_in(ou->n_wave, 0) || (ou->n_wave && !ou->wave))
        return 1;
    if (ou->n_sections < 0 || ou->n_sections > 1 << 20)
        return ou->kind == ZOO_OUTLET_CIRCUIT || ou->n_sections > 1 << 28 ? 1 : UNKNOWN;
    if (ou->n_modes < 0 || ou->n_modes > 1 << 20)
        return ou->kind == ZOO_OUTLET_CIRCUIT || ou->n_modes > 1 << 28 ? 1 : UNKNOWN;
    const int circuit = ou->kind == ZOO_OUTLET_CIRCUIT, ns = ou->n_sections, nm = circuit ? ou->n_modes : 0;
    if (nm && (!positive(ou->mode_rate) || !ou->mode_frequency || !ou->mode_cosine || !ou->mode_sine))
        return 1;
    unknown |= nm && (ou->mode_rate < 1e-29 || ou->mode_rate > 1e29);
    for (int m = 0; m < nm; m++)
        if (!in_range(ou->mode_frequency[m], 0.0, 1e30))
            return 1;
    if (circuit && (!finite_all(ou->inertance, nv, 0.0, DBL_MAX) || (ns && (!ou->section_resistance || !ou->section_compliance))))
        return 1;
    for (int k = 0; k < nv; k++) {
        if (fed[k]) /* not read */
            continue;
        if (!positive(ou->R1[k]) || !(ou->R2[k] == 0.0 || (positive(ou->R2[k]) && positive(ou->C[k]))) ||
            (ou->pressure && !in_range(ou->pressure[k], -DBL_MAX, DBL_MAX)))
            return 1;
        for (int m = k * ou->n_wave; m < (k + 1) * ou->n_wave; m++)
            if (!in_range(ou->wave[m], -1e30, 1e30))
                return 1;
        for (int m = k * nm; m < (k + 1) * nm; m++)
            if (!in_range(ou->mode_cosine[m], -1e30, 1e30) || !in_range(ou->mode_sine[m], -1e30, 1e30))
                return 1;
        double shares = 0.0, time = 0.0;
        for (int m = k * ns; circuit && m < (k + 1) * ns; m++) {
            const double rho = ou->section_resistance[m];
            if (!in_range(rho, -DBL_MAX, DBL_MAX) || (rho != 0.0 && !positive(rho < 0.0 ? -ou->section_compliance[m] : ou->section_compliance[m])))
                return 1;
            shares += rho;
            unknown |= rho != 0.0 && (fabs(rho) < 1e-100 || fabs(rho) > 1e100 || fabs(ou->section_compliance[m]) > 1e100 || fabs(ou->section_compliance[m]) < 1e-100);
            time += rho != 0.0 ? rho * rho * ou->section_compliance[m] : 0.0;
        }
        if (circuit && ns && (!(shares > 0.0) || !(time > 0.0)))
            return unknown ? UNKNOWN : 1;
    }
    return unknown ? UNKNOWN : 0;
}

/* Whether the parameters must be refused. */
static int parameters_verdict(const trial *t)
{
    const zoo_problem *pr = &t->problem;
    const zoo_parameters pa = t->parameters;
    const int nv = pr->network.n_vessels, shapes = zoo_wall_shapes(pr->wall.law);
    int fed[MOST_VESSELS] = {0}, unknown = 0;
    for (int k = 1; k < nv; k++)
        fed[pr->network.parent[k]] = 1;
    for (int k = 0; k < nv; k++) {
        const double chi = pa.stiffness[k], scale = pr->wall.law == ZOO_WALL_TANGENT ? chi * pr->wall.factor : chi;
        if (!positive(chi) || scale < 1e-31 || scale > 1e31)
            return 1;
        unknown |= scale < 1e-29 || scale > 1e29;
        for (int m = 0; m < shapes; m++)
            if (!positive(pa.shape[m * nv + k]))
                return 1;
        const zoo_outlet *ou = &pr->outlet;
        double against = 0.0;
        const int sections = !fed[k] && ou->kind == ZOO_OUTLET_CIRCUIT ? ou->n_sections : 0; /* else not read: any number */
        for (int m = 0; m < sections; m++)
            against -= fmin(ou->section_resistance[k * sections + m], 0.0);
        if (!fed[k] && ou->kind == ZOO_OUTLET_CIRCUIT && ou->n_modes > 0) { /* all together lets steady flow out */
            double steady = 0.0, shares = ou->n_sections ? 0.0 : 1.0;
            for (int m = k * ou->n_modes; m < (k + 1) * ou->n_modes; m++) {
                const double w = ou->mode_frequency[m % ou->n_modes];
                steady += (ou->mode_cosine[m] * ou->mode_rate + ou->mode_sine[m] * w) / (ou->mode_rate * ou->mode_rate + w * w);
            }
            for (int m = 0; m < sections; m++)
                shares += ou->section_resistance[k * sections + m];
            const double all = pa.psi1[k] * (ou->R1[k] + steady) + shares * (ou->R2[k] * pa.psi2[k]);
            unknown |= !(fabs(all) > 1e-9 * (pa.psi1[k] * (ou->R1[k] + fabs(steady)) + shares * ou->R2[k] * pa.psi2[k]));
            if (positive(pa.psi1[k]) && positive(pa.psi2[k]) && !(all > 0.0) && !unknown)
                return 1;
        }
        if (!fed[k] && positive(pa.psi1[k]) && positive(pa.psi2[k]) && against > 0.0) {
            const double first = ou->R1[k] * pa.psi1[k], less = against * (ou->R2[k] * pa.psi2[k]);
            unknown |= fabs(first - less) <= 1e-9 * first || !isfinite(less);
            if (!(first > less) && !unknown)
                return 1;
        }
        if (!fed[k] && (!positive(pa.psi1[k]) || !positive(pa.psi2[k]) || !positive(pa.c[k])))
            return 1;
    }
    return unknown ? UNKNOWN : 0;
}

/* ---- one case ---- */

static int all_nan(const double *x, int64_t n)
{
    for (int64_t i = 0; i < n; i++)
        if (!isnan(x[i]))
            return 0;
    return 1;
}

static uint64_t digest_arguments(const trial *t)
{
    uint64_t sum = digest(1, t, sizeof *t);
    for (int i = 0; i < n_reals; i++)
        sum = digest(sum, reals[i].at, (size_t)reals[i].n * sizeof(double));
    for (int i = 0; i < n_counts; i++)
        sum = digest(sum, counts[i].at, (size_t)counts[i].n * sizeof(int32_t));
    return sum;
}

typedef struct {
    double *wave[3], *fastest;
    zoo_report *report;
    int32_t code;
    uint64_t sum; /* digest of all that was written */
} answer;

/* Solves with a workspace of `bytes` full of `fill`; the outputs start as 0xc3. */
static answer call(const trial *t, int64_t bytes, int fill, int with_fastest)
{
    answer a;
    const size_t waves = (size_t)t->problem.outputs.n_series * (size_t)t->problem.outputs.n_times * sizeof(double);
    const size_t speeds = (size_t)t->problem.network.n_vessels * sizeof(double), room = (size_t)bytes;
    void *workspace = array_new(room, fill ? below(8) * 8 : 0, fill);
    for (int i = 0; i < 3; i++)
        a.wave[i] = array_new(waves, 0, 0xc3);
    a.fastest = with_fastest ? array_new(speeds, 0, 0xc3) : NULL;
    a.report = array_new(sizeof *a.report, 0, 0);
    calls_solve++;
    a.code = zoo_solve(&t->problem, &t->parameters, workspace, bytes, a.wave[0], a.wave[1], a.wave[2], a.fastest, a.report);
    int broken = guard_broken(workspace, room) | guard_broken(a.report, sizeof *a.report);
    a.sum = digest(7, a.report, sizeof *a.report);
    for (int i = 0; i < 3; i++) {
        broken |= guard_broken(a.wave[i], waves);
        a.sum = digest(a.sum, a.wave[i], waves);
    }
    if (a.fastest) {
        broken |= guard_broken(a.fastest, speeds);
        a.sum = digest(a.sum, a.fastest, speeds);
    }
    EXPECT(!broken, "it wrote beside an array");
    return a;
}

static void look_at(const trial *t, const answer *a)
{
    const zoo_report *r = a->report;
    const int nv = t->problem.network.n_vessels, expected = parameters_verdict(t);
    const int64_t n = (int64_t)t->problem.outputs.n_series * t->problem.outputs.n_times;
    EXPECT(r->status >= ZOO_OK && (r->status <= ZOO_NOT_PERIODIC || (r->status == ZOO_WALL_FALLS && t->problem.wall.function.n_knots) ||
            (r->status == ZOO_INLET_AREA && t->problem.inlet.kind == ZOO_INLET_PRESSURE)), "a solve has a status that does not exist");
    EXPECT(expected == UNKNOWN || (r->status == ZOO_BAD_ARGUMENT) == (expected == 1),
           "parameters are refused that are in range, or the other way round");
    EXPECT(r->vessel >= -1 && r->vessel < nv, "a report names a vessel that does not exist");
    if (r->status >= 0 && r->status <= ZOO_INLET_AREA)
        by_status[r->status]++;
    for (int part = 0; part < 3; part++) {
        const double *x = a->wave[part];
        EXPECT(r->status == ZOO_OK ? finite_all(x, n, part < 2 ? -DBL_MAX : -1e300, DBL_MAX) : all_nan(x, n),
               "samples do not fit the status");
    }
    if (a->fastest)
        EXPECT(r->status == ZOO_OK ? finite_all(a->fastest, nv, 0.0, DBL_MAX) : all_nan(a->fastest, nv),
               "speeds do not fit the status");
    if (r->status == ZOO_OK) {
        const zoo_numerics *nu = &t->problem.numerics;
        EXPECT(r->beats >= 1 && r->beats <= nu->max_beats && r->steps_per_beat >= 32 && r->steps_per_beat <= nu->max_steps &&
                   r->total_steps >= r->steps_per_beat && r->distance <= r->tolerance && in_range(r->change, 0.0, DBL_MAX) &&
                   in_range(r->max_cfl, 0.0, DBL_MAX) && isfinite(r->inflow) && isfinite(r->outflow) &&
                   isfinite(r->junction_defect),
               "the report of a solve does not hold together");
    }
}

static void solve_case(trial *t)
{
    int64_t bytes = -5;
    const int expected = verdict(t);
    const uint64_t before = digest_arguments(t);
    calls_size++;
    const int32_t status = zoo_workspace_size(&t->problem, &bytes);
    EXPECT(status == ZOO_OK || (status == ZOO_BAD_ARGUMENT && bytes == -5), "the size of a workspace has a wrong status");
    EXPECT(expected == UNKNOWN || (status != ZOO_OK) == expected, "a problem is refused that is in range, or the other way round");
    given++;
    if (status != ZOO_OK) {
        refused++;
        char some[64];
        zoo_report report;
        double out[3];
        memset(&report, 0xc3, sizeof report);
        memset(out, 0xc3, sizeof out);
        const uint64_t was = digest(digest(1, &report, sizeof report), out, sizeof out);
        calls_solve++;
        const int32_t code = zoo_solve(&t->problem, &t->parameters, some, sizeof some, out, out + 1, out + 2, NULL, &report);
        EXPECT(code == ZOO_BAD_ARGUMENT, "a solve accepts what its workspace refuses");
        EXPECT(was == digest(digest(1, &report, sizeof report), out, sizeof out), "a refused solve wrote something");
    } else if (bytes < 64 || bytes > MOST_BYTES || t->problem.numerics.max_beats > 10000) {
        EXPECT(bytes >= 64, "a workspace is smaller than nothing");
        given--; /* nobody waits for these */
    } else {
        const zoo_parameters *pa = &t->parameters;
        const int missing = !pa->stiffness || !pa->psi1 || !pa->psi2 || !pa->c ||
                            (zoo_wall_shapes(t->problem.wall.law) > 0 && !pa->shape);
        const int fastest = !one_in(4), small = one_in(50);
        const answer a = call(t, small ? bytes - 1 - below(64) : bytes, 0xff, fastest);
        if (missing || small) {
            refused++;
            EXPECT(a.code == (missing ? ZOO_BAD_ARGUMENT : ZOO_WORKSPACE), "what is missing was not noticed");
            EXPECT(a.report->status == 0 && a.report->beats == 0, "a refused solve wrote something");
        } else {
            EXPECT(a.code == ZOO_OK, "a solve refuses what its workspace accepts");
            if (a.code == ZOO_OK)
                look_at(t, &a);
            if (one_in(8)) {
                twice++;
                EXPECT(a.sum == call(t, bytes, 0, fastest).sum, "the answer depends on what stood in the workspace");
            }
        }
    }
    EXPECT(before == digest_arguments(t), "an argument was changed");
}

/* Names and single points of the walls. */
static void small_calls(void)
{
    const int32_t law = one_in(3) ? hostile_count() : below(6) - 2, kind = one_in(3) ? hostile_count() : below(6) - 2;
    const int32_t shapes = zoo_wall_shapes(law);
    const char *name = zoo_wall_name(law);
    calls_name += 6;
    EXPECT((name != NULL) == (law >= 0 && law < ZOO_N_WALLS) && (shapes >= 0) == (name != NULL), "a wall law has a wrong name");
    EXPECT((zoo_wall_shape_name(law, kind) != NULL) == (kind >= 0 && kind < shapes), "a shape parameter has a wrong name");
    EXPECT((zoo_inlet_name(kind) != NULL) == (kind >= 0 && kind < ZOO_N_INLETS), "an inlet has a wrong name");
    EXPECT((zoo_outlet_name(kind) != NULL) == (kind >= 0 && kind < ZOO_N_OUTLETS), "an outlet has a wrong name");
    EXPECT(zoo_status_text(kind) != NULL && *zoo_status_text(kind), "a status has no text");

    double x[6] = {1.0, 4e5, 4.0, 0.012, 0.01, 1.055};
    for (int i = 0; i < 6; i++)
        if (one_in(4))
            x[i] = hostile_real(x[i]);
    double *shape = one_in(4) ? NULL : array_new((size_t)(shapes > 0 ? shapes : 0) * sizeof(double), 0, 0);
    for (int m = 0; shape && m < shapes; m++)
        shape[m] = x[2];
    const double p = zoo_wall_pressure(law, x[0], x[1], shape, x[3], x[4]);
    const double c = zoo_wave_speed(law, x[0], x[1], shape, x[3], x[4], x[5]);
    calls_wall += 2;
    const int bad = !name || (shapes > 0 && (!shape || !positive(x[2]))) || !positive(x[0]) || !positive(x[1]) ||
                    !(x[3] > 0.0) || !positive(x[4]);
    EXPECT(!bad || (isnan(p) && isnan(c)), "a wall has a pressure where an argument is out of range");
    EXPECT(!(c < 0.0), "a wave speed is negative");
}

static void run_case(uint64_t seed)
{
    trial t;
    case_seed = stream = seed;
    const int64_t failed = failures;
    make(&t);
    if (one_in(2))
        spoil();
    solve_case(&t);
    small_calls();
    arrays_free();
    if (failures > failed)
        fflush(stderr);
}

static double now(void)
{
    struct timespec t;
    timespec_get(&t, TIME_UTC);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int64_t run_corpus(const char *path)
{
    FILE *file = fopen(path, "r");
    char line[512];
    int64_t n = 0;
    if (!file) {
        fprintf(stderr, "fuzz: %s: cannot be read; give a file with a seed at the start of each line\n", path);
        exit(2);
    }
    while (fgets(line, sizeof line, file)) {
        char *end;
        const uint64_t seed = strtoull(line, &end, 10);
        if (end != line) {
            run_case(seed);
            n++;
        }
    }
    fclose(file);
    return n;
}

int main(int argc, char **argv)
{
    double seconds = 0.0;
    int64_t calls = 0, cases = 0, from_corpus = 0;
    uint64_t seed = 1;
    int single = 0;
    const char *corpus = NULL;
    for (int i = 1; i < argc; i += 2) {
        const char *value = i + 1 < argc ? argv[i + 1] : "";
        if (strcmp(argv[i], "--seconds") == 0)
            seconds = atof(value);
        else if (strcmp(argv[i], "--calls") == 0)
            calls = atoll(value);
        else if (strcmp(argv[i], "--seed") == 0)
            seed = strtoull(value, NULL, 10);
        else if (strcmp(argv[i], "--corpus") == 0)
            corpus = value;
        else if (strcmp(argv[i], "--case") == 0)
            seed = strtoull(value, NULL, 10), single = 1;
        else {
            fprintf(stderr, "fuzz: %s: must be --seconds, --calls, --seed, --corpus or --case\n", argv[i]);
            return 2;
        }
    }
#ifdef FUZZ_ASAN
    __sanitizer_set_death_callback(last_words);
#else
    signal(SIGSEGV, on_signal);
    signal(SIGFPE, on_signal);
    signal(SIGABRT, on_signal);
#endif
    (void)on_signal;
    const double start = now();
    if (single)
        run_case(seed);
    else {
        if (corpus)
            cases = from_corpus = run_corpus(corpus);
        /* as many of the seeds from `seed` on as are asked for */
        for (uint64_t i = 0; (calls > 0 && calls_solve < calls) || (seconds > 0.0 && now() - start < seconds); i++, cases++) {
            stream = seed + i * 0x2545f4914f6cdd1du;
            run_case(draw());
        }
    }
    const double share = given ? (double)by_status[ZOO_OK] / (double)given : 0.0;
    printf("fuzz: seed %llu, %lld cases (%lld of the corpus) in %.0f s\n", (unsigned long long)seed, (long long)cases,
           (long long)from_corpus, now() - start);
    printf("  calls: zoo_solve %lld (%lld of them a second time), zoo_workspace_size %lld, names %lld, walls %lld\n",
           (long long)calls_solve, (long long)twice, (long long)calls_size, (long long)calls_name, (long long)calls_wall);
    printf("  refused %lld; solved %lld", (long long)refused, (long long)by_status[ZOO_OK]);
    for (int s = 1; s <= ZOO_INLET_AREA; s++)
        printf(", status %d %lld", s, (long long)by_status[s]);
    printf("\n  %.1f %% of %lld solved; %lld failures\n", 100.0 * share, (long long)given, (long long)failures);
    if (!single && cases > 100 && !(share > 1.0 / 3.0)) {
        fprintf(stderr, "fuzz: no more than a third was solved\n");
        return 1;
    }
    return failures > 0;
}
