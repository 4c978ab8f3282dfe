"""Mixtures of Gaussians whose components all stand for enough people."""

import warnings

import numpy as np
from jaxtyping import Float

FEWEST = 10.0
"""Least number of people of a component, so that nothing recorded can be read from it."""
_COMPONENTS = (1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36)


def responsibilities(
    x: Float[np.ndarray, "n D"], seed: int = 0, most: int = _COMPONENTS[-1]
) -> Float[np.ndarray, "n C"]:
    """P(component | sample) of the best such mixture, by the Bayesian information criterion.

    It has at most `most` components.
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    best: tuple[float, np.ndarray] = np.inf, np.ones((len(x), 1))
    for count in _COMPONENTS:
        if count > most or (count > 1 and len(x) < 2 * FEWEST * count):
            break
        mixture = GaussianMixture(
            count, reg_covar=1e-2, max_iter=60, random_state=seed, init_params="k-means++"
        )
        with warnings.catch_warnings():  # the criterion decides, whether it converged or not
            warnings.simplefilter("ignore", ConvergenceWarning)
            shares = mixture.fit(x).predict_proba(x)
        criterion = mixture.bic(x)
        if shares.sum(axis=0).min() >= FEWEST and criterion < best[0]:
            best = criterion, shares
    return best[1]
