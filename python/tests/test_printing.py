"""What print shows of results is short: one line for each value, and no more than a screen."""

import numpy as np
import pytest

import saltus


@pytest.fixture
def bounce():
    ball = saltus.HybridSystem(
        states={"flight": ["y", "v"]}, controls=["f"], parameters=["g", "e"],
        flow={"flight": lambda t, x, u, p: [x[1], -p[0] + u[0]]},
        guards={"flight": {"ground": lambda t, x, p: x[0]}},
        resets={"flight": {"ground": lambda t, x, p: ("flight", [0, -p[1] * x[1]])}})
    problem = saltus.HybridProblem(ball, mode="flight", initial=[4, 0], parameters=[9.8, 0.7], duration=5.0,
                                   control=np.zeros((20, 1)))
    problem.costs = [saltus.terminal([1, 0], weight=100), saltus.effort(1 / 32)]
    return problem


def shown(result):
    text = str(result)
    rows = {line.split()[0]: " ".join(line.split()[1:]) for line in text.split("\n")[1:]}
    sentences = ("reason", "remark", "remarks", "warning")
    assert text.count("\n") < 25 and all(len(row) < 160 for key, row in rows.items() if key not in sentences), text
    return rows


def test_hybrid_results(bounce):
    motion = saltus.rollout(bounce)
    rows = shown(motion)
    assert rows["states"] == f"{len(motion.states)} arrays, the first (2,)"
    assert rows["modes"] == f"{len(motion.modes)} entries, the first flight"
    assert rows["events"].startswith(f"{len(motion.events)} entries, the first (0.9035") and len(motion.events) > 3
    assert "remarks" not in rows  # what is empty is not shown
    regulator = saltus.track(bounce, Q=np.eye(2), R=[[1]], QT=np.eye(2))
    assert shown(regulator)["gains"] == "20 arrays, the first (1, 2)"
    assert shown(saltus.propagate(bounce, 1e-4 * np.eye(2)))["covariances"] == "21 arrays, the first (2, 2)"
    for result in (saltus.loss_and_gradient(bounce), saltus.final_derivatives(bounce),
                   saltus.noisy_runs(bounce, 1e-4 * np.eye(2), samples=10)):
        shown(result)
    bounce.duration = 1.0
    assert shown(saltus.solve(bounce, solver="ceres_phases"))["certificate"] == "stationary"


def test_results_of_scenes(two_balls):
    coarse = two_balls.replace(steps=60)
    run = saltus.solve(coarse)
    assert shown(run)["certificate"] == run.certificate.verdict
    for result in (saltus.rollout(coarse), saltus.loss_and_gradient(coarse), run.certificate):
        shown(result)


def test_problems_and_costs(bounce):
    assert repr(bounce) == "<saltus.HybridProblem from mode 'flight', 20 control intervals over 5, 2 costs and constraints>"
    assert repr(bounce.costs[0]) == "<saltus cost 'terminal cost', cost at end>"
    landing = saltus.residuals(lambda x: [x[1]], at="event", mode="flight", guard="ground", role="inequality", name="landing")
    assert repr(landing) == "<saltus cost 'landing', inequality at event of guard 'ground'>"
