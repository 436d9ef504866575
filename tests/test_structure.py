"""Which mechanical systems have an algebraic observer of their velocities, and why not."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from mechanisms import GENERAL, SYSTEMS

import aslo_jax as aslo
from aslo_jax.observers import velocity_observer
from aslo_jax.plants import InertiaWheelPendulum, MechanicalSystem, RoboticLeg
from aslo_jax.structure import StructureError, structure_of


def system(inertia, friction=None, position=(0.5, 0.6)):
    return MechanicalSystem(inertia, position=position, friction=friction)


STAGES = {
    "leg": ((1, 2), (0,)),
    "ball": ((1,), (0,)),
    "cart": ((1,), (0,)),
    "wheel": ((0, 1),),
    "pendulum": ((1,), (0,)),
    "general": ((2, 3), (0, 1), (4,)),  # q1 needs q3', q2 also q4', q5 needs q2'
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_velocities_are_found_in_stages(name):
    found = structure_of(SYSTEMS[name])
    assert found.stages == STAGES[name]
    assert set(found.friction) == {"none"}


def test_constant_inertias_are_known_as_such():
    assert structure_of(GENERAL).constant == (True, False, False, False, True)


def test_the_swapped_choice_is_covered():
    """The upper block depends on q2, the lower one is constant (paper, section 4.3)."""
    found = structure_of(system(lambda q: jnp.stack([1.0 + q[1] ** 2, 0 * q[0] + 2.0])))
    assert found.stages == ((0,), (1,))


def test_the_kinds_of_friction():
    leg = structure_of(RoboticLeg(2.0, 3.0, [0.5, 0.0, 0.2]))
    assert leg.friction == ("constant", "none", "constant")
    wheel = structure_of(InertiaWheelPendulum(0.1, 0.2, 1.0, [0.1, 0.3]))
    assert wheel.friction == ("constant", "constant")
    varying = lambda q: jnp.stack([0.3 + 0.0 * q[0], 0.2 + q[0] ** 2])
    found = structure_of(system(lambda q: jnp.stack([1.0, 1.0 + q[0] ** 2]), varying))
    assert found.friction == ("constant", "varying")
    assert "q2', then q1'" in str(found)
    assert "q2: varying with position" in str(found)


@pytest.mark.parametrize(
    ("inertia", "friction", "message"),
    [
        (
            lambda q: jnp.array([[2.0, 0.3], [0.3, 1.0]]),
            None,
            r"Assumption 2 fails: the inertia matrix is not diagonal, M\[0, 1\] = 0.3 at",
        ),
        (
            lambda q: jnp.stack([1.0 + q[0] ** 2, 1.0]),
            None,
            r"Assumption 2 fails: the inertia M\[0, 0\] of q1 depends on q1 itself",
        ),
        (
            lambda q: jnp.stack([1.0 + q[1] ** 2, 1.0 + q[0] ** 2]),
            None,
            r"no velocity can be found first.*M\[1, 1\] on q1, M\[0, 0\] on q2",
        ),
        (
            lambda q: jnp.ones(2),
            lambda q: jnp.array([[1.0, 0.1 * q[0]], [0.1 * q[0], 1.0]]),
            r"Assumption 3 fails: the friction R\[0, 1\] couples q1 with q2",
        ),
        (lambda q: jnp.ones(2), lambda q: -jnp.ones(2), r"R\[0, 0\] must not be negative"),
        (
            lambda q: jnp.ones(2),
            lambda q: jnp.array([[1.0, 0.1], [0.0, 1.0]]),
            r"friction matrix R\(q\) must be symmetric",
        ),
        (
            lambda q: jnp.stack([1.0, q[0] - 0.4]),
            None,
            r"M\[1, 1\] must be positive.*give the `region`",
        ),
    ],
)
def test_what_is_not_of_the_class_is_refused_and_why(inertia, friction, message):
    with pytest.raises(StructureError, match=message):
        velocity_observer(system(inertia, friction), aslo.LowPass(5.0))


def test_every_refusal_of_the_class_says_what_to_use_instead():
    with pytest.raises(StructureError, match=r"ExtendedKalman\.of_mechanical"):
        structure_of(system(lambda q: jnp.array([[2.0, 0.3], [0.3, 1.0]])))


def test_the_region_decides():
    """An entry that varies only beyond 1 is constant on a region below it."""
    bent = lambda q: jnp.stack([1.0 + jnp.maximum(q[0] - 1.0, 0.0) ** 2, 2.0 + q[0]])
    assert structure_of(system(bent), ([0.1, 0.1], [0.9, 0.9])).constant == (True, False)
    with pytest.raises(StructureError, match="depends on q1 itself, as it does at q = "):
        structure_of(system(bent), ([0.1, 0.1], [2.0, 0.9]))
    for region in (([0.0], [1.0]), ([0.0, 1.0], [1.0, 1.0])):
        with pytest.raises(ValueError, match="`region` must be a pair of bounds"):
            structure_of(system(bent), region)


def test_a_filter_slower_than_varying_friction_is_refused():
    friction = lambda q: jnp.stack([0.0 * q[0], 2.0 + q[0]])
    slow = system(lambda q: jnp.stack([1.0, 0.5]), friction)
    region = ([0.0, 0.0], [1.0, 1.0])
    with pytest.raises(
        ValueError, match=r"rate above the friction of q2 .* 5\.9\d+ 1/s at"
    ):
        velocity_observer(slow, aslo.LowPass(5.5), region=region)
    velocity_observer(slow, aslo.LowPass(6.5), region=region)


def test_the_form_can_be_known_already():
    form = structure_of(GENERAL)
    again = dataclasses.replace(form)
    observer = velocity_observer(GENERAL, aslo.LowPass(5.0), form=again)
    assert observer.velocities.stages == form.stages


def test_an_initial_guess_of_wrong_length_is_refused():
    with pytest.raises(ValueError, match="`initial` must have one velocity for each of"):
        velocity_observer(GENERAL, aslo.LowPass(5.0), initial=np.zeros(3))
