"""The studies that come with the library, for commands that import no JAX."""

from importlib.resources import files

NAMES = (
    "double_integrator",
    "pmsm",
    "wrim",
    "robotic_leg",
    "ball_beam",
    "magnetic_bearing",
)


def ready_made(name: str) -> str:
    """The text of the study of that name."""
    return (files("aslo_jax.study") / "configs" / f"{name}.toml").read_text("utf-8")
