"""Names, units and numbers as people read them."""

import math

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_SYMBOLS = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "theta": "θ", "lambda": "λ",
    "phi": "φ", "psi": "ψ", "omega": "ω",
}  # fmt: skip
# Units of what a log measures, by the first letter of its column; SI throughout.
_MEASURED = {"u": "V", "v": "V", "i": "A"}


def symbol(name: str) -> str:
    """The name of a column with symbols: `u_alpha` is u α, `qdot1` is q̇₁."""
    return " ".join(_word(word) for word in name.split("_") if word) or name


def _word(word: str) -> str:
    if word in _SYMBOLS:
        return _SYMBOLS[word]
    stem = word.rstrip("0123456789")
    index = word[len(stem) :].translate(_LOWERED)
    if stem.endswith("dot") and len(stem) == 4:
        stem = stem[0] + "\u0307"
    short = len(stem.replace("\u0307", "")) == 1
    return stem + index if short and index else word


def measured_unit(name: str) -> str:
    """The unit of a measured column of a machine, empty where its name does not tell."""
    first = name.partition("_")[0]
    return _MEASURED.get(first, "") if "_" in name else ""


def with_unit(label: str, unit: str) -> str:
    """A label and its unit in parentheses, which a dimensionless one has not."""
    return f"{label} ({unit})" if unit not in ("", "1") else label


def number(x: float, digits: int = 3) -> str:
    """`x` with so many significant digits; powers of ten where it is large or small."""
    if math.isnan(x):
        return "–"
    if math.isinf(x):
        return "∞" if x > 0 else "−∞"
    if x == 0.0:
        return "0"
    exponent = int(f"{x:.{digits - 1}e}".partition("e")[2])
    if -3 <= exponent < digits + 2:
        text = f"{x:.{max(0, digits - 1 - exponent)}f}"
    else:
        text = f"{x / 10.0**exponent:.{digits - 1}f}×{power(exponent)}"
    return text.replace("-", "−")


def power(exponent: int) -> str:
    """`10` with a raised exponent."""
    return "10" + str(exponent).translate(_RAISED)


def mark(x: float) -> str:
    """A number at a tick: no more digits than it takes."""
    if x == 0.0 or 1e-3 <= abs(x) < 1e5:
        return f"{x:.6g}".replace("-", "−")
    exponent = math.floor(math.log10(abs(x)) + 1e-9)
    mantissa = f"{x / 10.0**exponent:.5g}".replace("-", "−")
    tens = power(exponent)
    return {"1": tens, "−1": f"−{tens}"}.get(mantissa, f"{mantissa}×{tens}")
