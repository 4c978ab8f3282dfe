"""`crowdbench metrics`: list the metrics, built-in and registered."""

import argparse
from typing import TYPE_CHECKING

from crowdbench.cli.printing import new_console, new_table, print_note

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    metrics = commands.add_parser("metrics", help="list the metrics and where they are scored")
    metrics.set_defaults(run=_metrics)


def _metrics(args: argparse.Namespace) -> None:
    from crowdbench.metrics import METRICS, all_metrics
    from crowdbench.scene import list_scenes, load_scene

    scored = {scene: load_scene(scene).protocol.scored for scene in list_scenes()}
    table = new_table("metric", "family", "unit", "scored on", "from")
    for column in table.columns:
        column.justify = "left"
    for metric in all_metrics():
        scenes = [scene for scene, names in scored.items() if metric.name in names]
        package = "crowdbench" if metric in METRICS else type(metric).__module__
        table.add_row(metric.name, metric.family, metric.unit, ", ".join(scenes), package)
    new_console().print(table)
    print_note(
        "A scene is scored on the metrics that, according to `crowdbench power`, distinguish its "
        "anchor (the crowd that scores 0) from its recording. Other metrics are shown as distances."
    )
