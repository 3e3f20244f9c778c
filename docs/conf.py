"""How Sphinx makes a site of these pages: `make docs`. They are plain Markdown and read as well where they lie.

Sphinx with MyST was chosen over MkDocs since it resolves every link and heading while it builds, and so fails on a
dead one by itself (-W), and since it is kept up steadily. The site asks nothing of the network.
"""

from __future__ import annotations

import re
from pathlib import Path

import adcbf_cli

project = "adcbf"
author = "the adcbf authors"
release = version = adcbf_cli.__version__
html_title = f"adcbf {release}"
html_theme = "furo"
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False

extensions = ["myst_parser"]
root_doc = "index"
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build"]
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
highlight_language = "none"
smartquotes = False  # options begin with two dashes
nitpicky = True

_LINK = re.compile(r"\]\((?!https?:)([\w/-]+\.md)\)")


def _contents(_app: object, name: str, source: list[str]) -> None:
    """Gives an index the table of contents that the site wants: its own links, in their order. So a page that is
    linked from no index is one that nobody finds, and fails the build."""
    if Path(name).name == "index":
        pages = dict.fromkeys(page.removesuffix(".md") for page in _LINK.findall(source[0]))
        source[0] += "\n\n```{toctree}\n:hidden:\n\n" + "\n".join(pages) + "\n```\n"


def setup(app) -> dict[str, bool]:  # type: ignore[no-untyped-def]
    """Called by Sphinx."""
    app.connect("source-read", _contents)
    return {"parallel_read_safe": True}
