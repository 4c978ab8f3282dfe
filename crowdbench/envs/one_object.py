"""What Stable-Baselines3 asks of a `VecEnv` whose sub-environments are not objects."""

from collections.abc import Iterable
from typing import Any

from gymnasium import spaces
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from crowdbench.errors import SettingError


class OneObjectVecEnv(VecEnv):
    """A `VecEnv` that steps all its sub-environments itself; their attributes are its own."""

    def __init__(
        self,
        num_envs: int,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        render_mode: str | None,
    ) -> None:
        self.render_mode = render_mode  # which the next line asks for
        super().__init__(num_envs, observation_space, action_space)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """The attribute of this object, repeated for each sub-environment."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(
        self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None
    ) -> None:
        """Set an attribute of this object, which all sub-environments share."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Not supported: sub-environments are not objects with methods.

        Raises:
            SettingError: always.
        """
        raise SettingError(
            type(self).__name__,
            got=f"a call of {method_name} in sub-environments",
            expected="a method of the whole environment",
            hint="Sub-environments are not separate objects.",
        )

    def env_is_wrapped(
        self, wrapper_class: type[Any], indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        """True for `Monitor`, because infos contain what it would add, and else false.

        Evaluations of Stable-Baselines3 then count whole episodes and no waiting steps.
        """
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]
