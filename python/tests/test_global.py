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
    assert not proof["left"][0]["open"]
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
    assert searched["boxes"] > 1000
    assert searched["gap"] == pytest.approx(run["final_loss"] - searched["lower_bound"], abs=1e-12)
    assert searched["gap"] <= 1e-6 * run["final_loss"]


def test_what_is_not_supported_is_refused():
    scene = saltus.load_scene(SCENE).to_dict()
    scene["contact"]["friction"] = 0.1
    with pytest.raises(ValueError, match="friction"):
        saltus.bound_globally(scene, 1.0)
