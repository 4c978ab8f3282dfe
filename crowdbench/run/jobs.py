"""Rollouts as jobs: which rollouts an evaluation needs.

Each rollout is a job with a fingerprint of everything that it depends on.

Up to `BATCH` rollouts of the same models are made at once, if the policy allows it. The results of
a network depend on the size of its batch in the last bits. Therefore the rollouts of a batch are
determined by the jobs, never by the number of workers or by what exists already, and they are part
of the fingerprint: if one of them is missing, all are made again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from crowdbench.data.blocks import HELD_OUT, SPLITS
from crowdbench.errors import SettingError
from crowdbench.files import sha256
from crowdbench.policies import OnnxPolicy, Policy
from crowdbench.run.resolved import Resolved
from crowdbench.run.rollout import alike, batchable
from crowdbench.scene import Scene
from crowdbench.spawn.names import replays

Pair = tuple[str, str]
Models = tuple[str, str, str, str]
"""Names of a scene, spawn model and policy, and the fingerprint of their rollouts."""
MOST = 10_000
"""Largest number of rollouts of a pair and split."""
DRAWS = 6
"""Number of rollouts of a policy without random draws under perturbed arrivals."""
BATCH = 10
"""Maximum number of rollouts that are made at once."""


@dataclass(frozen=True)
class Job:
    """One rollout that is needed."""

    scene: str
    spawn: str
    policy: str
    split: str
    fit: int
    seed: int
    path: Path
    fingerprint: str
    """Hash of everything that the rollout depends on."""
    batch: int = 0
    """Number of the batch, of those with the same models."""
    exact: bool = True
    """Whether the rollout is the same in any batch."""
    shown: bool = True
    """Whether its trajectories are written, not only its summary."""

    @property
    def models(self) -> Models:
        """What its models are found by."""
        return self.scene, self.spawn, self.policy, self.fingerprint

    def __str__(self) -> str:
        return f"rollout {self.seed} of {self.spawn} × {self.policy} on {self.scene} ({self.split})"


def splits_of(protocol: str) -> tuple[str, ...]:
    """The splits that a protocol averages over: `full`, or all folds."""
    return SPLITS[:1] if protocol == "full" else SPLITS[1:]


def plan(
    scene: str, place: Scene, pairs: Sequence[Pair], protocol: str, seeds: int, folder: Path
) -> list[Job]:
    """All rollouts that an evaluation of these pairs needs.

    `seeds` is their number per pair and split. Under the recorded arrivals there are at most
    `walk_rollouts` of the scene's protocol, and one for a policy without random draws: everyone
    enters as recorded, nothing is fitted, and rollouts differ little. Under perturbed arrivals such
    a policy has up to `DRAWS`.

    Raises:
        SettingError: a name is unknown, or `seeds` is not a valid number of rollouts.
        WeightsError: the action of one person in a network depends on other persons' rows.
    """
    fits = place.protocol.fits
    if not 1 <= seeds <= MOST or (seeds >= 2 * fits and seeds % fits):
        raise SettingError(
            "seeds",
            got=str(seeds),
            expected=f"a multiple of {fits} up to {MOST:,}, so that all fits have the same number "
            f"of rollouts, or 1 to {2 * fits - 1} for distances without scores",
        )
    jobs = []
    tried: set[Path] = set()
    for s, p in pairs:
        pair = Resolved.of(place, s, p)
        recorded = replays(s)
        for split in _splits(pair, protocol, recorded=recorded):
            walkers = walkers_of(pair, split)
            for fold, walker in walkers.items():
                _check_unseen(p, walker, place, fold)
                if isinstance(walker, OnnxPolicy) and walker.path not in tried:
                    walker.check_rows()
                    tried.add(walker.path)
            walker = next(iter(walkers.values()))
            pair.spawn.model(fitted_for(split))  # raises an error if it cannot be made
            fingerprint = pair.fingerprint(split)
            number = min(seeds, place.protocol.walk_rollouts) if recorded else seeds
            if recorded and getattr(walker, "deterministic", False):
                number = 1 if s == "replay" else min(seeds, DRAWS)
            size = BATCH if batchable(walker) else 1
            exact = size == 1 or walker.sees == "state"
            for seed in range(number):
                path = folder / f"{_plain(s)}_{_plain(p)}_{split}_{seed}.parquet"
                batch = seed // size
                several = "" if exact else f"-{min(size, number - batch * size)}"
                of = fingerprint + several
                fit = 0 if recorded else seed % fits
                jobs.append(Job(scene, s, p, split, fit, seed, path, of, batch, exact))
    return jobs


def _splits(pair: Resolved, protocol: str, *, recorded: bool) -> tuple[str, ...]:
    """The splits of a pair's rollouts.

    Nothing is fitted to recorded arrivals, so one rollout suffices for all folds. If each fold has
    a network of its own, those take turns that were not trained on a time block, unless they
    remember what another network would not understand.
    """
    splits = splits_of(protocol)
    if not recorded:
        return splits
    if not pair.policy.per_split:
        return SPLITS[:1]
    if len(splits) > 1 and not pair.policy.own and alike([*walkers_of(pair, HELD_OUT).values()]):
        return (HELD_OUT,)
    return splits


def walkers_of(pair: Resolved, split: str) -> dict[str, Policy]:
    """The policies that walk in rollouts of a split, by the split that each is trained for."""
    splits = SPLITS[1:] if split == HELD_OUT else (split,)
    return {each: pair.policy.policy(each) for each in splits}


def fitted_for(split: str) -> str:
    """The split that the spawn model of a rollout is fitted for."""
    return SPLITS[0] if split == HELD_OUT else split


def batches(jobs: Sequence[Job]) -> list[tuple[Job, ...]]:
    """The jobs whose rollouts are made at once."""
    of: dict[tuple[object, ...], list[Job]] = {}
    for job in jobs:
        key = (job.models[:3], job.split, job.path.parent, job.batch)
        of.setdefault(key, []).append(job)
    return [tuple(each) for each in of.values()]


def _check_unseen(policy: str, walker: Policy, place: Scene, split: str) -> None:
    """Check that a policy was not trained on data that it is scored on.

    Raises:
        SettingError: it was trained on the scene, but for another split or on other scenes too.
    """
    if split == "full" or not isinstance(walker, OnnxPolicy):
        return
    card = walker.card
    if place.id in card.scenes and (card.scene, card.split) != (place.id, split):
        raise SettingError(
            f"policy {policy}",
            got=f"a network trained on {card.trained_on}",
            expected=f"a network that has not seen the data that {split} is scored on",
            hint="Train one network for each fold and name the folder with fold0.onnx, fold1.onnx, "
            "…, or evaluate with --protocol full.",
        )


def _plain(name: str) -> str:
    plain = "".join(c if c.isalnum() or c in "-." else "-" for c in name)
    return plain if plain == name else f"{plain}-{sha256(name.encode())[:6]}"
