"""Compiled kernels of `joint-gmm`: traces of past arrivals, the network, likelihood and sampling.

Training computes the network in torch, with the features that these kernels make; likelihood and
sampling compute it here. A test compares both.
"""

import math

import numpy as np

from crowdbench.compilation import compiled
from crowdbench.spawn.joint.traces import (
    FEATURES,
    HALF,
    RATE_BOUND,
    SIZE_BOUND,
    TAU_S,
    TRACES,
)


@compiled
def start_traces(mean, trace):
    """Fill the traces (K, 5) at the beginning of a stretch: nothing is known, so they are means."""
    trace[:] = mean


@compiled
def advance_traces(number, decay, trace):
    """Let traces (K, 5) decay over a step, in which `number` (K,) people entered."""
    for a in range(len(number)):
        for k in range(TRACES):
            trace[a, k] = decay[k] * (trace[a, k] + number[a])


@compiled
def fill_features(trace, mean, age_s, features):
    """Fill the features (K, 20) of all areas from their traces (K, 5) and mean traces (K, 5)."""
    for k in range(TRACES):
        total, usual = 0.0, 0.0
        for a in range(len(trace)):
            total += trace[a, k]
            usual += mean[a, k]
        common = math.log((total + HALF) / (usual + HALF))
        young = math.exp(-age_s / TAU_S[k])
        for a in range(len(trace)):
            features[a, k] = math.log((trace[a, k] + HALF) / (mean[a, k] + HALF))
            features[a, TRACES + k] = common
            features[a, 2 * TRACES + k] = young
            features[a, 3 * TRACES + k] = math.log(mean[a, k] + HALF)


@compiled
def features_of(counts, width, step_s, mean, features):
    """Fill the features (S, K, 20) at the beginnings of the steps of a stretch.

    `counts` (T, K) are people at grid points; a step has `width` of them.
    """
    points, areas = counts.shape
    decay = np.exp(-step_s / TAU_S)
    trace, number = np.empty((areas, TRACES)), np.empty(areas)
    start_traces(mean, trace)
    for s in range(len(features)):
        fill_features(trace, mean, s * step_s, features[s])
        number[:] = 0.0
        for t in range(s * width, min(points, (s + 1) * width)):
            for a in range(areas):
                number[a] += counts[t, a]
        advance_traces(number, decay, trace)


@compiled
def recent_of(counts, of_lag, recent):
    """Fill the numbers of people (T, K, B) who entered before each grid point, by bin of delays.

    `of_lag` (H,) is the bin of each delay of 1, 2, … grid steps. Numbers are means over the steps
    of a bin.
    """
    steps = np.zeros(recent.shape[2])
    for b in of_lag:
        steps[b] += 1.0
    recent[:] = 0.0
    for t in range(len(counts)):
        for h in range(min(t, len(of_lag))):
            b = of_lag[h]
            for a in range(counts.shape[1]):
                recent[t, a, b] += counts[t - 1 - h, a] / steps[b]


@compiled
def bounded(x, bound):
    """A number, drawn smoothly into (−bound, bound)."""
    return bound * math.tanh(x / bound)


@compiled
def network(features, weights, hidden, out):
    """Fill `out` (K, 2): logarithms of the factors of the rate of groups and of the odds.

    `weights` are those of `model.WEIGHTS`; the last two are different for each area.
    """
    in_weight, in_bias, weight, bias, out_weight, out_bias, own_in, own_out = weights
    size = len(in_bias)
    for a in range(len(features)):
        for i in range(size):
            x = in_bias[i] + own_in[a, i]
            for f in range(FEATURES):
                x += in_weight[i, f] * features[a, f]
            hidden[0, i] = math.tanh(x)
        for i in range(size):
            x = bias[i]
            for j in range(size):
                x += weight[i, j] * hidden[0, j]
            hidden[1, i] = math.tanh(x)
        for o in range(2):
            x = out_bias[o] + own_out[a, o]
            for i in range(size):
                x += out_weight[o, i] * hidden[1, i]
            out[a, o] = bounded(x, RATE_BOUND if o == 0 else SIZE_BOUND)


@compiled
def expect(counts, width, step_s, mean, weights, log_rate, log_odds, followers, rate, odds):
    """Fill the rates of groups and log odds of one more member (T, K) before each grid point.

    `counts` (T, K) are the numbers of people at the grid points of a stretch, and `followers` (H,)
    the people who follow each person 1, 2, … grid steps later.
    """
    points, areas = counts.shape
    decay = np.exp(-step_s / TAU_S)
    trace, number = np.empty((areas, TRACES)), np.zeros(areas)
    features, out = np.empty((areas, FEATURES)), np.empty((areas, 2))
    hidden = np.empty((2, len(weights[1])))
    start_traces(mean, trace)
    for t in range(points):
        if t % width == 0:
            if t > 0:
                advance_traces(number, decay, trace)
            number[:] = 0.0
            fill_features(trace, mean, (t // width) * step_s, features)
            network(features, weights, hidden, out)
        for a in range(areas):
            rate[t, a] = rate_now(counts, t, a, out, log_rate, log_odds, followers)
            odds[t, a] = log_odds[a] + out[a, 1]
            number[a] += counts[t, a]


@compiled
def rate_now(counts, t, a, out, log_rate, log_odds, followers):
    """The rate of groups at an area and grid point."""
    due = 0.0
    for h in range(min(t, len(followers))):
        due += followers[h] * counts[t - 1 - h, a]
    return math.exp(log_rate[a] + out[a, 0]) + due / (1.0 + math.exp(log_odds[a]))


@compiled
def draw(points, width, step_s, mean, weights, log_rate, log_odds, followers, rng):
    """Sample the numbers of people (points, K) at grid points."""
    areas = len(log_rate)
    decay = np.exp(-step_s / TAU_S)
    counts = np.zeros((points, areas), np.int64)
    trace, number = np.empty((areas, TRACES)), np.zeros(areas)
    features, out = np.empty((areas, FEATURES)), np.empty((areas, 2))
    hidden = np.empty((2, len(weights[1])))
    start_traces(mean, trace)
    for t in range(points):
        if t % width == 0:
            if t > 0:
                advance_traces(number, decay, trace)
            number[:] = 0.0
            fill_features(trace, mean, (t // width) * step_s, features)
            network(features, weights, hidden, out)
        for a in range(areas):
            rate = rate_now(counts, t, a, out, log_rate, log_odds, followers)
            if rng.random() < -math.expm1(-rate):
                more = -math.log1p(math.exp(-(log_odds[a] + out[a, 1])))
                n = 1 + int(math.log1p(-rng.random()) / more)
                counts[t, a] = n
                number[a] += n
    return counts
