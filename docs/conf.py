"""Configuration of Sphinx, which makes the site of these pages (scripts/docs.sh)."""

import html
import json
import os
import pathlib
import re

ROOT = pathlib.Path(__file__).resolve().parents[1]

project = "saltus"
author = "The saltus authors"
release = re.search(r"project\(saltus VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text()).group(1)
version = release
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
napoleon_use_ivar = True
napoleon_custom_sections = ["Methods"]
source_suffix = {".md": "markdown", ".ipynb": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
html_theme = "furo"
html_title = f"saltus {release}"
html_extra_path = [path for path in [os.environ.get("SALTUS_DOXYGEN", "")] if path]
autodoc_typehints = "description"
autodoc_member_order = "bysource"
# The compiled part is mocked where it is not built; its signatures are in _saltus.pyi.
autodoc_mock_imports = ["torch"] + ([] if os.environ.get("SALTUS_PYTHON") else ["saltus._saltus"])
suppress_warnings = ["myst.header"]


def notebook_as_markdown(text):
    """Returns a notebook as a page: its cells of text, its code, and the outputs that it stores."""
    parts = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                parts.append(f'<img alt="{html.escape(cell["metadata"].get("alt", "figure"), quote=True)}" '
                             f'src="data:image/png;base64,{"".join(data["image/png"]).strip()}">')
            else:
                parts.append("```text\n" + "".join(output.get("text", data.get("text/plain", ""))).rstrip() + "\n```")
    return "\n\n".join(parts) + "\n"


def read_page(app, docname, source):
    """Reads notebooks as pages. Files of the project outside docs/ have no page: links to them lead into the source tree."""
    if app.env.doc2path(docname).endswith(".ipynb"):
        source[0] = notebook_as_markdown(source[0])
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
    """Shows the module's docstring, which is laid out for help(saltus), as plain text."""
    if what == "module":
        lines[:] = ["::", ""] + ["   " + line for line in lines] + [""]
    else:  # a * outside of ``code`` is one
        lines[:] = ["``".join(part if k % 2 else re.sub(r"\*", r"\\*", part) for k, part in enumerate(line.split("``")))
                    for line in lines]


def setup(app):
    app.connect("source-read", read_page)
    app.connect("autodoc-process-docstring", keep_lines)
