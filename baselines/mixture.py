"""A stochastic policy: a mixture of Gaussians around the present velocity.

People keep their velocity or change it in one of several ways. A single Gaussian would have to be
wide enough for all of these, and samples from it would be unsteady. The network therefore predicts
the weight, mean and standard deviation of several changes of velocity (mixture density network:
Bishop 1994, Neural Computing Research Group Report NCRG/94/004, eqs. 22-27).

`MixturePolicy` is a policy of Stable-Baselines3, so that `imitation` can clone it and GAIL can
train it with PPO. `MixtureSampler` is the part that is exported to an ONNX file.
"""

import math
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from crowdbench.simulation import Settings, social
from crowdbench.simulation.observations import (
    GOAL_DIRECTION,
    GOAL_DISTANCE,
    GOAL_RANGE_M,
    PREFERRED_SPEED,
    version_of,
)
from crowdbench.spawn.recorded_plans import VISIT_M

SELF = 6
"""Number of values of an observation before the distances to bounds and along rays."""
BOUNDS = slice(SELF, 10)
"""Slice of the distances to the bounds in `lidar-3`."""
RAY_RANGE_M = Settings().shown.ray_range_m
NEAR_GOAL_M = 2.0
"""Distance below which a goal counts as near."""
NEAR_M = 1.0
"""Length scale of the nearness of people, walls and bounds."""
CHANGES = 5.0
"""Factor by which the change of velocity towards the goal is scaled, compared with velocities."""
COMPONENTS = 5
NOISE = 3
"""Number of normal numbers per sample: one chooses the component, two the deviation."""
_WIDTH = -3.0  # initial log standard deviation, in units of max_speed
_NARROWEST, _WIDEST = -6.0, 1.0
"""Bounds of the log standard deviation. The lower one corresponds to millimetres per step. With a
smaller one, people who keep their velocity exactly, as between two annotations, would dominate the
likelihood, and the policy would not learn to turn to the goal."""


def target_distance_m(seen: np.ndarray, observation: str) -> np.ndarray:
    """Distances (S,) to the targets in observations (S, obs) of this version, metres."""
    if version_of(observation).own_frame:
        return np.asarray(seen[:, social.ROUTE_LENGTH.start] * social.ROUTE_RANGE_M)
    return np.asarray(seen[:, GOAL_DISTANCE.start] * GOAL_RANGE_M)


def features_of(observation: str) -> type[BaseFeaturesExtractor]:
    """The features of observations of this version."""
    return Social if version_of(observation).own_frame else Scales


class Scales(BaseFeaturesExtractor):
    """An observation and derived features that a small network would not learn by itself.

    The observation may be `lidar-2` or `lidar-3`. The added features are the change of velocity
    that leads to the goal at the preferred speed, the offset to a near goal, and the nearness of
    the end of each ray and of each observed bound.
    """

    def __init__(self, observation_space: spaces.Box) -> None:
        numbers = int(observation_space.shape[0])
        super().__init__(observation_space, 2 * numbers - SELF + 4)

    def forward(self, seen: Tensor) -> Tensor:
        """Features (A, 2·obs − 2) of observations (A, obs)."""
        towards = seen[:, GOAL_DIRECTION]
        change = CHANGES * (towards * seen[:, PREFERRED_SPEED] - seen[:, :2])
        way = (seen[:, GOAL_DISTANCE] * (GOAL_RANGE_M / NEAR_GOAL_M)).clamp(max=1) * towards
        nearness = torch.exp(-seen[:, SELF:] * (RAY_RANGE_M / NEAR_M))
        return torch.cat([seen, change, way, nearness], dim=1)


class Social(BaseFeaturesExtractor):
    """The observation `social-1` and derived features, as those of `Scales`.

    The change of velocity is the one that follows the plan: it leads to the target at the preferred
    speed, or to a standstill at a stop.
    """

    def __init__(self, observation_space: spaces.Box) -> None:
        super().__init__(observation_space, social.SIZE + 4 + social.NEAREST)

    def forward(self, seen: Tensor) -> Tensor:
        """Features (A, 114) of observations (A, 102)."""
        length_m = seen[:, social.ROUTE_LENGTH] * social.ROUTE_RANGE_M
        towards = seen[:, social.ROUTE_DIRECTION]
        walks = 1 - seen[:, social.STOP] * (length_m <= VISIT_M)
        planned = walks * seen[:, social.PREFERRED_SPEED] * towards
        change = CHANGES * (planned - seen[:, social.VELOCITY])
        way = (length_m / NEAR_GOAL_M).clamp(max=1) * towards
        other = social.neighbours_of(seen)
        distance_m = other[..., social.OFFSET].norm(dim=-1) * social.RANGE_M
        nearness = other[..., social.PRESENT.start] * torch.exp(-distance_m / NEAR_M)
        return torch.cat([seen, change, way, nearness], dim=1)


