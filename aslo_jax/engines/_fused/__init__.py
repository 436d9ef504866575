"""The fused engine: loops compiled from functions, batches, tangents and replays."""

from .batch import Fused as Fused
from .program import Bodies as Bodies, Program as Program
