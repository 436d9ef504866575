"""What random programs are made of: operations of JAX as a user writes them, by type.

Types: `F` a real of the program's precision, `V` three of them, `I`, `L` and `U` whole
numbers (int32, int64, uint32), `B` a boolean. In an expression `{0}` stands for the first
operand, `{c}` for a constant, `{m}` for a small whole number, `{u}` for a positive one;
`F` is the type of reals, `T` a table of constants that all lanes share, and `p["c"]` one of
each lane.

Rounding: `R` marks what is rounded and `E` what is exact but for the sign of a zero, which
an engine may lose; `M` marks the operands too, of an expression whose terms may cancel. The
oracle moves what is rounded by some units in the last place and turns the sign of zeros, to
see what of a result is settled. The `log1p` of XLA is off by more, up to 128 units, between
-0.41 and -0.35, and is not asked for there.
"""

from typing import NamedTuple


class Operation(NamedTuple):
    """An expression of a `result` type; `smooth` where it has derivatives to compare."""

    result: str
    operands: str
    text: str
    rounding: str = ""
    smooth: bool = False
    weight: int = 1


def _all(result, operands, rounding, texts, smooth=False, weight=1):
    return [
        Operation(result, operands, text, rounding, smooth, weight)
        for text in texts.strip().splitlines()
        for text in [text.strip()]
    ]


SMOOTH = [
    *_all(
        "F",
        "FF",
        "R",
        """{0} + {1}
        {0} - {1}
        {0} * {1}
        R({c} * {0}) + R({c} * {1})
        R(p["y"] * {0}) + {1}
        {0} / R(1.0 + R({1} * {1}))
        {1} / p["d"]
        jnp.hypot(R(1.0 + {0}), {1})
        lax.cond({0} > {1}, lambda a, b: R(a * {c}), lambda a, b: R(b + {c}), {0}, {1})
        lax.fori_loop(0, 3, lambda j, z: R({c} * jnp.tanh(z) + {1}), {0})
        jnp.where({0} > {c}, {0} / jnp.where({0} > {c}, R(1.0 + {1} ** 2), 1.0), {1})""",
        smooth=True,
        weight=3,
    ),
    *_all(
        "F",
        "F",
        "R",
        """{c} * {0}
        {0} + {c}
        jnp.sin(R({0}))
        jnp.cos(R({c} * {0}))
        jnp.tanh({0})
        jnp.exp(-{0} * {0})
        jnp.sqrt(1.0 + {0} * {0})
        jnp.arctan({0})
        jnp.arctan2({0}, 2.0 + p["y"] * 0.1)
        jnp.log1p({0} * {0})
        jax.nn.sigmoid({0})
        {0} ** 3
        {0} * jnp.where({0} > 0, {c}, {c})
        jnp.stack([R({0}), R({c} * p["y"])]) @ jnp.array([{c}, {c}], F)""",
        smooth=True,
    ),
    *_all(
        "F",
        "V",
        "M",
        """jnp.sum({0})
        {0} @ {0}
        jnp.mean({0} * p["c"])
        jnp.sqrt(1.0 + jnp.sum({0} * {0}))""",
        smooth=True,
    ),
    *_all("F", "V", "E", "{0}[1]\n{0}[-1]", smooth=True),
    *_all("V", "FFF", "", "jnp.stack([{0}, {1}, {2}])", smooth=True, weight=3),
    *_all(
        "V",
        "VF",
        "M",
        """{c} * {0} + {1}
        {0} * p["c"]
        jnp.cross({0}, p["c"])
        {0}.at[1].set({1} * {c})
        {0}.at[0].add({1})
        jax.vmap(lambda a, b: R(a * jnp.tanh(b) + {1}))({0}, p["c"])
        jnp.array([[0.5, -0.2, 0.1], [0.3, 0.4, 0.0], [0.0, -0.6, 0.7]], F) @ {0}
        lax.scan(lambda a, b: (R(0.5 * a + b),) * 2, {1}, {0})[1]""",
        smooth=True,
    ),
]

