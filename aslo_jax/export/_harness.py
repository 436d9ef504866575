"""What comes with the C: a test, a filter of CSV files, and how to build them."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..engines._c.types import literal
from ._fields import Field
from ._traced import Traced
from ._vectors import Vectors

# Of the largest value of an output: what rounding may change in a test, at least and, where
# what the last bits of the inputs do to the outputs is more, at most.
TOLERANCE = {"float64": (1e-12, 1e-9), "float32": (2e-3, 2e-3)}

MAIN = """\
/* Replays recorded vectors: exits with 0 where the outputs are those of aslo_jax. */

#include <stdio.h>

#include "{p}.h"

#define ROWS {rows}
#define INPUTS {inputs}
#define OUTPUTS {outputs}
#define TOLERANCE {tolerance}

static const double given[ROWS][INPUTS] = {{
{given}
}};

static const double expected[ROWS][OUTPUTS] = {{
{expected}
}};

{shared}
static double size_of(double x)
{{
    return (x < 0.0) ? -x : x;
}}

int main(void)
{{
    double largest[OUTPUTS] = {{0.0}};
    double error[OUTPUTS] = {{0.0}};
    double found[OUTPUTS];
    double worst = 0.0;
    int k;
    int j;
    {p}_state state;
{declared}    {p}_output output;
{defaults}    for (k = 0; k < ROWS; ++k) {{
        {p}_status status = (k == 0) ? start(&state,{passed} given[k], &output)
                                     : step(&state,{passed} given[k], &output);
        if (status != {P}_OK) {{
            printf("row %d: status %d\\n", k, (int)status);
            return 1;
        }}
        put(&output, found);
        for (j = 0; j < OUTPUTS; ++j) {{
            const double size = size_of(expected[k][j]);
            const double off = size_of(found[j] - expected[k][j]);
            largest[j] = (size > largest[j]) ? size : largest[j];
            error[j] = (off <= error[j]) ? error[j] : off;
        }}
    }}
    for (j = 0; j < OUTPUTS; ++j) {{
        const double relative = error[j] / ((largest[j] > 0.0) ? largest[j] : 1.0);
        worst = (relative <= worst) ? worst : relative;
    }}
    printf("{p}: largest error %.3g of the signal in %d rows\\n", worst, ROWS);
    return (worst <= TOLERANCE) ? 0 : 1;
}}
"""

CSV = """\
/* Reads a log as CSV from stdin, writes the outputs as CSV to stdout. The first line names
   the columns, among which must be: {needed}.
   An input u of a row is held until the next one. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "{p}.h"

#define INPUTS {inputs}
#define OUTPUTS {outputs}
#define LONGEST 8192
#define COLUMNS 256
#define SEPARATORS ", \\t\\r\\n"

static const char *const names[INPUTS + 1] = {{{names}}};
{shared}
/* The numbers of a line; -1 where one of them is none. */
static int numbers(char *line, double *found)
{{
    int count = 0;
    char *field = line;
    while (count < COLUMNS) {{
        char *end;
        found[count] = strtod(field, &end);
        if (end == field) {{
            return -1;
        }}
        ++count;
        end += strspn(end, " \\t\\r\\n");
        if (*end != ',') {{
            return (*end == '\\0') ? count : -1;
        }}
        field = end + 1;
    }}
    return -1;
}}