class Mixture(Distribution):
    """Mixtures of Gaussians with diagonal covariance, one for each of A observations."""

    def __init__(self, parameters: Tensor, velocity: Tensor) -> None:
        """Create mixtures from network outputs (A, 5 · components) and velocities (A, 2)."""
        super().__init__()
        p = parameters.unflatten(1, (parameters.shape[1] // 5, 5))
        self.mean = velocity[:, None] + p[..., :2]
        self.log_std = (p[..., 2:4] + _WIDTH).clamp(_NARROWEST, _WIDEST)
        self.log_weight = torch.log_softmax(p[..., 4], dim=1)

    def log_prob(self, actions: Tensor) -> Tensor:
        """Log-densities (A,) of actions (A, 2)."""
        z = (actions[:, None] - self.mean) / self.log_std.exp()
        each = -(0.5 * z * z + self.log_std).sum(dim=2) - math.log(2 * math.pi)
        return torch.logsumexp(each + self.log_weight, dim=1)

    def drawn(self, noise: Tensor) -> Tensor:
        """Samples (A, 2) as a function of standard normal numbers (A, 3)."""
        uniform = 0.5 * (1 + torch.erf(noise[:, :1] / math.sqrt(2)))
        below = torch.cumsum(self.log_weight.exp(), dim=1) < uniform
        chosen = below.sum(dim=1, keepdim=True).clamp(max=below.shape[1] - 1)
        at = chosen[:, :, None].expand(-1, 1, 2)
        mean, std = self.mean.gather(1, at)[:, 0], self.log_std.gather(1, at)[:, 0].exp()
        return mean + std * noise[:, 1:]

    def sample(self) -> Tensor:
        """Random actions (A, 2), one per observation."""
        noise = torch.randn(len(self.mean), NOISE, device=self.mean.device)
        return self.drawn(noise)

    def mode(self) -> Tensor:
        """Mean (A, 2) of the most likely component."""
        at = self.log_weight.argmax(dim=1)[:, None, None].expand(-1, 1, 2)
        return self.mean.gather(1, at)[:, 0]

    def entropy(self) -> None:
        """Return None: the entropy of a mixture has no closed form."""

    def proba_distribution_net(self, *_: Any, **__: Any) -> nn.Module:
        """Not used: `MixturePolicy` creates its own network."""
        raise NotImplementedError

    proba_distribution = actions_from_params = log_prob_from_params = proba_distribution_net


class MixturePolicy(ActorCriticPolicy):
    """Policy with two hidden layers and a mixture of Gaussians as the distribution of actions."""

    def __init__(self, *args: Any, components: int = COMPONENTS, **kwargs: Any) -> None:
        self.components = components
        plain = {"net_arch": [32, 32], "features_extractor_class": Scales}
        super().__init__(*args, **{**plain, **kwargs})

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.log_std.requires_grad_(False)  # belongs to the Gaussian, which is replaced
        self.action_net = nn.Linear(self.mlp_extractor.latent_dim_pi, 5 * self.components)
        self.optimizer = self.optimizer_class(
            self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs
        )

    def narrow(self, width: float) -> None:
        """Multiply all standard deviations by `width`."""
        with torch.no_grad():
            self.action_net.bias.unflatten(0, (self.components, 5))[:, 2:4] += math.log(width)

    def get_distribution(self, obs: Tensor) -> Mixture:
        """Distribution of the action for each observation."""
        features = self.extract_features(obs, self.pi_features_extractor)
        parameters = self.action_net(self.mlp_extractor.forward_actor(features))
        return Mixture(parameters, obs[:, :2])

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Actions, values and log-probabilities."""
        distribution = self.get_distribution(obs)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, self.predict_values(obs), distribution.log_prob(actions)

    def evaluate_actions(self, obs: Tensor, actions: Tensor) -> tuple[Tensor, Tensor, None]:
        """Values, log-probabilities, and None for the entropy."""
        return self.predict_values(obs), self.get_distribution(obs).log_prob(actions), None


class MixtureSampler(nn.Module):
    """Computes actions from observations (A, obs) and standard normal numbers (A, 3)."""

    def __init__(self, policy: MixturePolicy) -> None:
        super().__init__()
        self.scales = policy.features_extractor
        self.actor = policy.mlp_extractor.policy_net
        self.head = policy.action_net

    def forward(self, seen: Tensor, noise: Tensor) -> Tensor:
        """Sampled actions (A, 2), clipped to [−1, 1]."""
        return (
            Mixture(self.head(self.actor(self.scales(seen))), seen[:, :2]).drawn(noise).clamp(-1, 1)
        )
