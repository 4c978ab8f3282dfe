"""`python -m studies NAME`: run a study, or write its page."""

import sys
from collections.abc import Sequence

from crowdbench.cli.running import new_app, run
from studies.commands.cheats import cheats
from studies.commands.diagrams import diagrams
from studies.commands.encounters import encounters
from studies.commands.figures import figures
from studies.commands.growth import growth
from studies.commands.leaderboard import leaderboard, trip_limits
from studies.commands.paper import paper
from studies.commands.results import results
from studies.commands.speed import speed
from studies.commands.walks import walks

STUDIES = (results, walks, cheats, paper, figures, encounters, speed, growth, diagrams)
app = new_app("python -m studies", "Studies of crowdbench, and the pages of its leaderboard.")
for study in (*STUDIES, leaderboard, trip_limits):
    app.command(study)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a study and return its exit code, which has the meaning of `crowdbench`'s."""
    return run(app, arguments)


if __name__ == "__main__":
    sys.exit(main())
