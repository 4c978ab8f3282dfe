"""What recorded people saw and did: state-action pairs to learn a policy from.

The recording is replayed in the simulation that environments stand on, everyone along its recorded
path, and what each person sees there is written down beside the action that takes it on. So the
pairs are those of the environment, observation for observation, walls and speed limit included.
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
from crowdbench.rollouts.episode import actions_of, begin, check_capacity, generator
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import OBSERVATION
from crowdbench.spawn import Replay
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.weights import check_part

if TYPE_CHECKING:
    from imitation.data.types import Trajectory
    from minari import MinariDataset


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """`L` lives or pieces of lives, `S` state-action pairs.

    A life is cut where it leaves the blocks that a part of the recording is fitted on.
    """

    observations: Float32[np.ndarray, "R obs"]
    """R = S + L: after the observations of each piece, one of where its last action leads."""
    actions: Float32[np.ndarray, "R 2"]
    """Velocity in units of the scene's greatest speed; NaN in the last row of each piece."""
    person: Int[np.ndarray, " L"]
    """Index of the person in the recording."""
    offsets: Int[np.ndarray, " L+1"]
    """Rows of piece k are offsets[k] … offsets[k + 1] − 1."""
    first: Int[np.ndarray, " L"]
    """Frame of each piece's first row."""
    complete: Bool[np.ndarray, " L"]
    """Whether the piece ends where the person left, or is cut off."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Whose they are and how they were made: the recording, whom to cite, and all settings."""

    def __len__(self) -> int:
        return len(self.person)

    def pairs(self) -> tuple[Float32[np.ndarray, "S obs"], Float32[np.ndarray, "S 2"]]:
        """All observations, and the actions taken in them."""
        acted = ~np.isnan(self.actions[:, 0])
        return self.observations[acted], self.actions[acted]

    def take(self, pieces: Sequence[int] | Int[np.ndarray, " l"]) -> "Demonstrations":
        """Some of the pieces, by index."""
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
        """Two lots, the second of about that share of the persons: nobody is in both."""
        persons = np.unique(self.person)
        chosen = np.random.default_rng(seed).random(len(persons)) < share
        second = np.isin(self.person, persons[chosen])
        return self.take(np.flatnonzero(~second)), self.take(np.flatnonzero(second))

    def to_imitation(self) -> "list[Trajectory]":
        """The pieces as `imitation`'s trajectories; needs the extra `imitation`."""
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
        """Write the pieces as a dataset of Minari; needs the extra `minari`.

        It lies where Minari keeps its own: in the folder that the environment variable
        `MINARI_DATASETS_PATH` names, by default `~/.minari/datasets`. Each piece is an episode of
        one observation more than actions. It ends terminated where the person left and truncated
        where it is cut off; its metadata hold `person` and `first_frame`. Rewards are zero: nobody
        recorded any. The dataset's metadata hold `provenance`, with whom to cite, as `crowdbench`.

        A recording stays under its owners' terms, and so does what is made of it: the dataset is
        for your own use, not to be published.

        Args:
            dataset_id: as Minari wants it, like `crowdbench/eth-full-v0`.

        Raises:
            SettingError: there are no pieces, or Minari does not take the id.
            OutputError: there is a dataset of that id, or it cannot be written.
        """
        from minari.dataset.minari_dataset import parse_dataset_id
        from minari.storage import get_dataset_path

        if not len(self):
            raise SettingError("to_minari", got="no demonstrations", expected="one or more")
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
                    got="a dataset that is there already",
                    expected="a new id",
                    hint=f"Count its version up, or run `minari delete {dataset_id}`.",
                )
            try:
                return self._write_minari(dataset_id)
            except (FileExistsError, ValueError):  # someone else has made one meanwhile
                raise
            except BaseException:  # half a dataset would look like a whole one
                shutil.rmtree(folder, ignore_errors=True)
                raise
        except OSError as error:
            raise OutputError(
                dataset_id,
                got=str(error),
                expected="a place that can be written to",
                hint="Name one in MINARI_DATASETS_PATH.",
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
            # Minari asks for an author, an address and an environment of Gymnasium's: none of them.
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
    part: str = "full",
    observation: str = OBSERVATION,
    rays: int = 32,
    ray_range_m: float = 10.0,
    displaced_m: float = 0.0,
    recovery_s: float = 1.5,
    seed: int = 0,
) -> Demonstrations:
    """The demonstrations of a scene's recording in the blocks that `part` is fitted on.

    Who only ever saw people on their way does not know how to get back to it: a cloned policy
    drifts, and then is where no demonstration was. So half of the persons, drawn by chance, can be
    displaced: again and again each is somewhere beside its recorded path, at another velocity, and
    comes back as a critically damped spring of time constant τ does, with
    (δ + (ε + δ/τ) t) exp(−t/τ) from where it was recorded after t. (Laskey et al. 2017, DART,
    CoRL, disturb the demonstrator for the same reason.) What displaced people do is as smooth as
    what was recorded: a displacement that came back in one step would look like unrest. In their
    last 2 s they go straight to where the record ends, and who stands is not displaced.

    Args:
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a scene.
        part: `full`, or `fold0` … for what a fold of the protocol `heldout` is fitted on, which
            knows nothing of the blocks it is scored on.
        observation: what they see, as in `parallel_env`; so are `rays` and `ray_range_m`.
        displaced_m: standard deviation of both components of δ, metres, and times 1/τ of those
            of ε; 0 for none.
        recovery_s: τ. A displacement lasts for 4 τ, and then there is another.
        seed: of the displacements.

    Raises:
        RecordingError: the recording has not been imported.
        SceneError, SettingError: there is no such scene, part or observation.
    """
    place = load_scene(scene)
    check_part(part, 0)
    for name, value, least in (("displaced_m", displaced_m, 0), ("recovery_s", recovery_s, 1e-3)):
        if not (np.isfinite(value) and value >= least):
            raise SettingError(name, got=str(value), expected=f"a finite number from {least:g} on")
    recording = recording_of(place)
    # A slot is free in the frame after the last, when others have entered already.
    most = 2 * int(recording.present().max())
    settings = Settings(max_alive=most, rays=rays, ray_range_m=ray_range_m, observation=observation)
    simulation = Simulation(place, settings=settings)
    walker = ReplayPolicy(recording)
    begin(
        simulation,
        Replay(recording),
        seed=0,
        frames=recording.frames,
        start="recorded",
        walker=walker,
        scripted=True,
    )
    walker.reset(place, generator(0, 0, "policy"))
    aside = PathPerturbation.of(recording, displaced_m, recovery_s, seed)
    last = recording.offsets[1:] - 1
    step_m = place.dt_s * place.motion.max_speed_mps
    inside = _trained_on(blocks_of(recording, place).training(part).frames, recording.frames)

    person: list[np.ndarray] = []
    frame: list[np.ndarray] = []
    observations: list[np.ndarray] = []
    actions: list[np.ndarray] = []
    slots = simulation.slots
    for t in range(recording.frames):
        actions_now = actions_of(walker, simulation)
        if inside[t]:
            there = (slots.alive[0] | (slots.ended[0] != 0)).nonzero()[0]
            event = slots.event[0, there]
            person.append(event)
            frame.append(np.full(len(there), t))
            now = actions_now[0, there]
            stood, went = slots.position[0, there], slots.velocity[0, there]
            row = np.minimum(recording.offsets[event] + t - recording.first[event], last[event])
            after = np.minimum(row + 1, last[event])
            here = (stood + aside.now[row]).astype(np.float64)
            moved = aside.now[row].any(axis=1) | aside.after[row].any(axis=1)
            moved &= place.walkable(here) & place.walkable(recording.xy[after] + aside.after[row])
            slots.position[0, there[moved]] = here[moved]
            slots.velocity[0, there[moved]] += aside.drift[row[moved]].astype(np.float32)
            observations.append(simulation.observe()[0, there])
            slots.position[0, there], slots.velocity[0, there] = stood, went
            way = recording.xy[after] + aside.after[row] - here
            now[moved] = (way / step_m).clip(-1, 1)[moved]
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
        "part": part,
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


def _cite(name: str) -> str:
    """The paper to cite for a recording; empty for what is generated or somebody's own."""
    try:
        return source(name).cite
    except SettingError:
        return ""


def _description(provenance: Mapping[str, Any]) -> str:
    """What a dataset says of itself where it is listed."""
    words = "What pedestrians saw and did, one episode for each piece of a life; rewards are zero."
    if name := provenance.get("recording"):
        words += f" Of the recording {name}, scene {provenance['scene']}, by crowdbench."
    if cite := provenance.get("cite"):
        words += f" It stays under its owners' terms, for your own use; cite {cite}."
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
    """Rows sorted into runs of frames of one person; runs of one row show no action."""
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
