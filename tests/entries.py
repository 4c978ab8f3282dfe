"""Entries that nobody submitted: numbers of a seed, in the shape that verification gives them."""

import zlib
from pathlib import Path

import msgspec
import numpy as np

from crowdbench.files import write_json
from crowdbench.leaderboard.scores import FAMILIES_OF
from crowdbench.leaderboard.submission.schema import SCENES, Declared, Kind, Track, Trained
from crowdbench.leaderboard.verification.entry import (
    SCHEMA,
    SCORER,
    Copy,
    Curve,
    Earlier,
    Entry,
    ExamEntry,
    Flag,
    MetricEntry,
    SceneEntry,
    ScoreCard,
    Status,
    entry_path,
)
from crowdbench.metrics import METRICS, WALK
from crowdbench.scoring.energy import RESAMPLES
from crowdbench.scoring.score import Score

UNCOUNTED = ("dwell", "detour", "wall_clearance", "overlap_rate", "companion_distance")
"""Metrics that no made-up scene counts."""


def made_up(
    name: str,
    track: Track,
    level: float,
    *,
    status: Status = "ranked",
    kind: Kind = "learned",
    scenes: tuple[str, ...] = SCENES,
    spread: float = 0.05,
    flags: tuple[Flag, ...] = (),
    history: tuple[Earlier, ...] = (),
    **declared: object,
) -> Entry:
    """An entry whose scores lie about `level`; `spread` is the noise that is its own."""
    facts = {
        "schema": 1,
        "name": name,
        "authors": ["Ada Example", "Ben Beispiel"],
        "contact": "crowds@example.org",
        "link": "https://example.org/paper",
        "licence": "Apache-2.0",
        "track": track,
        "kind": kind,
        "scenes": list(scenes),
        "training": Trained(data="two thirds of each recording", protocol="heldout",
                            parameters=21_508),
    } | declared  # fmt: skip
    return Entry(
        schema=SCHEMA,
        id=name if name.replace("-", "").isalnum() else "hostile",
        status=status,
        declared=Declared(**facts),  # type: ignore[arg-type]
        scorer=SCORER,
        crowdbench="0.1.0",
        artefacts={f"{scene}/policy/fold{k}.onnx": f"{k}" * 64 for scene in scenes for k in (0, 1)}
        | {"submission.toml": "f" * 64},
        scenes={scene: on_scene(name, scene, track, level, spread) for scene in scenes},
        flags=list(flags),
        exam=None
        if track == "spawn" or "eth-v0" not in scenes
        else ExamEntry(
            scene="eth-v0", body_radius_m=0.15, passed=["rimea-1", "door"], failed=["rimea-9"]
        ),
        history=list(history),
    )


def on_scene(name: str, scene: str, track: Track, level: float, spread: float) -> SceneEntry:
    """Families that lie about a level, with the scene's noise, which all share, and their own."""
    own = np.random.default_rng(zlib.crc32(f"{name} {scene}".encode()))
    shared = np.random.default_rng(zlib.crc32(scene.encode()))
    families, metrics = {}, {}
    for family in FAMILIES_OF[track]:
        value = level + 0.05 * own.normal()
        noise = 0.12 * shared.normal(size=RESAMPLES) + spread * own.normal(size=RESAMPLES)
        score = Score(value, value + noise)
        families[family] = ScoreCard.of(score)
        for metric in METRICS:
            if metric.family == family:
                counts = metric.name not in UNCOUNTED
                fits = (value + 0.08 * own.normal(size=(3, 5))).round(4).tolist()
                metrics[metric.name] = MetricEntry(
                    distance=round(abs(0.4 * (1 - value)), 4),
                    recorded=round(float(own.uniform(0.5, 40)), 3),
                    simulated=round(float(own.uniform(0.5, 40)), 3),
                    unit=metric.unit,
                    scored=counts,
                    score=value if counts else None,
                    interval=score.interval if counts else None,
                    splits={f"fold{k}": fits[k] for k in range(3)} if counts else {},
                )
    if "trips" in families:
        # Nothing of trips counts on ETH, as on the real one.
        for metric_name in ("origin_destination", "goal_share"):
            if scene == "eth-v0":
                metrics[metric_name] = msgspec.structs.replace(metrics[metric_name], scored=False)
        if scene == "eth-v0":
            del families["trips"]
    arrivals = None if track == "walk" else round(float(own.uniform(0.2, 0.45)), 4)
    return SceneEntry(
        made_from=f"{zlib.crc32(scene.encode()):016x}",
        protocol="heldout",
        fits=5,
        rollouts=30,
        persons=10_812,
        outcomes={"goal": 9_930, "exit": 402, "timeout": 60, "horizon": 420},
        speed_mps=1.31,
        at_goal=0.9555,
        recorded_speed_mps=1.33,
        recorded_at_goal=1.0,
        fails=[],
        families=families,
        metrics=metrics,
        copy=Copy(
            arrivals=arrivals,
            arrivals_limit=None if arrivals is None else 0.46,
            trips=round(float(own.uniform(0, 0.03)), 4),
        ),
        curves=curves(own, track) if scene in SCENES[:2] else {},
    )


