"""Validation of the actions that are passed to the PettingZoo environment."""

from collections.abc import Mapping, Sequence

import numpy as np

from crowdbench.errors import ActionError


def commands_of(actions: Mapping[str, np.ndarray], agents: Sequence[str]) -> np.ndarray:
    """Velocity commands of shape (A, 2) in [−1, 1], in the order of `agents`.

    Raises:
        ActionError: there are no agents, an action is missing or belongs to an unknown agent, or
            is not a pair of finite numbers.
    """
    if not agents:
        raise ActionError(
            "step", got="no agents", expected="a call of reset first",
            hint="The episode is over or has not begun.",
        )  # fmt: skip
    try:
        given = [actions[name] for name in agents]
    except KeyError:
        given = []
    except (TypeError, IndexError) as error:
        raise ActionError(
            "step",
            got=f"actions of type {type(actions).__name__}",
            expected="a dictionary from the names in env.agents to arrays of shape (2,)",
        ) from error
    if not given or len(actions) != len(given):
        missing = [name for name in agents if name not in actions]
        unknown = sorted(set(actions) - set(agents))
        raise ActionError(
            "step",
            got=f"missing actions for {missing[:3]}, actions for unknown agents {unknown[:3]}",
            expected=f"one action for each of the {len(agents)} agents",
            hint="Pass one action for each name in env.agents.",
        )
    try:
        commands = np.array(given)
    except ValueError:  # rows of different shapes
        commands = np.array(None)
    if commands.dtype.kind not in "fiu" or commands.shape != (len(agents), 2):
        raise ActionError(
            "step",
            got=f"actions of shape {commands.shape[1:]}"
            if commands.dtype.kind in "fiu"
            else "actions that are not pairs of numbers",
            expected="arrays of shape (2,): a velocity in units of the maximum speed",
        )
    if not np.isfinite(commands).all():
        name = agents[int(np.flatnonzero(~np.isfinite(commands).all(axis=1))[0])]
        raise ActionError(
            "step", got=f"{actions[name]} from {name}", expected="finite numbers",
            hint="Check the policy for a division by zero or a diverged network.",
        )  # fmt: skip
    if commands.dtype != np.float32:
        commands = commands.clip(-1, 1)  # before the conversion to float32, which may overflow
    return commands
