"""The player of crowds: its clips have everything that it shows, and it shows what they have."""

import json
import re
import zlib
from base64 import b64decode, b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from zlib import compress, decompress

import msgspec
import numpy as np
import pytest
from browser import Browser, browsing
from hypothesis import given
from strategies import crowd_of, crowds

from crowdbench.data.stops import standing
from crowdbench.data.table import Trajectories
from crowdbench.registry import policy, spawn_model
from crowdbench.report.html.player import (
    LARGEST_BYTES,
    SCRIPT,
    STYLE,
    Clip,
    check_clip,
    clip_of,
    fitting,
    player,
)
from crowdbench.report.html.render import html_page
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene

ETH = load_scene("eth-v0")
UNIT_M = (
    max(ETH.bounds.x_max_m - ETH.bounds.x_min_m, ETH.bounds.y_max_m - ETH.bounds.y_min_m) / 1000
)


class Person(NamedTuple):
    first: int
    goal: int
    group: int
    stands: list[bool]
    xy: np.ndarray


def unpacked(clip: Clip) -> list[Person]:
    """The people of a clip, read as its documentation says."""
    data = iter(decompress(b64decode(clip.data), -15))

    def number() -> int:
        value = shift = 0
        byte = 128
        while byte > 127:
            byte = next(data)
            value |= (byte & 127) << shift
            shift += 7
        return -(value + 1) // 2 if value % 2 else value // 2

    people = []
    while True:
        try:
            first = number()
        except StopIteration:
            return people
        length, goal, group, runs = (number() for _ in range(4))
        stands: list[bool] = []
        for run in range(runs):
            stands += [run % 2 == 1] * number()
        lines = [np.cumsum(np.cumsum([number() for _ in range(length)])) for _ in "xy"]
        assert len(stands) == length
        xy = np.stack(lines, axis=1) * UNIT_M + [ETH.bounds.x_min_m, ETH.bounds.y_min_m]
        people.append(Person(first, goal - 1, group - 1, stands, xy))


@given(crowds())
def test_a_clip_has_the_people_of_its_minute(crowd: Trajectories) -> None:
    clip = clip_of(crowd, ETH)
    check_clip(clip)
    start = round(clip.start_s / crowd.dt_s)
    stop = start + clip.frames
    assert 0 <= start < stop <= crowd.frames
    there = np.flatnonzero((crowd.first < stop) & (crowd.last >= start))
    people, stands = unpacked(clip), standing(crowd)
    assert len(people) == len(there)
    for person, k in zip(people, there.tolist(), strict=True):
        first = max(crowd.first[k], start)
        rows = slice(
            crowd.offsets[k] + first - crowd.first[k],
            crowd.offsets[k] + min(crowd.last[k], stop - 1) + 1 - crowd.first[k],
        )
        assert person.first == first - start
        assert person.goal == crowd.goal_area[k]
        assert person.stands == stands[rows].tolist()
        assert np.abs(person.xy - crowd.xy[rows]).max() <= UNIT_M / 2 + 1e-5
    groups = crowd.group[there]
    for mine, its in zip(people, groups, strict=True):
        assert (mine.group == -1) == (its == -1)
        same = [other.group == mine.group for other in people]
        assert same == (groups == its).tolist()
    dark = np.zeros(clip.frames, bool)
    for begin, end in clip.unobserved:
        dark[begin:end] = True
    assert dark.tolist() == (~crowd.is_observed()[start:stop]).tolist()


def test_the_minute_with_most_people_is_shown() -> None:
    crowd = crowd_of([(0, 5), (100, 130), (101, 131), (300, 320)], frames=400, dt_s=1.0)
    clip = clip_of(crowd, ETH)
    assert clip.start_s <= 100
    assert clip.start_s + 60 >= 131
    assert clip.frames == 61
    assert clip_of(crowd_of([(0, 3)]), ETH).frames == 4
    assert clip_of(crowd, ETH, 250).start_s == 250