def curves(rng: np.random.Generator, track: Track) -> dict[str, Curve]:
    """Two pictures."""
    scale = rng.uniform(0.8, 1.5)
    t = np.linspace(0, 60, 61)
    v = np.linspace(0, 2.5, 51)
    x, recorded, simulated = (t, np.exp(-t / 9), np.exp(-t / (9 * scale)))
    walk = (v, np.exp(-(((v - 1.3) / 0.3) ** 2)), np.exp(-(((v - 1.3 * scale) / 0.2) ** 2)))
    found = {
        "Speed": ("speed (m/s)", "density", *walk),
        "Time between arrivals": ("time between two arrivals (s)", "share above", x, recorded,
                                  simulated),
    }  # fmt: skip
    if track == "walk":
        del found["Time between arrivals"]
    return {
        title: Curve(x_label=x_label, y_label=y_label, x=a.round(4).tolist(),
                     recorded=b.round(5).tolist(), simulated=c.round(5).tolist())
        for title, (x_label, y_label, a, b, c) in found.items()
    }  # fmt: skip


def everyone() -> list[Entry]:
    """All that a leaderboard can hold."""
    flag = Flag(
        what="copied arrivals",
        scene="gc-v0",
        value=0.81,
        limit=0.46,
        text="Arrivals of a typical minute correlate at 0.81 with some minute of the recording; 99 "
        "of 100 crowds that cannot copy stay below 0.46.",
    )
    earlier = Earlier(
        scorer=0, crowdbench="0.0.9", overall=0.41, scenes={"eth-v0": 0.44, "gc-v0": 0.37},
        reason="Closest approaches count strangers only.",
    )  # fmt: skip
    six = (*SCENES, "hotel-v0", "plaza-v0", "zara1-v0")
    return [
        made_up("straight", "walk", 0.0, status="reference", kind="model-based", spread=0.0),
        made_up("replay-walk", "walk", 1.0, status="reference", kind="privileged"),
        made_up("random", "walk", -0.45, status="reference", kind="model-based"),
        made_up("social-force", "walk", 0.33, kind="privileged", scenes=six),
        made_up("bc", "walk", 0.61, history=(earlier,)),
        made_up("gail", "walk", 0.60),
        made_up("ppo", "walk", 0.59, scenes=("eth-v0", "gc-v0")),
        made_up("poisson-gmm", "spawn", 0.0, status="reference", kind="model-based", spread=0.0),
        made_up("block-replay", "spawn", 0.62, status="reference", kind="model-based"),
        made_up("renewal-gmm", "spawn", 0.55, kind="model-based", scenes=six),
        made_up("ntpp-gmm", "spawn", 0.71, scenes=six),
        made_up("twin", "spawn", 0.70),
        made_up("jittered-blocks", "spawn", 0.95, flags=(flag,)),
        made_up("theirs", "spawn", 0.8, status="listed", scenes=("eth-v0",)),
        made_up("ntpp-gmm-bc", "crowd", 0.66, scenes=six),
        made_up("ntpp-gmm-social-force", "crowd", 0.52, kind="privileged"),
        as_trajectories(
            made_up("simulator-of-theirs", "crowd", 0.2, status="listed", kind="model-based")
        ),
    ]  # fmt: skip


def as_trajectories(entry: Entry) -> Entry:
    """The same crowd, not rolled out by crowdbench: motion and interaction have no scores."""
    scenes = {}
    for name, scene in entry.scenes.items():
        families = {f: card for f, card in scene.families.items() if f not in WALK}
        scenes[name] = msgspec.structs.replace(scene, families=families, protocol="full")
    files = {f"{scene}/trajectories/{k}.parquet": f"{k}" * 64 for scene in scenes for k in (0, 1)}
    return msgspec.structs.replace(entry, scenes=scenes, artefacts=files)


def put(entries: list[Entry], root: Path) -> Path:
    """A leaderboard's folder with these entries; its rules make it one, and no preview."""
    (root / "entries").mkdir(parents=True, exist_ok=True)
    (root / "RULES.md").touch()
    for entry in entries:
        write_json(entry_path(root / "entries", entry.id), entry)
    return root
