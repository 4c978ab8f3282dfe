"""`python -m studies NAME`: run a study, or write its page."""

import sys
from collections.abc import Sequence

from crowdbench.cli.running import new_app, run
from studies.commands import checks, tables, trainings
from studies.commands.cheats import cheats
from studies.commands.diagrams import diagrams, moving_picture
from studies.commands.encounters import encounters
from studies.commands.figures import figures
from studies.commands.growth import growth
from studies.commands.leaderboard import clips, copy_limits, leaderboard, rescore, site
from studies.commands.paper import paper
from studies.commands.results import results
from studies.commands.speed import speed
from studies.commands.walks import walks

PAGES = (results, walks, paper, figures, encounters, cheats, growth, speed, diagrams, tables.plans)
TABLES = (
    *(tables.bodies, tables.exam, tables.robots, tables.sharing, tables.monte_carlo, tables.peers),
    *(tables.cheats_search, tables.copies, tables.ceilings, tables.joint),
)
TRAININGS = (
    *(trainings.ablation, trainings.across, trainings.compare_observations),
    *(trainings.without_reward_parts, trainings.runners, trainings.training_speed),
)
CHECKS = (checks.busy_steps, checks.ray_cluster)
SHOWN = (moving_picture, leaderboard, clips, site)
app = new_app("python -m studies", "Studies of crowdbench, and the pages of its leaderboard.")
for study in (*PAGES, *TABLES, *TRAININGS, *CHECKS, *SHOWN, rescore, copy_limits):
    app.command(study)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a study and return its exit code, which has the meaning of `crowdbench`'s."""
    return run(app, arguments)


if __name__ == "__main__":
    sys.exit(main())
