"""The keys of `[observer]` that kinds share."""

from typing import Any, Literal

from .._choices import RecordError
from ..schema import Positive, Table, key

Completion = Literal["least-squares", "repeat"]
Start = Literal["exact", "paper"]


def cutoff(
    default: str = "from the log", example: float = 150.0, allowed: str | None = None
) -> Any:
    text = f"cutoff of the filter, by default {default}"
    return key(text, "rad/s", default=None, example=example, allowed=allowed)


def forgetting(allowed: str | None = None) -> Any:
    text = "rate at which the least squares forget, by default that of the filter"
    full = f"{text}, or for the noise of the log"
    return key(full, "rad/s", default=None, example=80.0, allowed=allowed)


def completion() -> Any:
    return key("from one row to two", default="least-squares")


def start() -> Any:
    return key("how the filters start", default="exact")


def gain(default: str = "none, an ASLO") -> Any:
    return key(
        f"gain of an A-ASLO, by default {default}", "rad/s", default=None, example=50.0
    )


def threshold(default: float = 1e-3) -> Any:
    return key("certificate below which the estimate coasts", default=default)


def pll_bandwidth() -> Any:
    return key(
        "bandwidth of the phase-locked loop, by default 100, more for a log that "
        "accelerates fast, and at most half of the sampling rate",
        "rad/s",
        default=None,
        example=100.0,
    )


class CalibrationTable(Table):
    """`[calibration]`: what `aslo-jax calibrate` does where its options do not say."""

    fit: list[RecordError] = key(
        "errors of the record that are found as well", default=[], example=["offset"]
    )
    resolution: Positive = key(
        "a parameter is determined where the half width of its interval is less than this "
        "share of it",
        default=0.01,
    )
