EXPORT const char *fmi3GetVersion(void) { return "3.0"; }
EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                         bool logging, bool events, bool early, const uint32_t between[],
                                         size_t count, void *environment, void *logger, void *update)
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)between, (void)count;
    (void)environment, (void)logger, (void)update;
    return instantiate(token);
}
EXPORT void *fmi3InstantiateModelExchange(const char *name) { return (void)name, NULL; }
EXPORT void *fmi3InstantiateScheduledExecution(const char *name) { return (void)name, NULL; }
EXPORT void fmi3FreeInstance(void *m) { free(m); }
EXPORT int fmi3SetDebugLogging(void *m, bool on, size_t count, const char *const categories[])
{
    (void)m, (void)on, (void)count, (void)categories;
    return OK;
}
EXPORT int fmi3EnterInitializationMode(void *m, bool tolerant, double tolerance, double start, bool stops, double stop)
{
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    return begin(m, start);
}
EXPORT int fmi3ExitInitializationMode(void *m) { return (m != NULL) ? OK : ERROR; }
EXPORT int fmi3Terminate(void *m) { return (m != NULL) ? OK : ERROR; }
EXPORT int fmi3Reset(void *m) { return restart(m), OK; }
EXPORT int fmi3GetFloat64(void *m, const uint32_t at[], size_t count, double to[], size_t values)
{
    return (values == count) ? get(m, at, count, to) : ERROR;
}
EXPORT int fmi3SetFloat64(void *m, const uint32_t at[], size_t count, const double from[], size_t values)
{
    return (values == count) ? set(m, at, count, from) : ERROR;
}
EXPORT int fmi3GetInt32(void *m, const uint32_t at[], size_t count, int32_t to[], size_t values)
{
    return (values == count) ? get_flags(m, at, count, to) : ERROR;
}
EXPORT int fmi3GetFMUState(void *m, void **to) { return save(m, to); }
EXPORT int fmi3SetFMUState(void *m, void *from) { return copy(m, from, sizeof(Instance)); }
EXPORT int fmi3FreeFMUState(void *m, void **saved) { return (void)m, give_back(saved); }
EXPORT int fmi3SerializedFMUStateSize(void *m, void *saved, size_t *size)
{
    (void)m, (void)saved;
    *size = sizeof(Instance);
    return OK;
}
EXPORT int fmi3SerializeFMUState(void *m, void *saved, uint8_t to[], size_t size) { return (void)m, copy(to, saved, size); }
EXPORT int fmi3DeserializeFMUState(void *m, const uint8_t from[], size_t size, void **to)
{
    return (save(m, to) == OK) ? copy(*to, from, size) : ERROR;
}
EXPORT int fmi3DoStep(void *m, double time, double size, bool final, bool *event, bool *stop, bool *early, double *last)
{
    (void)time, (void)final;
    const int status = advance(m, size);
    *event = *stop = *early = false;
    *last = ((Instance *)m)->values[TIME];
    return status;
}
@stubs@
