/* @title@ */
#include "@id@.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#if defined(__FAST_MATH__) || defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ > 0))
#error "compile without -ffast-math: it takes away the checks for what is not a number"
#endif

typedef @id@_real real;

#define ZERO ((real)0)
#define ONE ((real)1)
#define TOKENS @tokens@u
#define MODEL @model_states@u
#define PLAN @plan_states@u
#define BLOCKS @blocks@u
#define BLOCK @block@u
#define WINDOW (BLOCKS * BLOCK)
#define SIGN @sign@   /* of the displacement that a force makes */
#define SENSOR @sensor@ /* -1: the sensor reads less as the displacement grows */
#define MOST_STEP (@UP@_MAX_SLEW * @UP@_DT)

@helpers@
@beside@
@functions@
/* 0 times anything that is not finite is not a number. */
static bool all_finite(const real values[], unsigned count)
{
    real sum = ZERO;
    for (unsigned k = 0u; k < count; k++) {
        sum += values[k] * ZERO;
    }
    return isfinite(sum) != 0;
}

/* A new state, taken over where all of it is finite. */
static bool accepted(real to[], const real from[], unsigned count, const real output[])
{
    const bool sound = all_finite(from, count) && all_finite(output, 1u);
    if (sound) {
        (void)memcpy(to, from, count * sizeof(real));
    }
    return sound;
}

/* Within the slew and the range, from the voltage before. */
static real limited(real last, real wanted, uint32_t *flags)
{
    real u = wanted;
    if (u > @UP@_MAX_VOLTAGE) {
        u = @UP@_MAX_VOLTAGE;
    } else if (u < @UP@_MIN_VOLTAGE) {
        u = @UP@_MIN_VOLTAGE;
    } else {
        /* within the range */
    }
    if ((u < wanted) || (u > wanted)) {
        *flags |= @UP@_VOLTAGE;
    }
    if (u > (last + MOST_STEP)) {
        u = last + MOST_STEP;
        *flags |= @UP@_SLEW;
    } else if (u < (last - MOST_STEP)) {
        u = last - MOST_STEP;
        *flags |= @UP@_SLEW;
    } else {
        /* within the slew */
    }
    return u;
}

/* Whether a target is still waited for: WATCHDOG calls. */
static bool waits(@id@_state *state, uint32_t *flags)
{
    *flags |= @UP@_NO_TARGET;
    const bool still = state->silent < @UP@_WATCHDOG;
    if (still) {
        state->silent++;
    }
    return still;
}

/* The displacement that the model expects of the feedforward alone, within its limits, at the time of this reading. */
static real expectation(@id@_state *state, real feedforward, uint32_t *flags)
{
    real next[MODEL];
    real out[1] = {ZERO};
    state->feed = limited(state->feed, feedforward, flags);
    predict_core(state->expected, &state->feed, next, out);
    (void)accepted(state->expected, next, MODEL, out);
    return out[0];
}

/* The last voltage for WATCHDOG calls, then a ramp to 0 @in@. */
static real silence(@id@_state *state, uint32_t *flags)
{
    uint32_t cut = 0u;
    if (!waits(state, flags)) {
        state->closed = 0u;
        state->voltage = limited(state->voltage, ZERO, &cut);
        state->feed = state->voltage;
    }
    if (state->stale == 0u) {
        (void)expectation(state, state->feed, &cut);
    }
    return state->voltage;
}

/* Eq. 13 before any limit; false where the target or the voltage is not finite. A target out of range is moved to its
 * end. */
static bool planned(@id@_state *state, real wanted[], real *voltage, uint32_t *flags)
{
    real next[PLAN];
    real out[2];
    bool sound = all_finite(wanted, TOKENS);
    if (sound) {
        const bool above = wanted[0] > @UP@_MAX_DISPLACEMENT;
        if (above || (wanted[0] < @UP@_MIN_DISPLACEMENT)) {
            (void)memset(wanted, 0, TOKENS * sizeof(real));
            wanted[0] = above ? @UP@_MAX_DISPLACEMENT : @UP@_MIN_DISPLACEMENT;
            *flags |= @UP@_DISPLACEMENT;
        }
        inverse_core(state->plan, wanted, next, out);
        sound = accepted(state->plan, next, PLAN, out);
    }
    if (sound) {
        *voltage = out[0];
        if (out[1] > ZERO) {
            *flags |= @UP@_INFEASIBLE;
        }
    } else {
        *flags |= @UP@_NOT_A_NUMBER;
    }
    return sound;
}

static real larger_of(real a, real b)
{
    return (a > b) ? a : b;
}

static real smaller_of(real a, real b)
{
    return (a < b) ? a : b;
}

/* The force of a voltage, and the voltage within the range that makes a force. */
static real force_of(real u)
{
    return @force_of@;
}

