"""Statistics of recordings for every metric: shipped ones, and those of metrics that others add."""

from dataclasses import replace

from crowdbench.registry import has_recording, recording_of
from crowdbench.scene import Scene
from crowdbench.scoring.reference import Reference, applicable, read_reference, summarise


def reference_of(scene: Scene) -> Reference:
    """The scene's reference, with the metrics that others have registered.

    A scene ships no statistics of those. They are computed where the recording is imported; where
    it is not, `missing` names them.

    Raises:
        WeightsError: the scene has no reference statistics.
    """
    reference = read_reference(scene)
    more = [m for m in applicable(reference.blocks) if m.name not in reference.statistics]
    if not more or not has_recording(scene):
        return reference
    found = summarise(recording_of(scene), reference.blocks, reference.place, more)
    return replace(reference, statistics=reference.statistics | found)


def missing(scene: Scene) -> list[str]:
    """Names of the registered metrics that need the scene's recording, which is not imported."""
    if has_recording(scene):
        return []
    reference = read_reference(scene)
    known = reference.statistics
    return [m.name for m in applicable(reference.blocks) if m.name not in known]
