"""`python -m studies leaderboard` and `trip-limits`: what the leaderboard's maintainers run."""

from collections.abc import Sequence
from pathlib import Path

from crowdbench.errors import SettingError
from crowdbench.report.text.terminal import print_table


def leaderboard(*, root: Path = Path("leaderboard"), site: Path | None = None) -> None:
    """Write the leaderboard's tables, or the pages of its site.

    Args:
        root: folder of the leaderboard, which contains entries/
        site: write a page per entry into this folder instead
    """
    from studies.site import build

    written = build(root, site)
    print(f"{len(written)} files written to {site or root}")


def trip_limits(scenes: Sequence[str] = (), /) -> None:
    """Measure how many trips are like recorded ones without copying; write the flag's limits.

    Args:
        scenes: ids of scenes (default: all)
    """
    from crowdbench.leaderboard.verification.trip_limits import trip_limit
    from crowdbench.scene import list_scenes, load_scene
    from studies.trip_limits import HONEST, measure, write

    unknown = sorted(set(scenes) - set(list_scenes()))
    if unknown:
        raise SettingError(
            "trip-limits",
            got=f"scene {', '.join(unknown)}",
            expected=f"scenes of crowdbench ({', '.join(list_scenes())})",
        )
    measured = {name: measure(load_scene(name)) for name in scenes or list_scenes()}
    path = write(measured)
    rows = [
        (name, *(f"{share:.2%}" for share in shares.values()), f"{trip_limit(name):.1%}")
        for name, shares in measured.items()
    ]
    print_table("copied trips", *HONEST, "limit", rows=rows)
    print(f"written to {path}. `python -m studies leaderboard` flags by these limits.")
