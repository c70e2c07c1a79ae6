/* Beats until the solution repeats itself.
 *
 * One beat maps the state x (areas, flows, the outlets' pressures) at its start
 * to g(x) at its end; the periodic state is the fixed point.  It is measured by
 *
 *   change = max |g(x) - x| over all nodes and outlets, as pressures
 *            (areas through dp/dA, flows through rho c/A),
 *
 * and since a plain beat only removes the part 1 - exp(-T/tau) of the
 * distance, the run ends when change/(1 - exp(-T/tau)) is below the tolerance.
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

/* The parts of the state in their order; one that the run does not have is empty. */
enum { PARTS = 5 };
static void parts_of(const zoo_sim *s, double *part[PARTS], size_t size[PARTS])
{
    size_t n = (size_t)s->n_nodes * s->lanes, nt = (size_t)s->outlets.count * s->lanes;
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
    int W = s->lanes, n = s->n_nodes * W;
    for (int i = 0; i < n; i++) {
        double a = s->A[i] * s->inv_A0[i / W];
        double slope = wall_slope(s->wall, zoo_K(s, i), zoo_shape(s, i), s->extra ? s->pe[i] : s->P[i], a, sqrt(a));
        s->weight[i] = slope * s->inv_A0[i / W];
        s->weight[n + i] = sqrt(a * slope / s->inv_density) / s->A[i];
    }
    double *weight = s->weight + 2 * n;
    int nt = s->outlets.count * W;
    for (int i = 0; i < s->outlets.rows.pressures * nt; i++)
        *weight++ = 1.0;
    /* at rest z = -kappa p_e, and the wall's own pressure is what counts */
    for (int i = 0; i < n && s->extra; i++)
        *weight++ = 1.0 / (1.0 + s->kappa[i / W]);
    for (int i = 0; i < s->outlets.rows.flows * nt; i++)
        *weight++ = s->weight[n + s->outlets.node[i % nt / W] * W + i % W];
}

/* Largest change over the beat, as a pressure; NaN if the state is not a number. */
static double largest_change(const zoo_sim *s, int lane, const double *end)
{
    double worst = 0.0;
    for (int i = lane; i < s->n_state * s->lanes; i += s->lanes) {
        double d = fabs(end[i] - s->start[i]) * s->weight[i];
        if (isnan(d))
            return d;
        if (d > worst)
            worst = d;
    }
    return worst;
}

/* Whether all that is told of a lane is a number. */
static int told_finite(const zoo_sim *s, int lane)
{
    const zoo_report *r = &s->report[lane];
    int good = isfinite(r->distance) && isfinite(r->max_cfl) && isfinite(r->inflow) && isfinite(r->outflow) &&
               isfinite(r->junction_defect) && zoo_output_finite(s, lane);
    for (int k = 0; k < s->n_vessels; k++)
        good &= isfinite(s->fastest[k * s->lanes + lane]) != 0;
    return good;
}

/* Replaces the state of one lane by Anderson's combination of the n_past
 * beats in states/ends (0 the newest); the largest combined change, as a
 * pressure, goes to `left`.  Returns 0, leaving the state alone, if the
 * combination is not usable. */
