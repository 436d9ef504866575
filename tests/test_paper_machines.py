"""Section 3 of the paper: the machines but the surface-mounted PMSM, and their claims."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_claims import kind, replaced, verdicts

import aslo_jax as aslo
from aslo_jax.paper._section3 import (
    machine_claims,
    machines as m,
    settings as s,
)
from aslo_jax.paper._section3.prescribed import PrescribedBearing, PrescribedMachine

PRINTED = s.Printed()


@pytest.fixture(scope="module")
def modulation():
    return m.modulation(PRINTED)


def test_a_prescribed_machine_is_a_solution_of_the_machine():
    machine = m.wrim()
    motion = PrescribedMachine(
        machine,
        lambda t: 1.5 * t + 0.3 * jnp.sin(t),
        lambda t: jnp.stack([jnp.cos(3 * t), jnp.sin(t), 0.4 + t, jnp.cos(t)]),
    )
    for t in jnp.array([0.0, 0.7]):
        x = aslo.plants.MachineState(motion.hidden(t), jnp.zeros(()), motion.angle(t))
        np.testing.assert_allclose(machine.output(x), motion.output(t), atol=1e-12)
        _, rate = jax.jvp(motion.hidden, (t,), (jnp.ones(()),))
        expected = machine.vector_field(t, x, motion.voltage(t)).flux
        np.testing.assert_allclose(rate, expected, atol=1e-12)


def test_a_prescribed_bearing_is_a_solution_of_the_bearing():
    plant = aslo.plants.MagneticBearing.laboratory()
    motion = PrescribedBearing(
        plant, lambda t: 1e-4 * jnp.sin(40 * t), lambda t: 6e-5 * (1 + 0.2 * jnp.cos(9 * t))
    )
    for t in jnp.array([0.0, 0.013]):
        _, rate = jax.jvp(motion.hidden, (t,), (jnp.ones(()),))
        x = plant.vector_field(t, motion.state(t), motion.voltage(t))
        expected = [*x.flux, x.position, x.velocity]
        np.testing.assert_allclose(rate, expected, rtol=1e-10)


def test_the_inductance_of_prop_3_fails_with_the_modulation(modulation):
    printed, right = (
        m.relative_by_depth(modulation, name) for name in ("as printed", "corrected")
    )
    assert right.max() < 1e-9 and printed[0] < 1e-9
    assert 0.07 < printed[-1] < 0.4
    # It grows in proportion at first: 3 % of modulation against 6 %.
    assert printed[2] / printed[1] == pytest.approx(2.0, rel=0.02)


def test_the_right_inductance_would_be_confirmed(modulation):
    name = "WRIM, L_s, both windings fed"
    claims = machine_claims.inductance(modulation)
    assert kind(claims, "corrected") == {name}
    assert PRINTED.winding(m.wrim(), "rotor").inductance == 0.1
    swapped = replaced(modulation, {"as printed": modulation.estimates["corrected"]})
    assert kind(machine_claims.inductance(swapped), "confirmed") == {c.name for c in claims}
    swapped = replaced(modulation, {"corrected": modulation.estimates["as printed"]})
    assert kind(machine_claims.inductance(swapped), "not reproduced") == {"WRIM, L_k"}


def test_the_claims_of_the_interior_pmsm():
    t = np.linspace(0.0, 1.2, 25)
    small = np.full((2, 3, 25), 1e-10)
    dropped = small.copy()
    dropped[1, 2] = 1e-3  # the last ratio, one of the angles
    right = m.Salient(t, dropped, small)
    assert set(verdicts(machine_claims.interior(right)).values()) == {"confirmed"}
    far = dropped.copy()
    far[0, 1, -1] = 3e-3
    found = verdicts(machine_claims.interior(m.Salient(t, far, far)))
    assert found == {
        "interior PMSM, d(t) dropped": "confirmed",
        "interior PMSM, no saliency": "not reproduced",
        "interior PMSM, self-consistent": "not reproduced",
    }
    found = verdicts(machine_claims.interior(m.Salient(t, 3 * dropped, small)))
    assert found["interior PMSM, d(t) dropped"] == "not reproduced"
