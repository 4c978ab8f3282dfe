"""The leaderboard's pages in a browser: sorted, filtered, read, and safe to open."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, browsing
from entries import everyone
from PIL import Image
from sites import HOSTILE, built, hostile, pages_of

from crowdbench.leaderboard.scores import View, scores
from crowdbench.report.text.words import with_interval
from studies.site.standings import standing

PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("leaderboard"))


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browsing(tmp_path_factory.mktemp("profile")) as one:
        yield one


def names(browser: Browser, track: str) -> list[str]:
    """Of the rows that are shown, in their order."""
    script = (
        f"[...document.querySelectorAll('#{track} table.ranked tbody tr')].filter(r => !r.hidden)"
        ".map(r => r.querySelector('a').textContent)"
    )
    return list(browser.run(script))


def choose(browser: Browser, track: str, what: str, value: str) -> None:
    browser.run(
        f"(() => {{ const s = document.querySelector('#{track} select[name={what}]');"
        f"s.value = '{value}'; s.dispatchEvent(new Event('change', {{bubbles: true}})); }})()"
    )


def column(browser: Browser, track: str, kind: str) -> list[str]:
    """What a column shows."""
    return list(
        browser.run(
            f"[...document.querySelectorAll('#{track} table.ranked tbody tr')]"
            f".filter(r => !r.hidden).map(r => r.querySelector('td.{kind}').innerText.trim())"
        )
    )


def click(browser: Browser, track: str, label: str) -> str:
    """Click on a head; the column's state afterwards."""
    return str(
        browser.run(
            f"(() => {{ const b = [...document.querySelectorAll('#{track} table.ranked button')]"
            f".find(b => b.innerText.trim().startsWith('{label}')); b.click();"
            "return b.closest('th').getAttribute('aria-sort'); })()"
        )
    )


