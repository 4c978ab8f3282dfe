"""Jinja2 environments for the templates of generated pages."""

from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined


def environment(folder: Path, *, html: bool = True) -> Environment:
    """An environment for the templates in a folder; a value that a template lacks is an error.

    With `html`, values are escaped unless they are `markupsafe.Markup`. Lines that contain only
    block tags leave no trace in the page.
    """
    return Environment(
        loader=FileSystemLoader(folder, encoding="utf-8"),
        autoescape=html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
