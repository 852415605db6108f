"""What is wrong is refused with an exception that names the argument and what was expected."""

import pickle

import numpy as np
import pytest
from conftest import SOURCE

import saltus


def refused(error, *words):
    return pytest.raises(error, match="(?s)" + ".*".join(words))


class TestScenes:
    def test_messages_are_those_of_scene_files(self, two_balls):
        data = two_balls.to_dict()
        data["bodies"][1]["radius"] = -0.2
        with refused(saltus.SceneError, r"bodies\[1\]\.radius: found -0\.2", "expected") as caught:
            saltus.Scene(data)
        assert caught.value.key == "bodies[1].radius"

    def test_a_file_is_named_with_its_line(self, tmp_path):
        path = tmp_path / "wrong.yaml"
        text = (SOURCE / "problems" / "two_balls.yaml").read_text().replace("steps: 480", "stepz: 480")
        path.write_text(text)
        with refused(saltus.SceneError, r"wrong\.yaml:\d+", "stepz") as caught:
            saltus.load_scene(path)
        assert text.splitlines()[caught.value.line - 1].startswith("stepz")
        with pytest.raises(FileNotFoundError):
            saltus.load_scene(tmp_path / "none.yaml")

    @pytest.mark.parametrize("value", [float("nan"), float("inf"), "wide", [1], None, {}, True, 1e30, object()])
    def test_values_that_are_no_radius(self, two_balls, value):
        data = two_balls.to_dict()
        data["bodies"][0]["radius"] = value
        with pytest.raises((saltus.SceneError, TypeError)):
            saltus.Scene(data)

    def test_no_scene_at_all(self):
        with refused(TypeError, "scene: found int", "expected"):
            saltus.rollout(3)
        with pytest.raises(saltus.SceneError):
            saltus.Scene({})

    def test_an_attribute_that_a_scene_does_not_have(self, two_balls):
        with refused(AttributeError, "no attribute 'gravity'", r"to_dict\(\)"):
            two_balls.gravity  # pylint: disable=pointless-statement
        assert two_balls.to_dict()["gravity"] == [0, 0]

    def test_copies_are_equal(self, two_balls):
        assert saltus.Scene(two_balls.to_dict()) == two_balls
        assert pickle.loads(pickle.dumps(two_balls)) == two_balls
        assert two_balls.replace(contact={"friction": 0.5}) != two_balls
        assert saltus.Scene(**{**two_balls.to_dict(), "steps": 480}) == two_balls

    @pytest.mark.parametrize("name", ["y", "n", "on", "No", "true", "null", "12", "1e3", "0x1f", "-1", ".5"])
    def test_what_reads_as_something_else_stays_text(self, two_balls, name):
        term = {"body": name, "quantity": "position", "component": "y", "weight": 1}
        scene = two_balls.replace(
            bodies=[{**two_balls.to_dict()["bodies"][0], "name": name}], control={"bodies": [name], "initial": [[0, 0]]},
            objective={"terminal": [term]})
        data = scene.to_dict()
        assert data["bodies"][0]["name"] == name and data["control"]["bodies"] == [name]
        assert data["objective"]["terminal"][0]["component"] == "y"
        assert saltus.Scene(data) == scene

    def test_keywords_and_numpy(self, two_balls):
        data = two_balls.to_dict()
        data["bodies"][0]["position"] = np.array([-2.0, -2.0])
        data["steps"] = np.int64(480)
        assert saltus.Scene(data) == two_balls


