"""Demonstrations: observations and actions of recorded people, for imitation learning.

The recording is replayed in the simulation of the environments. Everyone follows the recorded
path, and each observation is stored with the action that leads to the next recorded position.
Observations, walls and the speed limit are therefore the same as in the environments. Actions are
in the frame of the observation.
"""

import shutil
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float32, Int

from crowdbench import __version__
from crowdbench.envs.perturbation import PathPerturbation
from crowdbench.errors import OutputError, SettingError
from crowdbench.policies import ReplayPolicy
from crowdbench.recordings.catalogue import source
from crowdbench.registry import recording_of
from crowdbench.rollouts.episode import begin, check_capacity, generator
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import OBSERVATION
from crowdbench.simulation.social import in_own_frame
from crowdbench.spawn import Replay
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.weights import check_split
from crowdbench.trajectories.stops import STANDING_MPS

if TYPE_CHECKING:
    from imitation.data.types import Trajectory
    from minari import MinariDataset


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """`L` pieces (trips or parts of trips) with `S` observation-action pairs in total.

    Trips are cut at the ends of the time blocks on which a split of the recording is fitted.
    """

    observations: Float32[np.ndarray, "R obs"]
    """Observations of all pieces, R = S + L rows. The last row of each piece is the observation
    after its last action."""
    actions: Float32[np.ndarray, "R 2"]
    """Velocities in units of the scene's maximum speed, in the frame of the observation; NaN in the
    last row of each piece."""
    person: Int[np.ndarray, " L"]
    """Index of the person in the recording."""
    offsets: Int[np.ndarray, " L+1"]
    """Piece k has the rows offsets[k] … offsets[k + 1] − 1."""
    first: Int[np.ndarray, " L"]
    """Frame of each piece's first row."""
    complete: Bool[np.ndarray, " L"]
    """True if the piece ends where the person left the scene, false if it is cut off."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """The recording, the paper to cite, and all settings of the demonstrations."""

    def __len__(self) -> int:
        return len(self.person)

    def pairs(self) -> tuple[Float32[np.ndarray, "S obs"], Float32[np.ndarray, "S 2"]]:
        """Observations (S, obs) and the actions (S, 2) taken in them, of all pieces."""
        acted = ~np.isnan(self.actions[:, 0])
        return self.observations[acted], self.actions[acted]

    def take(self, pieces: Sequence[int] | Int[np.ndarray, " l"]) -> "Demonstrations":
        """The pieces with the given indices."""
        chosen = np.asarray(pieces, dtype=np.int64)
        length = np.diff(self.offsets)[chosen]
        offsets = np.concatenate([[0], np.cumsum(length)])
        within = np.arange(offsets[-1]) - np.repeat(offsets[:-1], length)
        rows = np.repeat(self.offsets[:-1][chosen], length) + within
        return Demonstrations(
            self.observations[rows],
            self.actions[rows],
            self.person[chosen],
            offsets,
            self.first[chosen],
            self.complete[chosen],
            self.provenance,
        )

    def split(self, share: float, seed: int) -> tuple["Demonstrations", "Demonstrations"]:
        """Two disjoint sets of persons, the second with about `share` of them."""
        persons = np.unique(self.person)
        chosen = np.random.default_rng(seed).random(len(persons)) < share
        second = np.isin(self.person, persons[chosen])
        return self.take(np.flatnonzero(~second)), self.take(np.flatnonzero(second))

    def to_imitation(self) -> "list[Trajectory]":
        """The pieces as trajectories of `imitation`; needs the extra `imitation`."""
        from imitation.data.types import Trajectory

        return [
            Trajectory(
                obs=self.observations[start:stop],
                acts=self.actions[start : stop - 1],
                infos=None,
                terminal=bool(complete),
            )
            for start, stop, complete in zip(
                self.offsets[:-1].tolist(), self.offsets[1:].tolist(), self.complete, strict=True
            )
        ]

    def to_minari(self, dataset_id: str) -> "MinariDataset":
        """Write the pieces as a Minari dataset and return it; needs the extra `minari`.

        The dataset is written to Minari's folder: `MINARI_DATASETS_PATH`, by default
        `~/.minari/datasets`. Each piece is an episode with one more observation than actions. The
        episode is terminated if the person left the scene and truncated if the piece is cut off.
        Its metadata contain `person` and `first_frame`. All rewards are zero, because recordings
        contain none. The dataset's metadata contain `provenance` under the key `crowdbench`.

        A dataset made from a recording remains subject to the terms of the recording's owners. It
        is for your own use and must not be published.

        Args:
            dataset_id: a Minari id such as `crowdbench/eth-full-v0`.

        Raises:
            SettingError: there are no pieces, or Minari does not accept the id.
            OutputError: a dataset with this id exists, or it cannot be written.
        """
        from minari.dataset.minari_dataset import parse_dataset_id
        from minari.storage import get_dataset_path

        if not len(self):
            raise SettingError("to_minari", got="no demonstrations", expected="at least one")
        try:
            parse_dataset_id(dataset_id)
        except (TypeError, ValueError) as error:  # TypeError: an id without a version
            raise SettingError(
                "dataset_id", got=repr(dataset_id), expected="an id like crowdbench/eth-full-v0"
            ) from error
        try:
            folder = get_dataset_path(dataset_id)
            if folder.exists():
                raise OutputError(
                    folder,
                    got="a dataset that already exists",
                    expected="a new id",
                    hint=f"Increase its version, or run `minari delete {dataset_id}`.",
                )
            try:
                return self._write_minari(dataset_id)
            except (FileExistsError, ValueError):  # another process has created it meanwhile
                raise
            except BaseException:  # an incomplete dataset would look like a complete one
                shutil.rmtree(folder, ignore_errors=True)
                raise
        except OSError as error:
            raise OutputError(
                dataset_id,
                got=str(error),
                expected="a writable folder",
                hint="Set MINARI_DATASETS_PATH to one.",
            ) from error

    def _write_minari(self, dataset_id: str) -> "MinariDataset":
        from gymnasium.spaces import Box
        from minari import create_dataset_from_buffers
        from minari.data_collector import EpisodeBuffer

        episodes, notes = [], []
        for k, complete in enumerate(self.complete.tolist()):
            start, stop = self.offsets[k : k + 2].tolist()
            last = np.arange(start + 1, stop) == stop - 1
            episodes.append(
                EpisodeBuffer(
                    observations=self.observations[start:stop],
                    actions=self.actions[start : stop - 1],
                    rewards=np.zeros(len(last), np.float32),
                    terminations=last & complete,
                    truncations=last & (not complete),
                )
            )
            notes.append({"person": int(self.person[k]), "first_frame": int(self.first[k])})
        with warnings.catch_warnings():
            # Minari warns if a dataset has no author, e-mail address or Gymnasium environment.
            warnings.filterwarnings("ignore", ".* is set to None|env_spec is None", UserWarning)
            dataset = create_dataset_from_buffers(
                dataset_id,
                episodes,
                observation_space=Box(-1.0, 1.0, self.observations.shape[1:], np.float32),
                action_space=Box(-1.0, 1.0, self.actions.shape[1:], np.float32),
                algorithm_name="recorded persons",
                description=_description(self.provenance),
            )
        dataset.storage.update_episode_metadata(notes)
        dataset.storage.update_metadata({"crowdbench": dict(self.provenance)})
        return dataset


def demonstrations(
    scene: str | Path | Scene,
    *,
    split: str = "full",
    observation: str = OBSERVATION,
    rays: int = 32,
    ray_range_m: float = 10.0,
    displaced_m: float = 0.0,
    recovery_s: float = 1.5,
    seed: int = 0,
) -> Demonstrations:
    """Demonstrations of a scene's recording, from the time blocks on which `split` is fitted.

    A cloned policy drifts away from the recorded paths into states without demonstrations. To show
    how to return, a random half of the persons can be displaced repeatedly: each displacement
    starts at an offset δ from the recorded path with an additional velocity ε, and decays like a
    critically damped spring with time constant τ. At time t the person is
    (δ + (ε + δ/τ) t) exp(−t/τ) away from the recorded position. (Laskey et al. 2017, DART, CoRL,
    disturb the demonstrator for the same reason.) The displaced motion is as smooth as the
    recorded one; a return in a single step would look like restless motion. In their last 2 s,
    displaced people walk straight to the last recorded position. People who stand still are not
    displaced.

    Args:
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        split: `full`, or `fold0`, `fold1`, … for the training data of a fold of the protocol
            `heldout`, which exclude the blocks that the fold is scored on.
        observation: version of the observation, as in `parallel_env`.
        rays: number of rays.
        ray_range_m: range of the rays in metres.
        displaced_m: standard deviation σ of each component of δ in metres; each component of ε has
            σ/τ. 0: no displacements.
        recovery_s: τ in seconds. Each displacement lasts for 4 τ and is followed by another one.
        seed: random seed of the displacements.

    Raises:
        RecordingError: the recording is not imported.
        SceneError, SettingError: the scene, split or observation does not exist.
    """
    place = load_scene(scene)
    check_split(split, 0)
    for name, value, least in (("displaced_m", displaced_m, 0), ("recovery_s", recovery_s, 1e-3)):
        if not (np.isfinite(value) and value >= least):
            raise SettingError(
                name, got=str(value), expected=f"a finite number of at least {least:g}"
            )
    recording = recording_of(place)
    # A slot becomes free only in the frame after the last, when others have already entered.
    most = 2 * int(recording.present().max())
    settings = Settings(max_alive=most, rays=rays, ray_range_m=ray_range_m, observation=observation)
    simulation = Simulation(place, settings=settings)
    actor = begin(
        simulation,
        Replay(recording),
        seed=0,
        frames=recording.frames,
        start="recorded",
        walker=ReplayPolicy(recording),
        scripted=True,
    )
    actor.reset(generator(0, 0, "policy"))
    aside = PathPerturbation.of(recording, displaced_m, recovery_s, seed)
    last = recording.offsets[1:] - 1
    step_m = place.dt_s * place.motion.max_speed_mps
    inside = _trained_on(blocks_of(recording, place).training(split).frames, recording.frames)

    person: list[np.ndarray] = []
    frame: list[np.ndarray] = []
    observations: list[np.ndarray] = []
    actions: list[np.ndarray] = []
    slots = simulation.slots
    for t in range(recording.frames):
        actions_now = actor.actions()
        if settings.own_frame:  # also for the step itself, so that it is that of the environment
            actions_now = in_own_frame(actions_now, slots.heading)
        if inside[t]:
            there = (slots.alive[0] | (slots.ended[0] != 0)).nonzero()[0]
            event = slots.event[0, there]
            person.append(event)
            frame.append(np.full(len(there), t))
            now = actions_now[0, there]
            stood, went = slots.position[0, there], slots.velocity[0, there]
            headed = slots.heading[0, there]
            row = np.minimum(recording.offsets[event] + t - recording.first[event], last[event])
            after = np.minimum(row + 1, last[event])
            here = (stood + aside.now[row]).astype(np.float64)
            moved = aside.now[row].any(axis=1) | aside.after[row].any(axis=1)
            moved &= place.walkable(here) & place.walkable(recording.xy[after] + aside.after[row])
            slots.position[0, there[moved]] = here[moved]
            slots.velocity[0, there[moved]] += aside.drift[row[moved]].astype(np.float32)
            # Distances walked and times stood are those of the recorded path.
            slots.heading[0, there] = _headings(slots.velocity[0, there], headed, moved)
            observations.append(simulation.observe()[0, there])
            way = (recording.xy[after] + aside.after[row] - here) / step_m
            if settings.own_frame:
                way = in_own_frame(way, slots.heading[0, there])
            slots.position[0, there], slots.velocity[0, there] = stood, went
            slots.heading[0, there] = headed
            now[moved] = way.clip(-1, 1)[moved]
            now[~slots.alive[0, there]] = np.nan
            actions.append(now)
        simulation.step(actions_now)
    check_capacity(simulation)
    provenance = {
        "version": __version__,
        "scene": place.id,
        "recording": place.recording.name,
        "sha256": recording.provenance.get("sha256", ""),
        "cite": _cite(place.recording.name),
        "dt_s": place.dt_s,
        "max_speed_mps": place.motion.max_speed_mps,
        "split": split,
        "observation": observation,
        "rays": rays,
        "ray_range_m": ray_range_m,
        "displaced_m": displaced_m,
        "recovery_s": recovery_s,
        "seed": seed,
    }
    return _pieces(
        np.concatenate(person),
        np.concatenate(frame),
        np.concatenate(observations),
        np.concatenate(actions),
        np.where(recording.left, recording.last, -1),
        provenance,
    )


def _headings(
    velocity: Float32[np.ndarray, "n 2"],
    heading: Float32[np.ndarray, "n 2"],
    moved: Bool[np.ndarray, " n"],
) -> Float32[np.ndarray, "n 2"]:
    """Headings of people with displaced velocities; those who stand keep theirs."""
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    turned = moved[:, None] & (speed >= STANDING_MPS)
    return np.where(turned, velocity / np.maximum(speed, STANDING_MPS), heading)


def _cite(name: str) -> str:
    """The paper to cite for a recording; empty for generated recordings and users' own."""
    try:
        return source(name).cite
    except SettingError:
        return ""


