"""The functions of FMI 2 for co-simulation, as a text of C."""

FMI2 = """
typedef void *component;
typedef void (*logger)(void *, const char *, int, const char *, const char *, ...);
typedef struct {{
    logger log;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
}} callbacks;
typedef struct {{
    model now;
    const callbacks *with;
}} instance;

const char *fmi2GetTypesPlatform(void) {{ return "default"; }}
const char *fmi2GetVersion(void) {{ return "2.0"; }}
int fmi2SetDebugLogging(component c, int on, size_t n, const char *const names[])
{{
    (void)c; (void)on; (void)n; (void)names;
    return 0;
}}
component fmi2Instantiate(const char *name, int kind, const char *guid, const char *where,
    const callbacks *with, int visible, int logging)
{{
    instance *made;
    (void)name; (void)where; (void)visible; (void)logging;
    if (kind != 1 || strcmp(guid, "{token}") != 0) {{
        return NULL;
    }}
    made = with->allocate(1, sizeof *made);
    if (made != NULL) {{
        made->with = with;
        reset(&made->now);
    }}
    return made;
}}
void fmi2FreeInstance(component c)
{{
    if (c != NULL) {{
        ((instance *)c)->with->release(c);
    }}
}}
int fmi2SetupExperiment(component c, int t, double tolerance, double start, int s,
    double stop)
{{
    (void)t; (void)tolerance; (void)s; (void)stop;
    ((instance *)c)->now.time = start;
    return 0;
}}
int fmi2EnterInitializationMode(component c) {{ (void)c; return 0; }}
int fmi2ExitInitializationMode(component c)
{{
    model *m = &((instance *)c)->now;
    const int status = sampled(m, m->time);
    m->steps = 0;
    return (status == 0) ? 0 : 3;
}}
int fmi2Terminate(component c) {{ (void)c; return 0; }}
int fmi2Reset(component c) {{ reset(&((instance *)c)->now); return 0; }}
int fmi2GetReal(component c, const unsigned r[], size_t n, double value[])
{{
    size_t k;
    int status = 0;
    for (k = 0; k < n; ++k) {{
        status |= get_real(&((instance *)c)->now, r[k], &value[k]);
    }}
    return status;
}}
int fmi2SetReal(component c, const unsigned r[], size_t n, const double value[])
{{
    size_t k;
    int status = 0;
    for (k = 0; k < n; ++k) {{
        status |= set_real(&((instance *)c)->now, r[k], value[k]);
    }}
    return status;
}}
int fmi2GetBoolean(component c, const unsigned r[], size_t n, int value[])
{{
    size_t k;
    int status = 0;
    for (k = 0; k < n; ++k) {{
        bool found = false;
        status |= get_bool(&((instance *)c)->now, r[k], &found);
        value[k] = found ? 1 : 0;
    }}
    return status;
}}
int fmi2GetFMUstate(component c, void **state)
{{
    instance *i = c;
    if (*state == NULL) {{
        *state = i->with->allocate(1, sizeof i->now);
    }}
    if (*state == NULL) {{
        return 3;
    }}
    memcpy(*state, &i->now, sizeof i->now);
    return 0;
}}
int fmi2SetFMUstate(component c, void *state)
{{
    memcpy(&((instance *)c)->now, state, sizeof(model));
    return 0;
}}
int fmi2FreeFMUstate(component c, void **state)
{{
    ((instance *)c)->with->release(*state);
    *state = NULL;
    return 0;
}}
int fmi2SerializedFMUstateSize(component c, void *state, size_t *size)
{{
    (void)c; (void)state;
    *size = sizeof(model);
    return 0;
}}
int fmi2SerializeFMUstate(component c, void *state, char bytes[], size_t size)
{{
    (void)c;
    if (size < sizeof(model)) {{
        return 3;
    }}
    memcpy(bytes, state, sizeof(model));
    return 0;
}}
int fmi2DeSerializeFMUstate(component c, const char bytes[], size_t size, void **state)
{{
    if (size != sizeof(model) || fmi2GetFMUstate(c, state) != 0) {{
        return 3;
    }}
    memcpy(*state, bytes, size);
    return 0;
}}
int fmi2DoStep(component c, double t, double h, int keep)
{{
    instance *i = c;
    model *m = &i->now;
    (void)keep;
{stepped}    return 0;
}}
int fmi2CancelStep(component c) {{ (void)c; return 3; }}

/* What no variable or capability calls for. */
{unsupported}
"""
UNSUPPORTED2 = (
    "GetInteger SetInteger SetBoolean GetString SetString GetDirectionalDerivative "
    "SetRealInputDerivatives GetRealOutputDerivatives GetStatus GetRealStatus "
    "GetIntegerStatus GetBooleanStatus GetStringStatus"
)
