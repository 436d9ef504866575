"""Datasheet values to the amplitude-invariant parameters of [`PMSM`][]."""

from ._datasheet import (
    MISTAKES as MISTAKES,
    RAD_PER_S_PER_KRPM as RAD_PER_S_PER_KRPM,
    Quantity as Quantity,
    agreed_flux as agreed_flux,
    emf_from_flux as emf_from_flux,
    flux_from_emf as flux_from_emf,
    flux_from_torque as flux_from_torque,
    star_equivalent as star_equivalent,
    torque_from_flux as torque_from_flux,
)

__all__ = [
    "MISTAKES",
    "RAD_PER_S_PER_KRPM",
    "Quantity",
    "agreed_flux",
    "emf_from_flux",
    "flux_from_emf",
    "flux_from_torque",
    "star_equivalent",
    "torque_from_flux",
]
