"""The names of the studies that come with the library, for help that imports no JAX."""

NAMES = (
    "double_integrator",
    "pmsm",
    "wrim",
    "robotic_leg",
    "ball_beam",
    "magnetic_bearing",
)
