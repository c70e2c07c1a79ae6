/* Beats until the solution repeats itself.
 *
 * One beat maps the state x (areas, flows, the outlets' pressures) at its start
 * to g(x) at its end; the periodic state is the fixed point.  It is measured by
 *
 *   change = max |g(x) - x| over all nodes and outlets, as pressures
 *            (areas through dp/dA, flows through rho c/A),
 *
 * and since a plain beat only removes the part 1 - exp(-T/tau) of the
 * distance, the run ends when change/(1 - exp(-T/tau)) is below the tolerance,
 * or below what rounding leaves of it.
 * Between beats the start is extrapolated from the last few by Anderson's
 * method (Walker & Ni 2011, doi 10.1137/10078356X): past ends, combined with
 * the weights for which the combined change is least.  A beat from there would
 * leave at most about that change, so that the last beat can be told beforehand.
 */
#include <math.h>
#include <string.h>

#include "inlet.h"
#include "outlet.h"

/* A beat is expected to be the last when the combined change is at most so many times the tolerance.  What the beat then
 * leaves was 0.7 of it at most, and mostly a tenth; with more, derivatives are of a run too far from periodic to search by. */
static const double EXPECTED = 1.0;

/* Largest weight of a past end, and in beats of the slowest decay, which by its last beat alone needs one. */
static const double LARGEST = 100.0, LARGEST_BEATS = 10.0;

/* What rounding may leave of a change, as a part of the state's own size. */
static const double ROUNDING = 1e-13;

/* The parts of the state in their order; one that the run does not have is empty. */
enum { PARTS = 5 };
static void parts_of(const zoo_sim *s, double *part[PARTS], size_t size[PARTS])
{
    size_t n = (size_t)s->n_nodes, nt = (size_t)s->outlets.count;
    double *parts[PARTS] = {s->A, s->q, s->outlets.v, s->z, s->outlets.carry};
    size_t sizes[PARTS] = {n, n, nt * s->outlets.rows.pressures, s->extra ? n : 0, nt * s->outlets.rows.flows};
    memcpy(part, parts, sizeof parts);
    memcpy(size, sizes, sizeof sizes);
}

void zoo_pack(const zoo_sim *s, double *x)
{
    double *part[PARTS];
    size_t size[PARTS];
    parts_of(s, part, size);
    for (int i = 0; i < PARTS; x += size[i++])
        memcpy(x, part[i], size[i] * sizeof *x);
}

void zoo_unpack(zoo_sim *s, const double *x)
{
    double *part[PARTS];
    size_t size[PARTS];
    parts_of(s, part, size);
    for (int i = 0; i < PARTS; x += size[i++])
        memcpy(part[i], x, size[i] * sizeof *x);
    zoo_refresh_nodes(s);
}

/* Factors that turn differences of the state into pressures. */
static void set_weights(zoo_sim *s)
{
    int n = s->n_nodes;
    for (int i = 0; i < n; i++) {
        double a = s->A[i] * s->inv_A0[i];
        double slope = wall_slope(s->wall, zoo_K(s, i), zoo_shape(s, i), s->extra ? s->pe[i] : s->P[i], a, sqrt(a));
        s->weight[i] = slope * s->inv_A0[i];
        s->weight[n + i] = sqrt(a * slope / s->inv_density) / s->A[i];
    }
    double *weight = s->weight + 2 * n;
    int nt = s->outlets.count;
    for (int i = 0; i < s->outlets.rows.pressures * nt; i++)
        *weight++ = 1.0;
    /* at rest z = -kappa p_e, and the wall's own pressure is what counts */
    for (int i = 0; i < n && s->extra; i++)
        *weight++ = 1.0 / (1.0 + s->kappa[i]);
    for (int i = 0; i < s->outlets.rows.flows * nt; i++)
        *weight++ = s->weight[n + s->outlets.node[i % nt]];
}

/* Largest change over the beat, as a pressure; NaN if the state is not a number. */
static double largest_change(const zoo_sim *s, const double *end)
{
    double worst = 0.0;
    for (int i = 0; i < s->n_state; i++) {
        double d = fabs(end[i] - s->start[i]) * s->weight[i];
        if (isnan(d))
            return d;
        if (d > worst)
            worst = d;
    }
    return worst;
}