REALS = [
    *_all(
        "F",
        "FF",
        "R",
        """{0} / {1}
        bounded({0}) % divisor({1})
        lax.rem(bounded({0}), divisor({1}))
        jnp.arctan2({0}, {1})
        jnp.abs({0}) ** {1}
        {0} ** {1}""",
    ),
    *_all(
        "F",
        "FF",
        "M",
        """jnp.logaddexp({0}, {1})
        jnp.linalg.det(jnp.stack([jnp.stack([{0}, 2.0 + {1}]), jnp.stack([{1}, {0}])]))""",
    ),
    *_all(
        "F",
        "F",
        "M",
        """jnp.interp({0}, jnp.array([-1.0, 0.0, 0.5], F), jnp.array([0.1, 1.0, -1.0], F))
        jnp.polyval(jnp.array([{c}, {c}, {c}], F), {0})""",
    ),
    *_all(
        "F",
        "F",
        "R",
        """jnp.sqrt({0})
        lax.rsqrt({0})
        jnp.exp({0})
        jnp.exp2({0})
        jnp.expm1({0})
        jnp.log({0})
        jnp.log1p(jnp.where(jnp.abs({0} + 0.38) < 0.036, 0.3, {0}))
        jnp.tan(R({0}))
        jnp.arcsin({0})
        jnp.arccos({0})
        jnp.sinh({0})
        jnp.cosh({0})
        {0} ** 0.5
        {0} ** -2
        {0} ** 2.5
        bounded({0}) % {u}.0
        bounded({0}) % 0.7
        1.0 / {0}
        {0}.astype(jnp.float32).astype(F)
        jnp.piecewise({0}, [{0} < -0.5, {0} > 0.5], [lax.neg, lambda z: R(z**2), 2])""",
    ),
    *_all(
        "F",
        "FF",
        "E",
        """jnp.maximum({0}, {1})
        jnp.minimum({0}, {1})
        jnp.fmax({0}, {1})
        jnp.copysign({0}, {1})
        jnp.clip({0}, {1}, 2.0)""",
    ),
    *_all(
        "F",
        "F",
        "E",
        """jnp.floor({0})
        jnp.ceil({0})
        jnp.round({0})
        jnp.trunc({0})
        jnp.sign({0})
        jnp.abs({0})
        -{0}
        jnp.clip({0}, -1.0, 2.0)
        jnp.nan_to_num({0}, nan={c}, posinf=3.0, neginf=-3.0)
        jnp.where(jnp.isfinite({0}), {0}, {c})""",
    ),
    *_all(
        "F",
        "BFF",
        "",
        """jnp.where({0}, {1}, {2})
        lax.cond({0}, lambda a, b: a, lambda a, b: R(a - b), {1}, {2})
        lax.select({0}, {2}, {1})""",
        weight=2,
    ),
    *_all(
        "F",
        "IFF",
        "",
        """lax.switch({0}, [lambda a, b: a, lambda a, b: R(a + b), jnp.fmax], {1}, {2})
        T[{0}] + 0.0 * p["y"]
        p["c"][{0}]
        lax.dynamic_index_in_dim(p["c"], {0}, keepdims=False)
        T.reshape(8, 10)[{0}, {0} // 3]
        jnp.stack([jnp.stack([{1}, {2}]), p["c"][:2]])[{0}, {0} % 3]
        jnp.choose({0}, [{1}, {2}, p["y"]], mode="clip")
        jnp.select([{0} > 2, {0} < -1], [{1}, {2}], p["y"])""",
    ),
    *_all("F", "I", "", "{0}.astype(F)"),
    *_all("F", "L", "R", "{0}.astype(F)\nT[{0} % 80]"),
    *_all("F", "U", "R", "{0}.astype(F)"),
    *_all("F", "B", "", "{0}.astype(F)"),
    *_all(
        "F",
        "V",
        "E",
        "jnp.max({0})\njnp.min({0})\njnp.median({0})\njnp.sort({0})[1]",
    ),
    *_all("F", "V", "M", "jnp.prod({0})\njnp.linalg.norm({0})\njnp.std({0})"),
    *_all("F", "VI", "", "{0}[{1}]"),
    *_all(
        "V",
        "V",
        "M",
        """jnp.cumsum({0})
        jnp.cumprod({0})
        jnp.cumsum({0}[::-1])
        lax.cumsum({0}, reverse=True)
        jnp.diff({0}, append=0.5)
        jnp.linalg.solve(R(jnp.diag(2.0 + jnp.cos({0})) + 0.3 * p["c"][:, None]), p["c"])
        R(jnp.linalg.inv(R(jnp.diag(1.5 + jnp.tanh(p["c"])) + 0.2))) @ {0}
        jnp.linalg.cholesky(R(jnp.diag(2.0 + jnp.sin({0})) + 0.1))[2]
        lax.associative_scan(lambda a, b: R(a * b), {0})""",
    ),
    *_all(
        "V",
        "V",
        "E",
        """lax.cummax({0})
        lax.cummin({0}, reverse=True)
        jnp.sort({0})
        jnp.sort({0}, descending=True)
        jnp.roll({0}, 1)
        {0}[::-1]
        {0}[jnp.array([2, 0, 0])]
        jnp.maximum({0}, p["c"])
        jnp.where({0} > 0, {0}, p["c"])
        {0}[jnp.argsort({0})]""",
    ),
    *_all(
        "V",
        "VIF",
        "",
        """jnp.where(jnp.arange(3) == {1}, {2}, {0})
        {0}.at[{1}].set({2})
        lax.dynamic_slice(jnp.concatenate([{0}, p["c"]]), ({1},), (3,))
        jnp.concatenate([{0}[1:], {2}[None]])
        jnp.take({0}, jnp.stack([{1}, {1} - 1, {1} + 1]), mode="clip")
        lax.cond({1} > 1, lambda a: a[::-1], lambda a: R(a + {2}), {0})""",
    ),
]

