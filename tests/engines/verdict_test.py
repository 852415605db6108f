#!/usr/bin/python3
# Verdicts and classes of engines: the closed form they are measured with, and laws of impact whose class is known.
import json
import pathlib
import sys
import unittest
from unittest import mock

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "engines"))

import measure  # noqa: E402
import verdict  # noqa: E402


# Final states of two discs that meet head-on on a time grid, as a driver would give them: `law` makes of (depth, approach)
# at the first step in contact the depth and the speed that are left.
def final_states_by(law):
    def final_states(_, __, requests):
        answers = []
        for steps, duration, ((x, _y, v, _v), _other), _control in requests:
            h, gap, speed, touched = duration / steps, -x - 0.4, v, False
            for _ in range(steps):
                gap -= h * speed
                if gap < 0 and not touched:
                    depth, speed = law(-gap, speed, h)
                    gap, touched = -depth, True
            answers.append([[-0.4 - gap, 0, speed, 0], [0, 0, 0, 0]])
        return answers
    return final_states


class Contact(unittest.TestCase):
    def class_of(self, law, restitution=1):
        with mock.patch.object(measure, "final_states", final_states_by(law)):
            study = {"impact": {str(steps): measure.impact(None, steps, False) for steps in (240, 2400)}}
        return verdict.of_contact(study, restitution)

    def test_classes(self):
        self.assertEqual(self.class_of(lambda depth, v, h: (depth, -v)), "impulse at a step boundary")
        self.assertEqual(self.class_of(lambda depth, v, h: (0, -v)), "projection")
        self.assertEqual(self.class_of(lambda depth, v, h: (-depth, -v)), "impact time resolved, or a resolved force")
        self.assertEqual(self.class_of(lambda depth, v, h: (-depth / 2, -v / 2), 0.5),
                         "impact time resolved, or a resolved force")
        self.assertEqual(self.class_of(lambda depth, v, h: (depth, -v - 0.2 * depth / h)), "depth feedback")
        self.assertEqual(self.class_of(lambda depth, v, h: (depth, -0.1 * v)), "no restitution")
        self.assertEqual(self.class_of(lambda depth, v, h: (-2 * depth, -v)), "displacement overcorrected")


class Exact(unittest.TestCase):
    def test_closed_form_has_the_values_of_the_references(self):
        references = json.loads((HERE.parents[1] / "data" / "exact_references.json").read_text())["task3_gradients_N480"]
        self.assertAlmostEqual(measure.exact_loss(measure.INITIAL), float(references["loss"]), 14)
        gradient = measure.exact_gradient()
        for entry, name in (("p1x", "dp1"), ("p2x", "dp2"), ("v1x", "dv1"), ("v2x", "dv2")):
            self.assertAlmostEqual(gradient[entry], float(references[name]), 8)


class Gradient(unittest.TestCase):
    exact = {"loss": 2, "gradient": [-0.4, -0.3, -0.5, -0.2]}

    def verdict_of(self, by_step):
        study = {"by_step": {str(steps): [2, gradient] for steps, gradient in by_step.items()}}
        return verdict.of_gradient(study, self.exact, False)

    def scaled(self, factor):
        return [factor * x for x in self.exact["gradient"]]

    def test_verdicts(self):
        steps = [120, 240, 480, 960]
        self.assertEqual(self.verdict_of({k: self.scaled(1 + 1e-9) for k in steps}), "right")
        self.assertEqual(self.verdict_of({k: self.scaled(1 + 1 / k) for k in steps}), "consistent")
        self.assertEqual(self.verdict_of({k: self.scaled(1.05) for k in steps}), "wrong")
        self.assertEqual(self.verdict_of({k: [0.4, -0.3, -0.5, -0.2] for k in steps}), "wrong sign")
        self.assertEqual(self.verdict_of({k: [1e-6, -0.7, -0.2, -0.5] for k in steps}), "wrong")

    def test_motion(self):
        for losses, expected in (([2.1, 2.05, 2.02, 2.01], "converges"), ([2.1, 2.2, 2.3, 2.4], "does not converge")):
            study = {"by_step": {str(120 * 2**k): [loss, []] for k, loss in enumerate(losses)}}
            self.assertEqual(verdict.of_motion(study, self.exact), expected)


if __name__ == "__main__":
    unittest.main()
