"""The C around an exported one that makes it an FMU: its own declarations of the interface,
of which no header is needed."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ._fields import Field
from ._fmi2 import FMI2, UNSUPPORTED2
from ._fmi3 import FMI3, UNSUPPORTED3
from ._harness import is_held, names_of


class Variable(NamedTuple):
    """One of an FMU: `place` is where it is in the model, an expression of C."""

    name: str
    reference: int
    causality: str
    boolean: bool
    start: float | None
    place: str
    about: str


MODEL = """\
/* {p} as an FMU: the functions of FMI {version} around {p}.c. A step at the time t takes
   the inputs of t, and the u that was set at the step before, which was held until t. */

#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "{p}.h"

#define INPUTS {inputs}
#define FIXED {fixed}

/* All that a step depends on, and what it gives: a value. */
typedef struct {{
    {p}_state state;
    {p}_output output;
{own}    double in[INPUTS];
    double held[INPUTS];
    double time;
    int steps;
}} model;

static void reset(model *m)
{{
    memset(m, 0, sizeof *m);
{defaults}}}

static double near(double x, double y)
{{
    const double off = x - y;
    return (off < 0.0) ? -off : off;
}}

/* The sample at the time t: 0, or the status of the step. */
static int sampled(model *m, double t)
{{
    int status;
    if (m->steps == 0) {{
{start}
    }} else {{
        const double dt = t - m->time;
        (void)dt;
{step}
    }}
    memcpy(m->held, m->in, sizeof m->held);
    m->time = t;
    ++m->steps;
    return status;
}}

static int get_real(const model *m, unsigned r, double *value)
{{
    switch (r) {{
{get_real}
    default: return 3;
    }}
    return 0;
}}

static int set_real(model *m, unsigned r, double value)
{{
    switch (r) {{
{set_real}
    default: return 3;
    }}
    return 0;
}}

static int get_bool(const model *m, unsigned r, bool *value)
{{
    switch (r) {{
{get_bool}
    default: return 3;
    }}
    return 0;
}}
"""

STEPPED = """\
    if (FIXED > 0.0 && near(h, FIXED) > 1e-6 * FIXED) {{
        {log}
        return 3;
    }}
    if (!(h > 0.0) || sampled(m, t) != 0) {{
        return 3;
    }}
"""

FAULT = "the communication step must be the interval of the model"
LOGS = {
    2: f'i->with->log(i->with->environment, "{{p}}", 3, "error", "{FAULT}");',
    3: f'if (i->log != NULL) {{{{ i->log(i->environment, 3, "error", "{FAULT}"); }}}}',
}


def variables(
    inputs: Sequence[Field],
    outputs: Sequence[Field],
    parameters: Sequence[Field],
    columns: Mapping[str, Sequence[str]],
    notes: Mapping[str, str],
) -> list[Variable]:
    """Inputs, outputs and parameters, entry by entry; `inputs` without an interval."""
    found: list[Variable] = []
    at = 0
    for causality, fields in (
        ("input", inputs),
        ("output", outputs),
        ("parameter", parameters),
    ):
        for field in fields:
            for k, name in enumerate(names_of(field, columns)):
                place = f"[{k}]" if field.is_array else ""
                where = {
                    "input": f"m->in[{at}]",
                    "output": f"m->output.{field.name}{place}",
                    "parameter": f"m->parameters.{field.name}{place}",
                }[causality]
                at += causality == "input"
                start = 0.0 if causality == "input" else None
                if field.default is not None:
                    start = float(field.default.reshape(-1)[k])
                boolean, about = (
                    field.dtype.kind == "b",
                    notes.get(field.name, field.origin),
                )
                made = Variable(name, len(found), causality, boolean, start, where, about)
                found.append(made)
    return found


def fmu_source(
    prefix: str,
    version: int,
    token: str,
    interval: float | None,
    real: str,
    inputs: Sequence[Field],
    first: Sequence[Field],
    known: Sequence[Variable],
) -> str:
    """The file; `inputs` are those of a step, an interval included, `first` those of the
    start."""
    own = any(v.causality == "parameter" for v in known)
    count = sum(v.causality == "input" for v in known)
    places, at = {}, 0
    for field in inputs:
        places[field.name] = at
        at += 0 if field.name == "dt" and interval is None else field.size

    def called(function: str, fields: Sequence[Field]) -> str:
        lines, passed = [], ["&m->state"] + (["&m->parameters"] if own else [])
        for field in fields:
            if field.name == "dt" and interval is None:
                passed.append(f"({real})dt")
                continue
            array = "held" if function == "step" and is_held(field) else "in"
            entries = [
                f"({real})m->{array}[{places[field.name] + k}]" for k in range(field.size)
            ]
            if field.is_array:
                lines.append(f"        {real} {field.name}[{field.size}];")
                passed.append(field.name)
            else:
                passed.append(entries[0])
        for field in fields:
            array = "held" if function == "step" and is_held(field) else "in"
            if field.is_array:
                lines += [
                    f"        {field.name}[{k}] = ({real})m->{array}"
                    f"[{places[field.name] + k}];"
                    for k in range(field.size)
                ]
        call = f"{prefix}_{function}({', '.join([*passed, '&m->output'])})"
        return "\n".join([*lines, f"        status = (int){call};"])

    case = lambda v, text: f"    case {v.reference}: {text} break;"
    reals = [v for v in known if not v.boolean]
    model = MODEL.format(
        p=prefix,
        version=version,
        inputs=max(count, 1),
        fixed=0.0 if interval is None else interval,
        own=f"    {prefix}_parameters parameters;\n" if own else "",
        defaults=f"    {prefix}_defaults(&m->parameters);\n" if own else "",
        start=called("init", first),
        step=called("step", inputs),
        get_real="\n".join(case(v, f"*value = (double){v.place};") for v in reals)
        + f"\n    case {len(known)}: *value = m->time; break;",
        set_real="\n".join(
            case(v, f"{v.place} = {'' if v.causality == 'input' else f'({real})'}value;")
            for v in reals
            if v.causality != "output"
        ),
        get_bool="\n".join(case(v, f"*value = {v.place};") for v in known if v.boolean),
    )
    text, names = {2: (FMI2, UNSUPPORTED2), 3: (FMI3, UNSUPPORTED3)}[version]
    return model + text.format(
        token=token,
        stepped=STEPPED.format(log=LOGS[version].format(p=prefix)),
        unsupported="\n".join(
            f"int fmi{version}{name}(void) {{ return 3; }}" for name in names.split()
        ),
    )
