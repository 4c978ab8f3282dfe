"""Slow waves of arrivals: random factors of the rates that last for seconds to minutes.

The logarithm of the factor of area a is a sum of stationary Gaussian processes z_j, minus half of
its variance, so that the mean factor is 1: a log-Gaussian Cox process (Møller, Syversveen and
Waagepetersen 1998, Scandinavian Journal of Statistics 25). z_j is a process over all areas with
the covariance B_j (1 + |h| / τ_j) exp(−|h| / τ_j), a Matérn covariance of order 3/2. With the
covariance exp(−|h| / τ_j) instead, waves would change too fast: in Grand Central, correlations are
the same at delays from 2 to 30 s.

The covariances are found by moments. For persons who enter independently of each other given the
factors, E[n_a(t) n_b(t + h)] = m_a m_b exp(C_ab(h)) for h > 0, with C the covariance of the
logarithms of the factors (ibid., theorem 1). The means m are those of the recording itself, which
contain a part of its slow waves. Therefore correlations are lower than exp(C(h)), by a factor of
about exp(C̄), where C̄ is the mean of C over all pairs of observed times: the integral constraint of
correlation functions (Peebles 1980, The Large-Scale Structure of the Universe, § 32).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.companions import ENTRY_S
from crowdbench.spawn.events import Arrivals

SCALES_S = (10.0, 30.0, 90.0, 270.0)
"""Candidates for τ: those that the recording is long enough for are used."""
STEP_S = 0.8
"""Shortest lag, and step of the factors; at least a step of the annotation grid."""
LEAST_LAG_S = ENTRY_S
"""Shortest delay at which correlations are due to waves: at shorter ones, companions enter."""
_LAGS_PER_SCALE = 3.0  # the longest lag is this number of times the longest scale
_SHORTEST_STRETCHES = 10.0  # a scale is used if the observed time is this number of times as long
_BINS_PER_OCTAVE = 3
_PRIOR_PERSONS = 100.0
"""Weight of the mean of all areas in the pair correlation of one area, persons."""
_LEAST = 0.05  # least pair correlation, of which the logarithm is taken
_TOTAL = 10.0  # weight of the total rate in the least squares
_STEPS = 500
_MOST = 4.0  # largest variance of the logarithm of a factor, for one scale and area


@dataclass(frozen=True, eq=False)
class PairCorrelations:
    """Pair correlations g_ab(h) of arrivals in `L` bins of lags."""

    lag_s: Float[np.ndarray, " L"]
    """Mean lag of each bin, seconds."""
    correlation: Float[np.ndarray, "L K K"]
    """E[n_a(t) n_b(t + h)] / m_a m_b; 1 for independent arrivals."""
    weight: Float[np.ndarray, " L"]
    """Number of pairs of intervals in each bin."""
    persons: Float[np.ndarray, " K"]
    """Number of persons of each area."""


@dataclass(frozen=True, eq=False)
class Waves:
    """The Gaussian processes of `J` scales for `K` areas."""

    tau_s: Float[np.ndarray, " J"]
    """Time constants, seconds."""
    covariance: Float[np.ndarray, "J K K"]
    """B_j: the covariance of the logarithms of the factors."""

    def variance(self) -> Float[np.ndarray, " K"]:
        """Variance of the logarithm of each area's factor."""
        return np.asarray(np.einsum("jkk->k", self.covariance))

    def roots(self) -> Float[np.ndarray, "J K K"]:
        """Matrices L_j with L_j L_jᵀ = B_j, also for covariances without full rank."""
        value, vector = np.linalg.eigh(self.covariance)
        return np.asarray(vector * np.sqrt(np.clip(value, 0, None))[:, None, :])

    def correlations(self, delay_s: Float[np.ndarray, " L"]) -> Float[np.ndarray, "L J"]:
        """Autocorrelation of each scale at these delays, seconds."""
        ratio = delay_s[:, None] / self.tau_s
        return np.asarray((1 + ratio) * np.exp(-ratio))

    def recursion(self, step_s: float) -> Float[np.ndarray, "J 4"]:
        """Coefficients of each scale's recursion over intervals of `step_s` seconds.

        With the columns a, b, σ and r: z(t) = a z(t − 1) + b z(t − 2) + σ ε(t), where ε is white
        noise, and z has the variance 1 and the autocorrelation r at a delay of one interval.
        """
        stay = np.exp(-step_s / self.tau_s)
        a, b = 2 * stay, -(stay**2)
        r = a / (1 - b)
        return np.column_stack([a, b, np.sqrt((1 - r * r) * (1 - b * b)), r])

    def factors(
        self, steps: int, step_s: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "T K"]:
        """Draw the factors of all areas in `steps` intervals of `step_s` seconds."""
        from scipy.signal import lfilter

        areas = self.covariance.shape[1]
        total = np.broadcast_to(-0.5 * self.variance(), (steps, areas)).copy()
        for (a, b, sigma, r), root in zip(self.recursion(step_s), self.roots(), strict=True):
            noise = rng.standard_normal((steps + 2, areas)) @ root.T
            first = noise[0]  # the first two are stationary
            second = r * first + np.sqrt(1 - r * r) * noise[1]
            before = np.stack([a * second + b * first, b * second])
            total += lfilter([1.0], [1.0, -a, -b], sigma * noise[2:], axis=0, zi=before)[0]
        return np.exp(total)


