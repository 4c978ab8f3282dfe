"""What every page of HTML is put into: one file that asks nobody for anything."""

from base64 import b64encode
from hashlib import sha256
from html import escape
from pathlib import Path


def html_page(title: str, body: str, *, style: str, script: str = "") -> str:
    """A whole page.

    The browser itself refuses whatever would have to be fetched, and runs this script alone.

    Args:
        title: Plain text.
        body: HTML.
        style: CSS beyond `base.css`, which all pages share.
        script: JavaScript; of none, the page has no right to run any.
    """
    base = (Path(__file__).parent / "base.css").read_text(encoding="utf-8")
    allowed, code = "", ""
    if script:
        digest = b64encode(sha256(f"\n{script}".encode()).digest()).decode()
        allowed = f"; script-src 'sha256-{digest}'"
        code = f"<script>\n{script}</script>\n"
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; img-src data:; style-src 'unsafe-inline'{allowed}">
<title>{escape(title)}</title>
<style>
{base}
{style}</style>
</head>
<body>
{body}{code}</body>
</html>
"""