WHOLE = [
    *[
        operation
        for kind in "ILU"
        for operation in _all(
            kind,
            kind * 2,
            "",
            """{0} + {1}
            {0} - {1}
            {0} * {1}
            {0} // {1}
            {0} % {1}
            lax.div({0}, {1})
            lax.rem({0}, {1})
            {0} & {1}
            {0} | {1}
            {0} ^ {1}
            {0} << {1}
            {0} >> {1}
            lax.shift_right_logical({0}, {1})
            jnp.maximum({0}, {1})
            jnp.clip({0}, jnp.minimum({0}, {1}), {1})
            jnp.where({1} != 0, {0} // {1}, {1})
            lax.fori_loop(0, 3, lambda j, z: z * {1} + j.astype(z.dtype), {0})""",
        )
    ],
    *[
        operation
        for kind in "ILU"
        for operation in _all(
            kind,
            kind,
            "",
            """{0} + {m}
            {0} * {u}
            {0} // {u}
            {0} % {u}
            {0} // {m}
            lax.rem({0}, jnp.asarray({m}, {0}.dtype))
            {0} << {u}
            {0} >> {u}
            ~{0}
            -{0}
            jnp.abs({0})
            jnp.sign({0})
            {0} ** 2
            {0} ** 3
            (100 // {0})
            jnp.clip({0}, {u}, 9)""",
        )
    ],
    *_all(
        "I",
        "F",
        "",
        """{0}.astype(jnp.int32)
        jnp.floor({0}).astype(jnp.int32)
        jnp.clip(jnp.floor({0}).astype(jnp.int32), 0, 7)
        jnp.round({0}).astype(jnp.int16).astype(jnp.int32)
        {0}.astype(jnp.int8).astype(jnp.int32)
        {0}.astype(jnp.uint8).astype(jnp.int32)
        jnp.digitize({0}, jnp.array([-1.0, 0.0, 0.4, 2.0], F)).astype(jnp.int32)
        jnp.searchsorted(jnp.array([-1.0, 0.0, 0.4, 2.0], F), {0}).astype(jnp.int32)""",
    ),
    *_all("L", "F", "", "{0}.astype(jnp.int64)\njnp.rint({0}).astype(jnp.int64)"),
    *_all("U", "F", "", "{0}.astype(jnp.uint32)"),
    *_all(
        "I",
        "V",
        "",
        """jnp.argmax({0}).astype(jnp.int32)
        jnp.argmin({0}).astype(jnp.int32)
        jnp.sum({0} > 0).astype(jnp.int32)
        jnp.argsort({0})[0].astype(jnp.int32)""",
    ),
    *_all("I", "L", "", "{0}.astype(jnp.int32)"),
    *_all("I", "U", "", "{0}.astype(jnp.int32)\nlax.bitcast_convert_type({0}, jnp.int32)"),
    *_all("I", "B", "", "{0}.astype(jnp.int32)"),
    *_all("L", "I", "", "{0}.astype(jnp.int64)\nk + {0}"),
    *_all("L", "U", "", "{0}.astype(jnp.int64)"),
    *_all("U", "I", "", "{0}.astype(jnp.uint32)"),
    *_all("U", "L", "", "{0}.astype(jnp.uint32)"),
    *_all("I", "BII", "", "jnp.where({0}, {1}, {2})", weight=3),
    *_all(
        "I",
        "III",
        "",
        """lax.switch({0}, [lax.add, lambda a, b: a // b, lambda a, b: b], {1}, {2})
        jnp.stack([{1}, {2}, {0}])[{0}]
        jnp.cumsum(jnp.stack([{0}, {1}, {2}]))[1]
        jnp.sort(jnp.stack([{0}, {1}, {2}]))[0]
        jnp.argmax(jnp.stack([{0}, {1}, {2}])).astype(jnp.int32)
        jnp.array([3, 1, 4, 1, 5, 9, 2, 6], jnp.int32)[{0}] + {1}""",
    ),
    *_all("L", "BLL", "", "jnp.where({0}, {1}, {2})"),
    *_all("U", "BUU", "", "lax.select({0}, {1}, {2})"),
]

