"""The functions that C lacks without a library, or does not define for every operand.

Each is a text with the prefix `{p}`, the type `{T}` and its short name `{s}`, and names the
others that it calls."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .types import c_type, literal, short


class Helper(NamedTuple):
    """Its text, and the helpers that it needs: names with their types."""

    text: str
    needs: tuple[tuple[str, np.dtype], ...] = ()


def _real(dtype: np.dtype) -> dict[str, str]:
    """What the texts for a type of real numbers have in it."""
    info = np.finfo(dtype)
    number = lambda x: literal(x, dtype)
    wide = dtype.itemsize == 8
    reach, step = (900, 100) if wide else (100, 30)
    return {
        "I": "int64_t" if wide else "int32_t",
        "U": "uint64_t" if wide else "uint32_t",
        "zero": number(0.0),
        "one": number(1.0),
        "half": number(0.5),
        "three_halves": number(1.5),
        "whole": number(2.0**info.nmant),
        "split": number(2.0 ** ((info.nmant + 2) // 2) + 1.0),
        "most": "DBL_MAX" if wide else "FLT_MAX",
        "fast": "__FP_FAST_FMA" if wide else "__FP_FAST_FMAF",
        "suffix": "" if wide else "f",
        "armed": "8" if wide else "4",
        "guess": "UINT64_C(0x5fe6eb50c7b537a9)" if wide else "UINT32_C(0x5f375a86)",
        "tiny": number(2.0**-reach),
        "huge": number(2.0**reach),
        "up": number(2.0 ** (2 * step)),
        "down": number(2.0 ** (-2 * step)),
        "root_up": number(2.0**step),
        "root_down": number(2.0**-step),
        "steps": "4" if wide else "3",
    }


REAL = {
    "of_bits": """
static {T} {p}_of_bits_{s}({I} x)
{{
    union {{ {I} whole; {T} real; }} both;
    both.whole = x;
    return both.real;
}}
""",
    "bits": """
static {I} {p}_bits_{s}({T} x)
{{
    union {{ {I} whole; {T} real; }} both;
    both.real = x;
    return both.whole;
}}
""",
    "abs": """
static {T} {p}_abs_{s}({T} x)
{{
    return (x > {zero}) ? x : ({zero} - x);
}}
""",
    "fma": """
/* x y + z, rounded once but for the last bit (Dekker's product, Knuth's sum). */
static {T} {p}_fma_{s}({T} x, {T} y, {T} z)
{{
#if defined({fast})
    return __builtin_fma{suffix}(x, y, z);
#else
    const {T} product = x * y;
    const {T} x_wide = {split} * x;
    const {T} y_wide = {split} * y;
    const {T} x_high = x_wide - (x_wide - x);
    const {T} y_high = y_wide - (y_wide - y);
    const {T} x_low = x - x_high;
    const {T} y_low = y - y_high;
    const {T} lost = (((x_high * y_high) - product) + (x_high * y_low) + (x_low * y_high))
        + (x_low * y_low);
    const {T} sum = product + z;
    const {T} part = sum - product;
    const {T} rest = (product - (sum - part)) + (z - part);
    const {T} found = sum + (rest + lost);
    return (found == found) ? found : (product + z);
#endif
}}
""",
    "sqrt": """
/* By Newton's method on 1/sqrt(x), or by the processor where that takes no library. */
static {T} {p}_sqrt_{s}({T} x)
{{
#if defined(__NO_MATH_ERRNO__) && (defined(__SSE2__) || defined(__aarch64__) \\
    || (defined(__ARM_FP) && ((__ARM_FP & {armed}) != 0)))
    return __builtin_sqrt{suffix}(x);
#else
    {T} scale = {one};
    {T} inverse;
    {T} root;
    int k;
    if (!(x > {zero})) {{
        return (x == {zero}) ? x : (({zero} * x) / ({zero} * x));
    }}
    if (x > {most}) {{
        return x;
    }}
    if (x < {tiny}) {{
        x = x * {up};
        scale = {root_down};
    }} else if (x > {huge}) {{
        x = x * {down};
        scale = {root_up};
    }}
    inverse = {p}_of_bits_{s}(({I})({guess} - (({U}){p}_bits_{s}(x) >> 1)));
    for (k = 0; k < {steps}; ++k) {{
        inverse = inverse * ({three_halves} - (({half} * x) * inverse) * inverse);
    }}
    root = x * inverse;
    root = root + (({half} * inverse) * {p}_fma_{s}(-root, root, x));
    return root * scale;
#endif
}}
""",
    "rint": """
static {T} {p}_rint_{s}({T} x)
{{
    if (!({p}_abs_{s}(x) < {whole})) {{
        return x;
    }}
    return (x < {zero}) ? ((x - {whole}) + {whole}) : ((x + {whole}) - {whole});
}}
""",
    "floor": """
