"""Writing of demonstrations as Minari datasets."""

import shutil
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.errors import OutputError, SettingError

if TYPE_CHECKING:
    from minari import MinariDataset

    from crowdbench.envs.demonstrated_trips import Demonstrations


def write_minari(dataset_id: str, shown: "Demonstrations") -> "MinariDataset":
    """Write demonstrations as a dataset; see `Demonstrations.to_minari`."""
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.storage import get_dataset_path

    if not len(shown):
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
            got = "a dataset that already exists"
            hint = f"Increase its version, or run `minari delete {dataset_id}`."
            raise OutputError(folder, got=got, expected="a new id", hint=hint)
        try:
            return _write(dataset_id, shown)
        except (FileExistsError, ValueError):  # another process has created it meanwhile
            raise
        except BaseException:  # an incomplete dataset would look like a complete one
            shutil.rmtree(folder, ignore_errors=True)
            raise
    except OSError as error:
        got = str(error)
        hint = "Set MINARI_DATASETS_PATH to one."
        raise OutputError(dataset_id, got=got, expected="a writable folder", hint=hint) from error


def _write(dataset_id: str, shown: "Demonstrations") -> "MinariDataset":
    from gymnasium.spaces import Box
    from minari import create_dataset_from_buffers
    from minari.data_collector import EpisodeBuffer

    buffers = []
    for rows, complete in zip(shown.rows(), shown.complete, strict=True):
        actions = shown.actions[rows][:-1]
        last = np.arange(len(actions)) == len(actions) - 1
        buffers.append(
            EpisodeBuffer(
                observations=shown.observations[rows],
                actions=actions,
                rewards=np.zeros(len(actions), np.float32),
                terminations=last & complete,
                truncations=last & ~complete,
            )
        )
    columns = zip(shown.person.tolist(), shown.first.tolist(), shown.entered.tolist(), strict=True)
    notes = [dict(zip(("person", "first_frame", "entered"), of, strict=True)) for of in columns]
    with warnings.catch_warnings():
        # Minari warns if a dataset has no author, e-mail address or Gymnasium environment.
        warnings.filterwarnings("ignore", ".* is set to None|env_spec is None", UserWarning)
        dataset = create_dataset_from_buffers(
            dataset_id,
            buffers,
            observation_space=Box(-1.0, 1.0, shown.observations.shape[1:], np.float32),
            action_space=Box(-1.0, 1.0, shown.actions.shape[1:], np.float32),
            algorithm_name="recorded persons",
            description=_description(shown.provenance),
        )
    dataset.storage.update_episode_metadata(notes)
    dataset.storage.update_metadata({"crowdbench": dict(shown.provenance)})
    return dataset


def _description(provenance: Mapping[str, Any]) -> str:
    words = "Observations and actions of pedestrians. An episode is a trip or a part of one. "
    words += "All rewards are zero."
    if name := provenance.get("recording"):
        words += f" Made by crowdbench from the recording {name}, scene {provenance['scene']}."
    if cite := provenance.get("cite"):
        words += f" For your own use only, subject to the terms of its owners. Cite: {cite}."
    return words