class TestArrays:
    @pytest.mark.parametrize("shape", [(), (960, 1), (480, 2), (479, 1, 2), (481, 1, 2), (480, 1, 2, 1), (0,)])
    def test_shapes(self, two_balls, shape):
        with refused(ValueError, "control: found shape", r"expected \(480, 1, 2\) or \(960,\)"):
            saltus.Simulation(two_balls).loss(np.zeros(shape))

    def test_types(self, two_balls):
        simulation = saltus.Simulation(two_balls)
        for wrong in [np.zeros(960, complex), np.zeros(960, object), np.zeros(960, bool), ["a"] * 960, "text"]:
            with refused(TypeError, "control: found", "expected real numbers"):
                simulation.loss(wrong)
        assert simulation.loss(np.full(960, 3)) == simulation.loss([3.0] * 960) == simulation.loss()
        assert simulation.loss(np.full(960, 3, np.float32)) == simulation.loss()
        assert simulation.loss(np.full((2, 1, 480), 3.0).T) == simulation.loss()

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    def test_numbers_that_are_not_finite(self, two_balls, value):
        control = np.full((480, 1, 2), 3.0)
        control[3, 0, 1] = value
        with refused(ValueError, r"control\[3, 0, 1\]: found", "expected a finite number"):
            saltus.Simulation(two_balls).loss_and_gradient(control)
        with refused(ValueError, "velocity", "finite"):
            saltus.rollout(two_balls, velocity=np.full((2, 2), value))

    def test_places_to_write_to(self, two_balls):
        simulation = saltus.Simulation(two_balls)
        z = simulation.initial_guess
        read_only = np.zeros(960)
        read_only.flags.writeable = False
        with refused(ValueError, "out: found a read-only array"):
            simulation.loss_and_gradient(z, out=read_only)
        with refused(TypeError, "out: found an array of dtype float32", "float64"):
            simulation.loss_and_gradient(z, out=np.zeros(960, np.float32))
        with refused(TypeError, "out: found", "C-contiguous"):
            simulation.loss_and_gradient(z, out=np.zeros((960, 2))[:, 0])
        with refused(TypeError, "out: found list"):
            simulation.loss_and_gradient(z, out=[0.0] * 960)
        with refused(ValueError, "out: found shape"):
            simulation.loss_and_gradient(z, out=np.zeros(959))
        with refused(ValueError, "out: found an array that shares memory"):
            simulation.loss_and_gradient(z, out=z)
        out = np.zeros(960)
        loss, gradient = simulation.loss_and_gradient(z, out=out)
        assert gradient is out or gradient.base is out or np.shares_memory(gradient, out)
        assert np.any(out != 0)

    def test_batches(self, two_balls):
        batch = saltus.Batch(two_balls)
        with refused(ValueError, "points"):
            batch.loss(np.zeros(960))
        with refused(ValueError, "points: found shape"):
            batch.loss(np.zeros((3, 959)))
        with refused(ValueError, "losses: found shape"):
            batch.loss(np.zeros((3, 960)), losses=np.zeros(2))
        with refused(ValueError, "threads"):
            saltus.Batch(two_balls, threads=-1)
        assert batch.loss(np.zeros((0, 960))).shape == (0,)

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize("contact", ["event", "direct_toi"])
    def test_batches_with_numbers_that_are_not_finite(self, two_balls, contact, value):
        points = np.full((5, 960), 3.0)
        points[3, 17] = value
        batch = saltus.Batch(two_balls, contact)
        for evaluate in (batch.loss, batch.loss_and_gradient):
            with refused(ValueError, r"points\[3, 17\]: found", "expected a finite number"):
                evaluate(points)