/* The accepted distance after a beat in which the root's pressure ranged from low to high. */
static double tolerance_after(const zoo_sim *s, double low, double high)
{
    const zoo_numerics *num = &s->problem->numerics;
    double size = 0.0;
    for (int i = 0; i < s->n_nodes; i++)
        size = fmax(size, s->weight[i] * s->A[i] + s->weight[s->n_nodes + i] * fabs(s->q[i]));
    return fmax(num->relative > 0.0 ? num->relative * (high - low) : num->tolerance, ROUNDING * size);
}

/* The vessel whose waves cross most of a cell in a step, by the speeds met in the beat. */
static int fastest_vessel(const zoo_sim *s)
{
    int worst = 0;
    for (int k = 1; k < s->n_vessels; k++)
        if (s->fastest[k] / s->dx[k] > s->fastest[worst] / s->dx[worst])
            worst = k;
    return worst;
}

/* Whether all that is told is a number. */
static int told_finite(const zoo_sim *s)
{
    const zoo_report *r = &s->report;
    int good = isfinite(r->distance) && isfinite(r->max_cfl) && isfinite(r->inflow) && isfinite(r->outflow) &&
               isfinite(r->junction_defect) && zoo_output_finite(s);
    for (int k = 0; k < s->n_vessels; k++)
        good &= isfinite(s->fastest[k]) != 0;
    return good;
}

/* Replaces the state by Anderson's combination of the n_past beats in states/ends (0 the newest); the largest combined change, as a
 * pressure, goes to `left`.  Returns 0, leaving the state alone, if the
 * combination is not usable. */
int zoo_extrapolate(zoo_sim *s, int n_past, double *left)
{
    int m = n_past - 1;
    size_t size = (size_t)s->n_state;
    double a[ZOO_HISTORY][ZOO_HISTORY + 1];
    for (int r = 0; r < m; r++)
        for (int c = 0; c <= m; c++)
            a[r][c] = 0.0;
    for (size_t i = 0; i < size; i++) {
        double now = s->ends[i] - s->states[i], d[ZOO_HISTORY];
        for (int r = 0; r < m; r++)
            d[r] = s->weight[i] * (now - (s->ends[(r + 1) * size + i] - s->states[(r + 1) * size + i]));
        for (int r = 0; r < m; r++) {
            for (int c = 0; c < m; c++)
                a[r][c] += d[r] * d[c];
            a[r][m] += d[r] * s->weight[i] * now;
        }
    }
    for (int r = 0; r < m; r++)
        a[r][r] *= 1.0 + 1e-12;
    for (int r = 0; r < m; r++) { /* symmetric and positive: no pivoting */
        if (!(a[r][r] > 0.0))
            return 0;
        for (int k = r + 1; k < m; k++) {
            double f = a[k][r] / a[r][r];
            for (int c = r; c <= m; c++)
                a[k][c] -= f * a[r][c];
        }
    }
    double x[ZOO_HISTORY];
    for (int r = m - 1; r >= 0; r--) {
        x[r] = a[r][m];
        for (int c = r + 1; c < m; c++)
            x[r] -= a[r][c] * x[c];
        x[r] /= a[r][r];
        if (!(fabs(x[r]) < fmax(LARGEST, LARGEST_BEATS / (1.0 - s->slow))))
            return 0;
    }
    *left = 0.0;
    for (size_t i = 0; i < size; i++) {
        const double now = s->ends[i] - s->states[i];
        double combined = now;
        for (int r = 0; r < m; r++)
            combined -= x[r] * (now - (s->ends[(r + 1) * size + i] - s->states[(r + 1) * size + i]));
        *left = fmax(*left, s->weight[i] * fabs(combined));
    }
    double *part[PARTS];
    size_t sizes[PARTS], n = (size_t)s->n_nodes;
    parts_of(s, part, sizes);
    for (int trial = 0; trial < 2; trial++) /* first look, then write */
        for (size_t i = 0; i < size; i++) {
            double y = s->ends[i];
            for (int r = 0; r < m; r++)
                y -= x[r] * (s->ends[i] - s->ends[(r + 1) * size + i]);
            if (trial == 0 && i < n) {
                double ratio = y * s->inv_A0[i];
                if (!(ratio > 0.05) || !wall_holds(s->wall, zoo_shape(s, i), ratio))
                    return 0;
            }
            if (trial == 1) {
                size_t at = i;
                int p = 0;
                while (at >= sizes[p])
                    at -= sizes[p++];
                part[p][at] = y;
            }
        }
    return 1;
}

