/* A loop at the model's rate: a target, the voltage for it, and how late each call was. */
#include <math.h>
#include <stdio.h>
#include <time.h>

#include "@id@.h"

int main(void)
{
    @id@_state state;
    struct timespec next, now;
    double latest = 0.0;
    @id@_init(&state, @rest@, @zero@);
    clock_gettime(CLOCK_MONOTONIC, &next);
    for (unsigned k = 0; k < 1.0 / (double)@UP@_DT; k++) {
        const double t = (k + @UP@_LOOK_AHEAD) * (double)@UP@_DT;
        const @id@_real y = (@id@_real)(@stroke@ * 0.5 * (1.0 - cos(6.283185307179586 * t)));
        uint32_t flags;
        const @id@_real u = @id@_inverse_target_step(&state, &y, &flags);
        if (k % 100 == 0) {
            printf("t %.3f s   u %.4g @in@   flags %u\n", k * (double)@UP@_DT, (double)u, (unsigned)flags);
        }
        next.tv_nsec += (long)(1e9 * (double)@UP@_DT);
        next.tv_sec += next.tv_nsec / 1000000000L;
        next.tv_nsec %= 1000000000L;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
        clock_gettime(CLOCK_MONOTONIC, &now);
        latest = fmax(latest, (double)(now.tv_sec - next.tv_sec) + 1e-9 * (double)(now.tv_nsec - next.tv_nsec));
    }
    printf("latest call: %.0f us\n", 1e6 * latest);
    return 0;
}