def pairs_of(arrivals: Arrivals, *, longest_s: float) -> PairCorrelations:
    """Pair correlations of the persons who enter, at lags up to `longest_s` seconds."""
    from scipy.fft import irfft, next_fast_len, rfft

    width = max(1, round(STEP_S / arrivals.grid_s))
    counts = in_steps(arrivals, width)
    step_s = width * arrivals.grid_s
    most = max(1, min(round(longest_s / step_s), max(map(len, counts)) - 1))
    areas = arrivals.areas
    products, pairs = np.zeros((most, areas, areas)), np.zeros(most)
    for n in counts:
        size = next_fast_len(len(n) + most, real=True)
        seen = rfft(n, size, axis=0)
        for a in range(areas):
            products[:, a] += irfft(seen[:, a, None].conj() * seen, size, axis=0)[1 : most + 1]
        pairs += np.clip(len(n) - np.arange(1, most + 1), 0, None)
    everyone = np.concatenate(counts).astype(np.float64)
    mean = everyone.mean(axis=0)
    of_lag = _bins(most)
    bins = int(of_lag[-1]) + 1
    weight = np.bincount(of_lag, pairs, minlength=bins)
    lag_s = np.bincount(of_lag, np.arange(1, most + 1) * step_s * pairs, minlength=bins) / weight
    summed = np.zeros((bins, areas, areas))
    np.add.at(summed, of_lag, products)
    expected = np.outer(mean, mean) * weight[:, None, None]
    persons = everyone.sum(axis=0)
    return PairCorrelations(lag_s, _shrunk(summed, expected, persons), weight, persons)


