"""Random programs as C have the results of scan."""

import pytest
from compiled_programs import outcome
from random_programs import generate, source

pytest.importorskip("llvmlite")
FEW = (0, 1, 2, 3)


@pytest.mark.parametrize(
    "seed", [*FEW, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(4, 40))]
)
def test_a_program_gives_what_scan_gives(seed, tmp_path):
    code = generate(seed)
    found = outcome(code, tmp_path)
    assert not found.wrong, f"{found.wrong}\n{source(code)}"
    assert found.refused or found.compared > 10 * found.unsettled
