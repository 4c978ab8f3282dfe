"""`python -m studies leaderboard`, `clips`, `site`, `rescore`, `copy-limits`: for maintainers."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.leaderboard import SandboxLimits, in_turn
from crowdbench.cli.options import Workers
from crowdbench.errors import SettingError
from crowdbench.report.text.terminal import print_table

if TYPE_CHECKING:
    from crowdbench.leaderboard.verification.entry import Entry


def leaderboard(*, root: Path = Path("leaderboard"), site: Path | None = None) -> None:
    """Write the leaderboard's tables, or the pages of its site.

    Args:
        root: folder of the leaderboard, which contains entries/
        site: write a page per entry into this folder instead
    """
    from studies.site import build

    written = build(root, site)
    print(f"{len(written)} files written to {site or root}")


def clips(entry: str, /, *, root: Path = Path("leaderboard")) -> None:
    """Simulate a minute of an entry's crowd on each of its scenes, for its page.

    Args:
        entry: id of the entry
        root: folder of the leaderboard, which contains submissions/
    """
    from studies.clips import write_clips

    print(f"written to {write_clips(entry, root)}")


def site(*, root: Path = Path(), out: Path = Path("site")) -> None:
    """Write the site: all pages with a search, a reference of the API, and the leaderboard.

    Args:
        root: folder of the repository
        out: output folder; an earlier site is replaced
    """
    from studies.site.documentation import build_site

    build_site(root, out)
    print(f"written to {out}: open {out}/index.html, or serve it: python -m http.server -d {out}")


def rescore(
    entries: Sequence[str] = (),
    /,
    *,
    reason: str,
    root: Path = Path("leaderboard"),
    out: Path = Path("results/leaderboard"),
    workers: Workers = None,
    at_most: SandboxLimits = SandboxLimits(),
) -> None:
    """Verify entries again with the current scorer; earlier results stay in the history.

    Args:
        entries: ids of entries (default: all)
        reason: reason to state in the entries' history
        root: folder of entries/ and submissions/
        out: output folder of ID.run.json and the rollouts
    """
    from crowdbench.leaderboard.verification.entry import entry_paths
    from studies import rescore as rescoring

    limits = at_most.checked()

    def one(entry: str) -> "Entry":
        return rescoring.rescore(
            entry, root, reason=reason, out=out, workers=workers, limits=limits
        )

    named = entries or list(entry_paths(root / "entries"))
    if not named:
        raise SettingError(
            f"{root}/entries",
            got="no entries",
            expected="at least one",
            hint="Set the folder of the leaderboard with --root.",
        )
    in_turn(named, one)


def copy_limits(scenes: Sequence[str] = (), /) -> None:
    """Measure how like recorded ones trips and arrivals are without copying; write flags' limits.

    Args:
        scenes: ids of scenes (default: all)
    """
    from crowdbench.leaderboard.verification.copying import independent_limits
    from crowdbench.leaderboard.verification.flags import trip_limit
    from crowdbench.scene import list_scenes, load_scene
    from studies.copy_limits import HONEST, measure, write

    unknown = sorted(set(scenes) - set(list_scenes()))
    if unknown:
        raise SettingError(
            "copy-limits",
            got=f"scene {', '.join(unknown)}",
            expected=f"scenes of crowdbench ({', '.join(list_scenes())})",
        )
    places = {name: load_scene(name) for name in scenes or list_scenes()}
    measured = {name: measure(place) for name, place in places.items()}
    path = write(measured, {name: independent_limits(place) for name, place in places.items()})
    rows = [
        (name, *(f"{share:.2%}" for share in shares.values()), f"{trip_limit(name):.1%}")
        for name, shares in measured.items()
    ]
    print_table("copied trips", *HONEST, "limit", rows=rows)
    print(f"written to {path}. `python -m studies leaderboard` flags by these limits.")
