EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void *fmi2Instantiate(const char *name, int kind, const char *token, const char *resources,
                             const void *functions, int visible, int logging)
{
    (void)name, (void)resources, (void)functions, (void)visible, (void)logging;
    return (kind == 1) ? instantiate(token) : NULL;
}
EXPORT void fmi2FreeInstance(void *m) { free(m); }
EXPORT int fmi2SetDebugLogging(void *m, int on, size_t count, const char *const categories[])
{
    (void)m, (void)on, (void)count, (void)categories;
    return OK;
}
EXPORT int fmi2SetupExperiment(void *m, int tolerant, double tolerance, double start, int stops, double stop)
{
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    return begin(m, start);
}
EXPORT int fmi2EnterInitializationMode(void *m) { return (m != NULL) ? OK : ERROR; }
EXPORT int fmi2ExitInitializationMode(void *m) { return (m != NULL) ? OK : ERROR; }
EXPORT int fmi2Terminate(void *m) { return (m != NULL) ? OK : ERROR; }
EXPORT int fmi2Reset(void *m) { return restart(m), OK; }
EXPORT int fmi2GetReal(void *m, const uint32_t at[], size_t count, double to[]) { return get(m, at, count, to); }
EXPORT int fmi2SetReal(void *m, const uint32_t at[], size_t count, const double from[])
{
    return set(m, at, count, from);
}
EXPORT int fmi2GetInteger(void *m, const uint32_t at[], size_t count, int to[]) { return get_flags(m, at, count, to); }
EXPORT int fmi2GetFMUstate(void *m, void **to) { return save(m, to); }
EXPORT int fmi2SetFMUstate(void *m, void *from) { return copy(m, from, sizeof(Instance)); }
EXPORT int fmi2FreeFMUstate(void *m, void **saved) { return (void)m, give_back(saved); }
EXPORT int fmi2SerializedFMUstateSize(void *m, void *saved, size_t *size)
{
    (void)m, (void)saved;
    *size = sizeof(Instance);
    return OK;
}
EXPORT int fmi2SerializeFMUstate(void *m, void *saved, char to[], size_t size) { return (void)m, copy(to, saved, size); }
EXPORT int fmi2DeSerializeFMUstate(void *m, const char from[], size_t size, void **to)
{
    return (save(m, to) == OK) ? copy(*to, from, size) : ERROR;
}
EXPORT int fmi2DoStep(void *m, double time, double size, int final)
{
    (void)time, (void)final;
    return advance(m, size);
}
@stubs@
