"""On a CUDA device, worlds are those of the CPU; only fused multiply-adds round differently."""

import pytest
from cuda_worlds import KINDS, difference

from crowdbench.errors import SettingError
from crowdbench.simulation.cuda import cuda_module

TOLERANCE = 1e-5

try:
    cuda_module()
except SettingError as error:
    pytest.skip(str(error), allow_module_level=True)


@pytest.mark.parametrize(("observation", "radius_m", "wide"), KINDS)
def test_worlds_on_a_device_are_those_on_the_cpu(
    observation: str, radius_m: float, *, wide: bool
) -> None:
    found = difference(observation, radius_m, wide=wide)
    assert {name: off for name, off in found.items() if off > TOLERANCE} == {}
    assert found.keys().isdisjoint({"slots.alive", "slots.ended", "slots.stage", "queue.status"})


def test_two_runs_give_the_same_bytes() -> None:
    assert difference("social-1", 0.15) == difference("social-1", 0.15)
