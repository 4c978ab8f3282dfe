"""`submission.toml`: what a submitter says of a submission.

A submission's folder holds it beside its artefacts, whose places are fixed, one folder per scene:

    submission.toml
    eth-v0/policy/fold0.onnx, fold1.onnx, fold2.onnx     tracks walk and crowd; full.onnx alone
                                                         where training.protocol is full
    eth-v0/spawn/ntpp-gmm.safetensors                    tracks spawn and crowd: a file as scenes
                                                         ship it, of any family they ship
    eth-v0/trajectories/0.parquet, 1.csv, …              instead of both: listed, never ranked
    policy.onnx                                          instead of policies per scene: one that
                                                         has seen none of the recordings

What comes with crowdbench needs no files: it is named (`shipped_policy`, `shipped_spawn`).
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

SCHEMA = 1
FILE = "submission.toml"
SCENES = ("eth-v0", "gc-v0", "forum-v0")
"""The scenes that the overall score is the mean of; an entry without one has none."""

Track = Literal["walk", "spawn", "crowd"]
Kind = Literal["learned", "model-based", "privileged"]
Training = Literal["heldout", "none", "full"]
Line = Annotated[str, Meta(min_length=1, max_length=200)]
"""A line of plain text: printable, no control characters, not blank."""


class Trained(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a submission was trained on."""

    data: Annotated[str, Meta(min_length=1, max_length=1000)]
    """In the submitter's words."""
    protocol: Training
    """`heldout`: the artefact of each fold has seen that fold's training blocks only; `none`: no
    recording of a scene it is submitted for; `full`: whole recordings, which cannot be ranked."""
    parameters: Annotated[int, Meta(ge=0, le=10**12)]
    """Numbers that were learned, all artefacts of one scene and fold together."""


class Declared(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What `submission.toml` holds."""

    schema: Literal[1]
    name: Line
    authors: Annotated[list[Line], Meta(min_length=1, max_length=50)]
    contact: Line
    """An e-mail address, or where issues are opened."""
    link: Line
    """https://…, to a paper or to code."""
    licence: Line
    """SPDX identifier of the artefacts' licence."""
    track: Track
    """`walk`: a policy under the recorded arrivals; `spawn`: a spawn model with straight walkers;
    `crowd`: both."""
    kind: Kind
    """`privileged`: it sees the simulation's state, not observations."""
    scenes: Annotated[list[Line], Meta(min_length=1, max_length=50)]
    """Ids of the scenes it is submitted for."""
    training: Trained
    shipped_policy: str = ""
    """A policy that comes with crowdbench, in place of files."""
    shipped_spawn: str = ""
    """A spawn model that comes with crowdbench, in place of files."""
