"""Random generators by purpose: what one is drawn from never appears in another."""

import numpy as np

PURPOSES = ("train", "calibration", "test", "bench")


def rng(purpose: str, seed: int, stream: int = 0) -> np.random.Generator:
    """Return the generator of a purpose, a seed (0 or more) and a stream within it.

    Streams of one seed are independent too, so a data set can be drawn item by item.

    Raises
    ------
    ValueError : a purpose that is not one of ``PURPOSES``, or a negative number.
    """
    return np.random.default_rng([PURPOSES.index(purpose), seed, stream])