LOGIC = [
    *_all(
        "B",
        "FF",
        "",
        "{0} > {1}\n{0} <= {1}\n{0} == {1}\n{0} != {1}\n~({0} < {1})",
        weight=2,
    ),
    *_all("B", "F", "", "{0} > {c}\n{0} >= 0\njnp.isnan({0})\njnp.isfinite({0})\n{0} == 0"),
    *_all("B", "II", "", "{0} > {1}\n{0} == {1}"),
    *_all("B", "L", "", "{0} % 3 == 0\n{0} > 2"),
    *_all("B", "UU", "", "{0} < {1}\n{0} > {1}"),
    *_all("B", "BB", "", "{0} & {1}\n{0} | {1}\n{0} ^ {1}\n{0} & ~{1}\n{0} == {1}"),
    *_all("B", "B", "", "~{0}\njnp.logical_not({0})"),
    *_all("B", "V", "", "jnp.any({0} > 0)\njnp.all({0} > -0.5)\njnp.isnan({0}).any()"),
    *_all("B", "I", "", "{0}.astype(bool)\n({0} & 1) == 1"),
]

OPERATIONS = [*SMOOTH, *REALS, *WHOLE, *LOGIC]

# Which an engine may refuse.
HALVES = _all(
    "F",
    "F",
    "E",
    """{0}.astype(jnp.float16).astype(F)
    {0}.astype(jnp.bfloat16).astype(F)""",
    weight=40,
)
