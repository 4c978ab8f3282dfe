"""Short, unambiguous names of spawn models and policies for tables and pictures.

A model under a scenario is named after the stem of the scenario file (`ntpp-gmm+rush_hour`), a
policy file after the name on its card, and a class of the user after its attribute `name`, if the
class has been imported and no model of crowdbench has that name. If two short names are equal, both
are shown in full, as the user gave them. Scorecards always keep the full names.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from crowdbench.plugins import imported_name
from crowdbench.policies.network import read_card
from crowdbench.registry import POLICIES, SPAWN_MODELS, policy_source, trained_policies
from crowdbench.scene import Scene
from crowdbench.spawn.steering.scenario import split_scenario


@dataclass(frozen=True)
class Names:
    """Display names of spawn models and policies, by the name that the user gave."""

    spawn: Mapping[str, str]
    policy: Mapping[str, str]

    def pair(self, spawn: str, policy: str) -> str:
        """Display name of a pair: `spawn × policy`."""
        return f"{self.spawn[spawn]} × {self.policy[policy]}"


def names_of(pairs: Iterable[tuple[str, str]], scene: Scene) -> Names:
    """Display names of all spawn models and policies in `pairs` on a scene.

    Raises:
        WeightsError: a policy file is missing or invalid.
        SettingError: onnx or onnxruntime is not installed.
    """
    spawns, policies = zip(*pairs, strict=True)
    own = trained_policies(scene)
    return Names(_apart(spawns, _spawn), _apart(policies, lambda asked: _policy(asked, scene, own)))


def _apart(asked: Iterable[str], name: Callable[[str], str]) -> dict[str, str]:
    names = {each: name(each) for each in asked}
    times = Counter(names.values())
    return {each: short if times[short] == 1 else each for each, short in names.items()}


def _spawn(asked: str) -> str:
    model, scenario = split_scenario(asked)
    model = _class(model, SPAWN_MODELS)
    return model if scenario is None else f"{model}+{scenario.stem}"


def _policy(asked: str, scene: Scene, trained: Sequence[str]) -> str:
    file = policy_source(asked, scene).card_file()
    return _class(asked, [*POLICIES, *trained]) if file is None else read_card(file).name


def _class(asked: str, taken: Collection[str]) -> str:
    """Name of an imported class `pkg.module:Class`; `asked` if it is none or its name is taken."""
    name = imported_name(asked) if ":" in asked else None
    return asked if name is None or name in taken else name
