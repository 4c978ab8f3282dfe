"""Measure the player: `python tests/player_speed.py [FOLDER]` prints its frame rate and size.

It shows two crowds of Grand Central, with about 300 people each, for 5 s in headless Chromium. With
a folder, pictures at three times are written there.
"""

import sys
import tempfile
from pathlib import Path

from browser import Browser, browsing

import crowdbench
from crowdbench.report.html.player import SCRIPT, STYLE, clip_of, player
from crowdbench.report.html.render import html_page
from crowdbench.scene import load_scene

SCENE, SPAWN = "gc-v0", ("cox-plans", "ntpp-plans")
RATE = """new Promise((done) => {
  document.querySelector(".play").click();
  const from = performance.now();
  let frames = 0;
  const count = () => {
    frames += 1;
    const took = (performance.now() - from) / 1000;
    if (took < 5) requestAnimationFrame(count);
    else done(frames / took);
  };
  requestAnimationFrame(count);
})"""


def main(folder: Path | None) -> None:
    """Print the numbers, and write pictures into the folder."""
    scene = load_scene(SCENE)
    crowds = [crowdbench.rollout(SCENE, name, "straight", seed=0) for name in SPAWN]
    clips = [(name, clip_of(crowd, scene)) for crowd, name in zip(crowds, SPAWN, strict=True)]
    page = html_page("player", player(scene, clips), style=STYLE, script=SCRIPT)
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "player.html"
        path.write_text(page, encoding="utf-8")
        with browsing(Path(place) / "profile") as browser:
            browser.open(path)
            browser.run("new Promise((done) => setTimeout(done, 1000))")
            for time_s in (0, 20, 40):
                told = _at(browser, time_s)
                print(f"at {time_s} s: {told[0]}; {told[1]}")
                if folder is not None:
                    folder.mkdir(parents=True, exist_ok=True)
                    browser.screenshot(folder / f"player-{time_s}.png")
            print(f"{browser.run(RATE):.0f} frames per second, page of {len(page) / 1000:.0f} kB")


def _at(browser: Browser, time_s: float) -> list[str]:
    browser.run(
        "(() => { const time = document.querySelector('.time');"
        f"time.value = {time_s}; time.dispatchEvent(new Event('input')); }})()"
    )
    return list(browser.run("[...document.querySelectorAll('.count')].map(c => c.textContent)"))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
