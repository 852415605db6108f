#!/usr/bin/env python3
# The viewer of pages, and the reports of all programs, in headless Chromium: valid, nothing cut off, at three widths.
import json
import os
import tempfile
import xml.etree.ElementTree

from pages import BALL, BOX, PROBLEMS, Pages, main, run

FLEES = """
name: flees
duration: 1
steps: 10
bodies:
  - {name: ball, radius: 0.1, mass: 1.0e-24, position: [0, 0]}
control: {bodies: [ball], initial: [[1.0e+24, 0]]}
objective: {terminal: [{body: ball, quantity: position, target: [1, 1], weight: 1.0e+24}], effort: 0.1}
optimize: control
"""


def series(label, y, **more):
    return {"label": label, "x": list(range(len(y))), "y": y, "colour": "#123456", "dash": "solid", "marker": "none", "line": True,
            "width": 2, **more}


def panel(curves, **more):
    return {"title": "", "x": {"label": "time (s)"}, "y": {"label": "loss"}, "equal_aspect": False, "series": curves, "reference_lines": [],
            "circles": [], "half_planes": [], "outlines": [], **more}


class Viewer(Pages):
    def show(self, *parts, width=1000, **more):
        self.open(self.page_of({"title": "Title & <b>more</b>", "subtitle": "", "parts": parts, **more}), width)

    def test_text_is_text(self):
        self.show({"kind": "heading", "text": "Two balls"}, {"kind": "text", "text": "`a < b` is <i>not</i> set; one ` alone stays."},
                  {"kind": "heading", "text": "Two balls"}, {"kind": "list", "items": [{"text": "`x`: y"}]},
                  {"kind": "code", "text": "if (a < b) \"x\""}, {"kind": "links", "files": ["a b.npz", "javascript:alert(1)"]})
        self.assertEqual(self.js("return document.title"), "Title & <b>more</b>")
        self.assertEqual(self.js("return document.querySelector('main p').innerHTML"),
                         "<code>a &lt; b</code> is &lt;i&gt;not&lt;/i&gt; set; one ` alone stays.")
        self.assertEqual(self.js("return document.querySelector('pre').textContent"), "if (a < b) \"x\"")
        targets = self.js("return [...document.querySelectorAll('nav a')].map((a) => a.getAttribute('href').slice(1))")
        self.assertEqual(targets, self.js("return [...document.querySelectorAll('h2')].map((part) => part.id)"))
        self.assertEqual(len(set(targets)), 2)
        self.assertEqual(self.js("return [...document.querySelectorAll('.links a')].map((a) => a.getAttribute('href'))"),
                         ["./a%20b.npz", "./javascript:alert(1)"])

    def test_tables_are_numbered_and_coloured(self):
        table = {"keys": 1, "columns": [{"header": "contact", "number": False}, {"header": "loss", "number": True}],
                 "rows": [["direct_toi", "2.059"], ["lcp", ["1.5", "bad"]]]}
        self.show({"kind": "table", "table": table, "caption": "Audits of `lcp`", "folded": False, "notes": ["a note"]},
                  {"kind": "table", "table": table, "caption": "All of it", "folded": True})
        self.assertEqual(self.js("return [...document.querySelectorAll('figcaption, figure summary')].map((part) => part.textContent)"),
                         ["Table 1. Audits of lcp", "Table 2. All of it"])
        self.assertEqual(self.js("return document.querySelectorAll('details:not([open]) table').length"), 1)
        cell = "return [...document.querySelectorAll('td')].map((cell) => [cell.className, cell.dataset.label, cell.textContent])"
        self.assertEqual(self.js(cell)[:4], [["key", "contact", "direct_toi"], ["number", "loss", "2.059"],
                                             ["key", "contact", "lcp"], ["number bad", "loss", "1.5"]])
        self.assertEqual(self.js("return document.querySelector('.notes li').textContent"), "a note")

    def test_long_remarks_are_notes(self):
        long = "sequences passed: " + "a-b,b-c; " * 8
        table = {"keys": 1, "columns": [{"header": "solver", "number": False}, {"header": "remark", "number": False}],
                 "rows": [["gd", long], ["hmp", ""], ["ceres_lm", "short"], ["ceres_event", long]]}
        self.show({"kind": "table", "table": table, "caption": "Runs", "folded": False},
                  {"kind": "table", "table": {**table, "rows": table["rows"][1:3]}, "caption": "Short", "folded": False})
        cells = self.js("return [...document.querySelectorAll('td:last-child')].map((cell) => cell.textContent)")
        self.assertEqual(cells, ["gd [1]", "hmp", "ceres_lm [2]", "ceres_event [1]", "", "short"])
        notes = self.js("return [...document.querySelectorAll('.notes li')].map((note) => note.textContent)")
        self.assertEqual(notes, [long, "short"])

    # Where a line goes, in pixels, is where its axis says.
    def test_plots_are_drawn_to_their_axes(self):
        curve = series("lcp", [1, 100, None, 0.01, -1, 10])
        self.show({"kind": "figure", "caption": "c", "figure": {"title": "", "panels": [
            panel([curve, series("marks", [3], marker="circle", line=False)], y={"label": "loss", "log": True},
                  reference_lines=[{"value": 2, "label": "impact", "vertical": True, "colour": "#999999", "dash": "dotted"}]),
            panel([series("constant", [5, 5])])]}})
        path = self.js("return document.querySelector('.plot g path').getAttribute('d')")
        pieces = [[tuple(map(float, point.split(","))) for point in piece.split("L")] for piece in path.split("M")[1:]]
        self.assertEqual([len(piece) for piece in pieces], [2, 1, 1])  # gaps: not a number, not positive
        (x0, y0), (x1, y1) = pieces[0]
        (x3, y3), (x5, y5) = pieces[1][0], pieces[2][0]
        self.assertAlmostEqual(x3 - x0, 3 * (x1 - x0), delta=0.2)
        self.assertAlmostEqual(x5 - x0, 5 * (x1 - x0), delta=0.2)
        self.assertAlmostEqual(y3 - y0, y0 - y1, delta=0.2)
        self.assertAlmostEqual(y5 - y0, (y1 - y0) / 2, delta=0.2)
        ticks = self.js("return [...document.querySelector('.plot .panels svg').querySelectorAll('text')].map((part) => part.textContent)")
        self.assertLessEqual({"0.01", "1", "100", "0", "5", "time (s)", "loss"}, set(ticks))
        self.assertEqual(self.js("return [...document.querySelectorAll('.key span')].map((part) => part.textContent)"),
                         ["lcp", "marks", "impact", "constant"])
        label = self.js("return document.querySelector('.plot .panels svg').getAttribute('aria-label')")
        self.assertEqual(label, "loss against time (s); lcp from (0.00, 1.00) to (5.00, 10.0), marks from (0.00, 3.00) to (0.00, 3.00), "
                                "impact at 2.00.")

    # The file has both panels beside each other, the title and the key, with text that is markup in neither.
    def test_figures_are_saved_as_svg(self):
        panels = [panel([series("a < b & c", [1, 2])]), panel([series("marks", [3], marker="circle", line=False)])]
        self.show({"kind": "figure", "caption": "c", "figure": {"title": "Waves", "panels": panels}})
        text = self.js("""
            const link = document.querySelector('.plot .save');
            link.addEventListener('click', (event) => event.preventDefault());
            link.click();
            return fetch(link.href).then((file) => file.text());""")
        root = xml.etree.ElementTree.fromstring(text)
        space = "{http://www.w3.org/2000/svg}"
        self.assertEqual(root.tag, space + "svg")
        places = [(part.get("x"), part.get("y")) for part in root.findall(space + "svg")]
        self.assertEqual(places, [("0", "24"), ("480", "24"), ("12", "344"), ("252", "344")])
        words = [part.text for part in root.findall(space + "text")]
        self.assertEqual(words, ["Waves", "a < b & c", "marks"])

    # A learning curve whose losses were thinned counts its iterations right.
    def test_learning_curves_count_iterations(self):
        runs = [{"losses": [3.0, 2.0]}, {"losses": {"every": 500, "items": [4.0, 3.0, 2.0]}}, {}]
        styles = [{"label": label, "colour": "#123456", "dash": "solid"} for label in ("a", "b", "c")]
        self.show({"kind": "plot", "plot": "learning_curves", "caption": "c"}, results={"solve": {"runs": runs}}, styles=styles)
        label = self.js("return document.querySelector('.plot svg').getAttribute('aria-label')")
        self.assertIn("a from (0.00, 3.00) to (1.00, 2.00), b from (0.00, 4.00) to (1.00e+3, 2.00)", label)
        self.show({"kind": "plot", "plot": "controls", "caption": "c"}, results={}, styles=styles)
        self.assertEqual(self.js("return document.querySelectorAll('figure').length"), 0)


    # Errors over the step, with the order by position in the label, and the entry that differences contradict most.
    def test_audits_are_drawn_by_step_and_width(self):
        def study(quantity, order):
            return {"quantity": quantity, "order": order, "verdict": "wrong", "steps": [10, 20], "error": [0.5, 0.25]}

        def sweep(entry, wide, finding="agrees with no differences"):
            return {"quantity": "position", "entry": entry, "gradient": 1.0, "narrow": 1.0, "wide": wide, "exact": 2.0,
                    "finding": finding, "grid_width": 0.5, "widths": [0.5, 1.0], "slopes": [1.0, wide]}
        sweeps = [sweep("px a", 2.0), sweep("py a", 3.0), sweep("px b", 9.0, "undecided")]
        studies = [study("position", 1.04), study("velocity", 0.0)]
        audits = [{"contact": "lcp", "refinement": {"quantities": studies}, "width_sweep": {"sweeps": sweeps}}, {"contact": "event"}]
        styles = {name: {"colour": "#123456", "dash": "solid", "marker": "circle"} for name in ("lcp", "event")}
        self.show({"kind": "plot", "plot": "refinement", "caption": "c", "more": {"duration": 2, "right": 1e-6, "styles": styles}},
                  {"kind": "plot", "plot": "widths", "caption": "c", "more": {"untelling": ["undecided"], "styles": styles}},
                  results={"scene": "s", "audits": audits})
        labels = self.js("return [...document.querySelectorAll('.plot svg[role=img]')].map((panel) => panel.getAttribute('aria-label'))")
        over_step = "relative error of the gradient against time step (s); lcp (1.0) from (0.200, 0.500) to (0.100, 0.250), right at 0.00000100."
        self.assertEqual(labels, [f"by position: {over_step}", f"by velocity: {over_step}",
                                  "d loss / d py a: slope against width / grid width; lcp from (1.00, 1.00) to (2.00, 3.00), exact at 2.00."])


