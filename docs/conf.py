"""Of Sphinx, which makes the site of these pages (scripts/docs.sh)."""

import os
import pathlib
import re

ROOT = pathlib.Path(__file__).resolve().parents[1]

project = "saltus"
author = "The saltus authors"
release = re.search(r"project\(saltus VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text()).group(1)
version = release
extensions = ["myst_parser", "sphinx.ext.autodoc"]
exclude_patterns = ["_build"]
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
html_theme = "furo"
html_title = f"saltus {release}"
html_extra_path = [path for path in [os.environ.get("SALTUS_DOXYGEN", "")] if path]
autodoc_typehints = "description"
autodoc_member_order = "bysource"
# The compiled part, where it is not built; its signatures are in _saltus.pyi.
autodoc_mock_imports = ["torch"] + ([] if os.environ.get("SALTUS_PYTHON") else ["saltus._saltus"])
suppress_warnings = ["myst.header"]


def link_to_sources(app, docname, source):
    """Files of the project outside docs/ have no page: links to them lead into the source tree."""
    folder, page = (pathlib.Path(app.srcdir) / docname).parent, (pathlib.Path(app.outdir) / docname).parent

    def replaced(match):
        text, target = match.groups()
        file = (folder / target).resolve()
        if target == "cpp/index.html":
            href = target
        elif target.startswith("http") or file.is_relative_to(app.srcdir) or not file.exists():
            return match[0]
        else:
            href = os.path.relpath(file, page)
        return f'<a href="{href}">' + re.sub(r"`([^`]+)`", r"<code>\1</code>", text) + "</a>"

    source[0] = re.sub(r"(?<!!)\[([^\]]+)\]\(([^)\s#]+)\)", replaced, source[0])


def keep_lines(app, what, name, obj, options, lines):  # pylint: disable=too-many-arguments
    """What help(saltus) prints is plain text."""
    if what == "module":
        lines[:] = ["::", ""] + ["   " + line for line in lines] + [""]
    else:  # a * outside of ``code`` is one
        lines[:] = ["``".join(part if k % 2 else re.sub(r"\*", r"\\*", part) for k, part in enumerate(line.split("``")))
                    for line in lines]


def setup(app):
    app.connect("source-read", link_to_sources)
    app.connect("autodoc-process-docstring", keep_lines)