def _description(provenance: Mapping[str, Any]) -> str:
    """Description of a dataset in Minari's lists."""
    words = "Observations and actions of pedestrians. An episode is a trip or a part of one. "
    words += "All rewards are zero."
    if name := provenance.get("recording"):
        words += f" Made by crowdbench from the recording {name}, scene {provenance['scene']}."
    if cite := provenance.get("cite"):
        words += f" For your own use only, subject to the terms of its owners. Cite: {cite}."
    return words


def _trained_on(blocks: Int[np.ndarray, "B 2"], frames: int) -> Bool[np.ndarray, " frames"]:
    inside = np.zeros(frames, dtype=bool)
    for start, stop in blocks.tolist():
        inside[start:stop] = True
    return inside


def _pieces(
    person: Int[np.ndarray, " n"],
    frame: Int[np.ndarray, " n"],
    observations: Float32[np.ndarray, "n obs"],
    actions: Float32[np.ndarray, "n 2"],
    last: Int[np.ndarray, " P"],
    provenance: Mapping[str, Any],
) -> Demonstrations:
    """Demonstrations from unsorted rows: runs of consecutive frames of one person.

    Runs of a single row are dropped, because they contain no action.
    """
    order = np.lexsort((frame, person))
    person, frame = person[order], frame[order]
    begins = (np.diff(person, prepend=-1) != 0) | (np.diff(frame, prepend=-2) != 1)
    run = np.cumsum(begins) - 1
    length = np.bincount(run)
    kept = length[run] > 1
    order, begins = order[kept], begins[kept]
    person, frame = person[kept], frame[kept]
    length = length[length > 1]
    offsets = np.concatenate([[0], np.cumsum(length)])
    observations, actions = observations[order], actions[order]
    actions[offsets[1:] - 1] = np.nan
    whose = person[begins].astype(np.int64)
    ends = frame[offsets[1:] - 1]
    complete = ends == last[whose]
    return Demonstrations(
        observations, actions, whose, offsets, frame[begins], complete, provenance
    )
