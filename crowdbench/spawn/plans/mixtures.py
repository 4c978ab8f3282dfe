"""Mixtures of Gaussians of places: their moments, densities, and how many Gaussians they have.

No Gaussian stands for fewer than ten people and none of places is narrower than 0.3 m, so that
nothing recorded can be read from them.
"""

import numpy as np
from jaxtyping import Float

FEWEST = 10.0
"""Least number of people of a Gaussian."""
PRIOR = 20.0
"""Weight of what people have in common with those of other areas, in people.

Of 10, 20 and 40, 20 gives the highest held-out likelihood of trips in Grand Central, Hotel and
Zara. In ETH 40 and in the Forum 10 are better, by 0.02 and 0.01 nats per person."""
NARROWEST_M = 0.3
"""Least standard deviation of a place in any direction."""
DECIMALS = 5
"""Digits after the point in files. `widened` leaves room for what rounding takes away."""
_NUGGET = 1e-4
_COMPONENTS = (1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36)
_PATIENCE = 2
"""Numbers of components without a better criterion after which no larger ones are tried."""


Moments = tuple[Float[np.ndarray, " D"], Float[np.ndarray, "D D"]]
"""Mean and covariance."""


def moments(x: Float[np.ndarray, "n D"], weight: Float[np.ndarray, " n"]) -> Moments:
    """Weighted mean and covariance."""
    mean = weight @ x / weight.sum()
    off = x - mean
    return mean, (off * weight[:, None]).T @ off / weight.sum()


def mixed(own: Moments, share: float, usual: Moments) -> Moments:
    """Moments of people of whom this share is like some and the others are like usual ones."""
    off = own[0] - usual[0]
    between = share * (1 - share) * np.outer(off, off)
    mean, within = (
        share * of + (1 - share) * common for of, common in zip(own, usual, strict=True)
    )
    return mean, within + between


def log_gaussians(
    x: Float[np.ndarray, "n D"],
    mean: Float[np.ndarray, "C D"],
    covariance: Float[np.ndarray, "C D D"],
) -> Float[np.ndarray, "n C"]:
    """Log density of each Gaussian at each point."""
    root = np.linalg.cholesky(covariance)
    off = np.linalg.solve(root, (x.T[None] - mean[..., None]))
    half = np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=-1)
    constant = 0.5 * x.shape[1] * np.log(2 * np.pi)
    return np.asarray((-0.5 * (off**2).sum(axis=1) - half[:, None] - constant).T)


def widened(covariance: Float[np.ndarray, "*pairs D D"], *places: slice) -> np.ndarray:
    """Covariances with a standard deviation of at least 0.3 m in each direction of each place.

    All are made a little wider, so that they remain so, and positive definite, when they are
    rounded to `DECIMALS` (which changes eigenvalues by up to D / 2 units of the last digit).
    """
    found = (covariance + covariance.swapaxes(-1, -2)) / 2
    for place in places:
        value, vector = np.linalg.eigh(found[..., place, place])
        wide = np.maximum(value, NARROWEST_M**2)
        found[..., place, place] = (vector * wide[..., None, :]) @ vector.swapaxes(-1, -2)
    return np.asarray(found + _NUGGET * np.eye(covariance.shape[-1]))


def responsibilities(
    x: Float[np.ndarray, "n D"], least_variance: float, most: int = _COMPONENTS[-1]
) -> Float[np.ndarray, "n C"]:
    """Those of the best mixture whose components all stand for enough people.

    The number of components, at most `most`, is chosen by the Bayesian information criterion among
    those that have 20 people or more each on average. `least_variance` is added to all variances
    while the components are looked for.
    """
    import warnings

    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    best: tuple[float, np.ndarray] = np.inf, np.ones((len(x), 1))
    if len(x) < 2 * 2 * FEWEST:  # not even two components
        return best[1]
    in_vain = 0
    for count in _COMPONENTS:
        if in_vain == _PATIENCE or count > most or len(x) < 2 * FEWEST * count:
            break
        mixture = GaussianMixture(
            count, reg_covar=least_variance, max_iter=60, random_state=0, init_params="k-means++"
        )
        with warnings.catch_warnings():  # the criterion decides, whether it converged or not
            warnings.simplefilter("ignore", ConvergenceWarning)
            shares = mixture.fit(x).predict_proba(x)
        criterion, in_vain = mixture.bic(x), in_vain + 1
        if shares.sum(axis=0).min() >= FEWEST and criterion < best[0]:
            best, in_vain = (criterion, shares), 0
    return best[1]
