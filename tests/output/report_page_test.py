#!/usr/bin/env python3
# Reports of all programs in headless Chromium: valid, nothing cut off, at three widths.
import os
import tempfile

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
                ("thermostat", ["--solver=none"], 3, 0)):
            with self.subTest(f"{program} {flags}"):
                folder = tempfile.mkdtemp(dir=self.folder)
                run(program, f"--output_dir={folder}", *flags)
                page = os.path.join(folder, "report.html")
                self.assert_valid(page)
                self.assert_fits(page)
                # One figure for each state and one for the guards, and the replay of systems that draw themselves.
                self.assertEqual(self.js("return document.querySelectorAll('svg').length"), charts + drawn)
                lines = self.js("return [...document.querySelectorAll('polyline')].map(line => line.getAttribute('points'))")
                self.assertGreater(len(lines), charts - 1)
                self.assertFalse([line for line in lines if "NaN" in line or "undefined" in line])
                before = self.js("return document.querySelector('input') ? document.querySelector('g').innerHTML : ''")
                after = self.js("const slider = document.querySelector('input'); if (!slider) return 'none';"
                                "slider.value = slider.max / 2; slider.oninput();"
                                "return document.querySelector('g').innerHTML")
                self.assertNotEqual(before, after)

    def test_reports_of_audits_and_sweeps(self):
        for program, problem, flags in (
                ("saltus_audit", "two_balls", ["--contact=direct_toi,event"]),
                ("saltus_audit", "two_balls", ["--contact=all"]),
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
                self.assertEqual(self.js("return window.saltusReplays ? saltusReplays.length : 0"),
                                 1 if program == "saltus_audit" else 0)

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
