"""`python -m studies encounters`: draw typical encounters, recorded and simulated."""

from pathlib import Path

from crowdbench.cli.options import SceneName


def encounters(
    scene: SceneName,
    /,
    *,
    policy: str | None = None,
    seed: int = 0,
    out: Path = Path("docs/encounters"),
) -> None:
    """Draw typical encounters of a recording beside simulated ones.

    Args:
        policy: policy that moves the people (default: anticipate if it ships with the scene, else
            anticipate-any)
        seed: random seed
        out: output folder
    """
    from studies.encounters import write_encounters

    paths, found = write_encounters(scene, policy=policy, out=out, seed=seed)
    for each in found:
        print(
            f"{each['kind']:<10} 1 of {each['chosen_from']:,}; {each['measure']}: "
            f"recorded {each['recorded']}, simulated {each['simulated']}"
        )
    print(f"written to {', '.join(str(path) for path in paths)}")
