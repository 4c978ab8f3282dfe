"""`crowdbench exam`: put policies through the verification tests that engineers use."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.options import Json, SceneName, Workers
from crowdbench.cli.printing import json_written, progress_bar
from crowdbench.cli.running import find_own_code
from crowdbench.report.text.terminal import print_note, print_table

if TYPE_CHECKING:
    from crowdbench.exam import Certificate


def exam(
    *,
    policy: Sequence[str] = ("straight", "social-force"),
    scene: SceneName = "eth-v0",
    test: Sequence[str] | None = None,
    body_radius_m: float | None = None,
    workers: Workers = None,
    out: Path | None = None,
    json: Json = None,
) -> None:
    """Put policies through the rooms of RiMEA, IMO and ISO 20414.

    Args:
        policy: policies by name, FILE.onnx or pkg.module:Class
        scene: the rooms have its time step and its limits of motion; policies by name are those
            trained for it
        test: tests by id, such as rimea-9 or door (default: all)
        body_radius_m: radius of bodies in metres, 0 for none (default: that of the scene, 0.15 if
            it has none)
        out: folder for exam.html, with pictures of the rooms, and exam.json
    """
    from crowdbench.exam import exam as examine
    from crowdbench.exam.trial import NOT_APPLICABLE

    find_own_code()
    with json_written(json) as write:
        with progress_bar("rooms"):
            certificates = examine(
                list(policy), scene, tests=test, body_radius_m=body_radius_m, workers=workers,
                out=out,
            )  # fmt: skip
        rows = [
            (of.title, ", ".join(of.guidelines), *(_verdict(one, k) for one in certificates))
            for k, of in enumerate(certificates[0].tests)
        ]
        total = [f"{of.passed} of {len(of.tests)}" for of in certificates]
        columns = ("test", "guidelines", *(of.policy for of in certificates))
        print_table(*columns, rows=[*rows, ("passed", "", *total)], left=("guidelines",))
        others = "; ".join(f"{which} ({why})" for which, why in NOT_APPLICABLE.items())
        print_note(f"Tests that do not apply: {others}.")
        if any(of.passed and of.random_passes for one in certificates for of in one.tests):
            print_note("* Random walkers pass, too.")
        if out is not None:
            print(f"written to {out}: exam.html and exam.json")
        write(certificates)


def _verdict(certificate: "Certificate", k: int) -> str:
    """What a cell of the table says: the verdict, or what failed."""
    from crowdbench.exam.page import written

    result = certificate.tests[k]
    if result.passed:
        return "passed*" if result.random_passes else "passed"
    failed = next(of for of in result.measured if of.holds is False)
    return f"{failed.name.split(',')[0]} {written(failed)}"