class Reports(Pages):
    def test_reports_of_eight_scenes(self):
        gas = run("saltus_scene", "--kind=gas", "--discs=100", "--seed=1").stdout
        rest = BALL.replace("FRICTION", "0.3").replace("restitution: 0.5", "restitution: 0").replace("[0, 1.25]", "[0, 0.25]")
        scenes = {
            "one_disc": (os.path.join(PROBLEMS, "bounce_once.yaml"), ["--contact=all", "--solver=none"]),
            "two_pushed_and_four_planes": (self.write("box.yaml", BOX), ["--contact=event,lcp", "--iterations=20"]),
            "a_hundred": (self.write("gas.yaml", gas), ["--contact=event,direct", "--solver=none"]),
            "no_planes": (os.path.join(PROBLEMS, "two_balls.yaml"),
                          ["--contact=event,convex", "--solver=gd,ceres_event", "--iterations=50"]),
            "several_impacts": (os.path.join(PROBLEMS, "multiple_collisions.yaml"),
                                ["--contact=event", "--iterations=20"]),
            "friction": (self.write("friction.yaml", BALL.replace("FRICTION", "0.4")),
                         ["--contact=event,qcqp", "--iterations=20"]),
            "rest": (self.write("rest.yaml", rest), ["--contact=event,lcp", "--solver=none"]),
            "failed": (self.write("flees.yaml", FLEES), ["--contact=event,direct", "--solver=gd"]),
        }
        for name, (scene, flags) in scenes.items():
            with self.subTest(name):
                folder, _ = self.solve(scene, *flags)
                page = os.path.join(folder, "report.html")
                self.assertLess(os.path.getsize(page), 6e6)
                self.assert_valid(page)
                self.assert_fits(page)
                self.assertGreater(self.js("return document.querySelectorAll('table').length"), 0)
                if name != "failed":
                    self.assertEqual(self.js("return saltusReplays.length"), 1)

    def test_reports_of_hybrid_systems(self):
        for program, flags, charts, drawn in (
                ("slip_hopper", ["--solver=all", "--iterations=20"], 7, 1),
                ("bouncing_ball", ["--solver=none", "--audit", "--set=y=1.3,v=0.4,g=9.81,e=0.8,duration=2"], 3, 1),
                ("bouncing_ball", ["--solver=none", "--set=y=1,v=0,e=0.5"], 3, 1),  # events accumulate
                ("wall_swing_up", ["--solver=none"], 4, 1),  # with its torque
                ("thermostat", ["--solver=none"], 3, 0)):
            with self.subTest(f"{program} {flags}"):
                folder = tempfile.mkdtemp(dir=self.folder)
                run(program, f"--output_dir={folder}", *flags)
                page = os.path.join(folder, "report.html")
                self.assert_valid(page)
                self.assert_fits(page)
                # Each motion has a panel for each state, each control that acts and the guards; systems that draw themselves have a replay.
                motions = self.js("return [...document.querySelectorAll('h2')].filter((h) => h.textContent.startsWith('Motion')).length")
                self.assertEqual(self.js("return document.querySelectorAll('.panels svg').length"), motions * charts)
                self.assertEqual(self.js("return document.querySelectorAll('.replay > svg').length"), motions * drawn)
                lines = self.js("return [...document.querySelectorAll('.panels g path')].map((line) => line.getAttribute('d'))")
                self.assertGreater(len(lines), charts - 1)
                self.assertFalse([line for line in lines if "NaN" in line or "undefined" in line])
                if not drawn:
                    continue
                before = self.js("return document.querySelector('.replay g').innerHTML")
                after = self.js("const slider = document.querySelector('.replay input'); slider.value = slider.max / 2;"
                                "slider.dispatchEvent(new Event('input')); return document.querySelector('.replay g').innerHTML")
                self.assertNotEqual(before, after)

    def test_bounds_stand_beside_controls(self):
        labels = "return [...document.querySelectorAll('.panels svg')].map((svg) => svg.getAttribute('aria-label'))"
        bounded = BOX.replace("[-0.2, 0.3]]}", "[-0.2, 0.3]], max: [1, 2], max_norm: [1.25, 2.5]}")
        folder, _ = self.solve(self.write("bounded.yaml", bounded), "--contact=event", "--solver=none")
        self.open(os.path.join(folder, "report.html"))
        forces = [label for label in self.js(labels) if "force" in label]
        expected = [f"bound at {bound}." for bound in ("-1.00", "-1.00", "1.25", "-2.00", "-2.00", "2.50")]
        self.assertEqual([label[label.index("bound at"):] for label in forces], expected)
        # turbo_car: -5 <= u <= 5.
        folder = tempfile.mkdtemp(dir=self.folder)
        run("turbo_car", f"--output_dir={folder}", "--solver=none")
        self.open(os.path.join(folder, "report.html"))
        self.assertEqual([label[label.index("bound at"):] for label in self.js(labels) if "bound" in label], ["bound at -5.00."])

    def test_numbers_of_noisy_runs_have_four_digits(self):
        folder = tempfile.mkdtemp(dir=self.folder)
        run("juggled_ball", f"--output_dir={folder}", "--feedback", "--feedback_samples=50")
        self.open(os.path.join(folder, "report.html"))
        with open(os.path.join(folder, "result.json"), encoding="utf-8") as file:
            study = json.load(file)["runs"][0]["feedback"]["open"]
        shown = self.js("return [...document.querySelectorAll('td[data-label=\"final error\"], td[data-label=\"first order\"]')].map((cell) => cell.textContent)")
        self.assertEqual(shown[:2], [f"{study['runs']['final_error']:.4g}", f"{study['final_error']:.4g}"])

    # Python writes an empty list where nothing was audited.
    def test_pages_without_audits_have_no_section_of_audits(self):
        folder = tempfile.mkdtemp(dir=self.folder)
        run("bouncing_ball", f"--output_dir={folder}", "--solver=none")
        self.open(os.path.join(folder, "report.html"))
        held = self.js("return JSON.parse(document.getElementById('document').textContent)")
        self.open(self.page_of({**held, "audits": []}))
        headings = self.js("return [...document.querySelectorAll('h2')].map((part) => part.textContent)")
        self.assertGreater(len(headings), 0)
        self.assertFalse([text for text in headings if "Audit" in text])

    def test_reports_of_audits_and_sweeps(self):
        for program, problem, flags in (
                ("saltus_audit", "two_balls", ["--contact=direct_toi,event"]),
                ("saltus_audit", "two_balls", ["--contact=all", "--steps=120"]),
                ("saltus_audit", "bank_shot", ["--contact=event,compliant_warp"]),  # as many columns as just fit at 1600
                ("saltus_sweep", "two_balls", ["--contact=event", "--solver=none", "--sweep=steps=10,20,40"])):
            with self.subTest(f"{program} {problem} {flags[0]}"):
                folder = tempfile.mkdtemp(dir=self.folder)
                scene = f"--scene={PROBLEMS}/{problem}.yaml"
                done = run(program, scene, f"--output_dir={folder}", "--progress=plain", *flags)
                page = os.path.join(folder, "report.html")
                printed = done.stdout if program == "saltus_audit" else done.stderr
                self.assertEqual(printed.splitlines()[-1], page)
                self.assert_valid(page)
                self.assert_fits(page)
                replays = self.js("return saltusReplays.length")
                self.assertEqual(replays, 1 if program == "saltus_audit" else 0)
                self.show_first_moment()

    # A step that is wrong is shown by the replay, under its model alone.
    def show_first_moment(self):
        shown = self.js("""
            const button = document.querySelector('button.moment');
            if (!button) return null;
            button.click();
            const [replay] = saltusReplays;
            return [replay.time, replay.motions.filter(({visible}) => visible).map(({label}) => label), button.parentNode.textContent];""")
        if shown:
            time, motions, text = shown
            self.assertEqual(motions, [text.split(":")[0]])
            self.assertGreater(time, 0)

    def test_reports_of_identifications(self):
        drops = os.path.join(PROBLEMS, "drops")
        for flags, headings in ((["--unknown=restitution", "--contact=event,direct"], ["Fits", "Motions", "Scene"]),
                                (["--law=network:2"], ["Fits", "Law of impact", "Motions", "Scene"])):
            with self.subTest(flags[0]):
                folder = tempfile.mkdtemp(dir=self.folder)
                done = run("saltus_identify", f"--scene={drops}/drops.yaml", f"--recording={drops}/drop_1.csv",
                           f"--output_dir={folder}", "--progress=none", *flags)
                page = os.path.join(folder, "report.html")
                self.assertEqual(done.stdout.splitlines()[-1], page)
                self.assert_valid(page)
                self.assert_fits(page)
                self.assertEqual(self.js("return [...document.querySelectorAll('h2')].map((part) => part.textContent)"),
                                 headings)
                self.assertGreaterEqual(self.js("return document.querySelectorAll('.plot svg[role=img]').length"), 2)


if __name__ == "__main__":
    main()
