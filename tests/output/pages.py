# Pages in headless Chromium: what the tests of replays and of reports share.
import json
import os
import shutil
import subprocess
import sys
import tempfile
import unittest

SKIPPED = 77  # for ctest
PROGRAMS = os.path.join(os.environ["SALTUS_BINARY_DIR"], "bin")
PROBLEMS = os.path.join(os.environ["SALTUS_SOURCE_DIR"], "problems")

BALL = """
name: falls
duration: 1
steps: 7
gravity: [0, -8]
bodies:
  - {name: ball, radius: 0.25, mass: 2, position: [0, 1.25], velocity: [3, 0]}
planes:
  - {name: ground, point: [0, 0], normal: [0, 1]}
contact: {restitution: 0.5, friction: FRICTION}
objective: {terminal: [{body: ball, quantity: position, target: [2, 1], weight: 1}]}
optimize: velocity
"""
BOX = """
name: box
duration: 2
steps: 100
bodies:
  - {name: left, radius: 0.1, mass: 1, position: [-0.5, 0.2], velocity: [2, 1.3]}
  - {name: right, radius: 0.15, mass: 2, position: [0.5, -0.1], velocity: [-1, 0.7]}
planes:
  - {name: floor, point: [0, -1], normal: [0, 1]}
  - {name: ceiling, point: [0, 1], normal: [0, -1]}
  - {name: west, point: [-1, 0], normal: [1, 0]}
  - {name: east, point: [1, 0], normal: [-1, 0]}
contact: {restitution: 1, friction: 0}
control: {bodies: [left, right], initial: [[0.5, 0.1], [-0.2, 0.3]]}
objective: {terminal: [{body: left, quantity: position, target: [0, 0], weight: 1}], effort: 0.01}
optimize: control
"""


def missing():
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "Python has no module selenium (package python3-selenium)"
    for program in ("chromium", "chromedriver"):
        if not shutil.which(program):
            return f"there is no {program}"
    return ""


def start_chromium():
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service
    options = Options()
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.binary_location = shutil.which("chromium")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(service=Service(shutil.which("chromedriver")), options=options)


def run(program, *arguments):
    done = subprocess.run([os.path.join(PROGRAMS, program), *arguments], capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise AssertionError(f"{program} {arguments}: {done.stderr}")
    return done


# `browser` and `folder` are those of all tests of a file.
class Pages(unittest.TestCase):
    def write(self, name, text):
        path = os.path.join(self.folder, name)
        with open(path, "w", encoding="utf-8") as file:
            file.write(text)
        return path

    def open(self, path, width=1000):
        self.browser.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False})
        self.browser.get("file://" + path)
        self.assert_quiet()

    # Nothing is cut off, and the page is never scrolled sideways. From 700 pixels on tables are tables, as wide as the
    # text; those with more columns than fit are scrolled beside their first column. On a phone their rows are cards.
    # Figures have a text.
    def assert_fits(self, path):
        for width in (400, 1000, 1600):
            self.open(path, width)
            self.assertLessEqual(self.js("return document.documentElement.scrollWidth"), width)
            wide = self.js("""
                for (const part of document.querySelectorAll('details')) part.open = true;
                return [...document.querySelectorAll(arguments[0])].filter((part) => part.scrollWidth > part.clientWidth)
                    .map((part) => `${part.className}: ${part.textContent.slice(0, 80)}`)""",
                           ".scroll, .plot, pre" if width < 700 else ".plot, pre")
            self.assertEqual(wide, [], width)
            heads = self.js("return [...document.querySelectorAll('thead')].map((head) => getComputedStyle(head).display)")
            self.assertEqual(set(heads) - {"table-header-group" if width >= 700 else "none"}, set(), width)
            widths = self.js("return [...document.querySelectorAll('main > p, main figure > .scroll, .plot')].map((part) => part.offsetWidth)")
            self.assertLessEqual(len(set(widths)), 1, width)
        keys = self.js("return [...document.querySelectorAll('main figure > .scroll td:first-child')].map((cell) => getComputedStyle(cell).position)")
        self.assertLessEqual(set(keys), {"sticky"})
        texts = self.js("return [...document.querySelectorAll('svg[role=img]')].map((svg) => svg.getAttribute('aria-label'))")
        self.assertTrue(all(texts), texts)

    def assert_quiet(self):
        self.assertEqual(self.browser.get_log("browser"), [])

    # A page with another document than a program has written.
    def page_of(self, document):
        page = os.path.join(self.folder, "viewer.html")
        states = {"bodies": [{"name": "a", "radius": 1}], "times": [0, 1], "states": [[[0, 0]], [[1, 1]]]}
        run("saltus_replay", self.write("viewer.json", json.dumps(states)), f"--output={page}")
        with open(page, encoding="utf-8") as file:
            before, after = file.read().split('id="document">', 1)
        text = json.dumps(document).replace("<", "\\u003c")
        return self.write("viewer.html", before + 'id="document">' + text + after[after.index("</script>"):])

    def js(self, code, *arguments):
        return self.browser.execute_script(code, *arguments)

    def assert_valid(self, path):
        if not shutil.which("tidy"):
            return
        checked = subprocess.run(["tidy", "-quiet", "-errors", "-utf8", path], capture_output=True, text=True)
        # This checker is older than divisions in lists of terms.
        known = ("<dd>", "<dt>", "<dl>", "</dl>")
        wrong = [line for line in checked.stderr.splitlines() if line and not any(k in line for k in known)]
        self.assertEqual(wrong, [], path)

    # What the table in the page shows: [x, y, v_x, v_y] by motion and disc.
    def shown_values(self):
        rows = self.js("""
            document.querySelector('.values').open = true;
            saltusReplays[0].redraw();
            return [...document.querySelectorAll('.values tbody tr')].map(
                (row) => [...row.children].map((cell) => cell.textContent));""")
        return {(row[0], row[1]): [float(value) for value in row[2:]] for row in rows}

    def solve(self, scene, *flags):
        folder = tempfile.mkdtemp(dir=self.folder)
        done = run("saltus_solve", f"--scene={scene}", f"--output_dir={folder}", "--progress=none", *flags)
        return folder, done


# Skipped, with the reason, where Chromium or Selenium is missing.
def main():
    reason = missing()
    if reason:
        print(f"skipped: {reason}")
        sys.exit(SKIPPED)
    with tempfile.TemporaryDirectory() as Pages.folder, start_chromium() as Pages.browser:
        unittest.main(verbosity=2)
