"""`python -m studies leaderboard` and `trip-limits`: what the leaderboard's maintainers run."""

from collections.abc import Sequence
from pathlib import Path

from crowdbench.errors import SettingError
from crowdbench.report.text.terminal import print_table


def leaderboard(*, root: Path = Path("leaderboard")) -> None:
    """Write the leaderboard's table and the pages of all entries.

    Args:
        root: folder of the leaderboard, which contains entries/
    """
    from crowdbench.leaderboard.pages import build
    from crowdbench.leaderboard.pages.standings import entry_paths

    written = build(root)
    entries = len(entry_paths(root / "entries"))
    number = f"{entries} {'entry' if entries == 1 else 'entries'}"
    if shipped := len(written) - 2 - entries:
        number += f" of yours and {shipped} that ship with crowdbench"
    print(f"{number}: written to {root}: README.md, index.html and pages/")


def trip_limits(scenes: Sequence[str] = (), /) -> None:
    """Measure how many trips are like recorded ones without copying; write the flag's limits.

    Args:
        scenes: ids of scenes (default: all)
    """
    from crowdbench.leaderboard.verification.trip_limits import HONEST, measure, trip_limit, write
    from crowdbench.scene import list_scenes, load_scene

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