int main(void)
{{
    static char line[LONGEST];
    static double row[COLUMNS];
    double now[INPUTS + 1];
    double before[INPUTS + 1] = {{0.0}};
    double in[INPUTS];
    double found[OUTPUTS];
    int place[INPUTS + 1];
    int column = 0;
    long rows = 0;
    int k;
    char *name;
    {p}_state state;
{declared}    {p}_output output;
{defaults}    for (k = 0; k <= INPUTS; ++k) {{
        place[k] = -1;
    }}
    if (fgets(line, LONGEST, stdin) == NULL) {{
        fputs("no header\\n", stderr);
        return 2;
    }}
    name = strtok(line, SEPARATORS);
    while (name != NULL) {{
        for (k = 0; k <= INPUTS; ++k) {{
            if ((names[k] != NULL) && (strcmp(name, names[k]) == 0)) {{
                place[k] = column;
            }}
        }}
        ++column;
        name = strtok(NULL, SEPARATORS);
    }}
    for (k = 0; k <= INPUTS; ++k) {{
        if ((names[k] != NULL) && (place[k] < 0)) {{
            fprintf(stderr, "no column %s\\n", names[k]);
            return 2;
        }}
    }}
    puts("{titles}");
    while (fgets(line, LONGEST, stdin) != NULL) {{
        const int count = numbers(line, row);
        {p}_status status;
        if (count != column) {{
            fprintf(stderr, "row %ld: not %d numbers\\n", rows + 1, column);
            return 2;
        }}
        for (k = 0; k <= INPUTS; ++k) {{
            now[k] = (place[k] < 0) ? 0.0 : row[place[k]];
        }}
{rowed}
        status = (rows == 0) ? start(&state,{passed} in, &output)
                             : step(&state,{passed} in, &output);
        if (status != {P}_OK) {{
            fprintf(stderr, "row %ld: status %d\\n", rows + 1, (int)status);
            return 1;
        }}
        put(&output, found);
        printf("%.17g", now[INPUTS]);
        for (k = 0; k < OUTPUTS; ++k) {{
            printf(",%.17g", found[k]);
        }}
        putchar('\\n');
        memcpy(before, now, sizeof now);
        ++rows;
    }}
    return 0;
}}
"""

MAKEFILE = """\
# make test: replay recorded vectors; make {p}_csv: a filter of CSV files.
CC ?= cc
CFLAGS ?= -O2 -fno-math-errno
WARNINGS = -std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion
WARNINGS += -ffp-contract=off

.PHONY: test clean
test: {p}_test
\t./{p}_test

{p}.o: {p}.c {p}.h
\t$(CC) $(CFLAGS) $(WARNINGS) -c -o $@ {p}.c

{p}_test: main.c {p}.o
\t$(CC) $(CFLAGS) $(WARNINGS) -o $@ main.c {p}.o

{p}_csv: {p}_csv.c {p}.o
\t$(CC) $(CFLAGS) $(WARNINGS) -o $@ {p}_csv.c {p}.o