/* Ends a run that failed. */
static void fail(zoo_sim *s, int status, int vessel, double time)
{
    s->report.status = status;
    s->report.vessel = vessel;
    s->report.time = time;
}

/* Looks for what went wrong when the state left the wall's range, or a root search did not end, in this step. */
static void find_failure(zoo_sim *s, int step)
{
    for (int j = 0; j < s->n_nodes; j++) {
        int k = s->vessel_of[j], boundary = j == s->first[k] || j == s->last[k];
        double a = s->A[j] * s->inv_A0[j];
        if (wall_holds(s->wall, zoo_shape(s, j), a))
            continue;
        fail(s,
             j == 0 && s->problem->inlet.kind == ZOO_INLET_PRESSURE ? ZOO_INLET_AREA
             : a >= wall_limit(s->wall, zoo_shape(s, j)) ? ZOO_WALL_LIMIT
             : isnan(a) && boundary                ? ZOO_NO_ROOT
                                                   : ZOO_COLLAPSE,
             k, step * s->dt);
        return;
    }
    if (s->no_root && s->stuck)
        fail(s, ZOO_NO_ROOT, -1, step * s->dt);
    s->no_root = s->stuck = 0;
}

/* One beat from the state in the nodes, with what goes along or NULL.
 * Returns the largest speed (1/s) met, or a negative number if the beat must
 * be run again with more steps; then its size is the speed that asked for them. */
static double beat(zoo_sim *s, double limit, const zoo_companion *with, double range[2])
{
    zoo_report *r = &s->report;
    double fastest = 0.0;
    int every = s->n_steps / ZOO_CHECKS;
    s->entered = 0.0;
    memset(s->outlets.volume, 0, (size_t)s->outlets.count * sizeof(double));
    memset(s->fastest, 0, (size_t)s->n_vessels * sizeof(double));
    const int finest = s->problem->numerics.steps_per_beat == 0 && s->n_steps >= s->problem->numerics.max_steps;
    range[0] = INFINITY;
    range[1] = -INFINITY;
    r->max_cfl = zoo_speed(s) * s->dt;
    r->vessel = fastest_vessel(s);
    r->junction_defect = 0.0;
    r->steps_per_beat = s->n_steps;
    s->stuck = 0;
    if (s->extra)
        zoo_refresh_nodes(s); /* what the walls remember is known for one length of the step only */
    zoo_output_begin(s);
    const int along = with && with->begin(with->self);
    for (int step = 0; step < s->n_steps; step++) {
        int wrong = along ? with->step(with->self, step) : zoo_step(s, step);
        if (wrong || s->no_root || (step + 1) % every == 0) {
            /* too long a step shows first as a state out of range: look at the speed before blaming the state */
            double speed = zoo_speed(s), defect = zoo_junction_defect(s);
            if (defect > r->junction_defect)
                r->junction_defect = defect;
            /* a state that blew up says nothing about the speed that made it do so */
            if (!wrong && speed * s->dt > r->max_cfl) {
                r->max_cfl = speed * s->dt;
                r->vessel = fastest_vessel(s);
            }
            fastest = speed > fastest ? speed : fastest;
            if (speed * s->dt > limit) {
                /* no step is short enough for blood that outruns its waves: then the state is to blame */
                if (finest && wrong && r->max_cfl <= limit)
                    find_failure(s, step + 1);
                return -fastest;
            }
            if (wrong || s->no_root) {
                find_failure(s, step + 1);
                if (r->status != ZOO_OK)
                    return fastest;
            }
        }
        range[0] = fmin(range[0], s->P[0]);
        range[1] = fmax(range[1], s->P[0]);
        zoo_output_step(s, step + 1);
    }
    return fastest;
}

