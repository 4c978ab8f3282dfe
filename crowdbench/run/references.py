"""Reference statistics for all metrics: those shipped with a scene, and those of added metrics."""

from dataclasses import replace

from crowdbench.data.recordings.noise import noise_of
from crowdbench.registry import has_recording, raw_recording_of, recording_of
from crowdbench.scene import Scene
from crowdbench.scoring.classifier import ClassifierTest
from crowdbench.scoring.reference import Reference, applicable, read_reference, summarise
from crowdbench.spawn.events import blocks_of


def reference_of(scene: Scene) -> Reference:
    """The scene's reference statistics, including metrics that other packages have registered.

    A scene does not ship statistics of registered metrics. They are computed from the recording if
    it is imported; otherwise they are left out, and `missing` lists them.

    Raises:
        WeightsError: the scene has no reference statistics.
    """
    reference = read_reference(scene)
    more = [m for m in applicable(reference.blocks) if m.name not in reference.statistics]
    if not more or not has_recording(scene):
        return reference
    found = summarise(recording_of(scene), reference.blocks, reference.place, more)
    return replace(reference, statistics=reference.statistics | found)


def classifier_test_of(scene: Scene) -> ClassifierTest:
    """What tells crowds from the scene's recording.

    Raises:
        RecordingError: the recording is not imported.
    """
    recorded, tick = recording_of(scene), scene.walking.tick_frames
    noise = noise_of(raw_recording_of(scene), tick)
    return ClassifierTest(recorded, noise, blocks_of(recorded, scene), tick)


def missing(scene: Scene) -> list[str]:
    """Names of the metrics that cannot be computed because the recording is not imported."""
    if has_recording(scene):
        return []
    reference = read_reference(scene)
    known = reference.statistics
    return [m.name for m in applicable(reference.blocks) if m.name not in known]
