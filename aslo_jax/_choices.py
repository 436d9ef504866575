"""What arguments and files are chosen from."""

from typing import Literal, TypeAlias

# How an observer's filters start; how rows are completed, in files.
FilterStart: TypeAlias = Literal["exact", "paper"]
CompletionName: TypeAlias = Literal["least-squares", "repeat"]

# Which engine is asked for, and which one runs.
Engine: TypeAlias = Literal["auto", "fused", "scan"]
RunningEngine: TypeAlias = Literal["fused", "scan"]
# The same in continuous time.
ContinuousEngine: TypeAlias = Literal["auto", "diffrax", "fused"]

# What a recorded input is between its samples.
Hold: TypeAlias = Literal["linear", "zero"]

MOST_SUBSTEPS = 1000  # of a sampling interval

# What becomes of samples that are missing.
Missing: TypeAlias = Literal["refuse", "coast", "interpolate"]

# How the samples of a study are laid out, and what its bound averages.
DesignName: TypeAlias = Literal["iid", "lhs", "sobol"]
Average: TypeAlias = Literal["bounds", "information"]

# How a fit takes derivatives, in which scale it tunes a leaf, and why it ended.
Mode: TypeAlias = Literal["auto", "forward", "reverse"]
UsedMode: TypeAlias = Literal["forward", "reverse"]
Scale: TypeAlias = Literal["auto", "log", "linear"]
Stopped: TypeAlias = Literal["converged", "no improvement", "iteration limit", "not finite"]

# What a datasheet may mean.
Amplitude: TypeAlias = Literal["peak", "rms"]
Between: TypeAlias = Literal["lines", "phase"]
Per: TypeAlias = Literal["krpm", "rad/s"]
Speed: TypeAlias = Literal["mechanical", "electrical"]
Connection: TypeAlias = Literal["star", "delta"]

# Errors of a record that a calibration finds besides the parameters.
RecordError: TypeAlias = Literal[
    "offset",
    "input_offset",
    "gain",
    "dead_time",
    "threshold",
    "delay",
    "encoder_offset",
]

# The windings of a wound-rotor machine.
Winding: TypeAlias = Literal["stator", "rotor"]

__all__ = [
    "Amplitude",
    "Average",
    "Between",
    "CompletionName",
    "Connection",
    "ContinuousEngine",
    "DesignName",
    "Engine",
    "FilterStart",
    "Missing",
    "Mode",
    "Per",
    "RecordError",
    "RunningEngine",
    "Scale",
    "Speed",
    "Stopped",
    "UsedMode",
    "Winding",
]
