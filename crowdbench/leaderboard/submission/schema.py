"""`submission.toml`: what a submitter declares about a submission.

It is at the top level of a submission's folder. The artefacts have fixed paths:

    submission.toml
    eth-v0/policy/fold0.onnx, fold1.onnx, fold2.onnx     tracks walk and crowd; only full.onnx if
                                                         training.protocol is full
    eth-v0/spawn/ntpp-gmm.safetensors                    tracks spawn and crowd: fits of a shipped
                                                         family, in the format that scenes ship
    eth-v0/trajectories/0.parquet, 1.csv, …              instead of models: listed, never ranked
    policy.onnx                                          instead of policies per scene: one network
                                                         trained on none of the recordings

Models that come with crowdbench need no files: `shipped_policy` and `shipped_spawn` name them.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

SCHEMA = 1
FILE = "submission.toml"
SCENES = ("eth-v0", "gc-v0", "forum-v0")
"""Scenes whose mean is the overall score; an entry that lacks one has no overall score."""

Track = Literal["walk", "spawn", "crowd"]
Kind = Literal["learned", "model-based", "privileged"]
Training = Literal["heldout", "none", "full"]
Line = Annotated[str, Meta(min_length=1, max_length=200)]
"""A line of plain text: printable, no control characters, not blank."""
_LINK = r"\Ahttps://[A-Za-z0-9-]+(\.[A-Za-z0-9-]+)+(:[0-9]{1,5})?([/?#][!#-;=?-_a-z~]*)?\Z"
_DATE = r"\A([0-9]{4}-(0[1-9]|1[0-2])-(0[1-9]|[12][0-9]|3[01]))?\Z"
_LICENCE = r"\A\(*[A-Za-z0-9.+-]+\)*( (AND|OR|WITH) \(*[A-Za-z0-9.+-]+\)*)*\Z"


class Trained(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a submission was trained on."""

    data: Annotated[str, Meta(min_length=1, max_length=1000)]
    """The training data, in the submitter's words."""
    protocol: Training
    """`heldout`: the artefact of each fold was trained on that fold's training blocks only; `none`:
    on no recording of the scenes it is submitted for; `full`: on whole recordings (not ranked)."""
    parameters: Annotated[int, Meta(ge=0, le=10**12)]
    """Number of learned parameters, all artefacts of one scene and fold together."""


class Declared(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The contents of `submission.toml`."""

    schema: Literal[1]
    name: Line
    authors: Annotated[list[Line], Meta(min_length=1, max_length=50)]
    contact: Line
    """An e-mail address or an issue tracker."""
    link: Annotated[str, Meta(pattern=_LINK, max_length=200)]
    """URL of a paper or of code, beginning with https://."""
    date: Annotated[str, Meta(pattern=_DATE)] = ""
    """Day of the submission, YYYY-MM-DD."""
    licence: Annotated[str, Meta(pattern=_LICENCE, max_length=200)]
    """SPDX identifier of the artefacts' licence."""
    track: Track
    """`walk`: a policy under the recorded arrivals; `spawn`: a spawn model with straight walkers;
    `crowd`: both."""
    kind: Kind
    """`privileged`: it uses the simulation's state instead of observations."""
    scenes: Annotated[list[Line], Meta(min_length=1, max_length=50)]
    """Ids of the scenes it is submitted for."""
    training: Trained
    shipped_policy: str = ""
    """Name of a policy that comes with crowdbench, instead of files."""
    shipped_spawn: str = ""
    """Name of a spawn model that comes with crowdbench, instead of files."""