def in_steps(arrivals: Arrivals, width: int) -> list[Int[np.ndarray, "T K"]]:
    """Number of persons in each interval of `width` grid points, in each observed stretch."""
    steps = [(counts, len(counts) // width) for counts in arrivals.by_window()]
    return [c[: n * width].reshape(n, width, -1).sum(axis=1) for c, n in steps if n]


def fit_waves(arrivals: Arrivals) -> Waves:
    """Waves whose pair correlations are as recorded."""
    observed_s = arrivals.exposure_s()
    tau_s = np.array([t for t in SCALES_S if t * _SHORTEST_STRETCHES <= observed_s])
    if len(tau_s) == 0 or len(arrivals.tick) < 2:
        return Waves(np.zeros(0), np.zeros((0, arrivals.areas, arrivals.areas)))
    longest_s = _LAGS_PER_SCALE * float(tau_s[-1])
    recorded = pairs_of(arrivals, longest_s=longest_s)
    excess = np.log(np.maximum(recorded.correlation, _LEAST))
    slow = recorded.lag_s > LEAST_LAG_S
    excess = ((excess + excess.transpose(0, 2, 1)) / 2)[slow]
    nothing = Waves(tau_s, np.zeros((len(tau_s), arrivals.areas, arrivals.areas)))
    basis = nothing.correlations(recorded.lag_s[slow]) - mean_correlations(nothing, arrivals)
    weight = np.sqrt(recorded.weight[slow])
    return Waves(tau_s, _covariances(excess, basis, weight, recorded.persons))


def mean_correlations(waves: Waves, arrivals: Arrivals) -> Float[np.ndarray, " J"]:
    """Mean autocorrelation of each scale over all pairs of observed times."""
    from scipy.fft import irfft, next_fast_len, rfft

    width = max(1, round(STEP_S / arrivals.grid_s))
    windows = arrivals.windows - arrivals.windows.min()
    observed = np.zeros(-(-int(windows.max()) // width))
    for first, last in (windows / width).tolist():
        observed[round(first) : round(last)] = 1.0
    size = next_fast_len(2 * len(observed), real=True)
    pairs = irfft(np.abs(rfft(observed, size)) ** 2, size)[: len(observed)]
    pairs[1:] *= 2  # both orders
    lag_s = np.arange(len(observed)) * width * arrivals.grid_s
    return np.asarray(pairs @ waves.correlations(lag_s) / pairs.sum())


def _covariances(
    excess: Float[np.ndarray, "L K K"],
    basis: Float[np.ndarray, "L J"],
    weight: Float[np.ndarray, " L"],
    persons: Float[np.ndarray, " K"],
) -> Float[np.ndarray, "J K K"]:
    """Least squares under the condition that the matrices are positive semidefinite.

    Minimises Σ_l w_l [Σ_ab s_a s_b r_ab(l)² + κ (Σ_ab s_a s_b r_ab(l))²], where r are the residuals
    of the logarithmic pair correlations and s the shares of the areas in all persons, by projected
    gradients (Beck and Teboulle 2009, SIAM Journal on Imaging Sciences 2). The second term is the
    covariance of the total rate. Without it the total would hardly fluctuate, because the errors of
    many pairs of areas are larger than what they have in common.
    """
    share = np.sqrt(np.maximum(persons, 0.5) / np.maximum(persons, 0.5).sum())
    scaled = np.outer(share, share)
    weight = weight / weight.sum()
    gram = np.einsum("l,lj,lk->jk", weight, basis, basis)
    aim = np.einsum("l,lj,lab->jab", weight, basis, excess) * scaled
    step = 1 / (np.linalg.eigvalsh(gram)[-1] * (1 + _TOTAL))
    found = ahead = np.zeros_like(aim)
    momentum = 1.0
    for _ in range(_STEPS):
        residual = np.einsum("jk,kab->jab", gram, ahead) - aim
        total = np.einsum("jab,a,b->j", residual, share, share)
        moved = ahead - step * (residual + _TOTAL * total[:, None, None] * scaled)
        value, vector = np.linalg.eigh((moved + moved.transpose(0, 2, 1)) / 2)
        now = (vector * np.clip(value, 0, None)[:, None, :]) @ vector.transpose(0, 2, 1)
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = now + (momentum - 1) / following * (now - found)
        found, momentum = now, following
    found = found / scaled
    largest = np.sqrt(_MOST / np.maximum(np.einsum("jkk->jk", found), _MOST))
    return np.asarray(found * largest[:, :, None] * largest[:, None, :])


def _bins(most: int) -> Int[np.ndarray, " most"]:
    """Bin of each of the lags 1, …, `most`: a bin per lag at first, then `_BINS_PER_OCTAVE`."""
    lag = np.arange(1, most + 1)
    octave = np.floor(_BINS_PER_OCTAVE * np.log2(lag) + 1e-9).astype(np.int64)
    return np.unique(octave, return_inverse=True)[1]


def _shrunk(
    summed: Float[np.ndarray, "L K K"],
    expected: Float[np.ndarray, "L K K"],
    persons: Float[np.ndarray, " K"],
) -> Float[np.ndarray, "L K K"]:
    """Pair correlations, drawn towards those of all areas where there are few persons."""
    same = np.eye(len(persons), dtype=bool)
    pooled = np.ones_like(summed)
    for chosen in (same, ~same):
        if chosen.any():
            pooled[:, chosen] = (
                summed[:, chosen].sum(axis=1) / np.maximum(expected[:, chosen].sum(axis=1), 1e-12)
            )[:, None]
    ratio = np.divide(summed, expected, out=np.ones_like(summed), where=expected > 0)
    weight = np.sqrt(np.outer(persons, persons))
    return np.asarray((weight * ratio + _PRIOR_PERSONS * pooled) / (weight + _PRIOR_PERSONS))
