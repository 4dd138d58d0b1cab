/* @count@ samples of @what@, both ways, against the numbers of the program that wrote this; 0 where they agree. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "@id@.h"

#define COUNT @count@u
#define EVERY @every@u /* calls from one number to the next */

typedef @id@_real real;

static const real voltage[COUNT] = {
@voltage@};
static const real displacement[COUNT] = {
@displacement@};
static const real target[COUNT][@UP@_TOKENS] = {
@targets@};
static const real planned[COUNT] = {
@planned@};

/* The number s calls after one of the vector, on the line to the next. */
static real between(double before, double next, unsigned s)
{
    return (real)(before + (((double)s / (double)EVERY) * (next - before)));
}

/* A cosine at half the resonance: its samples to inverse_target_step, its derivatives to inverse_step. */
static double differentiated(void)
{
    @id@_state samples;
    @id@_state derivatives;
    const double dt = (double)@UP@_DT;
    const double w = @slow@;
    const double half = 0.5 * @stroke@;
    double apart = 0.0;
    double top = 0.0;
    @id@_init(&samples, @rest@, @zero@);
    @id@_init(&derivatives, @rest@, @zero@);
    const unsigned count = (unsigned)(15.0 / (w * dt)) + (2u * @UP@_LOOK_AHEAD);
    for (unsigned k = 0u; k < count; k++) {
        const double t = w * dt * (double)(k + @UP@_LOOK_AHEAD);
        const real y = (real)(half * (1.0 - cos(t)));
        const double now = w * (((double)k * dt) + (double)@UP@_AHEAD);
        real rows[@UP@_TOKENS];
        double size = -half;
        uint32_t cut = 0u;
        uint32_t flags = 0u;
        for (unsigned i = 0u; i < @UP@_TOKENS; i++) {
            rows[i] = (real)(size * cos(now + (i * 1.5707963267948966)));
            size *= w;
        }
        rows[0] = (real)(half * (1.0 - cos(now)));
        if (k == (3u * @UP@_LOOK_AHEAD)) { /* from one state: the window's first samples are no motion, and plays remember */
            (void)memcpy(samples.plan, derivatives.plan, sizeof samples.plan);
            samples.voltage = derivatives.voltage;
        }
        const double got = (double)@id@_inverse_target_step(&samples, &y, &flags);
        const double right = (double)@id@_inverse_step(&derivatives, rows, &cut);
        if (k > (3u * @UP@_LOOK_AHEAD) && ((flags | cut) & (@UP@_VOLTAGE | @UP@_SLEW)) == 0u) {
            const double off = fabs(@target_error@);
            const double force = fabs(@target_force@);
            apart = (off > apart) ? off : apart;
            top = (force > top) ? force : top;
        }
    }
    return (top > 0.0) ? (apart / top) : 0.0;
}

int main(void)
{
    @id@_state state;
    double worst = 0.0;
    double wrong = 0.0;
    @id@_init(&state, @rest@, @zero@);
    for (unsigned k = 0u; k < COUNT; k++) {
        const double before = (double)voltage[(k > 0u) ? (k - 1u) : 0u];
        for (unsigned s = 1u; s < EVERY; s++) {
            (void)@id@_predict_step(&state, between(before, (double)voltage[k], s));
        }
        const double apart = fabs((double)(@id@_predict_step(&state, voltage[k]) - displacement[k]));
        worst = (apart > worst) ? apart : worst;
    }
    @id@_init(&state, @rest@, @zero@);
    for (unsigned k = 0u; k < COUNT; k++) {
        uint32_t flags = 0u;
        const real *before = target[(k > 0u) ? (k - 1u) : 0u];
        for (unsigned s = 1u; s < EVERY; s++) {
            real rows[@UP@_TOKENS];
            for (unsigned i = 0u; i < @UP@_TOKENS; i++) {
                rows[i] = between((double)before[i], (double)target[k][i], s);
            }
            (void)@id@_inverse_step(&state, rows, &flags);
        }
        const double u = (double)@id@_inverse_step(&state, target[k], &flags);
        const double apart = fabs(@force_error@);
        wrong = (apart > wrong) ? apart : wrong;
    }
    worst /= @range@;
    wrong /= @force_range@;
    const double apart = differentiated();
    (void)printf("predict_step: %.2g of the stroke, inverse_step: %.2g, inverse_target_step: %.2g of the force\n", worst,
                 wrong, apart);
    return ((worst < @tolerance@) && (wrong < @force_tolerance@) && (apart < @target_tolerance@)) ? 0 : 1;
}
