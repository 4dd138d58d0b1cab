// Teensy: a timer at the model's rate; the target comes as floats on the serial line, the voltage goes to a 12-bit DAC.
#include <Arduino.h>
#include "@id@.h"

static @id@_state state;
static IntervalTimer timer;

static void tick()
{
    static float next;
    const bool came = Serial.available() >= (int)sizeof next && Serial.readBytes((char *)&next, sizeof next) == sizeof next;
    const @id@_real target = next;
    uint32_t flags;
    const @id@_real u = @id@_inverse_target_step(&state, came ? &target : nullptr, &flags);
    analogWrite(A14, (int)(4095 * u / @UP@_MAX_VOLTAGE));
}

void setup()
{
    Serial.begin(1000000);
    analogWriteResolution(12);
    @id@_init(&state, @rest@, @zero@);
    timer.begin(tick, 1e6 * @UP@_DT);
}

void loop() {}
