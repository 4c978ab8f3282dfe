"""What tables and pictures call spawn models and policies: briefly, and each by another name.

A model under a scenario is called by the scenario's stem (`ntpp-gmm+rush_hour`), a policy in a file
of its own as its card says. What would share a name with something else is called as it was asked
for. Scorecards always keep what was asked for.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from crowdbench.policies.network import read_card
from crowdbench.registry import policy_file
from crowdbench.scene import Scene
from crowdbench.spawn.scenario import split
from crowdbench.trajectories.blocks import PARTS


@dataclass(frozen=True)
class Names:
    """The names of some spawn models and policies, by what was asked for."""

    spawn: Mapping[str, str]
    policy: Mapping[str, str]

    def pair(self, spawn: str, policy: str) -> str:
        """`spawn × policy`."""
        return f"{self.spawn[spawn]} × {self.policy[policy]}"


def names_of(pairs: Iterable[tuple[str, str]], scene: Scene) -> Names:
    """The names of all spawn models and policies in some pairs of a scene.

    Raises:
        WeightsError: a policy's file is missing or broken.
        SettingError: ONNX files cannot be read here.
    """
    spawns, policies = zip(*pairs, strict=True)
    return Names(_apart(spawns, _spawn), _apart(policies, lambda asked: _policy(asked, scene)))


def _apart(asked: Iterable[str], name: Callable[[str], str]) -> dict[str, str]:
    names = {each: name(each) for each in asked}
    times = Counter(names.values())
    return {each: short if times[short] == 1 else each for each, short in names.items()}


def _spawn(asked: str) -> str:
    model, scenario = split(asked)
    return model if scenario is None else f"{model}+{scenario.stem}"


def _policy(asked: str, scene: Scene) -> str:
    """Of a folder, as one of its files says: no protocol needs all of them."""
    files = [file for part in PARTS if (file := policy_file(asked, scene, part))]
    there = [file for file in files if file.is_file()] or files
    return read_card(there[0]).name if there else asked
