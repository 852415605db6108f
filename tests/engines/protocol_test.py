#!/usr/bin/python3
# Every language's side of the protocol: what it answers to good and to bad requests. Runs those drivers that are there.
import argparse
import copy
import json
import math
import pathlib
import subprocess
import sys
import unittest

HERE = pathlib.Path(__file__).resolve().parent
ENGINES = HERE.parents[1] / "engines"
sys.path.insert(0, str(ENGINES))

from check import command_of, engines  # noqa: E402

SCENE = {
    "name": "two",
    "duration": 0.5,
    "steps": 4,
    "gravity": [0, -2],
    "bodies": [{"name": "a", "radius": 0.2, "mass": 2, "fixed": False, "position": [0, 0], "velocity": [0, 0]},
               {"name": "b", "radius": 0.2, "mass": None, "fixed": True, "position": [5, 5], "velocity": [0, 0]}],
    "planes": [],
    "contact": {"restitution": 1, "friction": 0, "stiffness": 1e4, "damping": 0},
    "control": {"bodies": ["a"], "initial": [[0, 0]]},
    "objective": {"terminal": [], "effort": 0},
    "optimize": "none",
    "hidden": [],
}
INITIAL = [[0, 0, 1, 0], [5, 5, 0, 0]]
FORCES = [[[4, 0]], [[0, 0]], [[0, 0]], [[0, 8]]]


def simulate(**changed):
    return {"simulate": {"steps": 4, "duration": 0.5, "initial": INITIAL, "control": FORCES, **changed}}


def scene_with(**changed):
    return {"saltus": 1, "scene": {**copy.deepcopy(SCENE), **changed}}


