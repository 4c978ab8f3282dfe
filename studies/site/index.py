"""`index.html`: a table per track, and how to read it."""

from collections.abc import Sequence

from markupsafe import Markup

from crowdbench.leaderboard.submission.schema import SCENES, Track
from crowdbench.report.html.render import html_page
from crowdbench.report.text.words import plainly
from crowdbench.scene import load_scene
from crowdbench.scoring.ceilings import read_ceilings
from studies.site.headline import headline
from studies.site.render import html, own
from studies.site.standings import Standing
from studies.site.tables import listed_table, ranked_table
from studies.site.text import in_html

JUDGED: dict[Track, str] = {
    "walk": "A policy moves the people of the recording. Their times and places of entry are "
    "changed at random, by up to 2 s and by some decimetres, with a key that was secret. "
    "People of references, external and listed entries enter exactly as recorded. Scored on motion "
    "and interaction, of which the lesser counts.",
    "spawn": "A spawn model draws when, where and with which goal people enter; they walk "
    "straight. Scored on arrivals, presence, trips and space.",
    "crowd": "A spawn model and a policy together. Scored on arrivals, presence, trips and space "
    "of the simulated crowd, and on motion and interaction (the lesser) as on the track walk; the "
    "mean of both counts.",
}


def judged() -> dict[Track, str]:
    """How each track is judged, with what a right model would get in walking."""
    known = {name: read_ceilings(load_scene(name)) for name in SCENES}
    values = [f"{plainly(of.perturbed.walk)} on {name}" for name, of in known.items() if of]
    if not values:
        return JUDGED
    right = (
        f" A right model, whose people act by chance, would get about {', '.join(values)} (what "
        "anticipate would get if the recording were one of its rollouts)."
    )
    return JUDGED | {"walk": JUDGED["walk"] + right}


LISTED = (
    "Scored in the same way, but not ranked: trajectories that crowdbench did not simulate, and "
    "models trained on the recordings that they are scored on (full). Trajectories of crowds have "
    "no scores of motion and interaction, which need the recorded arrivals."
)
LEAD = (
    "Spawn models and walking policies, simulated by crowdbench and compared with held-out parts "
    "of recordings of real places."
)
SUBMIT = """\
crowdbench submit init my-policy --track walk --policy results/ppo-*
crowdbench submit check my-policy
crowdbench leaderboard verify my-policy --out verified"""
"""The commands of a submission; `networks` contains a folder for each scene."""
_RESCORING = (
    "Any change that alters scores makes a new scorer version. Then all entries are scored again, "
    "and their earlier scores are kept. Cite a score with its scorer version, and a rank with the "
    "commit of the leaderboard. Each entry’s page has a citation."
)


def index_page(standings: Sequence[Standing]) -> str:
    """The page as HTML; it is complete without its script."""
    entries = [o.entry for s in standings for o in (*s.lines, *s.listed)]
    body = html(
        "index.html.j2",
        tracks=[
            (each, headline(each), ranked_table(each), listed_table(each)) for each in standings
        ],
        entries=entries,
        versions=Markup(", ").join(sorted({in_html(entry.crowdbench) for entry in entries})),
        preview=standings[0].yours is not None,
        rules=rules_of(standings[0]),
        scenes=SCENES,
        lead=LEAD,
        judged=judged(),
        listing=LISTED,
        rescoring=_RESCORING,
        submit=SUBMIT,
    )
    return html_page("crowdbench leaderboard", body, style=own("pages.css"), script=own("index.js"))


def rules_of(standing: Standing) -> str:
    """Path of the rules, relative to `index.html`."""
    return "pages/RULES.md" if standing.paged else "RULES.md"
