/* @title@ */
#include "@id@.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

typedef @id@_real real;

#define ZERO ((real)0)
#define ONE ((real)1)
#define TOKENS @tokens@u
#define MODEL @model_states@u
#define PLAN @plan_states@u
#define WINDOW @window@u
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
static real limited(@id@_state *state, real wanted, uint32_t *flags)
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
    if (u > (state->voltage + MOST_STEP)) {
        u = state->voltage + MOST_STEP;
        *flags |= @UP@_SLEW;
    } else if (u < (state->voltage - MOST_STEP)) {
        u = state->voltage - MOST_STEP;
        *flags |= @UP@_SLEW;
    } else {
        /* within the slew */
    }
    state->voltage = u;
    return u;
}

/* The last voltage for WATCHDOG calls, then a ramp to 0 V. */
static real silence(@id@_state *state, uint32_t *flags)
{
    *flags |= @UP@_NO_TARGET;
    if (state->silent < @UP@_WATCHDOG) {
        state->silent++;
        return state->voltage;
    }
    state->integral = ZERO;
    uint32_t cut = 0u;
    return limited(state, ZERO, &cut);
}

/* Eq. 13 before any limit; false where the target or the voltage is not finite. */
static bool planned(@id@_state *state, const real target[], real *voltage, uint32_t *flags)
{
    real wanted[TOKENS];
    real next[PLAN];
    real out[2];
    (void)memcpy(wanted, target, sizeof wanted);
    bool sound = all_finite(wanted, TOKENS);
    if (sound) {
        const bool above = wanted[0] > @UP@_MAX_DISPLACEMENT;
        if (above || (wanted[0] < @UP@_MIN_DISPLACEMENT)) {
            (void)memset(wanted, 0, sizeof wanted);
            wanted[0] = above ? @UP@_MAX_DISPLACEMENT : @UP@_MIN_DISPLACEMENT;
            *flags |= @UP@_DISPLACEMENT;
        }
        inverse_core(state->plan, wanted, next, out);
        sound = accepted(state->plan, next, PLAN, out);
    }
    if (sound) {
        state->silent = 0u;
        *voltage = out[0];
        if (out[1] > ZERO) {
            *flags |= @UP@_INFEASIBLE;
        }
    } else {
        *flags |= @UP@_NOT_A_NUMBER;
    }
    return sound;
}

void @id@_init(@id@_state *state, real y0, real u0)
{
    const real held[2] = {y0, u0};
    (void)memset(state, 0, sizeof *state);
    predict_start(held, held, state->model, NULL);
    inverse_start(held, held, state->plan, NULL);
    for (unsigned k = 0u; k < WINDOW; k++) {
        state->window[k] = y0;
    }
    state->displacement = y0;
    state->voltage = u0;
    state->p = @p@;
    state->i = @i@;
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

real @id@_inverse_step(@id@_state *state, const real target[@tokens@], uint32_t *flags)
{
    real voltage = ZERO;
    *flags = 0u;
    const bool came = (target != NULL) && planned(state, target, &voltage, flags);
    return came ? limited(state, voltage, flags) : silence(state, flags);
}

real @id@_inverse_target_step(@id@_state *state, const real *target, uint32_t *flags)
{
    static const real weights[TOKENS][WINDOW] = {
@weights@};
    real rows[TOKENS];
    if ((target == NULL) || !all_finite(target, 1u)) {
        *flags = 0u;
        if (target != NULL) {
            *flags = @UP@_NOT_A_NUMBER;
        }
        return silence(state, flags);
    }
    (void)memmove(&state->window[0], &state->window[1], (WINDOW - 1u) * sizeof(real));
    state->window[WINDOW - 1u] = *target;
    for (unsigned i = 0u; i < TOKENS; i++) {
        rows[i] = ZERO;
        for (unsigned k = 0u; k < WINDOW; k++) {
            rows[i] += weights[i][k] * state->window[k];
        }
    }
    return @id@_inverse_step(state, rows, flags);
}

real @id@_pi_step(@id@_state *state, const real target[@tokens@], real measured, uint32_t *flags)
{
    real voltage = ZERO;
    *flags = 0u;
    if ((target == NULL) || !planned(state, target, &voltage, flags)) {
        return silence(state, flags);
    }
    if (!all_finite(&measured, 1u)) {
        *flags |= @UP@_NOT_A_NUMBER;
        return limited(state, voltage, flags);
    }
    const real error = target[0] - measured;
    const real total = state->integral + (error * @UP@_DT);
    const real wanted = voltage + (state->p * error) + (state->i * total);
    if ((wanted <= @UP@_MAX_VOLTAGE) && (wanted >= @UP@_MIN_VOLTAGE)) {
        state->integral = total;
    }
    return limited(state, wanted, flags);
}
