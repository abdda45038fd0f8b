"""Smoothing of curves, for the few figures that say so. Statistics are made of curves as they were measured."""

from __future__ import annotations

import numpy as np

from rrmctl.stats import Floats


def smooth(values: Floats, window: int) -> Floats:
    """Centred moving mean along the last axis; the window shrinks evenly at both ends, so that no curve is shifted.

    A straight line stays what it is, and so do the first and the last value.

    Args:
        values: [..., T].
        window: evaluations under the mean where there is room for them; odd.

    Raises:
        ValueError: the window is even or not positive.
    """
    if window < 1 or window % 2 == 0:
        raise ValueError(f"a centred window is an odd number of evaluations, not {window}")
    length = values.shape[-1]
    place = np.arange(length)
    reach = np.minimum(window // 2, np.minimum(place, length - 1 - place))
    means = [values[..., at - wide : at + wide + 1].mean(axis=-1) for at, wide in zip(place, reach, strict=True)]
    return np.stack(means, axis=-1)
