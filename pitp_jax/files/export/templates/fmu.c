/* @title@ FMI @fmi@ co-simulation: voltage held over a step -> displacement; target -> command.
 *
 * Value references: 0 time, 1 voltage, 2 ... @tokens_end@ target and its derivatives, then displacement, command, flags.
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "@id@.h"

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { OK, WARNING, DISCARD, ERROR };
enum { TIME, VOLTAGE, TARGET, DISPLACEMENT = TARGET + @tokens@, COMMAND, FLAGS, COUNT };

typedef struct {
    @id@_state state;
    double values[COUNT];
    double start; /* s, and steps since: time does not add up its rounding */
    double steps;
} Instance;

static const double starts[COUNT] = {@starts@};

static void restart(Instance *m)
{
    (void)memcpy(m->values, starts, sizeof starts);
    @id@_init(&m->state, @rest@, @zero@);
    m->start = 0.0;
    m->steps = 0.0;
}

static int begin(Instance *m, double start)
{
    m->start = start;
    m->values[TIME] = start;
    return OK;
}

static void *instantiate(const char *token)
{
    Instance *m = NULL;
    if ((token != NULL) && (strcmp(token, "@token@") == 0)) {
        m = calloc(1u, sizeof *m);
    }
    if (m != NULL) {
        restart(m);
    }
    return m;
}

static int get(const Instance *m, const uint32_t at[], size_t count, double to[])
{
    for (size_t k = 0u; k < count; k++) {
        if (at[k] >= (uint32_t)COUNT) {
            return ERROR;
        }
        to[k] = m->values[at[k]];
    }
    return OK;
}

static int set(Instance *m, const uint32_t at[], size_t count, const double from[])
{
    for (size_t k = 0u; k < count; k++) {
        if ((at[k] < (uint32_t)VOLTAGE) || (at[k] >= (uint32_t)DISPLACEMENT)) {
            return ERROR;
        }
        m->values[at[k]] = from[k];
    }
    return OK;
}

static int get_flags(const Instance *m, const uint32_t at[], size_t count, int32_t to[])
{
    for (size_t k = 0u; k < count; k++) {
        if (at[k] != (uint32_t)FLAGS) {
            return ERROR;
        }
        to[k] = (int32_t)m->values[FLAGS];
    }
    return OK;
}

/* Whole steps of the model; another size is refused. */
static int advance(Instance *m, double size)
{
    const double dt = (double)@UP@_DT;
    const double steps = floor((size / dt) + 0.5);
    @id@_real target[@tokens@];
    uint32_t flags = 0u;
    if ((steps < 1.0) || (fabs(size - (steps * dt)) > (1e-6 * dt))) {
        return ERROR;
    }
    for (int i = 0; i < @tokens@; i++) {
        target[i] = (@id@_real)m->values[TARGET + i];
    }
    for (double k = 0.0; k < steps; k += 1.0) {
        m->values[DISPLACEMENT] = (double)@id@_predict_step(&m->state, (@id@_real)m->values[VOLTAGE]);
        m->values[COMMAND] = (double)@id@_inverse_step(&m->state, target, &flags);
    }
    m->values[FLAGS] = (double)flags;
    m->steps += steps;
    m->values[TIME] = m->start + (m->steps * dt);
    return OK;
}

static int save(const Instance *m, void **to)
{
    if (*to == NULL) {
        *to = malloc(sizeof *m);
    }
    if (*to == NULL) {
        return ERROR;
    }
    (void)memcpy(*to, m, sizeof *m);
    return OK;
}

static int give_back(void **saved)
{
    free(*saved);
    *saved = NULL;
    return OK;
}

static int copy(void *to, const void *from, size_t size)
{
    if (size < sizeof(Instance)) {
        return ERROR;
    }
    (void)memcpy(to, from, sizeof(Instance));
    return OK;
}

@api@