static real voltage_of(real force)
{
    const real kept = smaller_of(larger_of(force, force_of(@UP@_MIN_VOLTAGE)), force_of(@UP@_MAX_VOLTAGE));
    return @voltage_of@;
}

/* The window of an actuator that stands there. */
static void fill(@id@_state *state, real y)
{
    for (unsigned k = 0u; k < WINDOW; k++) {
        state->window[k] = y;
    }
    state->head = 0u;
}

/* One sample into the window: the mean of the last BLOCK samples, so that float can be differentiated at high rates. */
static void push(@id@_state *state, real y)
{
    real sum = y;
    state->recent[state->head % BLOCK] = y;
    for (unsigned k = 1u; k < BLOCK; k++) {
        sum += state->recent[(state->head + k) % BLOCK];
    }
    state->window[state->head] = sum / (real)BLOCK;
    state->head = (state->head + 1u) % WINDOW;
}

/* Row i: derivative i of the target DT LOOK_AHEAD before the newest sample; the last row: one sample after it. */
static real windowed(const @id@_state *state, unsigned i)
{
    static const real weights[TOKENS + 1u][BLOCKS] = {
@weights@};
    const real middle = state->window[(state->head + (((BLOCKS / 2u) + 1u) * BLOCK) - 1u) % WINDOW];
    real sum = ((i == 0u) || (i == TOKENS)) ? middle : ZERO;
    for (unsigned k = 0u; k < BLOCKS; k++) { /* weights of a derivative sum to 0, the others to 1 */
        sum += weights[i][k] * (state->window[(state->head + ((k + 1u) * BLOCK) - 1u) % WINDOW] - middle);
    }
    return sum;
}

/* The displacement of a reading. */
static real displaced(const @id@_state *state, real measured)
{
    return SENSOR * (measured - state->zero);
}

void @id@_init(@id@_state *state, real reading, real u0)
{
    const bool still = !((u0 < ZERO) || (u0 > ZERO));
    const real zero = still ? reading : @UP@_REST;
    const real y0 = still ? ZERO : (SENSOR * (reading - zero));
    const real held[2] = {y0, u0};
    (void)memset(state, 0, sizeof *state);
    predict_start(held, held, state->model, NULL);
    inverse_start(held, held, state->plan, NULL);
    fill(state, y0);
    state->zero = zero;
    state->asked = y0;
    state->reference[0] = y0;
    state->displacement = y0;
    state->voltage = u0;
    predict_start(held, held, state->expected, NULL);
    state->feed = u0;
    if (still) { /* at rest there is no voltage to take over */
        state->closed = 1u;
        state->blind = 1u;
    }
    state->p = @UP@_P;
    state->i = @UP@_I;
    state->track = @UP@_TRACK;
}

real @id@_predict_step(@id@_state *state, real u)
{
    real next[MODEL];
    real out[1];
    if (all_finite(&u, 1u)) {
        predict_core(state->model, &u, next, out);
        if (accepted(state->model, next, MODEL, out)) {
            state->displacement = out[0];
        }
    }
    return state->displacement;
}

/* The voltage for a target with its derivatives, or silence. */
static real open_loop(@id@_state *state, real wanted[], bool came, uint32_t *flags)
{
    real voltage = ZERO;
    state->closed = 0u;
    state->stale = 1u;
    if (!planned(state, wanted, &voltage, flags)) {
        return silence(state, flags);
    }
    if (came) {
        state->silent = 0u;
    }
    state->voltage = limited(state->voltage, voltage, flags);
    return state->voltage;
}

real @id@_inverse_step(@id@_state *state, const real target[@tokens@], uint32_t *flags)
{
    real wanted[TOKENS];
    *flags = 0u;
    if (target == NULL) {
        return silence(state, flags);
    }
    (void)memcpy(wanted, target, sizeof wanted);
    return open_loop(state, wanted, true, flags);
}

real @id@_inverse_target_step(@id@_state *state, const real *target, uint32_t *flags)
{
    real rows[TOKENS];
    const bool came = (target != NULL) && all_finite(target, 1u);
    *flags = 0u;
    if (came) {
        if (state->silent >= @UP@_WATCHDOG) {
            fill(state, *target);
        }
        push(state, *target);
    } else {
        if (target != NULL) {
            *flags = @UP@_NOT_A_NUMBER;
        }
        if (!waits(state, flags)) {
            return silence(state, flags);
        }
        push(state, windowed(state, TOKENS)); /* the polynomial through the window, one sample on */
    }
    for (unsigned i = 0u; i < TOKENS; i++) {
        rows[i] = windowed(state, i);
    }
    return open_loop(state, rows, came, flags);
}

/* PI on the force: u = map^-1(F + P e + I (integral of e)), F that of the feedforward.
 *
 * e = what the model expects of the feedforward less the displacement, so that delay, hold, limits and memories of the
 * actuator that the model knows are no error. The sensor's noise is averaged, and what it leaves of it is no error either.
 *
 * Back-calculation: what range and slew cut off the force leaves the integral with the closed loop's time constant.
 * Without a reading the correction stands for WATCHDOG calls, then fades; a reading that comes again, or a start, takes
 * the voltage over as it is.
 */
