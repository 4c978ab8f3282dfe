"""Draws from mixtures and Gaussians."""

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.data.table import Indices


def choose(cumulative: Float[np.ndarray, "n C"], rng: Generator) -> Indices:
    """A random column in each row of cumulative weights, whose sums need not be 1."""
    u = rng.random((len(cumulative), 1)) * cumulative[:, -1:]
    return np.asarray((u >= cumulative).sum(axis=1))


def draw_normal(
    mean: Float[np.ndarray, "n D"], root: Float[np.ndarray, "n D D"], rng: Generator
) -> Float[np.ndarray, "n D"]:
    """A draw from each Gaussian; `root` are Cholesky factors of the covariances."""
    return mean + np.einsum("nij,nj->ni", root, rng.standard_normal(mean.shape))