static {T} {p}_floor_{s}({T} x)
{{
    const {T} nearest = {p}_rint_{s}(x);
    return (nearest > x) ? (nearest - {one}) : nearest;
}}
""",
    "ceil": """
static {T} {p}_ceil_{s}({T} x)
{{
    const {T} nearest = {p}_rint_{s}(x);
    return (nearest < x) ? (nearest + {one}) : nearest;
}}
""",
    "products": """
/* Of every row of a matrix with every one of another: out[j m + i]. */
static void {p}_products_{s}({T} *out, const {T} *a, const {T} *b, size_t m, size_t n,
    size_t inner)
{{
    size_t i;
    size_t j;
    size_t k;
    for (j = 0U; j < n; ++j) {{
        for (i = 0U; i < m; ++i) {{
            {T} sum = a[i * inner] * b[j * inner];
            for (k = 1U; k < inner; ++k) {{
                sum = sum + (a[(i * inner) + k] * b[(j * inner) + k]);
            }}
            out[(j * m) + i] = sum;
        }}
    }}
}}
""",
}
NEEDS = {
    "sqrt": ("of_bits", "bits", "fma"),
    "rint": ("abs",),
    "floor": ("rint",),
    "ceil": ("rint",),
}
WHOLE = {
    "div": """
/* Towards zero; by zero all ones, and the least number by -1 itself. */
static {T} {p}_div_{s}({T} x, {T} y)
{{
    if (y == 0) {{
        return ({T})(~(({U})0));
    }}
    return {overflow}({T})(x / y);
}}
""",
    "shl": """
static {T} {p}_shl_{s}({T} x, {T} n)
{{
    return (({V})n < {bits}u) ? ({T})(({U})({V})x << ({V})n) : ({T})0;
}}
""",
    "lshr": """
static {T} {p}_lshr_{s}({T} x, {T} n)
{{
    return (({V})n < {bits}u) ? ({T})(({V})x >> ({V})n) : ({T})0;
}}
""",
    "ashr": """
static {T} {p}_ashr_{s}({T} x, {T} n)
{{
    const {V} by = (({V})n < {bits}u) ? ({V})n : ({V}){top}u;
    const {V} rest = ({V})(({V})x >> by);
    const {V} signs = ({V})(~({V})(({V})(~({V})0) >> by));
    return ({T})((x < 0) ? ({V})(rest | signs) : rest);
}}
""",
    "ones": """
static {T} {p}_ones_{s}({T} x)
{{
    {V} left = ({V})x;
    {T} count = 0;
    while (left != 0u) {{
        left = ({V})(left & ({V})(left - 1u));
        ++count;
    }}
    return count;
}}
""",
    "zeros": """
static {T} {p}_zeros_{s}({T} x)
{{
    {V} left = ({V})x;
    {T} count = {bits};
    while (left != 0u) {{
        left = ({V})(left >> 1);
        --count;
    }}
    return count;
}}
""",
}


def _whole(dtype: np.dtype) -> dict[str, str]:
    kind = c_type(dtype)
    signed = dtype.kind == "i"
    return {
        "V": f"uint{8 * dtype.itemsize}_t",
        "U": "uint64_t" if dtype.itemsize == 8 else "uint32_t",
        "bits": str(8 * dtype.itemsize),
        "top": str(8 * dtype.itemsize - 1),
        "overflow": f"(y == -1) ? ({kind})(0u - (uint64_t)x) : " if signed else "",
    }


def _to_whole(source: np.dtype) -> Callable[[np.dtype], str]:
    def text(dtype: np.dtype) -> str:
        bounds = np.iinfo(dtype)
        past = literal(float(bounds.max + 1), source)  # a power of two
        low = literal(float(bounds.min), source)
        least, most = (literal(x, dtype) for x in (bounds.min, bounds.max))
        return f"""
/* Towards zero, the next one where it is out of range, and zero where x is no number. */
static {{T}} {{p}}_to_{short(source)}_{{s}}({c_type(source)} x)
{{{{
    if (!(x > {low})) {{{{
        return (x == x) ? {least} : ({c_type(dtype)})0;
    }}}}
    return (x >= {past}) ? {most} : ({{T}})x;
}}}}
"""

    return text


def helper(name: str, dtype: np.dtype, prefix: str) -> Helper:
    """A function by its name: of a type, or, as `to_f64`, to one."""
    common = {"p": prefix, "T": c_type(dtype), "s": short(dtype)}
    if name.startswith("to_"):
        source = np.dtype({"f64": "float64", "f32": "float32"}[name[3:]])
        return Helper(_to_whole(source)(dtype).format(**common).strip("\n"))
    real = name in REAL and dtype.kind == "f"
    texts, more = (REAL, _real(dtype)) if real else (WHOLE, _whole(dtype))
    needs = NEEDS.get(name, ()) if real else ()
    text = texts[name].format(**common, **more).strip("\n")
    return Helper(text, tuple((other, dtype) for other in needs))
