"""The functions of FMI 3 for co-simulation, as a text of C."""

FMI3 = """
typedef void *component;
typedef void (*logger)(void *, int, const char *, const char *);
typedef struct {{
    model now;
    void *environment;
    logger log;
}} instance;

const char *fmi3GetVersion(void) {{ return "3.0"; }}
int fmi3SetDebugLogging(component c, bool on, size_t n, const char *const names[])
{{
    (void)c; (void)on; (void)n; (void)names;
    return 0;
}}
component fmi3InstantiateModelExchange(void) {{ return NULL; }}
component fmi3InstantiateScheduledExecution(void) {{ return NULL; }}
component fmi3InstantiateCoSimulation(const char *name, const char *token,
    const char *where, bool visible, bool logging, bool events, bool early,
    const unsigned *required, size_t n, void *environment, logger log, void *update)
{{
    instance *made;
    (void)name; (void)where; (void)visible; (void)logging; (void)events; (void)early;
    (void)required; (void)n; (void)update;
    if (strcmp(token, "{token}") != 0) {{
        return NULL;
    }}
    made = calloc(1, sizeof *made);
    if (made != NULL) {{
        made->environment = environment;
        made->log = log;
        reset(&made->now);
    }}
    return made;
}}
void fmi3FreeInstance(component c) {{ free(c); }}
int fmi3EnterInitializationMode(component c, bool t, double tolerance, double start, bool s,
    double stop)
{{
    (void)t; (void)tolerance; (void)s; (void)stop;
    ((instance *)c)->now.time = start;
    return 0;
}}
int fmi3ExitInitializationMode(component c)
{{
    model *m = &((instance *)c)->now;
    const int status = sampled(m, m->time);
    m->steps = 0;
    return (status == 0) ? 0 : 3;
}}
int fmi3EnterStepMode(component c) {{ (void)c; return 0; }}
int fmi3Terminate(component c) {{ (void)c; return 0; }}
int fmi3Reset(component c) {{ reset(&((instance *)c)->now); return 0; }}
int fmi3GetFloat64(component c, const unsigned r[], size_t n, double value[], size_t m)
{{
    size_t k;
    int status = (n == m) ? 0 : 3;
    for (k = 0; k < n && status == 0; ++k) {{
        status = get_real(&((instance *)c)->now, r[k], &value[k]);
    }}
    return status;
}}
int fmi3SetFloat64(component c, const unsigned r[], size_t n, const double value[],
    size_t m)
{{
    size_t k;
    int status = (n == m) ? 0 : 3;
    for (k = 0; k < n && status == 0; ++k) {{
        status = set_real(&((instance *)c)->now, r[k], value[k]);
    }}
    return status;
}}
int fmi3GetBoolean(component c, const unsigned r[], size_t n, bool value[], size_t m)
{{
    size_t k;
    int status = (n == m) ? 0 : 3;
    for (k = 0; k < n && status == 0; ++k) {{
        status = get_bool(&((instance *)c)->now, r[k], &value[k]);
    }}
    return status;
}}
int fmi3GetFMUState(component c, void **state)
{{
    if (*state == NULL) {{
        *state = malloc(sizeof(model));
    }}
    if (*state == NULL) {{
        return 3;
    }}
    memcpy(*state, &((instance *)c)->now, sizeof(model));
    return 0;
}}
int fmi3SetFMUState(component c, void *state)
{{
    memcpy(&((instance *)c)->now, state, sizeof(model));
    return 0;
}}
int fmi3FreeFMUState(component c, void **state)
{{
    (void)c;
    free(*state);
    *state = NULL;
    return 0;
}}
int fmi3SerializedFMUStateSize(component c, void *state, size_t *size)
{{
    (void)c; (void)state;
    *size = sizeof(model);
    return 0;
}}
int fmi3SerializeFMUState(component c, void *state, unsigned char bytes[], size_t size)
{{
    (void)c;
    if (size < sizeof(model)) {{
        return 3;
    }}
    memcpy(bytes, state, sizeof(model));
    return 0;
}}
int fmi3DeserializeFMUState(component c, const unsigned char bytes[], size_t size,
    void **state)
{{
    if (size != sizeof(model) || fmi3GetFMUState(c, state) != 0) {{
        return 3;
    }}
    memcpy(*state, bytes, size);
    return 0;
}}
int fmi3DoStep(component c, double t, double h, bool keep, bool *event, bool *terminate,
    bool *early, double *last)
{{
    instance *i = c;
    model *m = &i->now;
    (void)keep;
    *event = false;
    *terminate = false;
    *early = false;
    *last = t;
{stepped}    *last = t + h;
    return 0;
}}

/* What no variable or capability calls for. */
{unsupported}
"""
UNSUPPORTED3 = (
    "EnterEventMode GetFloat32 GetInt8 GetUInt8 GetInt16 GetUInt16 GetInt32 GetUInt32 "
    "GetInt64 GetUInt64 GetString GetBinary GetClock SetFloat32 SetInt8 SetUInt8 SetInt16 "
    "SetUInt16 SetInt32 SetUInt32 SetInt64 SetUInt64 SetBoolean SetString SetBinary "
    "SetClock GetNumberOfVariableDependencies GetVariableDependencies "
    "GetDirectionalDerivative GetAdjointDerivative EnterConfigurationMode "
    "ExitConfigurationMode GetIntervalDecimal GetIntervalFraction GetShiftDecimal "
    "GetShiftFraction SetIntervalDecimal SetIntervalFraction SetShiftDecimal "
    "SetShiftFraction EvaluateDiscreteStates UpdateDiscreteStates EnterContinuousTimeMode "
    "CompletedIntegratorStep SetTime SetContinuousStates GetContinuousStateDerivatives "
    "GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates "
    "GetNumberOfEventIndicators GetNumberOfContinuousStates GetOutputDerivatives "
    "ActivateModelPartition"
)
