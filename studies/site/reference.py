"""The pages of the reference: which modules each shows."""

import crowdbench

TITLES = {
    "reference/crowdbench.md": "crowdbench",
    "reference/envs.md": "Environments",
    "reference/robot.md": "Robots",
    "reference/simulation.md": "Simulation and observations",
    "reference/policies.md": "Policies",
    "reference/spawn.md": "Spawn models",
    "reference/data.md": "Data and scenes",
    "reference/metrics.md": "Metrics and scores",
    "reference/run.md": "Evaluation",
}
"""The pages and their titles."""
MODULES = {
    "reference/envs.md": (
        "envs.config", "envs.parallel_env", "envs.person_env", "envs.torchrl_env", "envs.vec_env",
        "envs.demonstrations", "envs.reference_rewards",
    ),
    "reference/robot.md": (
        "robot.config", "robot.robots", "robot.env", "robot.vector_env", "robot.sb3",
        "robot.controllers", "robot.seeing", "robot.observing", "robot.measures", "robot.costs",
        "robot.tasks", "robot.comparison", "robot.record", "robot.worlds",
    ),
    "reference/simulation.md": (
        "simulation.simulation", "simulation.state", "simulation.observations",
        "simulation.reward", "simulation.contact",
    ),
    "reference/policies.md": ("policies.policy", "policies.walkers", "policies.social_force",
                              "policies.speed_model", "registry"),
    "reference/spawn.md": ("spawn.model", "spawn.events", "spawn.areas", "spawn.replay"),
    "reference/data.md": ("data.table", "data.storage", "scene"),
    "reference/metrics.md": ("metrics", "scoring.scorecard", "scoring.score"),
    "reference/run.md": ("crowds", "evaluation", "run.executor", "plugins", "errors"),
}  # fmt: skip
"""The modules of the pages, in crowdbench."""


def pages() -> dict[str, str]:
    """The pages as Markdown for mkdocstrings, by their paths in the site."""
    names = "\n\n".join(f"::: crowdbench.{name}" for name in crowdbench.__all__)
    start = f"# crowdbench\n\nThe names that `import crowdbench` gives.\n\n{names}\n"
    made = {"reference/crowdbench.md": start}
    for name, modules in MODULES.items():
        shown = "\n\n".join(f"::: crowdbench.{module}" for module in modules)
        made[name] = f"# {TITLES[name]}\n\n{shown}\n"
    return made
