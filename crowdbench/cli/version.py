"""What `crowdbench --version` says: the version, and the commit where that is known."""

import json
from importlib import metadata
from pathlib import Path

from crowdbench import __version__
from crowdbench.files import revision

_ROOT = Path(__file__).parents[2]


def described_version() -> str:
    """`crowdbench VERSION (COMMIT)`: of a clone, or of an installation from a git address.

    A version from an index has no commit here: it is that of the tag with its name.
    """
    commit = revision(_ROOT) if (_ROOT / ".git").exists() else _installed_commit()
    return f"crowdbench {__version__}" + (f" ({commit})" if commit else "")


def _installed_commit() -> str:
    """The commit that was installed, see PEP 610; empty if it was not from a repository."""
    try:
        told = metadata.distribution("crowdbench").read_text("direct_url.json")
        return str(json.loads(told or "{}").get("vcs_info", {}).get("commit_id", ""))[:12]
    except (metadata.PackageNotFoundError, ValueError, AttributeError):
        return ""
