"""The page of the exam of the policies that come with crowdbench."""

from collections.abc import Sequence

from crowdbench.exam import TRIALS, Certificate, exam
from crowdbench.exam.page import written
from crowdbench.exam.trial import NOT_APPLICABLE
from studies.markdown import flowed, table

ORCA = "crowdbench.baselines.orca:ORCA"
POLICIES = ("straight", "social-force", "speed-model", ORCA, "ppo", "gail", "bc", "anticipate")
TITLE = """# The exam

Engineers believe a pedestrian model that passes the verification tests of their guidelines: RiMEA
4.1.1, IMO MSC.1/Circ.1238 and ISO 20414:2020. `crowdbench exam` puts any policy through their
rooms. The tables show the policies of {scene}, with bodies of {radius:g} m and steps of {dt:g} s. A
value is the mean over the seeds, with its range. A test is passed if each value with a limit lies
within it. “Never” means that somebody did not arrive in time.

This page is the output of `python -m studies exam`. `crowdbench exam --policy straight --out exam`
also draws each room with its flow."""


def page(policies: Sequence[str], workers: int | None = None) -> str:
    """The page as Markdown."""
    found = exam(list(policies), workers=workers)
    one = found[0]
    title = TITLE.format(scene=one.scene, radius=one.body_radius_m, dt=one.dt_s)
    verdicts = table(
        ["test", "guidelines", *map(_name, found)],
        [
            [f"[{of.title}](#{_anchor(of.title)})", ", ".join(of.guidelines), *_verdicts(found, k)]
            for k, of in enumerate(one.tests)
        ]
        + [["passed", "", *(f"{of.passed} of {len(of.tests)}" for of in found)]],
        text=2,
    )
    others = "\n".join(f"- {which}: {why}." for which, why in NOT_APPLICABLE.items())
    rooms = "\n\n".join(_room(found, k) for k in range(len(one.tests)))
    marked = any(of.passed and of.random_passes for each in found for of in each.tests)
    note = "\\* random walkers pass, too.\n\n" if marked else ""
    return (
        f"{flowed(title)}\n{verdicts}\n\n{note}"
        f"{flowed('Tests that do not apply:')}\n{others}\n\n{rooms}\n"
    )


def _name(certificate: Certificate) -> str:
    return certificate.policy.split(":")[-1]


def _anchor(title: str) -> str:
    return title.lower().replace(" ", "-").replace(":", "").replace("/", "")


def _verdicts(found: Sequence[Certificate], k: int) -> list[str]:
    results = [of.tests[k] for of in found]
    return [
        ("passed\\*" if of.random_passes else "passed") if of.passed else "**failed**"
        for of in results
    ]


def _room(found: Sequence[Certificate], k: int) -> str:
    first = found[0].tests[k]
    trial = TRIALS[first.id]
    lines = [
        [
            of.name,
            of.limit or "",
            *(written(one.tests[k].measured[m]) for one in found),
        ]
        for m, of in enumerate(first.measured)
    ]
    values = table(["value", "limit", *map(_name, found)], lines, text=2)
    text = f"{trial.task} Limits: {trial.source}. Seeds: {trial.seeds}."
    return f"## {first.title}\n\n{flowed(text)}\n{values}"
