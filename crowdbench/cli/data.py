"""`crowdbench data`: fetch, import, list, describe, convert and remove recordings."""

from dataclasses import asdict
from pathlib import Path

import crowdbench
from crowdbench.cli.options import OwnFile, SceneName, Written
from crowdbench.cli.printing import progress_bar
from crowdbench.cli.running import new_app
from crowdbench.errors import SettingError
from crowdbench.report.text import terminal

app = new_app("data", "Recordings: fetch, import, list, describe, convert and remove them.")


@app.command
def fetch(name: str, /, *, out: Path | None = None) -> None:
    """Download a published recording and import it.

    Args:
        name: name of a recording (see `crowdbench data list`)
        out: download folder, in OpenTraj's layout (default: OpenTraj in $CROWDBENCH_HOME)
    """
    from crowdbench.data.recordings import fetch as downloads
    from crowdbench.data.recordings.catalogue import source

    published = source(name)
    folder = out or downloads.default_folder()
    with progress_bar(name, of_bytes=True) as progress:
        fetched = downloads.fetch(name, folder, progress)
    how = f"fetched from {published.address}" if fetched else "already there"
    print(f"{folder / published.path}: {how}")
    _import_published(name, folder)


@app.command(name="import")
def import_(name: str, /, *, source: Path | None = None, how: OwnFile = OwnFile()) -> None:
    """Read a recording and store it for later use.

    Args:
        name: name of a recording (see `crowdbench data list`); with --format, a new name for your
            own recording
        source: folder in OpenTraj's layout (default: $CROWDBENCH_DATA), or your own recording
    """
    from crowdbench.data.recordings.catalogue import cached
    from crowdbench.data.recordings.describe import describe
    from crowdbench.data.recordings.own import import_own

    if how.layout is None:
        if how.given():
            got = f"{how.given()[0]} without --format"
            expected = "--format as well"
            hint = "The option applies to your own recordings only."
            raise SettingError("crowdbench data import", got=got, expected=expected, hint=hint)
        _import_published(name, source)
        return
    if source is None:
        raise SettingError(
            "crowdbench data import", got="--format without --source", expected="--source PATH"
        )
    crowd = import_own(name, source, **asdict(how))
    facts = repairs(crowd, how) | describe(crowd) | {"stored at": str(cached(name))}
    terminal.print_facts(name, facts)


def _import_published(name: str, folder: Path | None) -> None:
    from crowdbench.data.recordings.catalogue import cached, known_sha256, source
    from crowdbench.data.recordings.describe import describe
    from crowdbench.registry import import_recording

    first = name != "plaza" and known_sha256(source(name)) is None
    crowd = import_recording(name, folder)
    terminal.print_facts(name, describe(crowd) | {"stored at": str(cached(name))})
    if first:
        print(
            f"SHA-256 {crowd.provenance['sha256']} stored at first use; the publisher states none."
        )
    if name != "plaza":
        print(f"The recording remains subject to its owners' terms. Cite: {source(name).cite}.")


def repairs(crowd: "crowdbench.Trajectories", how: OwnFile) -> dict[str, str]:
    """Repairs made by `--gaps`, as a fact to print; empty if the option was not given."""
    notes = crowd.provenance.get("notes", {})
    return {} if how.gaps is None else {"mended": notes.get("mended", "nothing; no faults found")}


@app.command(name="list")
def list_() -> None:
    """List the known recordings."""
    from crowdbench.data.recordings.catalogue import COMMIT, OWN_NAME, REPOSITORY, SOURCES, cached
    from crowdbench.registry import RECORDINGS

    scenes = {
        crowdbench.load_scene(scene).recording.name: scene for scene in crowdbench.list_scenes()
    }
    rows = []
    for name in RECORDINGS:
        state, path = "always available", "generated"
        if name in SOURCES:
            state = "imported" if cached(name).exists() else "not imported"
            path = SOURCES[name].path
        rows.append((name, scenes.get(name, ""), state, path))
    for file in sorted(cached("").parent.glob("*.parquet")):
        if OWN_NAME.fullmatch(file.stem) and file.stem not in RECORDINGS:
            rows.append((file.stem, scenes.get(file.stem, ""), "imported", "your own"))
    heads = ("scene", "state", "source")
    terminal.print_fitting(
        [[terminal.new_table("name", *heads, rows=rows, left=heads)]], terminal.new_console()
    )
    print(f"File paths are those of OpenTraj, {REPOSITORY}/tree/{COMMIT}")
    terminal.print_note(
        "`crowdbench data fetch` also accepts other days of the Forum, for example forum-14jul."
    )


@app.command
def describe(name: str, /) -> None:
    """Print statistics of a recording.

    Args:
        name: name of a recording
    """
    from crowdbench.data.recordings import describe as recordings

    terminal.print_facts(name, recordings.describe(crowdbench.recording(name)))


@app.command
def remove(name: str, /) -> None:
    """Delete an imported recording.

    Args:
        name: name of a recording
    """
    from crowdbench.data.recordings.catalogue import remove_imported

    print(f"{remove_imported(name)}: removed")


@app.command
def arrivals(scene: SceneName, /, *, out: Path) -> None:
    """Write who entered a scene's recording: when, where, by which way and with whom.

    Args:
        out: CSV, Parquet or JSON file to write, as `crowdbench spawn sample` does
    """
    from crowdbench.cli.spawn import sample

    sample(scene, out=out, model="replay")


@app.command
def convert(table: Path, /, *, to: Written, out: Path, how: OwnFile = OwnFile()) -> None:
    """Convert trajectories between the formats of crowdbench and other programs.

    Args:
        table: file to convert; by default a table in CSV or Parquet
        to: format to write
        out: file to write
    """
    from crowdbench.data.recordings.formats import WRITERS, read_recording

    read = asdict(how) | {"layout": how.layout or "csv"}
    crowd = read_recording(table, name=table.stem, at_frames=False, **read)
    WRITERS[to](crowd, out)
    for name, fact in repairs(crowd, how).items():
        print(f"{name}: {fact}")
    print(f"{len(crowd)} persons, {crowd.frames} frames of {crowd.dt_s:.4g} s")
    print(f"written to {out}")
