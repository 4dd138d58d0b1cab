/* The controller's side: a timer, the exported inverse, UDP on the loopback to the actuator.
 *
 * controller PORT COUNT PI < rows (COUNT x TOKENS doubles)  >  late (s), command (V), measured (m) per call
 */
#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>

#include "pitp_model.h"

static double since(const struct timespec *start)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)(now.tv_sec - start->tv_sec) + 1e-9 * (double)(now.tv_nsec - start->tv_nsec);
}

int main(int argc, char **argv)
{
    pitp_model_state state;
    struct sockaddr_in plant = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    struct timespec next;
    double measured = 0.0;
    if (argc != 4) {
        return 2;
    }
    plant.sin_port = htons((uint16_t)atoi(argv[1]));
    const long count = atol(argv[2]);
    const int line = socket(AF_INET, SOCK_DGRAM, 0);
    if (line < 0 || connect(line, (struct sockaddr *)&plant, sizeof plant) != 0) {
        return 1;
    }
    pitp_model_init(&state, 0, 0);
    clock_gettime(CLOCK_MONOTONIC, &next);
    for (long k = 0; k < count; k++) {
        pitp_model_real target[PITP_MODEL_TOKENS];
        double row[PITP_MODEL_TOKENS], out[3];
        uint32_t flags;
        if (fread(row, sizeof row, 1, stdin) != 1) {
            return 1;
        }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
        out[0] = since(&next);
        while (recv(line, &measured, sizeof measured, MSG_DONTWAIT) == (ssize_t)sizeof measured) {
            /* the newest reading */
        }
        for (unsigned i = 0; i < PITP_MODEL_TOKENS; i++) {
            target[i] = row[i];
        }
        out[1] = argv[3][0] == '1' ? pitp_model_pi_step(&state, target, measured, &flags)
                                   : pitp_model_inverse_step(&state, target, &flags);
        out[2] = measured;
        if (send(line, &out[1], sizeof(double), 0) < 0) {
            return 1;
        }
        fwrite(out, sizeof out, 1, stdout);
        next.tv_nsec += (long)(1e9 * PITP_MODEL_DT);
        next.tv_sec += next.tv_nsec / 1000000000L;
        next.tv_nsec %= 1000000000L;
    }
    return 0;
}