class TestNames:
    def test_contact_models_and_options(self, two_balls):
        for contact, words in [("dirct", "expected a contact model"), ("ncp:kappa=-1", "kappa"), ("", "contact")]:
            with refused(ValueError, "contact", words):
                saltus.Simulation(two_balls, contact)
            with refused(ValueError, "contact", words):
                saltus.audit(two_balls, [contact])
            with pytest.raises(ValueError):
                saltus.solve(two_balls, contact, "gd")
        with refused(TypeError, "contact: found int"):
            saltus.rollout(two_balls, 7)

    def test_what_a_model_or_solver_cannot_take(self, two_balls):
        rough = two_balls.replace(contact={"friction": 0.1})
        with refused(ValueError, "direct", "friction"):
            saltus.rollout(rough, "direct")
        with refused(ValueError, "direct", "friction"):
            saltus.audit(rough, "direct")
        with pytest.raises(ValueError):
            saltus.solve(two_balls, "direct", "hmp")
        with refused(ValueError, "solver"):
            saltus.solve(two_balls, "event", "newton")

    def test_options(self, two_balls):
        for wrong in [{"iterations": -1}, {"learning_rate": 0.0}, {"learning_rate": float("nan")}, {"threads": -2},
                      {"sequence": "striker-moon"}, {"memory_limit": 0}, {"surrogate": "exact"},
                      {"surrogate": {"kind": "smoothed_zeroth", "samples": 3}}, {"precision": "half"}]:
            with refused(ValueError, next(iter(wrong))):
                saltus.solve(two_balls, "event", "gd", **wrong)

    def test_options_of_another_type(self, two_balls):
        for wrong, expected in [({"iterations": "ten"}, "a whole number"), ({"iterations": 1.5}, "a whole number"),
                                ({"threads": None}, "a whole number"), ({"learning_rate": "fast"}, "a number"),
                                ({"memory_limit": True}, "a number"), ({"sequence": 3}, "text"),
                                ({"keep_iterates": 1}, "True or False"), ({"callback": 3}, "a callable"),
                                ({"status": ""}, "a callable"), ({"precision": float}, "text")]:
            with refused(TypeError, f"{next(iter(wrong))}: found", f"expected {expected}"):
                saltus.solve(two_balls, "event", "gd", **wrong)
        with refused(TypeError, "threads: found str"):
            saltus.Batch(two_balls, threads="two")
        with refused(TypeError, "precision: found int"):
            saltus.rollout(two_balls, precision=64)
        for wrong, expected in [({"contact": 3}, "text"), ({"contact": ["event", 3]}, "text"), ({"solver": [3]}, "text"),
                                ({"iterations": "ten"}, "a whole number"), ({"precision": 64}, "text"),
                                ({"learning_rate": "fast"}, "a number"), ({"point_seconds": "one"}, "a number")]:
            with refused(TypeError, f"^{next(iter(wrong))}: found", f"expected {expected}"):
                saltus.sweep(two_balls, {"steps": [8]}, **wrong)
        for contact in [3, ["event", 3]]:
            with refused(TypeError, "^contact: found int, expected text"):
                saltus.audit(two_balls, contact)
        for load in [saltus.load_scene, saltus.load_bodies, saltus.load_result]:
            with refused(TypeError, f"^{load.__name__}: found int, expected the path of a file"):
                load(3)
        saltus.solve(two_balls, "event", "gd", iterations=np.int64(1), learning_rate=np.float32(1), threads=np.int32(1))

    def test_what_no_function_expects(self, two_balls):
        """Messages name the argument, what was expected, and the way on."""
        recording = {"time": [0.1], "body": ["striker"], "position": [[0, 0]]}
        for names in (3, [3]):
            with refused(TypeError, "^unknown: found int, expected text: a name, or a list of names"):
                saltus.identify(two_balls, recording, names)
        with refused(TypeError, "^load_bodies: found NoneType, expected the path of a file, or a dict with the keys of one"):
            saltus.load_bodies(None)
        for name, function in (("interp", saltus.interp), ("spline", saltus.spline)):
            for arguments, found in ((("a", [0, 1], [1, 2]), "'a' in x"), ((0.5, "ab", [1, 2]), "'ab' in xs"), ((0.5, [0, 1], ["a", 2]), "'a' in ys")):
                with refused(TypeError, f"^{name}: found {found}, expected numbers, or symbols of a function that is recorded, such as x"):
                    function(*arguments)
        disc = saltus.MechanicalSystem(coordinates=["y"], mass=lambda: [[1]], force=lambda: [-9.8],
                                       contacts={"floor": saltus.Contact(gap=lambda q: q[0], restitution=0.5)})
        with refused(ValueError, "^mode: found 3, expected a letter for each of 1 contacts, such as 'o'; leave it out"):
            saltus.SaltedKalmanFilter(disc, [1, 0], np.eye(2), mode=3)
        with refused(ValueError, "^mode and parameters: found some with a scene, which has its own; leave them out"):
            saltus.SaltedKalmanFilter(two_balls, np.zeros(8), np.eye(8), mode="m")

    def test_an_end_state_of_another_control(self):
        line = saltus.HybridSystem(states={"m": ["x"]}, controls=["u"], flow={"m": lambda u: [u[0]]})
        end = saltus.HybridEndState(saltus.HybridProblem(line, mode="m", initial=[0.0], duration=1.0, control=np.ones((4, 1))))
        assert abs(end([0.0], np.arange(4.0), [])[0] - 1.5) < 1e-12
        for wrong in (np.ones(3), np.ones((4, 2)), 1.0):
            with refused(ValueError, r"^control: found shape .*, expected \(4, 1\), as the problem of this HybridEndState has; make another"):
                end([0.0], wrong, [])

    @pytest.mark.parametrize("solver", ["auto", "gd", "ceres_phases"])
    def test_a_problem_without_costs_is_remarked(self, solver):
        line = saltus.HybridSystem(states={"m": ["x"]}, controls=["u"], flow={"m": lambda u: [u[0]]})
        problem = saltus.HybridProblem(line, mode="m", initial=[0.0], duration=1.0, control=np.ones((4, 1)))
        remark = {"kind": "guess", "text": "the problem has no costs and no constraints, so that any motion is optimal; add some"}
        assert remark in saltus.solve(problem, solver=solver).remarks
        problem.costs = [saltus.effort()]
        assert remark not in saltus.solve(problem, solver=solver).remarks

    def test_a_start_that_overlaps(self, two_balls):
        with refused(ValueError, "overlap"):
            saltus.rollout(two_balls, position=[[-1, -1], [-1, -1]])

    def test_residuals_of_no_squares(self):
        with refused(ValueError, "sum of squares"):
            saltus.Simulation(SOURCE / "problems" / "bounce_once.yaml").residuals()


