"""Plants: the systems whose states are observed."""

from .base import AbstractPlant as AbstractPlant
from .chain import ChainRelation as ChainRelation, IntegratorChain as IntegratorChain
from .pmsm import PMSM as PMSM, FluxRelation as FluxRelation, PMSMState as PMSMState
