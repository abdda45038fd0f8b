"""Ways in which the runs of two methods could have been labelled, group after group.

If two methods are alike, every way to split the 2 n scores of a group into n and n was as likely as the one that came
about. A sequence says for each group which scores it gives to the first method; the first sequence is what was seen.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from math import comb

import numpy as np
import numpy.typing as npt

from rrmctl.stats.aggregate import Floats


@lru_cache(maxsize=4)
def sequences(group: int, looks: int, most: int, seed: int) -> tuple[Floats, ...]:
    """Signs of the scores in sequences of splits: for each group [B, 2 group], +1 / group or -1 / group.

    The first groups run through all their splits together, as long as `most` sequences have room for them, each as
    often as any other; the later ones are drawn at random, but for the first sequence, which changes nothing. With few
    groups of few runs that is every sequence there is. Such a set, taken after a random one of its own members, is
    distributed as before; so what was seen is, where the methods are alike, a member like any other. A test that lets
    through a share of at most alpha of the sequences then errs with a probability of at most alpha, however many there
    are: fewer only make it coarser.

    Args:
        group: runs of each method in a group.
        looks: groups.
        most: sequences, as a rule; never fewer than one group has splits.
        seed: of the generator of each group's splits, together with the group's number.
    """
    splits = _splits(group)
    listed = next((n for n in range(looks, 1, -1) if len(splits) ** n <= most), 1)
    repeats = 1 if listed == looks else max(1, most // len(splits) ** listed)
    total = repeats * len(splits) ** listed
    drawn = []
    for look in range(looks):
        if look < listed:
            which = np.arange(total) // len(splits) ** look % len(splits)
        else:
            which = np.random.default_rng([seed, look]).integers(len(splits), size=total)
            which[0] = 0
        drawn.append(splits[which])
        drawn[-1].flags.writeable = False  # shared by all who ask
    return tuple(drawn)


def _splits(group: int) -> Floats:
    """Every split, the observed one first: [C(2 group, group), 2 group]."""
    chosen: npt.NDArray[np.intp] = np.array(list(combinations(range(2 * group), group)))
    signs = np.full((comb(2 * group, group), 2 * group), -1.0 / group)
    np.put_along_axis(signs, chosen, 1.0 / group, axis=1)
    return signs
