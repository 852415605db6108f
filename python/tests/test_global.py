"""Lower bounds over all controls."""

from pathlib import Path

import pytest

import saltus

SCENE = str(Path(__file__).resolve().parents[2] / "problems" / "two_balls.yaml")
TWO_BALLS = 1.396542160123


def test_two_balls_is_bounded():
    proof = saltus.bound_globally(SCENE, TWO_BALLS + 1e-9)
    assert proof["complete"] and proof["remarks"] == []
    assert TWO_BALLS - 1e-6 <= proof["lower_bound"] <= TWO_BALLS + 1e-9
    assert proof["gap"] == pytest.approx(TWO_BALLS + 1e-9 - proof["lower_bound"])
    assert proof["left"][0]["sequence"] == "striker-target"
    assert {part["open"] for part in proof["excluded"]} == {False, True}


def test_limits_leave_a_gap():
    proof = saltus.bound_globally(SCENE, TWO_BALLS, boxes=100)
    assert not proof["complete"]
    assert proof["lower_bound"] < TWO_BALLS
    assert proof["left"]
    (remark,) = proof["remarks"]
    assert "before the gap was reached; raise boxes or seconds" in remark


def test_a_loss_that_no_solution_has_is_remarked():
    proof = saltus.bound_globally(SCENE, 0.5 * TWO_BALLS)
    assert proof["remarks"] == ["no control has the given loss: all are above it; give the loss of a motion"]
    assert proof["left"] == []
    own = saltus.rollout(SCENE)["loss"]
    proof = saltus.bound_globally(SCENE, 2 * own, gap=own, boxes=1000)
    assert proof["remarks"][-1].startswith("the scene's own control has a smaller loss, ")
    assert float(proof["remarks"][-1].split("loss, ")[1].split(";")[0]) == pytest.approx(own, rel=1e-8)


@pytest.mark.parametrize("boxes", [-1, 2**63])
def test_wrong_limits_are_refused(boxes):
    with pytest.raises(ValueError, match=f"boxes: found {boxes}, expected a whole number >= 0"):
        saltus.bound_globally(SCENE, TWO_BALLS, boxes=boxes)


def test_the_solver_has_the_verdict():
    run = saltus.solve(SCENE, "event", "global")
    assert run["certificate"]["verdict"] == "global"
    assert "no control has a loss below 1.39654" in run["certificate"]["reason"]
    assert "global" in saltus.solvers()
    searched = run["searched"]
    assert searched["boxes"] > 100
    assert searched["gap"] == pytest.approx(run["final_loss"] - searched["lower_bound"], abs=1e-12)
    assert searched["gap"] <= 1e-6 * run["final_loss"]


def test_what_is_not_supported_is_refused():
    scene = saltus.load_scene(SCENE).to_dict()
    scene["contact"]["friction"] = 0.1
    with pytest.raises(ValueError, match="friction"):
        saltus.bound_globally(scene, 1.0)


class TestMotionWithoutImpacts:
    """A disc whose best control keeps it from the wall: the least loss over forces of any shape has a closed form."""

    MASS, WEIGHT, EFFORT, DURATION = 0.6, 2.0, 0.09, 1.0
    START, SPEED, TARGET = (-1.5, 0.1), (1.1, 0.0), (-0.9, -0.45)

    def scene(self, steps):
        return {
            "name": "short_way", "duration": self.DURATION, "steps": steps, "contact": {"restitution": 0.87},
            "bodies": [{"name": "disc", "radius": 0.2, "mass": self.MASS, "position": self.START, "velocity": self.SPEED}],
            "planes": [{"name": "wall", "point": [1.0, 0], "normal": [-1.0, 0.0]}],
            "control": {"bodies": ["disc"], "initial": [[-0.4, 0.0]]}, "optimize": "control",
            "objective": {
                "terminal": [{"body": "disc", "quantity": "position", "target": self.TARGET, "weight": self.WEIGHT}],
                "effort": self.EFFORT,
            },
        }

    def least(self):
        """The way d costs r |d|^2 / G, G = T^3 / (3 m^2), by the force that falls linearly to 0."""
        miss = sum((self.TARGET[i] - self.START[i] - self.DURATION * self.SPEED[i]) ** 2 for i in range(2))
        G = self.DURATION**3 / (3 * self.MASS**2)
        return miss * self.WEIGHT * self.EFFORT / (self.WEIGHT * G + self.EFFORT)

    def test_verdict_termination_and_gap_agree(self):
        run = saltus.solve(self.scene(7), "event", "global")
        assert run.termination == "converged" and run.certificate["verdict"] == "global"
        assert run.final_loss == pytest.approx(self.least(), rel=1e-6)
        assert 0 <= run.searched["gap"] <= 1e-6 * run.final_loss
        assert run.searched["lower_bound"] == pytest.approx(run.final_loss - run.searched["gap"], rel=1e-12)

    def test_a_gap_that_no_box_closes_is_remarked(self):
        coarse = saltus.solve(self.scene(7), "event", "mode_search").exact_loss
        assert coarse > 1.001 * self.least()
        proof = saltus.bound_globally(self.scene(7), coarse)
        assert proof["lower_bound"] == pytest.approx(self.least(), rel=1e-6)
        assert proof["gap"] > 1e-6 and not proof["complete"]
        (remark,) = proof["remarks"]
        assert "give the loss of a control on more steps" in remark
        assert saltus.bound_globally(self.scene(7), coarse, gap=0.01)["complete"]
