"""`Demonstrations`: trips of recorded people as observations and actions, and their rows."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

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

    def pairs(self) -> tuple[Float32[np.ndarray, "S obs"], Float32[np.ndarray, "S 2"]]:
        """Observations (S, obs) and the actions (S, 2) taken in them, of all pieces."""
        shown = ~np.isnan(self.actions[:, 0])
        return self.observations[shown], self.actions[shown]

    def padded(
        self,
    ) -> tuple[
        Float32[np.ndarray, "L T obs"], Float32[np.ndarray, "L T 2"], Bool[np.ndarray, "L T"]
    ]:
        """Observations, actions and a mask by piece and step, for recurrent networks.

        T is the number of actions in the longest piece. Shorter pieces are followed by zeros. The
        mask is true where there is an action. To save memory, take a batch of pieces first:
        `shown.take(batch).padded()`.
        """
        steps = np.diff(self.offsets) - 1
        there = np.arange(steps.max(initial=0)) < steps[:, None]
        acted = ~np.isnan(self.actions[:, 0])
        observations = np.zeros((*there.shape, self.observations.shape[1]), np.float32)
        actions = np.zeros((*there.shape, 2), np.float32)
        observations[there], actions[there] = self.observations[acted], self.actions[acted]
        return observations, actions, there

    def take(self, pieces: Sequence[int] | Int[np.ndarray, " l"]) -> "Demonstrations":
        """The pieces with the given indices."""
        chosen = np.asarray(pieces, dtype=np.int64)
        length = np.diff(self.offsets)[chosen]
        offsets = np.concatenate([[0], np.cumsum(length)])
        within = np.arange(offsets[-1]) - np.repeat(offsets[:-1], length)
        rows = np.repeat(self.offsets[:-1][chosen], length) + within
        of_rows, of_pieces = (
            {name: getattr(self, name)[which] for name in names}
            for names, which in (
                (("observations", "actions"), rows),
                (("person", "first", "entered", "complete"), chosen),
            )
        )
        return replace(self, offsets=offsets, **of_rows, **of_pieces)

    def rows(self) -> Iterator[slice]:
        """The rows of each piece."""
        return map(slice, self.offsets[:-1].tolist(), self.offsets[1:].tolist())

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
                obs=self.observations[rows],
                acts=self.actions[rows][:-1],
                infos=None,
                terminal=bool(complete),
            )
            for rows, complete in zip(self.rows(), self.complete, strict=True)
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

        return write_minari(dataset_id, self)


class Rows(NamedTuple):
    """A row for each of the `n` persons who decide, or whose trips ended, in a frame."""

    person: Int[np.ndarray, " n"]
    frame: Int[np.ndarray, " n"]
    step: Int[np.ndarray, " n"]
    """Number of decisions that the person has made before."""
    observations: Float32[np.ndarray, "n obs"]
    actions: Float32[np.ndarray, "n 2"]


def pieces_of(
    rows: Sequence[Rows],
    first: Int[np.ndarray, " P"],
    last: Int[np.ndarray, " P"],
    provenance: Mapping[str, Any],
) -> Demonstrations:
    """Demonstrations from the rows of all frames: runs of consecutive decisions of one person.

    `first` are the frames in which the recorded trips begin, `last` those in which people left
    the scene, −1 if they did not. Runs of a single row are dropped, because they contain no action.
    """
    found = Rows(*map(np.concatenate, zip(*rows, strict=True)))
    order = np.lexsort((found.step, found.person))
    found = Rows(*(column[order] for column in found))
    begins = (np.diff(found.person, prepend=-1) != 0) | (np.diff(found.step, prepend=-2) != 1)
    run = np.cumsum(begins) - 1
    length = np.bincount(run)
    kept = length[run] > 1
    begins, found = begins[kept], Rows(*(column[kept] for column in found))
    offsets = np.concatenate([[0], np.cumsum(length[length > 1])])
    found.actions[offsets[1:] - 1] = np.nan
    person, frame = found.person[begins].astype(np.int64), found.frame[begins]
    return Demonstrations(
        observations=found.observations,
        actions=found.actions,
        person=person,
        offsets=offsets,
        first=frame,
        entered=frame == first[person],
        complete=found.frame[offsets[1:] - 1] == last[person],
        provenance=provenance,
    )
