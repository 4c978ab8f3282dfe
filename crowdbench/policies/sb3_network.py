"""The network by which a policy of Stable-Baselines3 walks a person, as a policy file needs it."""

from typing import Any

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import Tensor, nn

LOG_STD = (-20.0, 2.0)
"""Range of the logarithm of SAC's standard deviation, as in Stable-Baselines3."""


class Sb3Network(nn.Module):
    """Actions of a policy of Stable-Baselines3: clipped or squashed to [−1, 1] as by its `predict`.

    It shares its weights with the policy. Critics are left out. `memory` is the size M of the state
    of a person. `normalized` says that the policy was trained in a `VecNormalize`.
    """

    def __init__(self, policy: Any, noise: int) -> None:
        """Take the parts of a policy that lead to its actions.

        Args:
            policy: an `ActorCriticPolicy`, with an LSTM or without, or a policy with an actor as
                that of SAC or TD3.
            noise: 0 for the mean action; 2 for a Gaussian one.

        Raises:
            LookupError: the policy has other parts.
        """
        super().__init__()
        actor: Any = getattr(policy, "actor", None)
        self.features: nn.Module
        self.body: nn.Module = nn.Identity()
        self.log_std: nn.Module | nn.Parameter | None = None
        if isinstance(policy, ActorCriticPolicy):
            self.features = policy.pi_features_extractor
            self.body = policy.mlp_extractor.policy_net
            self.mean = policy.action_net
            self.squashed = policy.squash_output
            if isinstance(policy.log_std, nn.Parameter) and not policy.use_sde:
                self.log_std = policy.log_std
        elif hasattr(actor, "latent_pi"):  # SAC and its kin
            self.features, self.body = actor.features_extractor, actor.latent_pi
            self.mean, self.squashed = actor.mu, True
            if not actor.use_sde:
                self.log_std = actor.log_std
        elif hasattr(actor, "mu"):  # TD3 and DDPG, whose last layer squashes
            self.features = actor.features_extractor
            self.mean, self.squashed = actor.mu, False
        else:
            raise LookupError
        self.noise = noise
        self.normalized = False
        lstm = getattr(policy, "lstm_actor", None)
        self.cells = nn.ModuleList(_cells(lstm) if lstm is not None else ())
        self.units = lstm.hidden_size if lstm is not None else 0
        self.memory = 2 * self.units * len(self.cells)

    def forward(
        self, seen: Tensor, first: Tensor | None = None, second: Tensor | None = None
    ) -> Tensor | tuple[Tensor, Tensor]:
        """Actions (A, 2) of observations (A, obs); with a memory, also the next states (A, M).

        `first` and `second` are the normal numbers (A, 2), if `noise` is 2, and the states (A, M),
        if there is a memory, in this order.
        """
        noise, state = (first, second) if self.noise else (None, first)
        latent = self.features(seen)
        if state is not None:
            latent, state = self._step_lstm(latent, state)
        latent = self.body(latent)
        action = self.mean(latent)
        if noise is not None and self.log_std is not None:
            action = action + self._deviation(latent) * noise
        action = torch.tanh(action) if self.squashed else action.clamp(-1.0, 1.0)
        return action if state is None else (action, state)

    def _deviation(self, latent: Tensor) -> Tensor:
        if isinstance(self.log_std, nn.Parameter):  # the same in all states
            return self.log_std.exp()
        assert self.log_std is not None
        found: Tensor = self.log_std(latent)
        return found.clamp(*LOG_STD).exp()

    def _step_lstm(self, latent: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """One step of the LSTM. A state has the outputs of all layers, then their cell states."""
        parts = state.chunk(2 * len(self.cells), dim=1)
        outputs, insides = [], []
        for k, cell in enumerate(self.cells):
            latent, inside = cell(latent, (parts[k], parts[len(self.cells) + k]))
            outputs.append(latent)
            insides.append(inside)
        return latent, torch.cat([*outputs, *insides], dim=1)


def _cells(lstm: nn.LSTM) -> list[nn.LSTMCell]:
    """The layers of an LSTM as cells with the same weights: one step needs no loop over time."""
    cells = []
    for k in range(lstm.num_layers):
        size = lstm.hidden_size if k else lstm.input_size
        cell = nn.LSTMCell(size, lstm.hidden_size, bias=lstm.bias)
        for name in ("weight_ih", "weight_hh", *(("bias_ih", "bias_hh") if lstm.bias else ())):
            setattr(cell, name, getattr(lstm, f"{name}_l{k}"))
        cells.append(cell)
    return cells
