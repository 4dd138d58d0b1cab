/* @title@
 *
 * One actuator: its displacement for a voltage, and the voltage for a displacement, every @dt@ s.
 * Voltages are in @in@. Targets and predictions are displacements in @out@: @meaning@.
 * Derivatives are in @derivative_unit@. `measured` is the sensor's own reading, and init takes that reading at 0 @in@.
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
#define @UP@_MAX_VOLTAGE @high@    /* @in@ */
#define @UP@_MIN_VOLTAGE @low@
#define @UP@_MAX_SLEW @slew@       /* @slew_unit@ */
#define @UP@_MAX_DISPLACEMENT @top@ /* @out@ from 0 @in@ */
#define @UP@_MIN_DISPLACEMENT @bottom@
#define @UP@_WATCHDOG @watchdog@u           /* calls without a target before the voltage ramps to 0 @in@ */
#define @UP@_REST @rest@ /* @out@: the sensor's reading at 0 @in@ in the recordings */
#define @UP@_LATE @late@u                  /* predict_step gives the displacement so many calls ago */
#define @UP@_AHEAD @ahead@           /* s: the drive is so late; give inverse_step the target of then */
#define @UP@_LOOK_AHEAD @look_ahead@u           /* calls: inverse_target_step takes the target of then */
#define @UP@_P @p@             /* gains of the PI steps, on the force: @gain_unit@, */
#define @UP@_I @i@             /* @integral_unit@ */
#define @UP@_TRACK @track@         /* 1/s: over the closed loop's time constant */
#define @UP@_SMOOTH @smooth@         /* of the difference between expectation and reading, a call */
#define @UP@_DEAD @dead@         /* @out@: noise of the sensor that this leaves, which is not corrected */

/* What a call may report; more than one bit may be set. */
#define @UP@_NOT_A_NUMBER 1u   /* an input was not finite: the last valid voltage is kept */
#define @UP@_INFEASIBLE 2u     /* no voltage makes the force asked for */
#define @UP@_VOLTAGE 4u        /* cut by the range of the voltage */
#define @UP@_SLEW 8u           /* cut by the slew */
#define @UP@_DISPLACEMENT 16u  /* the target is beyond the range of the displacement: held at its end */
#define @UP@_NO_TARGET 32u     /* no target came: it is carried on or the voltage kept, then the voltage ramps to 0 @in@ */
#define @UP@_NO_SENSOR 64u     /* no reading came: the correction is kept, then fades */

typedef struct {
    @id@_real model[@model_states@];
    @id@_real expected[@model_states@]; /* the model under the feedforward alone */
    @id@_real plan[@plan_states@];
    @id@_real window[@window@];
    @id@_real recent[@block@];
    @id@_real reference[@tokens@];
    @id@_real zero;         /* @out@, the sensor's reading at 0 @in@ */
    @id@_real asked;        /* @out@, the last target of pi_target_step */
    @id@_real displacement; /* @out@, last predicted */
    @id@_real voltage;      /* @in@, last given out */
    @id@_real feed;         /* @in@, the feedforward within the limits */
    @id@_real smooth;       /* @out@, expectation less reading */
    @id@_real p;            /* @gain_unit@, gains of the PI steps: set them after init */
    @id@_real i;            /* @integral_unit@ */
    @id@_real track;        /* 1/s, of the back-calculation; 0 turns it off */
    @id@_real integral;     /* @force_unit@ */
    @id@_real trim;         /* @force_unit@, P and I together */
    uint32_t head;          /* oldest place of the window */
    uint32_t silent;        /* calls without a target */
    uint32_t blind;         /* calls without a reading */
    uint32_t stale;         /* steps without a loop left `expected` behind */
    uint32_t closed;        /* the last voltage came from a PI step */
} @id@_state;

/* An actuator that has stood under u0, where the sensor reads `reading`. With u0 = 0 that is the reading at 0 @in@, from
 * which `measured` is counted afterwards; with another u0 it is counted from @UP@_REST, or set state->zero. */
void @id@_init(@id@_state *state, @id@_real reading, @id@_real u0);

/* Displacement at this sample for the voltage at this sample. */
@id@_real @id@_predict_step(@id@_state *state, @id@_real u);

/* Voltage for [y, y', ..., y^(@order@)] at this sample; target NULL: none came. */
@id@_real @id@_inverse_step(@id@_state *state, const @id@_real target[@tokens@], uint32_t *flags);

/* Voltage now for a target sampled every DT, given LOOK_AHEAD samples early; NULL: none came. */
@id@_real @id@_inverse_target_step(@id@_state *state, const @id@_real *target, uint32_t *flags);

/* inverse_step and a PI on the force, u = map^-1(F + P e + I (integral of e)), e = expected - y(measured); measured NAN: none came.
 * e compares the reading with what the model expects of the feedforward at that time, with its delay and its limits. It
 * starts from the voltage that stands, and what range and slew cut does not wind it up. */
@id@_real @id@_pi_step(@id@_state *state, const @id@_real target[@tokens@], @id@_real measured, uint32_t *flags);

/* The same for a target of this moment, without derivatives: it is followed through @reference_order@ lags of @reference_ms@ ms. */
@id@_real @id@_pi_target_step(@id@_state *state, const @id@_real *target, @id@_real measured, uint32_t *flags);

#ifdef __cplusplus
}
#endif

#endif
