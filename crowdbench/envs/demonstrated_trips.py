"""`Demonstrations`: trips of recorded people as observations and actions, and their rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float32, Int

if TYPE_CHECKING:
    from imitation.data.types import Trajectory
    from minari import MinariDataset


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """`L` pieces (trips or parts of trips) with `S` observation-action pairs in total.

    A piece has a row for each decision of its person, in order of time, and a last row for its end.
    Trips are cut at the ends of the time blocks on which a split of the recording is fitted.
    """

    observations: Float32[np.ndarray, "R obs"]
    """Observations of all pieces, R = S + L rows. The last row of each piece is the observation
    after its last action."""
    actions: Float32[np.ndarray, "R 2"]
    """Velocities in units of the scene's maximum speed, in the frame of the observation; NaN in the
    last row of each piece."""
    deviation_m: Float32[np.ndarray, " R"]
    """Distance of the person from its recorded position, in metres."""
    person: Int[np.ndarray, " L"]
    """Index of the person in the recording."""
    offsets: Int[np.ndarray, " L+1"]
    """Piece k has the rows offsets[k] … offsets[k + 1] − 1."""
    first: Int[np.ndarray, " L"]
    """Frame of each piece's first row."""
    entered: Bool[np.ndarray, " L"]
    """True if the piece begins where the person's recorded trip begins, so that a policy with a
    memory knows nothing of the person yet; false if the beginning is cut off."""
    complete: Bool[np.ndarray, " L"]
    """True if the piece ends where the person left the scene, false if it is cut off."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """The recording, the paper to cite, and all settings of the demonstrations."""

    def __len__(self) -> int:
        return len(self.person)

    def pairs(
        self, within_m: float = np.inf
    ) -> tuple[Float32[np.ndarray, "S obs"], Float32[np.ndarray, "S 2"]]:
        """Observations (S, obs) and the actions (S, 2) taken in them, of all pieces.

        Without the actions of people who are `within_m` or more from their recorded positions.
        """
        shown = ~np.isnan(self.actions[:, 0]) & (self.deviation_m < within_m)
        return self.observations[shown], self.actions[shown]

    def padded(
        self, within_m: float = np.inf
    ) -> tuple[
        Float32[np.ndarray, "L T obs"], Float32[np.ndarray, "L T 2"], Bool[np.ndarray, "L T"]
    ]:
        """Observations, actions and a mask by piece and step, for recurrent networks.

        T is the number of actions in the longest piece. Shorter pieces are followed by zeros. The
        mask is true where there is an action, unless the person is `within_m` or more from its
        recorded position. To save memory, take a batch of pieces first:
        `shown.take(batch).padded()`.
        """
        steps = np.diff(self.offsets) - 1
        there = np.arange(steps.max(initial=0)) < steps[:, None]
        acted = ~np.isnan(self.actions[:, 0])
        observations = np.zeros((*there.shape, self.observations.shape[1]), np.float32)
        actions = np.zeros((*there.shape, 2), np.float32)
        observations[there], actions[there] = self.observations[acted], self.actions[acted]
        there[there] = self.deviation_m[acted] < within_m
        return observations, actions, there

    def take(self, pieces: Sequence[int] | Int[np.ndarray, " l"]) -> "Demonstrations":
        """The pieces with the given indices."""
        chosen = np.asarray(pieces, dtype=np.int64)
        length = np.diff(self.offsets)[chosen]
        offsets = np.concatenate([[0], np.cumsum(length)])
        within = np.arange(offsets[-1]) - np.repeat(offsets[:-1], length)
        rows = np.repeat(self.offsets[:-1][chosen], length) + within
        return Demonstrations(
            observations=self.observations[rows],
            actions=self.actions[rows],
            deviation_m=self.deviation_m[rows],
            person=self.person[chosen],
            offsets=offsets,
            first=self.first[chosen],
            entered=self.entered[chosen],
            complete=self.complete[chosen],
            provenance=self.provenance,
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
        Its metadata contain `person`, `first_frame` and `entered`. All rewards are zero, because
        recordings contain none. The dataset's metadata contain `provenance` under the key
        `crowdbench`.

        A dataset made from a recording remains subject to the terms of the recording's owners. It
        is for your own use and must not be published.

        Args:
            dataset_id: a Minari id such as `crowdbench/eth-full-v0`.

        Raises:
            SettingError: there are no pieces, or Minari does not accept the id.
            OutputError: a dataset with this id exists, or it cannot be written.
        """
        from crowdbench.envs.minari_export import write_minari

        episodes = []
        for k in range(len(self)):
            start, stop = self.offsets[k : k + 2].tolist()
            notes = {
                "person": int(self.person[k]),
                "first_frame": int(self.first[k]),
                "entered": bool(self.entered[k]),
            }
            actions = self.actions[start : stop - 1]
            episodes.append((self.observations[start:stop], actions, self.complete[k], notes))
        return write_minari(dataset_id, episodes, self.provenance)


@dataclass
class Rows:
    """Rows of demonstrations, frame by frame."""

    _frames: list[tuple[np.ndarray, ...]] = field(default_factory=list)

    def add(
        self,
        *,
        frame: int,
        person: Int[np.ndarray, " n"],
        step: Int[np.ndarray, " n"],
        observations: Float32[np.ndarray, "n obs"],
        actions: Float32[np.ndarray, "n 2"],
        deviation_m: Float32[np.ndarray, " n"],
    ) -> None:
        """Add a row each for the `n` persons who decide, or whose trips ended, in a frame.

        `step` is the number of decisions that the person has made before.
        """
        frames = np.full(len(person), frame)
        self._frames.append((person, frames, step, observations, actions, deviation_m))

    def pieces(
        self,
        first: Int[np.ndarray, " P"],
        last: Int[np.ndarray, " P"],
        provenance: Mapping[str, Any],
    ) -> Demonstrations:
        """Demonstrations from the rows: runs of consecutive decisions of one person.

        `first` are the frames in which the recorded trips begin, `last` those in which people left
        the scene, −1 if they did not. Runs of a single row are dropped, because they contain no
        action.
        """
        columns = [np.concatenate(column) for column in zip(*self._frames, strict=True)]
        order = np.lexsort((columns[2], columns[0]))
        person, frame, step, observations, actions, deviation_m = (c[order] for c in columns)
        begins = (np.diff(person, prepend=-1) != 0) | (np.diff(step, prepend=-2) != 1)
        run = np.cumsum(begins) - 1
        length = np.bincount(run)
        kept = length[run] > 1
        frame, begins, actions = frame[kept], begins[kept], actions[kept]
        offsets = np.concatenate([[0], np.cumsum(length[length > 1])])
        actions[offsets[1:] - 1] = np.nan
        whose = person[kept][begins].astype(np.int64)
        return Demonstrations(
            observations=observations[kept],
            actions=actions,
            deviation_m=deviation_m[kept],
            person=whose,
            offsets=offsets,
            first=frame[begins],
            entered=frame[begins] == first[whose],
            complete=frame[offsets[1:] - 1] == last[whose],
            provenance=provenance,
        )
