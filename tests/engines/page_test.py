#!/usr/bin/python3
# The page of engines: each cell says its column, which cards on narrow screens show; figures have words; HTML is valid.
import html.parser
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "engines"))

import page_table  # noqa: E402
import report  # noqa: E402
import study  # noqa: E402

ROWS = [{"id": name, "engine": f"{name} <1> & co", "licence": "MIT", "precision": precision, "package": "apt x", "command": "x"}
        for name, precision in (("measured", "float32"), ("failed", "float64"), ("missing", "float64"))]
TASK = {"id": "measured", "task": "two_balls", "loss": "2.1", "loss_error": "0.02", "narrow_error": "0.9",
        "wide_error": "0.1", "motion": "converges", "verdict": "wrong", "reason": ""}


def known():
    exact = study.exact()
    gradient = [1.5 * entry for entry in exact["gradient"]]
    impact = {"e": 1.0, "keep": 1.0, "feed": 0.0}
    measured = {"scan": [2.06] * len(study.SCAN), "by_step": {str(steps): [2.06, gradient] for steps in study.STEPS},
                "by_width": {str(width): gradient for width in study.WIDTHS}, "impact": {"240": impact, "2400": impact},
                "oblique": "it cannot & will not", "fixed": 0.5}
    return {"engines": {"measured": measured, "failed": {"failed": "it <crashed>"}}, "exact": exact,
            "widths": study.WIDTHS, "steps": study.STEPS, "scan": study.SCAN}


# Heads, and rows of [what a cell says its column is, how many columns it spans], of each table; and what figures say.
class Reader(html.parser.HTMLParser):
    def __init__(self):
        super().__init__()
        self.tables, self.figures, self.in_head = [], [], False

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag == "table":
            self.tables.append(([], []))
        elif tag == "tr":
            self.tables[-1][1].append([])
        elif tag == "td":
            self.tables[-1][1][-1].append((given["data-label"], int(given.get("colspan", 1))))
        elif tag == "svg":
            self.figures.append((given["role"], given["aria-label"]))
        self.in_head = tag == "th"

    def handle_data(self, data):
        if self.in_head:
            self.tables[-1][0].append(data)
        self.in_head = False


class Page(unittest.TestCase):
    def setUp(self):
        self.page = report.page(known(), ROWS, [TASK])
        self.reader = Reader()
        self.reader.feed(self.page)

    def test_cells_say_their_columns(self):
        self.assertEqual(len(self.reader.tables), 2)
        for heads, (_, *rows) in self.reader.tables:
            for row in rows:
                self.assertEqual([label for label, _ in row], heads[:len(row)])
                self.assertEqual(sum(span for _, span in row), len(heads))
        self.assertEqual(len(self.reader.tables[0][1]), 1 + 1 + len(ROWS))  # heads, exact

    def test_figures_have_words(self):
        self.assertEqual(len(self.reader.figures), 1 + 2 * 3)
        for role, words in self.reader.figures:
            self.assertEqual(role, "img")
            self.assertGreater(len(words), 20)

    def test_names_are_text(self):
        self.assertIn("measured &lt;1&gt; &amp; co", self.page)
        self.assertIn("it &lt;crashed&gt;", self.page)
        self.assertNotIn("<1>", self.page)

    def test_cards_are_of_the_tables_that_there_are(self):
        for name in report.CARDS_BELOW:
            self.assertIn(f'<table class="{name}">', self.page)
            self.assertIn(f".{name} thead {{ display: none; }}", page_table.style(report.CARDS_BELOW))

    @unittest.skipUnless(shutil.which("tidy"), "there is no tidy")
    def test_page_is_valid(self):
        with tempfile.NamedTemporaryFile("w", suffix=".html", encoding="utf-8") as file:
            file.write(self.page)
            file.flush()
            checked = subprocess.run(["tidy", "-quiet", "-errors", "-utf8", file.name], capture_output=True, text=True)
        self.assertEqual(checked.stderr, "")


if __name__ == "__main__":
    unittest.main(verbosity=2)
