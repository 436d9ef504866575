"""The studies that come with the library, for commands that import no JAX."""

from importlib.resources import files

NAMES = (
    "double_integrator",
    "pmsm",
    "wrim",
    "robotic_leg",
    "ball_beam",
    "magnetic_bearing",
    "buck",
    "boost",
    "cuk",
    "synchronous_reluctance",
    "dc_motor",
    "dc_motor_with_tachometer",
    "levitation",
    "battery",
    "lateral_vehicle",
    "chemostat",
    "van_der_pol",
    "lorenz",
    "cart_pole",
    "drone",
)


def ready_made(name: str) -> str:
    """The text of the study of that name."""
    return (files("aslo_jax.study") / "configs" / f"{name}.toml").read_text("utf-8")
