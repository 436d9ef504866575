"""Tuning by gradients: losses, the descent, design charts."""

from . import losses as losses
from .descent import History as History
from .fit import Fitted as Fitted, fit as fit
from .stationary import stationary_variance as stationary_variance
