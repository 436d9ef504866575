"""What the tests of the explorer share."""

import base64

import numpy as np


def unpacked(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


def drawing(found) -> list[str]:
    """Everything that is drawn of a run."""
    return [line["values"] for panel in found["panels"] for line in panel["lines"]]
