"""Configuration of Sphinx, which makes the site of these pages (scripts/docs.sh)."""

import html
import inspect
import json
import os
import pathlib
import re

ROOT = pathlib.Path(__file__).resolve().parents[1]

project = "saltus"
author = copyright = "The saltus authors"
release = re.search(r"project\(saltus VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text()).group(1)
version = release
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
napoleon_use_ivar = True
source_suffix = {".md": "markdown", ".ipynb": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
smartquotes = False  # flags keep their two hyphens
html_theme = "furo"
html_title = f"saltus {release}"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_extra_path = [path for path in [os.environ.get("SALTUS_DOXYGEN", "")] if path]
autodoc_typehints = "description"
autodoc_member_order = "bysource"
# The compiled part is mocked where it is not built; its signatures are in _saltus.pyi.
autodoc_mock_imports = ["jax", "torch"] + ([] if os.environ.get("SALTUS_PYTHON") else ["saltus._saltus"])
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
        if target == "cpp/index.html" or target.startswith("gallery/"):
            href = target
        elif target.startswith("http") or file.is_relative_to(app.srcdir) or not file.exists():
            return match[0]
        else:
            href = os.path.relpath(file, page)
        return f'<a href="{href}">' + re.sub(r"`([^`]+)`", r"<code>\1</code>", text) + "</a>"

    source[0] = re.sub(r"(?<!!)\[([^\]]+)\]\(([^)\s#]+)\)", replaced, source[0])


def show_math(self, node, inline=False):
    """Writes a formula as MathML, which needs no script from elsewhere."""
    from docutils.nodes import SkipNode  # pylint: disable=import-outside-toplevel
    from docutils.utils.math.latex2mathml import tex2mathml  # pylint: disable=import-outside-toplevel

    formula = tex2mathml(node.astext(), inline)
    self.body.append(formula if inline else f"<p>{formula}</p>\n")
    raise SkipNode


def keep_lines(app, what, name, obj, options, lines):  # pylint: disable=too-many-arguments
    """Shows the module's docstring, which is laid out for help(saltus), as plain text."""
    if what == "module":
        lines[:] = [".. code-block:: text", ""] + ["   " + line for line in inspect.getdoc(obj).split("\n")] + [""]
    else:  # a * or | outside of ``code`` is one
        lines[:] = ["``".join(part if k % 2 else re.sub(r"[*|]", r"\\\g<0>", part) for k, part in enumerate(line.split("``")))
                    for line in lines]


def drop_broken_script(app, pagename, templatename, context, doctree):  # pylint: disable=too-many-arguments
    """Drops the script of Debian's furo, which is a module but is loaded as a plain script (site.css)."""
    context["script_files"] = [file for file in context["script_files"] if not str(file).endswith("furo.js")]


def setup(app):
    app.connect("html-page-context", drop_broken_script, priority=900)
    app.add_html_math_renderer("mathml", (lambda self, node: show_math(self, node, inline=True), None), (show_math, None))
    app.connect("source-read", read_page)
    app.connect("autodoc-process-docstring", keep_lines, priority=900)  # after napoleon