static int steps_for(const zoo_sim *s, double speed)
{
    const zoo_numerics *num = &s->problem->numerics;
    double n = ceil(s->problem->inlet.period * speed / num->cfl / ZOO_STEP_UNIT) * ZOO_STEP_UNIT;
    n = fmax(n, fmax(num->least_steps, ZOO_STEP_UNIT));
    return n > num->max_steps ? num->max_steps : (int)n;
}

void zoo_periodic(zoo_sim *s, zoo_companion *with, double *pressure, double *flow, double *area)
{
    const zoo_numerics *num = &s->problem->numerics;
    const int fixed = num->steps_per_beat > 0;
    const double limit = 1.0; /* the scheme's own stability limit */
    const size_t size = (size_t)s->n_state;
    zoo_report *r = &s->report;
    int past = 0, expected = 0;
    int64_t steps = 0;
    zoo_set_step(s, fixed ? num->steps_per_beat : ZOO_STEP_UNIT);
    zoo_start(s);
    if (!fixed)
        zoo_set_step(s, steps_for(s, zoo_start_speed(s)));
    for (int n = 1; n <= num->max_beats; n++) {
        zoo_pack(s, s->start);
        double range[2], fastest = beat(s, limit, expected ? with : NULL, range);
        if (expected)
            with->beat = fastest < 0.0 ? -1 : n;
        expected = 0;
        steps += s->n_steps;
        while (fastest < 0.0) {
            int more = steps_for(s, -1.05 * fastest);
            if (fixed || s->n_steps >= num->max_steps) {
                if (r->status == ZOO_OK)
                    fail(s, ZOO_CFL, r->vessel, 0.0);
                return;
            }
            if (more < s->n_steps + s->n_steps / 8)
                more = s->n_steps + s->n_steps / 8;
            zoo_set_step(s, more > num->max_steps ? num->max_steps : more);
            zoo_unpack(s, s->start);
            fastest = beat(s, limit, NULL, range);
            steps += s->n_steps;
        }
        if (r->status != ZOO_OK)
            return;
        /* newest first */
        memmove(s->states + size, s->states, (ZOO_HISTORY - 1) * size * sizeof *s->states);
        memmove(s->ends + size, s->ends, (ZOO_HISTORY - 1) * size * sizeof *s->ends);
        memcpy(s->states, s->start, size * sizeof *s->start);
        zoo_pack(s, s->ends);
        past += past < ZOO_HISTORY;
        set_weights(s);
        r->beats = n;
        r->steps_per_beat = s->n_steps;
        r->total_steps = steps;
        r->change = largest_change(s, s->ends);
        r->distance = r->change / (1.0 - s->slow);
        r->inflow = inlet_volume(s);
        r->outflow = 0.0;
        for (int t = 0; t < s->outlets.count; t++)
            r->outflow += s->outlets.volume[t];
        r->tolerance = tolerance_after(s, range[0], range[1]);
        const int close = r->distance <= r->tolerance;
        if (close && told_finite(s)) {
            r->vessel = -1;
            zoo_output_store(s, pressure, flow, area);
            return;
        }
        if (close || !isfinite(r->change)) {
            fail(s, ZOO_COLLAPSE, -1, 0.0);
            return;
        }
        int wanted = fixed ? s->n_steps : steps_for(s, fastest);
        if (wanted > s->n_steps || (n == 1 && wanted < s->n_steps))
            zoo_set_step(s, wanted);
        double left;
        if (num->accelerate && past > 1 && zoo_extrapolate(s, past, &left)) {
            zoo_refresh_nodes(s);
            expected = with && with->beat == 0 && left / (1.0 - s->slow) <= EXPECTED * r->tolerance;
        }
    }
    fail(s, ZOO_NOT_PERIODIC, -1, 0.0);
}
