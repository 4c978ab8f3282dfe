"""Studies that print tables, such as `plans`, `bodies` and `monte-carlo`."""

from pathlib import Path

import crowdbench
from crowdbench.cli.options import Workers
from crowdbench.cli.printing import progress_bar
from crowdbench.report.text.terminal import print_table


def plans(scenes: list[str], /) -> None:
    """Print the page on how well plans describe people.

    Args:
        scenes: ids of scenes, or their folders
    """
    from studies.plans import page

    print(page(scenes), end="")


def joint(scenes: list[str] | None = None, /) -> None:
    """Print the page on one neural process for all areas (half an hour).

    Args:
        scenes: ids of recorded scenes (default: all)
    """
    from studies.joint import SCENES, page

    print(page(scenes or SCENES), end="")


def bodies(scenes: list[str] | None = None, /) -> None:
    """Print the page on the radius of bodies, and on the scenes that have them (minutes).

    Args:
        scenes: ids of scenes, or their folders (default: all)
    """
    from studies.bodies import page

    print(page(scenes or crowdbench.list_scenes()), end="")


def copies(scenes: list[str] | None = None, /) -> None:
    """Print the page on policies that copy recorded paths (minutes).

    Args:
        scenes: ids of scenes, or their folders (default: ETH and the Forum)
    """
    from studies.copies import SCENES, page

    print(page(scenes or SCENES), end="")


def exam(policies: list[str] | None = None, /, *, workers: Workers = None) -> None:
    """Print the page on the exam of the policies that come with crowdbench (minutes).

    Args:
        policies: policies of ETH by name (default: all, without the rule-based ones of extras)
    """
    from studies.exam import POLICIES, page

    print(page(policies or POLICIES, workers), end="")


def robots(
    *, episodes: int = 500, pictures: Path = Path("docs/robots"), workers: Workers = None
) -> None:
    """Print the page on controllers of robots among people of several kinds (minutes).

    Args:
        episodes: number of episodes of each controller among people of each kind
        pictures: folder for the pictures
    """
    from studies.robots import page

    print(page(episodes, workers=workers, pictures=pictures), end="")


def peers(*, out: Path = Path("docs/peers.md")) -> None:
    """Write the page about models of other simulators, from their entries on the leaderboard.

    Args:
        out: page to write
    """
    from studies.peers import write_page

    print(f"written to {write_page(out)}")


def sharing(scenes: list[str], /) -> None:
    """Compare one network for all spawn areas with one for each (minutes).

    Args:
        scenes: ids of scenes, or their folders
    """
    from studies.sharing import comparison

    print(comparison(scenes))


def ceilings(
    scenes: list[str] | None = None,
    /,
    *,
    policy: str = "anticipate",
    out: Path = Path("results/ceilings"),
    workers: Workers = None,
) -> None:
    """Measure what a right model would score in walking, and write it beside the scenes' files.

    Args:
        scenes: ids of scenes, or their folders (default: all real ones)
        policy: policy whose rollouts stand for the recording
        out: folder of the rollouts that are made
    """
    from crowdbench.metrics import WALK
    from crowdbench.scene import load_scene
    from studies.ceilings import measure, write
    from studies.monte_carlo import SCENES

    rows = []
    for name in scenes or SCENES:
        scene = load_scene(name)
        with progress_bar(f"rollouts of {scene.id}") as progress:
            found = measure(scene, policy, out / scene.id, workers, progress)
        write(scene, found)
        for arrivals, of in (("recorded", found.recorded), ("perturbed", found.perturbed)):
            values = [f"{of.families[family]:.2f}" for family in WALK if family in of.families]
            rows.append((scene.id, arrivals, *values, f"{of.walk:.2f}"))
    print_table("scene", "arrivals", *WALK, "walk", rows=rows, left=("arrivals",))


def monte_carlo(
    scenes: list[str] | None = None,
    /,
    *,
    out: Path = Path("results/rollouts"),
    workers: Workers = None,
) -> None:
    """Print the page on the error that few rollouts make, beside that of few time blocks.

    Args:
        scenes: ids of scenes, or their folders (default: all real ones)
        out: folder of the rollouts that are made
    """
    from studies.monte_carlo import SCENES, page

    print(page(scenes or SCENES, out=out, workers=workers), end="")


def cheats_search(scene: str = "eth-v0", /, *, draws: int = 200) -> None:
    """Search at random for blind wanderers that score well (minutes).

    Args:
        scene: id of a scene, or its folder
        draws: number of wanderers
    """
    from studies.cheats.search import search

    print("\n".join(search(scene, draws)))
