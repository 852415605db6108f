"""Every number that Python returns is that of the programs' JSON, to the last digit."""

import json
import pickle

import numpy as np
import pytest
from conftest import TASKS, make_generated_scenes, run_program, scene_of, without
from conftest import SOURCE

import saltus


def path_of(task):
    return SOURCE / "problems" / f"{task}.yaml"


@pytest.mark.parametrize("task", ["bounce_once", "ground_wall", "two_balls"])
def test_audits_of_the_tasks(task):
    contacts = ["direct_toi", "toi_velocity", "event", "convex", "pbd_warp"]
    printed = run_program("saltus_audit", f"--scene={path_of(task)}", f"--contact={','.join(contacts)}")
    assert saltus.audit(path_of(task), contacts).to_dict() == printed


@pytest.mark.parametrize("task", TASKS)
def test_runs_of_the_tasks(task):
    scene = scene_of(task)
    for contact, solver in [("direct_toi", "gd"), ("event", "ceres_lbfgs"), ("event", "hmp"), ("event", "ceres_event")]:
        flags = [f"--scene={path_of(task)}", f"--contact={contact}", f"--solver={solver}", "--iterations=40"]
        try:
            run = saltus.solve(scene, contact, solver, iterations=40)
        except ValueError:
            continue  # not applicable: the program ends with code 2
        printed = run_program("saltus_solve", *flags)["runs"][0]
        assert without(run.to_dict(), "seconds") == without(printed, "seconds")


def document_of(folder):
    """The document of a page, without what depends on the clock: tables of runs have their time in a column."""
    text = (folder / "report.html").read_text(encoding="utf-8").partition('id="document">')[2].partition("</script>")[0]
    document = without(json.loads(text), "seconds")
    for table in (part["table"] for part in document["parts"] if "table" in part):
        clock = [i for i, column in enumerate(table["columns"]) if column["header"] == "seconds"]
        table["rows"] = [[cell for i, cell in enumerate(row) if i not in clock] for row in table["rows"]]
    return document


@pytest.mark.parametrize("contact", ["event", "toi_velocity"])
def test_the_page_of_a_run_is_that_of_the_program(tmp_path, contact):
    flags = [f"--scene={path_of('two_balls')}", f"--contact={contact}", "--solver=ceres_lbfgs", "--iterations=20"]
    run_program("saltus_solve", *flags, f"--output_dir={tmp_path / 'program'}")
    run = saltus.solve(scene_of("two_balls"), contact, "ceres_lbfgs", iterations=20)
    run.save_page(tmp_path / "python" / "run")
    document = document_of(tmp_path / "python" / "run")
    assert document == document_of(tmp_path / "program") and len(document["parts"]) > 5
    name = f"two_balls_{contact}_ceres_lbfgs.npz"
    found, expected = (np.load(folder / name) for folder in (tmp_path / "python" / "run", tmp_path / "program"))
    assert all(np.array_equal(found[key], expected[key]) for key in expected)
    assert saltus.load_result(tmp_path / "python" / "run" / "result.json")["final_loss"] == run["final_loss"]


def test_results_without_their_scene_have_no_page(tmp_path):
    run = saltus.solve(scene_of("two_balls"), "direct_toi", "gd", iterations=2)
    with pytest.raises(ValueError, match="save_page: found a run without its scene, from a file, a pickle or a contact model in Python"):
        pickle.loads(pickle.dumps(run)).save_page(tmp_path)
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(OSError):
        run.save_page(tmp_path / "file")


def test_generated_scenes(tmp_path):
    compared = 0
    for path in make_generated_scenes(50, tmp_path):
        printed = run_program("saltus_audit", f"--scene={path}", "--contact=event,toi_velocity", "--steps=60",
                              "--attribution_seconds=0.001")
        scene = saltus.load_scene(path).replace(steps=60)
        for item in printed["audits"]:
            if "gradient" not in item:
                continue
            found = saltus.loss_and_gradient(scene, item["contact"])
            assert found.to_dict()["gradient"] == item["gradient"]
            assert found["loss"] == item["loss"]
            assert saltus.rollout(scene, item["contact"])["loss"] == item["loss"]
            compared += 1
    assert compared >= 80


def test_loss_and_gradient_is_that_of_the_simulation(two_balls):
    for contact in ["direct_toi", "event", "compliant_warp"]:
        everything = saltus.loss_and_gradient(two_balls, contact)
        loss, gradient = saltus.Simulation(two_balls, contact).loss_and_gradient()
        assert loss == everything["loss"]
        # Two adjoints, with and without parameters: the same but for rounding.
        np.testing.assert_allclose(gradient, everything.gradient.control, rtol=1e-9, atol=1e-13)