class Protocol(unittest.TestCase):
    commands = {}

    def ask(self, command, *lines):
        texts = [line if isinstance(line, str) else json.dumps(line) for line in lines]
        done = subprocess.run(command, input="\n".join(texts) + "\n", capture_output=True, text=True, check=True)
        return [json.loads(line) for line in done.stdout.splitlines()]

    def test_free_motion(self):
        # Steps of 1/8 s: 4 N to the right in the first, 8 N upwards in the last, and gravity.
        for name, command in self.commands.items():
            with self.subTest(name):
                first, answer = self.ask(command, scene_with(), {"id": 7, **simulate(states=True)})
                self.assertIn("states", first["can"])
                self.assertNotIn("not_applicable", first)
                self.assertEqual(answer["id"], 7)
                self.assertEqual(len(answer["states"]), 5)
                self.assertEqual(answer["states"][0], INITIAL)
                self.assertEqual(answer["states"][-1], answer["final"])
                self.assertEqual(answer["final"][1], [5, 5, 0, 0])
                x, y, vx, vy = answer["final"][0]
                self.assertAlmostEqual(vx, 1 + 1 / 8 * 4 / 2, 6)
                self.assertAlmostEqual(vy, -0.5 * 2 + 1 / 8 * 8 / 2, 6)
                # Where the engine moves within a step is its own matter.
                self.assertAlmostEqual(x, 0.625, delta=0.04)
                self.assertAlmostEqual(y, -0.1875, delta=0.13)

    def test_a_constant_force_and_nothing_left_of_the_request_before(self):
        for name, command in self.commands.items():
            with self.subTest(name):
                one, all_rows = simulate(control=[[[4, 0]]]), simulate(control=[[[4, 0]]] * 4)
                _, *answers = self.ask(command, scene_with(), *({"id": i, **r} for i, r in enumerate([one, all_rows, one])))
                self.assertEqual(answers[0]["final"], answers[1]["final"])
                self.assertEqual(answers[0]["final"], answers[2]["final"])
                self.assertAlmostEqual(answers[0]["final"][0][2], 2, 6)  # 1 + 4 N / 2 kg * 0.5 s

    def test_refusals(self):
        for name, command in self.commands.items():
            with self.subTest(name):
                segments = scene_with(segments=[{"from": [0, 0], "to": [1, 0]}])
                self.assertIn("segments", self.ask(command, segments)[0]["not_applicable"])
                spinning = scene_with()
                spinning["scene"]["bodies"][0]["angular_velocity"] = 3
                self.assertIn("angular_velocity", self.ask(command, spinning)[0]["not_applicable"])
                rough = scene_with(contact={**SCENE["contact"], "rolling_friction": 0.1})
                self.assertIn("rolling_friction", self.ask(command, rough)[0]["not_applicable"])

    # A box flies, and strikes the ground with a corner: Newton's law without friction.
    def test_steps_of_a_box(self):
        mass, inertia, (a, b), angle, e, h = 2, 0.05, (0.3, 0.2), 0.7, 0.5, 1e-4
        box = {"name": "box", "position": [0, 0], "angle": 0, "fixed": False, "mass": mass, "inertia": inertia, "box": [a, b]}
        post = {"name": "post", "position": [9, 9], "angle": 1, "fixed": True, "mass": 1, "inertia": 1, "radius": 0.1}
        hello = {"saltus": 1, "hybrid": {}, "scene": {"bodies": [post, box], "planes": [{"point": [0, 0], "normal": [0, 1]}]}}
        corner = [-a * math.cos(angle) + b * math.sin(angle), -a * math.sin(angle) - b * math.cos(angle)]
        depth, vy, spin = 1e-4, -4, 1.5
        flies, strikes = [0, 5, 3, 1, 2, -2], [0.5, -corner[1] - depth, angle, 1, vy, spin]
        steps = [{"id": i, "step": {"mode": "ooo", "t": 0, "h": h, "state": state, "control": [],
                                    "parameters": [e, 0, 0, gravity]}}
                 for i, (state, gravity) in enumerate([(flies, -10), (strikes, 0)])]
        for name, command in self.commands.items():
            with self.subTest(name):
                greeting, *answers = self.ask(command, hello, *steps)
                if name == "python":
                    self.assertIn("do not turn", greeting["not_applicable"])
                    continue
                self.assertEqual([answer["mode"] for answer in answers], ["ooo", "ooo"])
                flown, struck = (answer["state"] for answer in answers)
                for found, expected in zip(flown, [h, 5 + 2 * h, 3 - 2 * h, 1, 2 - 10 * h, -2]):
                    self.assertAlmostEqual(found, expected, delta=2e-5)
                impulse = -(1 + e) * (vy + corner[0] * spin) / (1 / mass + corner[0] ** 2 / inertia)
                for found, expected in zip(struck[3:], [1, vy + impulse / mass, spin + corner[0] * impulse / inertia]):
                    self.assertAlmostEqual(found, expected, delta=0.02)

    def test_errors_come_with_the_id_and_do_not_end_the_driver(self):
        bad = [simulate(control=FORCES[:3]), simulate(control=[[[0, 0], [0, 0]]]), simulate(initial=INITIAL[:1]),
               simulate(steps=0), {"dance": True}]
        for name, command in self.commands.items():
            with self.subTest(name):
                answers = self.ask(command, scene_with(), *({"id": i, **r} for i, r in enumerate(bad)), "no JSON",
                                   {"id": "last", **simulate()})
                self.assertEqual(len(answers), len(bad) + 3)
                for i, answer in enumerate(answers[1:-2]):
                    self.assertEqual(answer["id"], i)
                    self.assertTrue(answer["error"])
                self.assertIn("1 or 4 rows", answers[1]["error"])
                self.assertIn("1 forces a row", answers[2]["error"])
                self.assertIn("2 rows", answers[3]["error"])
                self.assertTrue(answers[-2]["error"])
                self.assertEqual(answers[-1]["id"], "last")
                self.assertIn("final", answers[-1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--build", type=pathlib.Path, required=True)
    build = parser.parse_args().build
    Protocol.commands["python"] = [sys.executable, str(HERE / "drift.py")]
    for row in engines():
        if row["id"] in ("box2d", "chipmunk", "ode", "planck") and (command := command_of(row, build)):
            Protocol.commands[row["id"]] = command
    print("drivers:", *Protocol.commands, flush=True)
    unittest.main(argv=sys.argv[:1])