def test_results_are_saved_with_all_digits(two_balls, tmp_path):
    run = saltus.solve(two_balls, "direct_toi", "gd", iterations=3)
    for result in [run, saltus.rollout(two_balls), saltus.loss_and_gradient(two_balls), saltus.audit(two_balls, "lcp")]:
        result.save(tmp_path / "result.json")
        read = saltus.load_result(tmp_path / "result.json")
        assert type(read) is type(result)
        assert read.to_dict() == result.to_dict()
        assert pickle.loads(pickle.dumps(result)).to_dict() == result.to_dict()
        assert "<table>" in result._repr_html_() and result._kind in repr(result)
    assert run.control.shape == (480, 1, 2) and run.losses.shape == (4,)
    with refused(AttributeError, "no 'controls'", "control"):
        run.controls  # pylint: disable=pointless-statement
    with pytest.raises(saltus.WrongGradient, match="convex: the gradient is wrong"):
        saltus.audit(two_balls, "convex").raise_if_wrong()
    with pytest.raises(saltus.WrongGradient, match="compliant_warp: the gradient has the wrong sign: continuous force"):
        saltus.audit(two_balls, "compliant_warp").raise_if_wrong()
    saltus.audit(two_balls, ["event", "toi_velocity"]).raise_if_wrong()


def test_overlaps_at_the_start_are_refused_everywhere():
    scene = saltus.Scene({
        "name": "overlap", "duration": 1.0, "steps": 10,
        "bodies": [
            {"name": "a", "radius": 0.2, "mass": 1, "position": [0.3, 0], "velocity": [1, 0]},
            {"name": "b", "radius": 0.2, "mass": 1, "position": [1, 0]},
        ],
        "objective": {"terminal": [{"body": "b", "quantity": "position", "target": [2.3, 0]}]},
        "optimize": "position", "free": ["a"],
    })
    with pytest.raises(ValueError, match="overlap"):
        saltus.rollout(scene, position=[[0.7, 0], [1, 0]])
    simulation = saltus.Simulation(scene)
    for evaluate in (simulation.loss, simulation.loss_and_gradient, simulation.rollout):
        with pytest.raises(RuntimeError, match=r"overlap of 0\.(1|0999)\d* m with bodies\[0\]"):
            evaluate([[0.7, 0]])
    assert simulation.loss([[0.5, 0]]) == pytest.approx(0.16)  # b moves on at 1 m/s after 0.1 s
    losses = saltus.Batch(scene, threads=1).loss(np.array([[0.5, 0], [0.7, 0]]))
    assert losses[0] == pytest.approx(0.16)
    assert np.isnan(losses[1])
    end = saltus.EndState(scene)
    initial = end.initial.copy()
    initial[0, 0] = 0.7
    with pytest.raises(RuntimeError, match="overlap"):
        end(initial, end.control)


def test_a_gradient_that_overflows_names_the_steps():
    """A light disc between a wall and a heavy one meets them 31415 times: what is across grows at each impact."""
    scene = saltus.Scene(
        name="counting", duration=6, steps=1, optimize="velocity",
        bodies=[{"name": "light", "radius": 0.1, "mass": 1, "position": [1, 0]},
                {"name": "heavy", "radius": 0.3, "mass": 1e8, "position": [3, 0], "velocity": [-1, 0]}],
        planes=[{"name": "wall", "point": [0, 0], "normal": [1, 0]}],
        objective={"terminal": [{"body": "heavy", "quantity": "position", "target": [3, 0]}]})
    message = "the derivatives of a state overflow, as 31415 contacts happen within the step: use more `steps`"
    with pytest.raises(RuntimeError, match=message):
        saltus.loss_and_gradient(scene, contact="event")
    with pytest.raises(RuntimeError, match=message):
        saltus.Simulation(scene, "event").loss_and_gradient()