def test_gradient_descent_takes_the_gradient_of_the_simulation(two_balls):
    for contact in ["direct_toi", "event", "compliant_warp"]:
        run = saltus.solve(two_balls, contact, "gd", iterations=2, learning_rate=8.0, keep_iterates=True)
        simulation = saltus.Simulation(two_balls, contact)
        for k in range(2):
            z = run.iterates[k].reshape(480, 1, 2)
            loss, gradient = simulation.loss_and_gradient(z)
            assert loss == run["losses"][k]
            np.testing.assert_array_equal(run.iterates[k + 1].reshape(480, 1, 2), z - 8.0 * gradient)


def test_a_control_of_its_own(two_balls):
    control = np.linspace(2.0, 3.0, 960).reshape(480, 1, 2)
    everything = saltus.loss_and_gradient(two_balls, "toi_velocity", control=control)
    loss, gradient = saltus.Simulation(two_balls, "toi_velocity").loss_and_gradient(control)
    assert loss == everything["loss"] == saltus.rollout(two_balls, "toi_velocity", control=control)["loss"]
    np.testing.assert_allclose(gradient, everything.gradient.control, rtol=1e-9, atol=1e-13)
    # By differences of a loss that is smooth there.
    direction = np.random.default_rng(1).normal(size=control.shape)
    simulation = saltus.Simulation(two_balls, "event")
    slope = (simulation.loss(control + 1e-5 * direction) - simulation.loss(control - 1e-5 * direction)) / 2e-5
    exact = saltus.loss_and_gradient(two_balls, "event", control=control).gradient.control
    assert np.sum(exact * direction) == pytest.approx(slope, rel=1e-6)


def test_a_batch_has_the_bits_of_single_points(two_balls):
    rng = np.random.default_rng(2)
    points = 3 + rng.normal(size=(20, 480, 1, 2))
    simulation = saltus.Simulation(two_balls, "direct_toi")
    for threads in (1, 2):
        losses, gradients = saltus.Batch(two_balls, "direct_toi", threads=threads).loss_and_gradient(points)
        for point, loss, gradient in zip(points, losses, gradients):
            single, of_single = simulation.loss_and_gradient(point)
            assert single == loss
            np.testing.assert_array_equal(of_single.ravel(), gradient)


def test_far_from_the_origin(two_balls):
    """Decision variables that are positions pass through another origin."""
    far = two_balls.to_dict()
    for body in far["bodies"]:
        body["position"] = [body["position"][0] + 4096, body["position"][1]]
    far["objective"]["terminal"][0]["target"] = [4096, 0]
    far.update(optimize="position", free=["striker"])
    scene = saltus.Scene(far)
    simulation = saltus.Simulation(scene, "event")
    at_home = saltus.Simulation(two_balls.replace(optimize="position", free=["striker"]), "event")
    everything = saltus.loss_and_gradient(scene, "event")
    np.testing.assert_array_equal(simulation.initial_guess, [[4094, -2]])
    loss, gradient = simulation.loss_and_gradient(simulation.initial_guess)
    assert loss == everything["loss"] == saltus.loss_and_gradient(two_balls, "event")["loss"]
    np.testing.assert_array_equal(gradient, at_home.loss_and_gradient()[1])
    np.testing.assert_array_equal(simulation.rollout()["states"][0, 0], [4094, -2, 0, 0])


def test_linearization_is_the_gradient_of_the_rollout(two_balls):
    """The chain of all steps' derivatives, against the adjoint."""
    motion = saltus.rollout(two_balls, "toi_velocity")
    A, B = saltus.linearize(two_balls, "toi_velocity")
    assert A.shape == (480, 8, 8) and B.shape == (480, 8, 1, 2)
    costate = np.zeros(8)
    costate[4:6] = 2 * motion.final_state[1, :2]  # of the squared distance of the target from the origin
    by_control = np.zeros((480, 1, 2))
    for k in reversed(range(480)):
        by_control[k] = np.tensordot(costate, B[k], 1)
        costate = costate @ A[k]
    by_control += 2 * 0.1 * two_balls.dt * 3
    everything = saltus.loss_and_gradient(two_balls, "toi_velocity").gradient
    np.testing.assert_allclose(by_control, everything.control, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(costate.reshape(2, 4)[:, :2], everything.position, rtol=1e-10)
    np.testing.assert_allclose(motion.times[-1], two_balls.duration)


def test_what_a_rollout_reports(two_balls):
    motion = saltus.rollout(two_balls, "event")
    # Two discs of radius 0.2 meet when the striker, at acceleration (3, 3), has closed the distance sqrt(2) - 0.4.
    time = np.sqrt(2 * (np.sqrt(2) - 0.4) / np.hypot(3, 3))
    (event,) = motion["events"]
    assert event["time"] == pytest.approx(time, abs=1e-14)
    assert (event["a"], event["b"]) == ("striker", "target")
    np.testing.assert_array_equal(motion.steps_with_contact, [int(time * 480)])
    assert motion.positions.shape == (481, 2, 2)