def test_a_player_holds_as_many_clips_as_fit() -> None:
    clip = Clip(start_s=0, frames=1, unobserved=[], data="x" * (LARGEST_BYTES // 3))
    assert fitting([("one", clip)] * 5) == [("one", clip)] * 3
    assert fitting([]) == []
    large = msgspec.structs.replace(clip, data="x" * (LARGEST_BYTES + 4))
    assert fitting([("large", large), ("one", clip)]) == [("large", large)]
    assert "2 more crowds do not fit\ninto this page" in player(ETH, [("one", clip)] * 5)
    assert "1 more crowd does not fit" in player(ETH, [("one", clip)] * 4)
    assert "not fit" not in player(ETH, [("one", clip)] * 3)


def packed(*numbers: int) -> str:
    return b64encode(compress(bytes(2 * number for number in numbers), 9, -15)).decode()


@pytest.mark.parametrize(
    "changed",
    [
        {"frames": 0},
        {"frames": 10**9},
        {"data": "not base 64!"},
        {"data": packed(0, 2, 0, 0, 1, 2, 5, 5, 5, 5)[:-4]},
        {"data": packed(0, 2, 0, 0, 1, 2, 5, 5, 5)},
        {"data": packed(0, 2, 0, 0, 1, 1, 5, 5, 5, 5)},
        {"data": packed(9, 2, 0, 0, 1, 2, 5, 5, 5, 5)},
        {"data": packed(0, 0, 0, 0, 1, 0)},
        {"data": b64encode(compress(bytes([128]), 9, -15)).decode()},
        {"data": b64encode(compress(bytes(20_000_000), 9, -15)).decode()},
    ],
)
def test_a_damaged_clip_is_found(changed: dict[str, Any]) -> None:
    clip = Clip(start_s=0, frames=2, unobserved=[], data=packed(0, 2, 0, 0, 1, 2, 5, 5, 5, 5))
    check_clip(clip)
    with pytest.raises((ValueError, zlib.error)):
        check_clip(msgspec.structs.replace(clip, **changed))


@pytest.fixture(scope="module")
def both() -> list[Trajectories]:
    """Two crowds at ETH; one has companions."""
    straight = policy("straight", ETH)
    return [
        rollout(ETH, spawn_model(name, ETH), straight, seed=0)
        for name in ("cox-plans", "poisson-gmm")
    ]


@pytest.fixture(scope="module")
def shown(both: list[Trajectories], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with a player of these, whose labels are hostile."""
    labels = ("</script><script>document.title = 'ran'", "<b>&")
    clips = [(label, clip_of(crowd, ETH)) for label, crowd in zip(labels, both, strict=True)]
    page = html_page("crowds", player(ETH, clips), style=STYLE, script=SCRIPT)
    path = tmp_path_factory.mktemp("player") / "page.html"
    path.write_text(page, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browsing(tmp_path_factory.mktemp("profile")) as found:
        yield found


def at(browser: Browser, time_s: float) -> list[str]:
    """Move the slider, and return what the sides say."""
    browser.run(
        "(() => { const time = document.querySelector('.time');"
        f"time.value = {time_s}; time.dispatchEvent(new Event('input')); }})()"
    )
    return list(browser.run("[...document.querySelectorAll('.count')].map(c => c.textContent)"))


def wait_for(browser: Browser, script: str) -> None:
    browser.run(
        "new Promise((done) => { const look = () => "
        f"({script}) ? done() : requestAnimationFrame(look); look(); }})"
    )


DRAWN = "[...document.querySelectorAll('.count')].every(c => c.textContent)"


def test_each_side_counts_its_people(
    browser: Browser, shown: Path, both: list[Trajectories]
) -> None:
    browser.open(shown)
    wait_for(browser, DRAWN)
    starts = [round(clip_of(crowd, ETH).start_s / ETH.dt_s) for crowd in both]
    for frame in (0, 50, 150):
        present = [
            crowd.present()[start + frame] for crowd, start in zip(both, starts, strict=True)
        ]
        told = at(browser, frame * ETH.dt_s + 0.01 * (frame < 150))
        assert [int(re.match(r"\d+", text)[0]) for text in told] == present  # type: ignore[index]
    assert browser.said("Runtime.exceptionThrown") == []
    assert browser.said("Log.entryAdded") == []
    assert browser.run("document.title") == "crowds"


def test_it_plays_pauses_and_begins_again(browser: Browser, shown: Path) -> None:
    browser.open(shown)
    wait_for(browser, DRAWN)
    now = "Number(document.querySelector('.time').value)"
    browser.run("document.querySelector('.play').click()")
    wait_for(browser, f"{now} > 0.5")
    assert browser.run("document.querySelector('.play').textContent") == "Pause"
    browser.run("document.querySelector('canvas').click()")
    stopped = browser.run(now)
    browser.run("new Promise((done) => setTimeout(done, 100))")
    assert browser.run(now) == stopped
    browser.run("document.querySelector('.speed').value = '8'")
    at(browser, 59.5)
    browser.run("document.querySelector('.play').click()")
    wait_for(browser, f"{now} < 10")


def test_boxes_and_lists_change_the_picture(browser: Browser, shown: Path) -> None:
    browser.open(shown)
    wait_for(browser, DRAWN)
    at(browser, 20.0)

    def picture() -> str:
        return str(browser.run("document.querySelector('canvas').toDataURL()"))

    seen = {picture()}
    for name in ("trails", "companions", "areas"):
        browser.run(f"document.querySelector('.{name}').click()")
        seen.add(picture())
    other = "(() => { const of = document.querySelector('.side select'); of.value = '1';"
    browser.run(f"{other} of.dispatchEvent(new Event('change')); }})()")
    wait_for(
        browser, "document.querySelector('canvas').getAttribute('aria-label').includes('<b>&')"
    )
    seen.add(picture())
    assert len(seen) == 5


@pytest.mark.parametrize("width", [390, 1280])
def test_it_fits_the_window(browser: Browser, shown: Path, width: int) -> None:
    browser.open(shown, width=width)
    wait_for(browser, DRAWN)
    assert browser.run("document.documentElement.scrollWidth") <= width
    shape = "(c => c.clientWidth / c.clientHeight)(document.querySelector('canvas'))"
    ratio = browser.run(shape)
    b = ETH.bounds
    wanted = (b.x_max_m - b.x_min_m) / (b.y_max_m - b.y_min_m)
    assert ratio == pytest.approx(wanted, rel=0.02)


def test_the_page_is_small_and_loads_nothing(shown: Path, both: list[Trajectories]) -> None:
    text = shown.read_text()
    assert len(text) < 60_000
    assert re.findall(r"https?://|@import|url\(|<link|fetch\(|import\(", text) == []
    (content,) = re.findall(r'<script type="application/json">(.*?)</script>', text)
    assert [clip["label"][:9] for clip in json.loads(content)["clips"]] == ["</script>", "<b>&"]


def test_a_damaged_clip_says_so_instead_of_showing_another(
    browser: Browser, both: list[Trajectories], tmp_path: Path
) -> None:
    whole = clip_of(both[0], ETH)
    cut = msgspec.structs.replace(whole, data=packed(0, 60, 0, 0))
    clips = [("whole", whole), ("another", clip_of(both[1], ETH)), ("cut", cut)]
    path = tmp_path / "page.html"
    path.write_text(html_page("cut", player(ETH, clips), style=STYLE, script=SCRIPT))
    browser.open(path)
    wait_for(browser, DRAWN)
    other = "(() => { const of = document.querySelector('.side select'); of.value = '2';"
    browser.run(f"{other} of.dispatchEvent(new Event('change')); }})()")
    wait_for(browser, "document.querySelector('.count').textContent.includes('cut off')")
    assert at(browser, 30.0)[0] == "The clip cannot be shown: its data is cut off"