static real trimmed(@id@_state *state, real feedforward, real target, real displacement, bool seen, uint32_t *flags)
{
    if (state->stale > 0u) {
        const real held[2] = {displacement, state->voltage};
        state->stale = 0u;
        predict_start(held, held, state->expected, NULL);
        state->feed = state->voltage;
        state->smooth = ZERO;
    }
    const real now = expectation(state, feedforward, flags);
    const real expected = (@UP@_LATE > 0u) ? target : now; /* a late prediction is not of this reading */
    const real base = force_of(state->feed);
    if (seen) {
        state->smooth += @UP@_SMOOTH * ((expected - displacement) - state->smooth);
    }
    const real error = state->smooth - smaller_of(larger_of(state->smooth, -@UP@_DEAD), @UP@_DEAD);
    const real p = SIGN * state->p * error;
    if (state->closed == 0u) {
        state->trim = seen ? (force_of(state->voltage) - base) : ZERO;
        state->closed = 1u;
        state->blind = 1u;
    }
    if (seen) {
        if (state->blind > 0u) {
            state->integral = state->trim - p;
            state->blind = 0u;
        }
        state->integral += SIGN * state->i * error * @UP@_DT;
        state->trim = p + state->integral;
    } else {
        *flags |= @UP@_NO_SENSOR;
        if (state->blind < @UP@_WATCHDOG) {
            state->blind++;
        } else {
            state->trim -= smaller_of(state->track * @UP@_DT, ONE) * state->trim;
        }
    }
    const real wanted = base + state->trim;
    const real u = limited(state->voltage, voltage_of(wanted), flags);
    state->voltage = u;
    if ((wanted < force_of(@UP@_MIN_VOLTAGE)) || (wanted > force_of(@UP@_MAX_VOLTAGE))) {
        *flags |= @UP@_VOLTAGE;
    }
    if (seen) {
        state->integral += smaller_of(state->track * @UP@_DT, ONE) * (force_of(u) - wanted);
    }
    return u;
}

/* Whether there is a controller: with P = I = 0 the PI steps are the feedforward alone. */
static bool controls(const @id@_state *state)
{
    return (state->p < ZERO) || (state->p > ZERO) || (state->i < ZERO) || (state->i > ZERO);
}

real @id@_pi_step(@id@_state *state, const real target[@tokens@], real measured, uint32_t *flags)
{
    real wanted[TOKENS];
    real voltage = ZERO;
    *flags = 0u;
    if (target == NULL) {
        return silence(state, flags);
    }
    (void)memcpy(wanted, target, sizeof wanted);
    if (!planned(state, wanted, &voltage, flags)) {
        return silence(state, flags);
    }
    state->silent = 0u;
    if (!controls(state)) {
        state->trim = ZERO;
        state->closed = 1u;
        state->blind = 1u;
        state->stale = 1u;
        state->voltage = limited(state->voltage, voltage, flags);
        return state->voltage;
    }
    const bool seen = all_finite(&measured, 1u);
    if (!seen) {
        *flags |= @UP@_NOT_A_NUMBER;
    }
    return trimmed(state, voltage, wanted[0], seen ? displaced(state, measured) : wanted[0], seen, flags);
}

real @id@_pi_target_step(@id@_state *state, const real *target, real measured, uint32_t *flags)
{
    /* the reference is target / (1 + s T)^@reference_order@: its motion and derivatives over T^-i, exact for a target that is held */
    static const real onward[TOKENS][TOKENS] = {
@onward@};
    static const real units[TOKENS] = {@units@};
    real from[TOKENS];
    real rows[TOKENS];
    uint32_t told = 0u;
    if ((target != NULL) && all_finite(target, 1u)) {
        state->asked = *target;
        state->silent = 0u;
    } else {
        if (target != NULL) {
            told = @UP@_NOT_A_NUMBER;
        }
        if (!waits(state, &told)) {
            *flags = told;
            return silence(state, flags);
        }
    }
    if (state->closed == 0u) { /* a start: the reference begins where the actuator stands */
        (void)memset(state->reference, 0, sizeof state->reference);
        state->reference[0] = all_finite(&measured, 1u) ? displaced(state, measured) : state->asked;
    }
    (void)memcpy(from, state->reference, sizeof from);
    from[0] = state->asked - state->reference[0];
    for (unsigned i = 0u; i < TOKENS; i++) {
        for (unsigned k = 0u; k < TOKENS; k++) {
            state->reference[i] += onward[i][k] * from[k];
        }
        rows[i] = state->reference[i] * units[i];
    }
    const uint32_t before = state->silent;
    const real u = @id@_pi_step(state, rows, measured, flags);
    state->silent = before;
    *flags |= told;
    return u;
}