def drop(**changes):
    """A ball that falls on the floor, with a force."""
    system = saltus.HybridSystem(
        states={"fly": ["height", "speed"]},
        controls=["force"],
        parameters=["gravity"],
        flow={"fly": changes.pop("flow", lambda x, u, p: [x[1], u[0] - p[0]])},
        guards={"fly": {"hit": lambda x: x[0]}},
        resets={"fly": {"hit": lambda x: ("fly", [0 * x[0], -0.5 * x[1]])}},
    )
    given = dict(mode="fly", initial=[1.0, 0.0], parameters=[9.81], duration=1.0, control=np.zeros((4, 1)),
                 costs=[saltus.terminal([0.5, 0])])
    return saltus.HybridProblem(system, **{**given, **changes})


class TestHybridProblems:
    @pytest.mark.parametrize(
        "wrong, error, words",
        [
            ({"costs": None}, TypeError, r"^costs: found NoneType, expected a list"),
            ({"costs": "effort"}, TypeError, r"^costs: found str, expected a list"),
            ({"costs": saltus.effort()}, TypeError, r"^costs: found Cost, expected a list"),
            ({"costs": [saltus.effort(), 3]}, TypeError, r"^costs\[1\]: found 3, expected a list"),
            ({"steps_per_interval": 10**12}, ValueError, r"^steps_per_interval: found 1000000000000, expected"),
            ({"most_events": 2**31}, ValueError, r"^most_events: found 2147483648, expected"),
            ({"most_repeats": -(10**12)}, ValueError, r"^most_repeats: found -1000000000000, expected"),
            ({"wait_behind_guards": "yes"}, TypeError, r"^wait_behind_guards: found str, expected True or False"),
            ({"optimize": "contrl"}, ValueError, r"^optimize: found 'contrl', expected some of control, "),
            ({"optimize": None}, TypeError, r"^optimize: found None"),
            ({"initial": [True, 0]}, TypeError, r"^initial: found bool, expected real numbers"),
            ({"parameters": (True,)}, TypeError, r"^parameters: found bool, expected real numbers"),
        ],
    )
    def test_arguments_are_refused_at_once(self, wrong, error, words):
        with refused(error, words):
            drop(**wrong)

    @pytest.mark.parametrize("attribute, value", [("costs", None), ("wait_behind_guards", 1), ("most_events", 2**31)])
    def test_attributes_that_are_set_later(self, attribute, value):
        problem = drop()
        with refused((TypeError, ValueError), f"^{attribute}: found"):
            setattr(problem, attribute, value)
            saltus.rollout(problem)

    @pytest.mark.parametrize("target", ["ab", ["a", "b"], [True, 0], {"height": 1}, [1j, 0]])
    def test_targets_that_are_no_numbers(self, target):
        with refused(TypeError, "^target: found", "expected numbers, and None"):
            saltus.terminal(target)
        with refused(TypeError, "^max: found", "expected numbers, and None"):
            saltus.terminal(max=target)
        with refused(TypeError, "^weight: found", "expected numbers"):
            saltus.terminal([1, 2], weight=target)

    @pytest.mark.parametrize(
        "table, words",
        [
            (lambda x: np.interp(x, [0, 1], [1, 2], left=0), r"for left and right, write saltus\.where\(x < xp\[0\], left"),
            (lambda x: np.interp(x, [0, 1], [1, np.nan]), "found fp with a number that is not finite"),
            (lambda x: np.interp(x, [0, np.inf], [1, 2]), "found xp with a number that is not finite"),
        ],
    )
    def test_tables(self, table, words):
        with refused((TypeError, ValueError), "(?i)flow of mode 'fly': numpy.interp", words):
            drop(flow=lambda x, u, p: [x[1], u[0] - table(x[0])])

    def test_a_table_with_values_on_either_side(self):
        """The remedy of the message: a constant acceleration of -3 above the table."""

        def pull(x):
            xp = [0.0, 0.1]
            return saltus.where(x < xp[0], 0.0, saltus.where(x > xp[-1], 3.0, np.interp(x, xp, [0.0, 1.0])))

        motion = saltus.rollout(drop(flow=lambda x, u, p: [x[1], u[0] - pull(x[0])], duration=0.5))
        np.testing.assert_allclose(motion.final, [1 - 1.5 * 0.25, -1.5], rtol=1e-9)

    def test_a_run_that_failed_has_no_loss(self):
        run = saltus.solve(drop(initial=[-1.0, 0.0]))
        assert run.termination == "failed" and run.loss is None
        assert run["loss"] is None and "loss" in run.to_dict()


