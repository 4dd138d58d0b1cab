/* @title@
 *
 * One actuator: its displacement for a voltage, and the voltage for a displacement, every @dt@ s.
 * Displacement in m as the sensor reads it, voltage in V, derivatives in m/s^i. See README.md.
 */
#ifndef @UP@_H
#define @UP@_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef @real@ @id@_real;

#define @UP@_DT @dt_number@          /* s between two calls */
#define @UP@_ORDER @order@u
#define @UP@_TOKENS @tokens@u                /* y, y', ..., y^(@order@) */
#define @UP@_MAX_VOLTAGE @high@    /* V */
#define @UP@_MIN_VOLTAGE @low@
#define @UP@_MAX_SLEW @slew@       /* V/s */
#define @UP@_MAX_DISPLACEMENT @top@ /* m, as the sensor reads it */
#define @UP@_MIN_DISPLACEMENT @bottom@
#define @UP@_WATCHDOG @watchdog@u           /* calls without a target before the voltage ramps to 0 V */
#define @UP@_LATE @late@u                  /* predict_step gives the displacement so many calls ago */
#define @UP@_AHEAD @ahead@           /* s: the drive is so late; give inverse_step the target of then */
#define @UP@_LOOK_AHEAD @look_ahead@u           /* calls: inverse_target_step takes the target of then */

/* What a call may report; more than one bit may be set. */
#define @UP@_NOT_A_NUMBER 1u   /* an input was not finite: the last valid voltage is kept */
#define @UP@_INFEASIBLE 2u     /* no voltage makes the force asked for */
#define @UP@_VOLTAGE 4u        /* cut by the range of the voltage */
#define @UP@_SLEW 8u           /* cut by the slew */
#define @UP@_DISPLACEMENT 16u  /* the target is beyond the range of the displacement: held at its end */
#define @UP@_NO_TARGET 32u     /* no target came: the voltage is kept, then ramps to 0 V */

typedef struct {
    @id@_real model[@model_states@];
    @id@_real plan[@plan_states@];
    @id@_real window[@window@];
    @id@_real displacement; /* m, last predicted */
    @id@_real voltage;      /* V, last given out */
    @id@_real p;            /* V/m, gain of pi_step */
    @id@_real i;            /* V/(m s) */
    @id@_real integral;     /* m s */
    uint32_t silent;        /* calls without a target */
} @id@_state;

/* Held at y0 under u0 for ever; at rest: y0 = @rest@, u0 = 0. */
void @id@_init(@id@_state *state, @id@_real y0, @id@_real u0);

/* Displacement at this sample for the voltage at this sample. */
@id@_real @id@_predict_step(@id@_state *state, @id@_real u);

/* Voltage for [y, y', ..., y^(@order@)] at this sample; target NULL: none came. */
@id@_real @id@_inverse_step(@id@_state *state, const @id@_real target[@tokens@], uint32_t *flags);

/* Voltage now for a target sampled every DT, given LOOK_AHEAD samples early; NULL: none came. */
@id@_real @id@_inverse_target_step(@id@_state *state, const @id@_real *target, uint32_t *flags);

/* inverse_step plus p e + i (integral of e), e = y - measured; the integral stops where the voltage is cut. */
@id@_real @id@_pi_step(@id@_state *state, const @id@_real target[@tokens@], @id@_real measured, uint32_t *flags);

#ifdef __cplusplus
}
#endif

#endif