int zoo_extrapolate(zoo_sim *s, int lane, int n_past, double *left)
{
    int W = s->lanes, m = n_past - 1;
    size_t size = (size_t)s->n_state * W;
    double a[ZOO_HISTORY][ZOO_HISTORY + 1];
    for (int r = 0; r < m; r++)
        for (int c = 0; c <= m; c++)
            a[r][c] = 0.0;
    for (size_t i = (size_t)lane; i < size; i += (size_t)W) {
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
        if (!(fabs(x[r]) < 100.0))
            return 0;
    }
    *left = 0.0;
    for (size_t i = (size_t)lane; i < size; i += (size_t)W) {
        const double now = s->ends[i] - s->states[i];
        double combined = now;
        for (int r = 0; r < m; r++)
            combined -= x[r] * (now - (s->ends[(r + 1) * size + i] - s->states[(r + 1) * size + i]));
        *left = fmax(*left, s->weight[i] * fabs(combined));
    }
    double *part[PARTS];
    size_t sizes[PARTS], n = (size_t)s->n_nodes * W;
    parts_of(s, part, sizes);
    for (int trial = 0; trial < 2; trial++) /* first look, then write */
        for (size_t i = (size_t)lane; i < size; i += (size_t)W) {
            double y = s->ends[i];
            for (int r = 0; r < m; r++)
                y -= x[r] * (s->ends[i] - s->ends[(r + 1) * size + i]);
            if (trial == 0 && i < n) {
                double ratio = y * s->inv_A0[i / W];
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

/* In every one of n elements, one lane from another. */
static void copy_lane(double *x, ptrdiff_t n, int W, int to, int from)
{
    for (ptrdiff_t j = 0; j < n; j++)
        x[j * W + to] = x[j * W + from];
}

/* Gives a lane that is of no more interest the parameters and the state of a
 * live one, so that it goes on computing something harmless. */
static void disarm(zoo_sim *s, int lane)
{
    int W = s->lanes, from = -1;
    for (int l = 0; l < W && from < 0; l++)
        if (s->live[l])
            from = l;
    if (from < 0)
        return;
    double *nodes[] = {s->K, s->A, s->q, s->P, s->M, s->G, s->Ah, s->qh, s->Ph, s->Mh, s->Gh, s->z, s->pe, s->off, s->off_half};
    for (int a = 0; a < (s->extra ? 15 : 11); a++)
        copy_lane(nodes[a], s->n_nodes, W, lane, from);
    if (s->varying)
        copy_lane(s->K_mid, s->n_nodes, W, lane, from);
    const zoo_terminals *ou = &s->outlets;
    copy_lane(s->coefficient, (ptrdiff_t)wall_shapes(s->wall) * s->n_nodes, W, lane, from);
    copy_lane(ou->R1, ou->count, W, lane, from);
    copy_lane(ou->R2, ou->count, W, lane, from);
    copy_lane(ou->C, ou->count, W, lane, from);
    copy_lane(ou->coefficient, (ptrdiff_t)ou->rows.coefficients * ou->count, W, lane, from);
    copy_lane(ou->v, (ptrdiff_t)ou->rows.pressures * ou->count, W, lane, from);
    copy_lane(ou->carry, (ptrdiff_t)ou->rows.flows * ou->count, W, lane, from);
    for (int g = 0; g < s->n_groups; g++)
        zoo_set_softness(s, &s->groups[g], lane);
    copy_lane(s->start, s->n_state, W, lane, from);
}

/* Marks a lane as failed. */
static void retire(zoo_sim *s, int lane, int status, int vessel, double time)
{
    s->report[lane].status = status;
    s->report[lane].vessel = vessel;
    s->report[lane].time = time;
    s->live[lane] = 0;
    disarm(s, lane);
}

static int any_live(const zoo_sim *s)
{
    for (int l = 0; l < s->lanes; l++)
        if (s->live[l])
            return 1;
    return 0;
}

/* Looks for the lanes whose state left the wall's range in this step. */
static void find_failures(zoo_sim *s, int step)
{
    for (int l = 0; l < s->lanes; l++) {
        int status = ZOO_OK, vessel = -1;
        for (int j = 0; j < s->n_nodes && status == ZOO_OK; j++) {
            int i = j * s->lanes + l, k = s->vessel_of[j];
            double a = s->A[i] * s->inv_A0[j];
            int boundary = j == s->first[k] || j == s->last[k];
            if (wall_holds(s->wall, zoo_shape(s, i), a))
                continue;
            vessel = k;
            status = a >= wall_limit(s->wall, zoo_shape(s, i)) ? ZOO_WALL_LIMIT
                     : isnan(a) && boundary                ? ZOO_NO_ROOT
                                                           : ZOO_COLLAPSE;
        }
        if (status == ZOO_OK && s->no_root && s->stuck[l])
            status = ZOO_NO_ROOT;
        if (status != ZOO_OK && s->live[l])
            retire(s, l, status, vessel, step * s->dt);
        else if (status != ZOO_OK)
            disarm(s, l);
        s->stuck[l] = 0;
    }
}

/* One beat from the state in the nodes, with what goes along or NULL.
 * Returns the largest speed (1/s) met in the live lanes, or a negative number
 * if the beat must be run again with more steps; then its size is the speed
 * that asked for them. */
static double beat(zoo_sim *s, double limit, const zoo_companion *with)
{
    double fastest = 0.0;
    int every = s->n_steps / ZOO_CHECKS;
    memset(s->outlets.volume, 0, (size_t)s->outlets.count * s->lanes * sizeof(double));
    memset(s->entered, 0, (size_t)s->lanes * sizeof(double));
    for (int l = 0; l < s->lanes; l++) {
        if (!s->live[l])
            continue;
        for (int k = 0; k < s->n_vessels; k++)
            s->fastest[k * s->lanes + l] = 0.0;
        s->report[l].max_cfl = zoo_speed(s, l) * s->dt;
        s->report[l].junction_defect = 0.0;
        s->report[l].steps_per_beat = s->n_steps;
    }
    memset(s->stuck, 0, (size_t)s->lanes * sizeof *s->stuck);
    memset(s->outran, 0, (size_t)s->lanes * sizeof *s->outran);
    if (s->extra)
        zoo_refresh_nodes(s); /* what the walls remember is known for one length of the step only */
    zoo_output_begin(s);
    const int along = with && with->begin(with->self);
    for (int step = 0; step < s->n_steps; step++) {
        int wrong = along ? with->step(with->self, step) : zoo_step(s, step);
        if (wrong || s->no_root || (step + 1) % every == 0) {
            /* too long a step shows first as a state out of range: look at the speed before blaming the state */
            double now = 0.0;
            int unstable = 0;
            for (int l = 0; l < s->lanes; l++) {
                if (!s->live[l])
                    continue;
                double speed = zoo_speed(s, l), defect = zoo_junction_defect(s, l);
                if (defect > s->report[l].junction_defect)
                    s->report[l].junction_defect = defect;
                /* a state that blew up says nothing about the speed that made it do so */
                if (!wrong && speed * s->dt > s->report[l].max_cfl)
                    s->report[l].max_cfl = speed * s->dt;
                s->outran[l] = speed * s->dt > limit;
                unstable |= s->outran[l];
                if (speed > now)
                    now = speed;
            }
            fastest = now > fastest ? now : fastest;
            if (unstable)
                return -fastest;
            if (wrong || s->no_root) {
                find_failures(s, step + 1);
                s->no_root = 0;
                if (!any_live(s))
                    return fastest;
            }
        }
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

static void retire_all(zoo_sim *s, int status)
{
    for (int l = 0; l < s->lanes; l++)
        if (s->live[l])
            retire(s, l, status, -1, 0.0);
}

void zoo_periodic(zoo_sim *s, zoo_companion *with, double *pressure, double *flow, double *area)
{
    const zoo_numerics *num = &s->problem->numerics;
    const int fixed = num->steps_per_beat > 0;
    const double limit = 1.0; /* the scheme's own stability limit */
    size_t size = (size_t)s->n_state * s->lanes;
    int past = 0, expected = 0;
    int64_t steps = 0;
    zoo_set_step(s, fixed ? num->steps_per_beat : ZOO_STEP_UNIT);
    zoo_start(s);
    if (!fixed)
        zoo_set_step(s, steps_for(s, zoo_start_speed(s)));
    for (int n = 1; n <= num->max_beats && any_live(s); n++) {
        zoo_pack(s, s->start);
        double fastest = beat(s, limit, expected ? with : NULL);
        if (expected)
            with->beat = fastest < 0.0 ? -1 : n;
        expected = 0;
        steps += s->n_steps;
        while (fastest < 0.0) {
            int more = steps_for(s, -1.05 * fastest);
            if (fixed || s->n_steps >= num->max_steps) {
                for (int l = 0; l < s->lanes; l++)
                    if (s->live[l] && s->outran[l])
                        retire(s, l, ZOO_CFL, -1, 0.0);
            } else {
                if (more < s->n_steps + s->n_steps / 8)
                    more = s->n_steps + s->n_steps / 8;
                zoo_set_step(s, more > num->max_steps ? num->max_steps : more);
            }
            if (!any_live(s))
                return;
            zoo_unpack(s, s->start);
            fastest = beat(s, limit, NULL);
            steps += s->n_steps;
        }
        if (!any_live(s))
            return;
        /* newest first */
        memmove(s->states + size, s->states, (ZOO_HISTORY - 1) * size * sizeof *s->states);
        memmove(s->ends + size, s->ends, (ZOO_HISTORY - 1) * size * sizeof *s->ends);
        memcpy(s->states, s->start, size * sizeof *s->start);
        zoo_pack(s, s->ends);
        past += past < ZOO_HISTORY;
        set_weights(s);
        for (int l = 0; l < s->lanes; l++) {
            zoo_report *r = &s->report[l];
            if (!s->live[l])
                continue;
            r->beats = n;
            r->steps_per_beat = s->n_steps;
            r->total_steps = steps;
            r->change = largest_change(s, l, s->ends);
            r->distance = r->change / (1.0 - s->slow[l]);
            r->inflow = inlet_volume(s, l);
            r->outflow = 0.0;
            for (int t = 0; t < s->outlets.count; t++)
                r->outflow += s->outlets.volume[t * s->lanes + l];
            const int close = r->distance <= num->tolerance;
            if (close && told_finite(s, l)) {
                s->live[l] = 0;
                zoo_output_store(s, l, pressure, flow, area);
            } else if (close || !isfinite(r->change)) {
                retire(s, l, ZOO_COLLAPSE, -1, 0.0);
            }
        }
        if (!any_live(s))
            return;
        int wanted = fixed ? s->n_steps : steps_for(s, fastest);
        if (wanted > s->n_steps || (n == 1 && wanted < s->n_steps))
            zoo_set_step(s, wanted);
        if (num->accelerate && past > 1) {
            int moved = 0;
            double left;
            for (int l = 0; l < s->lanes; l++)
                moved |= s->live[l] && zoo_extrapolate(s, l, past, &left);
            if (moved)
                zoo_refresh_nodes(s);
            expected = moved && with && with->beat == 0 && left / (1.0 - s->slow[0]) <= EXPECTED * num->tolerance;
        }
    }
    retire_all(s, ZOO_NOT_PERIODIC);
}