@pytest.mark.parametrize("values", [{"steps": [True]}, {"restitution": [0.5, np.True_]}, {("steps", "restitution"): [(True, 0.5)]},
                                    {"steps": [None]}])
def test_values_of_a_sweep_that_are_no_numbers(two_balls, values):
    with refused(TypeError, "^grid: found (np.)?(True|None)", "expected numbers or text"):
        saltus.sweep(two_balls, values)


def test_files_that_are_no_results(tmp_path):
    path = tmp_path / "solution.npz"
    np.savez(path, control=np.zeros(3))
    with refused(ValueError, r"solution\.npz: found an NPZ archive", "read it with numpy.load"):
        saltus.load_result(path)
    path.write_text("{")
    with refused(ValueError, r"solution\.npz: expected a result that saltus has saved"):
        saltus.load_result(path)
    path.write_bytes(b"\xff\xfe\x00")
    with refused(ValueError, r"solution\.npz: expected a result that saltus has saved"):
        saltus.load_result(path)


def test_a_gradient_beside_running_costs_is_that_of_the_hybrid_problem(two_balls):
    data = two_balls.to_dict()
    data["objective"]["running"] = [{"body": "target", "quantity": "position", "weight": 1.0, "target": [[0, 0, 0], [1, 0, 0]]}]
    with refused(RuntimeError, "running costs", r"take that of its hybrid problem \(saltus\.hybrid_problem\)"):
        saltus.loss_and_gradient(data)
    assert np.isfinite(saltus.loss_and_gradient(saltus.hybrid_problem(data)).loss)


def test_remedies_of_a_disc_at_rest_do_not_lead_in_a_circle():
    """A disc that lies on the floor, and is to end at x = 1: solvers by phases name solvers by rollouts, which take no constraints."""
    disc = {"name": "d", "radius": 0.1, "mass": 1.0, "position": [0, 0.1]}
    hard = {"body": "d", "quantity": "position", "component": "x", "target": 1.0, "hard": True}
    scene = saltus.Scene({"name": "s", "duration": 1.0, "steps": 10, "gravity": [0, -9.81], "bodies": [disc],
                          "planes": [{"name": "g", "point": [0, 0], "normal": [0, 1]}], "optimize": "control",
                          "control": {"bodies": ["d"], "initial": [[0, 0]]}, "objective": {"terminal": [hard], "effort": 0.1}})
    for solver in ("ceres_phases", "ipopt", "auto"):
        with refused(ValueError, "discs rest on", "start from a guess without such contacts, or use ceres_lm", "with costs in place of"):
            saltus.solve(scene, solver=solver)
    with refused(ValueError, "ceres_phases takes them"):
        saltus.solve(scene, solver="ceres_lm")
    lifted = scene.replace(control={"initial": [[0, 12]]})
    assert saltus.solve(lifted, solver="ipopt").termination == "converged"
    cost = {"body": "d", "quantity": "position", "target": [1.0, 0.1], "weight": 1000.0}
    weighed = scene.replace(objective={"terminal": [cost]})
    run = saltus.solve(weighed, solver="ceres_lm")
    # With the weight w the force along the floor is least squares of 0.1 |u|^2 h + w (x - 1)^2, where x is linear in it.
    slope = np.array([(9.5 - k) / 100 for k in range(10)])
    assert run.termination == "converged"
    np.testing.assert_allclose(run.final_loss, 1 / (1 / 1000 + slope @ slope / 0.01), rtol=1e-9)
    for extra in ({"duration": {"free": True, "min": 0.5, "max": 2, "weight": 1.0}},
                  {"via": [{"body": "d", "time": 0.5, "quantity": "position", "target": [0.5, 0.1]}]}):
        run = saltus.solve(weighed.replace(objective=extra), solver="auto")
        assert "start from a guess without such contacts" in run.reason
    slowed = scene.replace(forces=[{"drag": {"body": "d", "linear": 0.1}}])
    with refused(RuntimeError, "."):
        saltus.rollout(slowed)
    assert "discs do not come to rest on each other in scenes with drag" in saltus.solve(slowed, solver="ceres_phases").reason