def test_heads_sort_by_their_column(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    by_rank = ["replay-walk", "bc", "gail", "social-force", "straight", "random", "ppo"]
    assert names(browser, "walk") == by_rank
    assert click(browser, "walk", "gc-v0") == "descending"
    entries = {e.id: scores(e) for e in everyone() if e.declared.track == "walk"}
    by_gc = sorted(entries, key=lambda i: -entries[i][View(scene="gc-v0")].value)
    assert names(browser, "walk") == by_gc
    assert click(browser, "walk", "gc-v0") == "ascending"
    assert names(browser, "walk") == by_gc[::-1]
    assert click(browser, "walk", "entry") == "ascending"
    assert names(browser, "walk") == sorted(by_gc)
    assert click(browser, "walk", "overall") == "descending"
    assert names(browser, "walk")[-1] == "ppo"
    assert click(browser, "walk", "overall") == "ascending"
    assert names(browser, "walk")[-1] == "ppo"
    assert click(browser, "walk", "rank") == "ascending"
    assert names(browser, "walk") == by_rank
    assert names(browser, "spawn")[0] == "jittered-blocks"
    assert browser.run("document.querySelectorAll('#walk [aria-sort]').length") == 1


def test_views_show_their_own_scores_ranks_and_order(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    found = standing("spawn", everyone())
    for view in (View("space", "gc-v0"), View("trips"), View("trips", "eth-v0"), View()):
        choose(browser, "spawn", "family", view.family)
        choose(browser, "spawn", "scene", view.scene)
        order = found.ordered(view)
        assert names(browser, "spawn") == [line.entry.id for line in order]
        assert column(browser, "spawn", "rank") == [found.rank(line, view) for line in order]
        shown = [text.split("\n")[0] for text in column(browser, "spawn", "score")]
        expected = [line.scores.get(view) for line in order]
        assert shown == ["–" if s is None else with_interval(s).split()[0] for s in expected]
    assert browser.run("document.querySelector('#spawn th.score').innerText.trim()") == "overall"


def test_filters_leave_who_fits_and_the_references(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    choose(browser, "walk", "kind", "privileged")
    assert names(browser, "walk") == ["replay-walk", "social-force", "straight", "random"]
    assert browser.run("document.querySelector('#walk output').textContent") == "1 of 4 entries"
    choose(browser, "walk", "kind", "")
    choose(browser, "walk", "scene", "forum-v0")
    assert "ppo" not in names(browser, "walk")
    choose(browser, "walk", "scene", "hotel-v0")
    assert names(browser, "walk") == ["social-force"]
    listed = "document.querySelector('#spawn .listed').hidden"
    assert browser.run(listed) is False
    choose(browser, "spawn", "scene", "gc-v0")
    assert browser.run(listed) is True
    choose(browser, "spawn", "scene", "eth-v0")
    assert browser.run(listed) is False


def test_the_keyboard_reaches_and_turns_everything(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    browser.run("document.querySelector('#walk output').focus()")
    reached = []
    for _ in range(60):
        browser.press("Tab", 9)
        reached.append(
            browser.run(
                "(e => `${e.tagName} ${e.name ?? ''}${e.innerText?.trim() ?? ''}`)"
                "(document.activeElement)"
            )
        )
        if reached[-1].startswith("BUTTON gc-v0"):
            break
    assert [r.split("\n")[0][:12] for r in reached if r.startswith("SELECT")] != []
    assert browser.run("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    browser.press("Enter", 13, "\r")
    sorted_by = "document.activeElement.closest('th').getAttribute('aria-sort')"
    assert browser.run(sorted_by) == "descending"
    browser.press(" ", 32, " ")
    assert browser.run(sorted_by) == "ascending"


def test_without_scripts_the_tables_are_complete(board: Path, browser: Browser) -> None:
    browser.ask("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(board / "index.html")
        shown = browser.run("document.body.innerText")
        assert "filters" in browser.run("document.querySelector('[hidden]').className")
        assert browser.run("document.querySelectorAll('button').length") == 0
    finally:
        browser.ask("Emulation.setScriptExecutionDisabled", value=False)
    for entry in everyone():
        assert entry.declared.name in shown
        for score in (s for v, s in scores(entry).items() if not v.family):
            assert with_interval(score).split()[0] in shown


def test_pages_of_entries_are_linked_and_link_back(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    hrefs = set(browser.run("[...document.querySelectorAll('.name > a')].map(a => a.href)"))
    assert hrefs == {p.as_uri() for p in (board / "pages").glob("*.html")}
    browser.open(board / "pages" / "twin.html")
    assert browser.run("document.querySelector('h1').innerText") == "twin"
    back = browser.run("document.querySelector('.kicker a').href")
    assert back == (board / "index.html").as_uri()


@pytest.mark.parametrize("page", ["index.html", "pages/ntpp-gmm.html"])
def test_no_request_leaves_a_page(page: str, board: Path, browser: Browser) -> None:
    browser.open(board / page)
    asked = {r["request"]["url"] for r in browser.said("Network.requestWillBeSent")}
    assert asked == {(board / page).as_uri()}
    # Nor could one, nor run what is no script of the page's: its own policy refuses both.
    for element in (
        "Object.assign(new Image(), {src: 'https://example.org/x'})",
        "Object.assign(document.createElement('script'), {text: 'document.title = 1'})",
    ):
        refused = browser.run(
            "new Promise(r => { addEventListener('securitypolicyviolation', e => "
            f"r(e.effectiveDirective), {{once: true}}); document.body.append({element}); }})"
        )
        assert refused == ("img-src" if "Image" in element else "script-src-elem")


@pytest.mark.parametrize("text", [HOSTILE[0], HOSTILE[7], "n" * 10_000])
def test_hostile_names_do_nothing_in_a_browser(text: str, tmp_path: Path, browser: Browser) -> None:
    names_of = dict(zip(("readme", "index", "page"), pages_of(hostile(text)), strict=True))
    for name in ("index", "page"):
        path = tmp_path / f"{name}.html"
        path.write_text(names_of[name], encoding="utf-8")
        browser.open(path, **PHONE)  # type: ignore[arg-type]
        assert browser.run("document.title") != "ran"
        assert browser.run("document.querySelectorAll('h1').length") == 1
        assert browser.run("document.documentElement.scrollWidth") == 390
        assert text[:40] in browser.run("document.body.textContent")
        assert browser.said("Runtime.exceptionThrown") == []
    assert browser.run("document.querySelector('h1').getBoundingClientRect().height") < 500


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("page", ["index.html", "pages/ntpp-gmm-bc.html", "pages/bc.html"])
def test_no_page_scrolls_sideways(page: str, width: int, board: Path, browser: Browser) -> None:
    browser.open(board / page, width=width)
    assert browser.run("document.documentElement.scrollWidth") == width
    assert browser.said("Runtime.exceptionThrown") == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("page", ["index.html", "pages/bc.html"])
def test_letters_stand_out_in_light_and_dark(
    page: str, scheme: str, board: Path, browser: Browser, tmp_path: Path
) -> None:
    browser.open(board / page, prefers_color_scheme=scheme)
    with Image.open(browser.screenshot(tmp_path / "shot.png")) as image:
        corner = np.mean(image.convert("L").crop((0, 0, 8, 8)))
    assert (corner > 240) if scheme == "light" else (corner < 40)
    for selector in ("h1", ".n", ".i", "a", ".kicker"):
        colours = browser.run(
            f"[getComputedStyle(document.querySelector('{selector}')).color,"
            "getComputedStyle(document.body).backgroundColor]"
        )
        assert contrast(*colours) > 4.5, selector


def contrast(one: str, other: str) -> float:
    """Of two colours (WCAG 2.1)."""

    def luminance(colour: str) -> float:
        rgb = np.array(re.findall(r"\d+", colour)[:3], dtype=float) / 255
        linear = np.where(rgb <= 0.03928, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_on_paper_the_controls_are_gone(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    browser.ask("Emulation.setEmulatedMedia", media="print")
    shown = browser.run("getComputedStyle(document.querySelector('.filters')).display")
    browser.ask("Emulation.setEmulatedMedia", media="")
    assert shown == "none"


def test_the_address_says_which_filters_are_set(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    choose(browser, "walk", "scene", "gc-v0")
    choose(browser, "walk", "kind", "learned")
    address = browser.run("location.hash")
    assert address == "#track=walk&scene=gc-v0&kind=learned"
    shown = names(browser, "walk")
    browser.open(board / "pages" / "gail.html")
    browser.open(board / "index.html", address)
    assert names(browser, "walk") == shown
    browser.run("(() => { document.querySelector('#walk .filters select').value = ''; })()")
    choose(browser, "walk", "kind", "")
    assert browser.run("location.hash") == "#walk"
    browser.run(f"location.hash = '{address}'")
    browser.run("new Promise((done) => setTimeout(done, 100))")
    assert names(browser, "walk") == shown
    browser.open(board / "pages" / "gail.html")
    browser.open(board / "index.html", "#track=walk&scene=<b>&kind=nobody")
    assert len(names(browser, "walk")) == 7


@pytest.mark.parametrize("name", ["index.html", "pages/gail.html"])
def test_a_phone_shows_scores_first(board: Path, browser: Browser, name: str) -> None:
    browser.open(board / name, **PHONE)
    columns = (
        "[...document.querySelector('table.standing, table.metrics').querySelectorAll('thead th')]"
    )
    right = browser.run(
        f"{columns}.find(t => /score|overall/.test(t.textContent)).getBoundingClientRect().right"
    )
    assert right <= PHONE["width"]