clean:
\trm -f {p}.o {p}_test {p}_csv
"""

CMAKE = """\
cmake_minimum_required(VERSION 3.13)
project({p} C)
set(CMAKE_C_STANDARD 99)
add_library({p} STATIC {p}.c)
target_include_directories({p} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
add_executable({p}_test main.c)
target_link_libraries({p}_test PRIVATE {p})
add_executable({p}_csv {p}_csv.c)
target_link_libraries({p}_csv PRIVATE {p})
enable_testing()
add_test(NAME {p}_vectors COMMAND {p}_test)
"""


def _tolerance(conditioning: float, least: float, most: float) -> float:
    """Ten times what the last bits of the inputs do, as a power of ten: the roundings of a
    step do as much as they."""
    if not conditioning > 0.1 * least:
        return least
    return min(float(f"1e{math.ceil(math.log10(10.0 * conditioning))}"), most)


def harness(
    traced: Traced,
    prefix: str,
    vectors: Vectors,
    columns: Mapping[str, Sequence[str]],
) -> dict[str, str]:
    """The files by name, but for the README."""
    labels = lambda fields: [n for f in fields for n in names_of(f, columns)]
    inputs, outputs = (sum(f.size for f in x) for x in (traced.inputs, traced.outputs))
    own = bool(traced.parameters)
    measured = [
        "t" if f.name == "dt" and traced.interval is None else None
        for f in traced.inputs
        for _ in range(f.size)
    ]
    read = [
        "NULL" if special else f'"{label}"'
        for special, label in zip(measured, labels(traced.inputs), strict=True)
    ]
    given = {
        "p": prefix,
        "P": prefix.upper(),
        "rows": len(vectors.inputs),
        "inputs": inputs,
        "outputs": outputs,
        "tolerance": _tolerance(vectors.conditioning, *TOLERANCE[traced.dtype.name]),
        "given": _rows(vectors.inputs),
        "expected": _rows(vectors.outputs),
        "shared": calls(traced, prefix),
        "declared": f"    {prefix}_parameters parameters;\n" if own else "",
        "defaults": f"    {prefix}_defaults(&parameters);\n" if own else "",
        "passed": " &parameters," if own else "",
        "names": ", ".join([*read, '"t"']),
        "needed": ", ".join(["t", *(x.strip('"') for x in read if x != "NULL")]),
        "titles": ",".join(["t", *labels(traced.outputs)]),
        "rowed": _rowed(traced),
    }
    return {
        "main.c": MAIN.format(**given),
        f"{prefix}_csv.c": CSV.format(**given),
        "Makefile": MAKEFILE.format(**given),
        "CMakeLists.txt": CMAKE.format(**given),
    }


def names_of(field: Field, columns: Mapping[str, Sequence[str]]) -> list[str]:
    """A column for each entry of a field."""
    if field.name in columns:
        return list(columns[field.name])
    if not field.is_array:
        return [field.name]
    return [f"{field.name}_{k}" for k in range(field.size)]


def _rows(values: np.ndarray) -> str:
    number = lambda x: literal(np.float64(x), np.dtype(float))
    lines = []
    for row in values:
        entries = [number(x) for x in row]
        parts = [", ".join(entries[k : k + 4]) for k in range(0, len(entries), 4)]
        lines.append("    {" + ",\n     ".join(parts) + "}")
    return ",\n".join(lines)


def _rowed(traced: Traced) -> str:
    """The inputs of a step from two rows of a log."""
    lines, at = [], 0
    for field in traced.inputs:
        if field.name == "dt" and traced.interval is None:
            lines.append(f"in[{at}] = now[INPUTS] - before[INPUTS];")
        else:
            held = "before" if is_held(field) else "now"
            lines += [f"in[{at + k}] = {held}[{at + k}];" for k in range(field.size)]
        at += field.size
    return "\n".join(f"        {line}" for line in lines)


def is_held(field: Field) -> bool:
    """Whether it is an input that was held over the interval, of which a log has the value
    in the row before."""
    return field.name == "u" or field.name.startswith("u_")


def calls(traced: Traced, prefix: str) -> str:
    """Functions on flat arrays of numbers."""
    parameters = f"const {prefix}_parameters *parameters, " if traced.parameters else ""
    own = "parameters, " if traced.parameters else ""
    return "\n".join(
        [
            _call(traced, prefix, "start", "init", traced.first, parameters, own),
            _call(traced, prefix, "step", "step", traced.inputs, parameters, own),
            _put(traced, prefix),
        ]
    )


def _call(
    traced: Traced,
    prefix: str,
    name: str,
    function: str,
    fields: Sequence[Field],
    parameters: str,
    own: str,
) -> str:
    places, at = {}, 0
    for field in traced.inputs:
        places[field.name] = at
        at += field.size
    lines, passed = [], []
    for field in fields:
        kind = {"float64": "double", "float32": "float", "bool": "bool"}[field.dtype.name]
        if field.is_array:
            lines.append(f"    {kind} {field.name}[{field.size}];")
        passed.append(field.name if field.is_array else f"({kind})in[{places[field.name]}]")
    for field in fields:
        kind = "double" if field.dtype.itemsize == 8 else "float"
        if field.is_array:
            for k in range(field.size):
                place = places[field.name] + k
                lines.append(f"    {field.name}[{k}] = ({kind})in[{place}];")
    call = f"{prefix}_{function}(state, {own}{', '.join([*passed, 'output'])})"
    head = (
        f"static {prefix}_status {name}({prefix}_state *state, {parameters}\n"
        f"    const double *in, {prefix}_output *output)"
    )
    return "\n".join([head, "{", *lines, f"    return {call};", "}", ""])


def _put(traced: Traced, prefix: str) -> str:
    lines, at = [], 0
    for field in traced.outputs:
        for k in range(field.size):
            name = f"output->{field.name}" + (f"[{k}]" if field.is_array else "")
            value = f"{name} ? 1.0 : 0.0" if field.dtype.kind == "b" else f"(double){name}"
            lines.append(f"    out[{at}] = {value};")
            at += 1
    head = f"static void put(const {prefix}_output *output, double *out)"
    return "\n".join([head, "{", *lines, "}", ""])
