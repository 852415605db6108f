"""The remarks on a result are the same in programs and in Python."""

import json
import math

import numpy as np
import pytest
from conftest import SOURCE, make_generated_scenes, run_program, scene_of

import saltus

RNG_SEEDS = range(12)


def box_of(bodies, **changes):
    width = 4.0
    return {
        "name": "box", "duration": 0.6, "steps": 24, "bodies": bodies, "contact": {"restitution": 0.8},
        "planes": [{"name": "left", "point": [0, 0], "normal": [1, 0]}, {"name": "right", "point": [width, 0], "normal": [-1, 0]},
                   {"name": "bottom", "point": [0, 0], "normal": [0, 1]}, {"name": "top", "point": [0, width], "normal": [0, -1]}],
        "objective": {"terminal": [{"body": bodies[0]["name"], "quantity": "position", "target": [1, 1], "weight": 1}]},
        "optimize": "velocity", "free": [bodies[0]["name"]], **changes}


def disc(name, position, velocity=(0, 0), radius=0.2):
    return {"name": name, "radius": radius, "mass": 1, "position": list(position), "velocity": list(velocity)}


def settling_bag(seed):
    """Discs that fall into the gaps of those below, whose impacts accumulate."""
    r, rng = 0.1, np.random.default_rng(seed)
    bodies = [{**disc(f"d{i}", (r * (1 + 2.05 * (i % 6) + i // 6 % 2), r * (1 + 2.05 * (i // 6))), radius=r),
               "velocity": (0.01 * rng.normal(size=2)).tolist()} for i in range(36)]
    planes = [{"name": "ground", "point": [0, 0], "normal": [0, 1]}, {"name": "left", "point": [0, 0], "normal": [1, 0]},
              {"name": "right", "point": [1.4, 0], "normal": [-1, 0]}]
    return {"name": "bag", "duration": 0.2, "steps": 40, "gravity": [0, -9.8], "bodies": bodies, "planes": planes,
            "contact": {"restitution": 0.3}, "optimize": "velocity", "free": ["d0"],
            "objective": {"terminal": [{"body": "d0", "quantity": "position", "target": [0, 0]}]}}


def dense_pile(seed, side=3):
    """Discs 0.1 mm apart: the order of many impacts at nearly the same time decides."""
    rng, r, gap = np.random.default_rng(seed), 0.05, 1e-4
    pitch = 2 * r + gap
    bodies = [{"name": f"d{side * i + j}", "radius": r, "mass": float(rng.uniform(0.5, 2)), "velocity": rng.normal(size=2).tolist(),
               "position": [r + pitch * (j + 0.5 * (i % 2)) + gap, r + gap + pitch * i * 3**0.5 / 2 + 1e-6]}
              for i in range(side) for j in range(side)]
    width, height = pitch * (side + 0.5) + 2 * gap, 2 * r + 2 * gap + pitch * (side - 1) * 3**0.5 / 2 + 2e-6
    planes = [{"name": "l", "point": [0, 0], "normal": [1, 0]}, {"name": "r", "point": [width, 0], "normal": [-1, 0]},
              {"name": "b", "point": [0, 0], "normal": [0, 1]}, {"name": "t", "point": [0, height], "normal": [0, -1]}]
    return {"name": "dense", "duration": 0.05, "steps": 20, "bodies": bodies, "contact": {"restitution": 0.5}, "planes": planes,
            "objective": {"terminal": [{"body": "d0", "quantity": "position", "component": "x"}]}, "optimize": "velocity"}


def struck_pair(seed):
    """A disc that strikes two others at the same time: the order of the impacts changes the motion."""
    angle, speed = 0.6 + 0.05 * seed, 2.0 + 0.1 * seed  # above 0.53 the two do not overlap
    bodies = [disc("striker", (1, 2), (speed, 0))]
    for name, side in (("upper", 1), ("lower", -1)):
        bodies.append(disc(name, (1.7 + 0.4 * np.cos(angle), 2 + side * 0.4 * np.sin(angle))))
    return box_of(bodies)


def crossed_pairs(seed):
    """Two pairs that collide at the same time and do not meet each other: the order changes nothing."""
    speed = 1.0 + 0.1 * seed
    return box_of([disc("a", (1, 1), (speed, 0)), disc("b", (1.8, 1)), disc("c", (1, 3), (speed, 0)), disc("d", (1.8, 3))])


def flat_corner(seed):
    """A disc that meets two perpendicular walls at the same time: either order leads to the same motion."""
    return box_of([disc("a", (0.7, 0.7), (-2.0 - seed, -2.0 - seed)), disc("far", (3, 3))])


def kinds(remarks):
    return [remark["kind"] for remark in remarks]


KINDS = [(settling_bag, "fallback"), (dense_pile, "ambiguous"), (struck_pair, "ambiguous"), (crossed_pairs, None), (flat_corner, None)]


def compare(scene, path):
    """The remarks of all calls on one motion. Returns them."""
    path.write_text(scene.to_yaml(), encoding="utf-8")
    run = run_program("saltus_solve", f"--scene={path}", "--contact=event", "--solver=none")["runs"][0]
    motion = saltus.rollout(scene)
    assert motion["remarks"] == run["remarks"]
    simulation, batch, end = saltus.Simulation(scene), saltus.Batch(scene), saltus.EndState(scene)
    assert simulation.remarks == []
    simulation.loss_and_gradient()
    assert simulation.remarks == motion["remarks"]
    assert batch.remarks(simulation.initial_guess[None]) == [motion["remarks"]]
    end(end.initial, end.control)
    assert end.remarks == motion["remarks"]
    gradient = saltus.loss_and_gradient(scene)
    assert [remark for remark in gradient["remarks"] if remark["kind"] not in ("derivative", "lost digits")] == motion["remarks"]
    assert ("ambiguous" in gradient) == ("ambiguous" in kinds(motion["remarks"]))
    return motion["remarks"]


@pytest.mark.parametrize("make, kind", KINDS)
def test_scenes(tmp_path, make, kind):
    # All orders of the impacts of a dense pile are simulated, which takes long.
    for seed in range(1, 4) if make is dense_pile else RNG_SEEDS:
        remarks = compare(saltus.Scene(make(seed)), tmp_path / "scene.yaml")
        if kind is None:
            assert remarks == []
        else:
            assert kinds(remarks) == [kind], make
            assert remarks[0]["text"]


def test_generated_scenes(tmp_path):
    for path in make_generated_scenes(12, tmp_path):
        compare(saltus.load_scene(path), path)


def test_gradients_and_audits(tmp_path):
    path = tmp_path / "scene.yaml"
    for make, kind in [(struck_pair, "ambiguous"), (crossed_pairs, None)]:
        scene = saltus.Scene(make(1))
        path.write_text(scene.to_yaml(), encoding="utf-8")
        reference = run_program("saltus_audit", f"--scene={path}", "--contact=event")["reference"]
        assert reference["remarks"] == saltus.loss_and_gradient(scene)["remarks"]
        assert reference["remarks"] == saltus.audit(scene, "event")["reference"]["remarks"]
        assert kinds(reference["remarks"]) == ([kind] if kind else [])


@pytest.mark.parametrize("contact, solver", [("event", "gd"), ("direct_toi", "gd"), ("event", "ceres_lbfgs")])
def test_solvers(tmp_path, contact, solver):
    path = tmp_path / "scene.yaml"
    for make, kind in KINDS[:4]:
        scene = saltus.Scene(make(2))
        path.write_text(scene.to_yaml(), encoding="utf-8")
        flags = (f"--scene={path}", f"--contact={contact}", f"--solver={solver}", "--iterations=1", "--learning_rate=1e-9")
        expected = run_program("saltus_solve", *flags)["runs"][0]["remarks"]
        run = saltus.solve(scene, contact, solver, iterations=1, learning_rate=1e-9)
        assert run["remarks"] == expected
        if kind and solver == "gd":
            assert kind in kinds(expected)


class TestHybridSystems:
    """A ball under the controls of the program bouncing_ball."""

    @staticmethod
    def problem(**changes):
        system = saltus.HybridSystem(
            states={"flight": ["height", "velocity"]}, parameters=["gravity", "restitution"],
            flow={"flight": lambda t, x, u, p: [x[1], -p[0]]}, guards={"flight": {"ground": lambda t, x, p: x[0]}},
            resets={"flight": {"ground": lambda t, x, p: ("flight", [x[0], -p[1] * x[1]])}})
        return saltus.HybridProblem(
            system, **{"mode": "flight", "initial": [4, 0], "parameters": [9.8, 0.7], "duration": 1.0,
                       "costs": [saltus.terminal([1, 0])], **changes})

    def test_a_motion_without_remarks(self):
        for result in (saltus.rollout(self.problem()), saltus.loss_and_gradient(self.problem())):
            assert result["remarks"] == []
        assert saltus.rollout(self.problem()).integration_error < 1e-11

    def test_an_event_at_the_end(self):
        problem = self.problem(initial=[4.9, 0], parameters=[9.8, 0.5])
        for result in (saltus.rollout(problem), saltus.loss_and_gradient(problem)):
            assert kinds(result["remarks"]) == ["derivative"]
            assert result["remarks"][0]["text"] == result["remark"]

    def test_too_few_steps(self):
        # A rate of constant coefficients would have a closed form, which needs no steps.
        swings = saltus.HybridSystem(
            states={"m": ["a", "b"]}, flow={"m": lambda t, x, u, p: [20 * (1 + t) * x[1], -20 * (1 + t) * x[0]]})
        problem = saltus.HybridProblem(swings, mode="m", initial=[1, 0], duration=2.0, steps_per_interval=50)
        motion = saltus.rollout(problem)
        assert kinds(motion["remarks"]) == ["integration error"]
        # The exact motion is a rotation by 20 (t + t^2 / 2).
        error = np.abs(motion.final - [np.cos(80), -np.sin(80)]).max()
        assert 0.2 * error < motion.integration_error < 5 * error
        assert saltus.rollout(saltus.HybridProblem(swings, mode="m", initial=[1, 0], duration=2.0))["remarks"] == []

    def test_programs(self):
        for height in np.linspace(1, 6, 6):
            document = run_program("bouncing_ball", f"--set=y={height}", "--solver=none")
            guess = document["guess"]
            motion = saltus.rollout(self.problem(
                initial=guess["initial"], parameters=guess["parameters"], duration=guess["duration"]))
            assert motion["remarks"] == document["motion"]["remarks"]


    def test_an_event_at_the_start_names_what_it_depends_on(self):
        problem = self.problem(initial=[0, -1], duration=0.1)
        text = "guard 'ground' has an event at the start: derivatives by height are one-sided"
        for result in (saltus.rollout(problem), saltus.loss_and_gradient(problem)):
            assert result.remark == text and [remark["text"] for remark in result.remarks] == [text]

    def test_a_clock_that_ticks_at_the_start_has_no_remark(self):
        clock = saltus.HybridSystem(
            states={"m": ["x", "next"]}, parameters=["period"], flow={"m": lambda x: [-x[0], 0]},
            guards={"m": {"tick": lambda t, x: x[1] - t}}, resets={"m": {"tick": lambda x, p: ("m", [x[0] + 1, x[1] + p[0]])}})
        begins = saltus.HybridSystem(
            states={"off": ["x"], "on": ["x"]}, flow={"off": lambda x: -x, "on": lambda x: 1 - x},
            guards={"off": {"start": lambda t: 0.0 - t}}, resets={"off": {"start": lambda x: ("on", x)}})
        motion = saltus.rollout(saltus.HybridProblem(begins, mode="off", initial=[2.0], duration=1.0))
        assert [event[2] for event in motion.events] == ["start"]
        assert motion.remark == "" and motion.remarks == []
        # Here it is a state when the clock ticks, and another one begins behind the tick.
        motion = saltus.rollout(saltus.HybridProblem(clock, mode="m", initial=[1.0, 0.0], parameters=[0.3], duration=1.0))
        assert motion.remark == "guard 'tick' has an event at the start: derivatives by next are one-sided"

    def test_events_at_the_start_have_one_remark(self):
        corner = saltus.HybridSystem(
            states={"m": ["x", "y", "vx", "vy"]}, flow={"m": lambda x: [x[2], x[3], 0, 0]},
            guards={"m": {"wall": lambda x: x[0], "floor": lambda x: x[1]}},
            resets={"m": {"wall": lambda x: ("m", [x[0], x[1], -x[2], x[3]]), "floor": lambda x: ("m", [x[0], x[1], x[2], -x[3]])}})
        motion = saltus.rollout(saltus.HybridProblem(corner, mode="m", initial=[0, 0, -1, -2], duration=1.0))
        np.testing.assert_allclose(motion.final, [1, 2, 1, 2])
        assert motion.remark == "guards 'wall', 'floor' have events at the start: derivatives by x, y are one-sided"

    def test_what_repeats_is_told_once(self):
        """A clock whose ticks turn the sign of y come where the control jumps."""
        clock = saltus.HybridSystem(
            states={"m": ["phase", "y"]}, controls=["u"], flow={"m": lambda x, u: [1, u[0]]},
            guards={"m": {"tick": lambda x: 1 - x[0]}}, resets={"m": {"tick": lambda x: ("m", [x[0] - 1, -x[1]])}})
        motion = saltus.rollout(saltus.HybridProblem(
            clock, mode="m", initial=[0, 0], duration=39.5, durations=[1.0] * 39 + [0.5], control=np.arange(40.0)[:, None]))
        assert len(motion.events) == 39
        assert motion.remark == "guard 'tick' has an event at t = 1 and 38 more times, where the control jumps"

    def test_failures_of_batches_are_those_of_one_problem(self):
        problem = self.problem(most_events=1, duration=3.0)
        batch = saltus.HybridBatch(problem, optimize=["height"], threads=2)
        batch.loss([[4.0], [400.0]])
        with pytest.raises(RuntimeError) as error:
            saltus.loss_and_gradient(problem)
        assert batch.failures == {0: str(error.value)}


def boxes(seed):
    """Boxes that fall, rest and slide, and a tall one that tips over."""
    height, speed = (0.1, 0.3 * seed) if seed % 2 else (0.3, 0.1 * seed)
    return {"name": "boxes", "duration": 0.4, "steps": 16, "gravity": [0, -9.81],
            "bodies": [{"name": "a", "box": [0.2, 0.1], "mass": 1, "position": [0, height], "velocity": [speed, 0]},
                       {"name": "b", "box": [0.1, 0.3], "mass": 1, "position": [0.6, 0.33], "angle": 0.05 * seed}],
            "planes": [{"point": [0, 0], "normal": [0, 1]}], "contact": {"restitution": 0.1 * seed, "friction": 0.2},
            "objective": {"terminal": [{"body": "a", "quantity": "position", "target": [1, 0]}]}, "optimize": "none"}


@pytest.mark.parametrize("seed", range(6))
def test_mechanical_systems(tmp_path, seed):
    path = tmp_path / "boxes.yaml"
    path.write_text(json.dumps(boxes(seed)), encoding="utf-8")
    document = run_program("saltus_bodies", f"--scene={path}", "--solver=none")["motion"]
    problem = saltus.load_bodies(path)
    motion = saltus.rollout(problem)
    assert motion["remarks"] == document["remarks"]
    assert motion.remark == document.get("remark", "")
    gradient = saltus.loss_and_gradient(problem)
    without_error = [remark for remark in motion["remarks"] if remark["kind"] != "integration error"]
    assert [remark for remark in gradient["remarks"] if remark["kind"] != "integration error"] == without_error


def test_global_runs(tmp_path):
    path = tmp_path / "scene.yaml"
    scene = scene_of("two_balls")
    path.write_text(scene.to_yaml(), encoding="utf-8")
    expected = run_program("saltus_solve", f"--scene={path}", "--contact=event", "--solver=global")["runs"][0]
    run = saltus.solve(scene, "event", "global")
    assert run["remarks"] == expected["remarks"]
    assert run["certificate"] == expected["certificate"]
    assert (run["termination"], run.get("reason", "")) == (expected["termination"], expected.get("reason", ""))


class TestFits:
    """Recordings of a ball that falls from 1 m: with and without sigma, few, in other units, with outliers, and of a wrong scene."""

    KINDS = {"sigma": "fits", "no_sigma": "fits", "large_sigma": "fits", "millimetres": "contradicted", "few": "not judged",
             "outliers": None, "wrong_radius": None, "no_impact": "not determined"}

    @staticmethod
    def recording(kind, seed):
        rng = np.random.default_rng(seed)
        radius, restitution, gravity, fall = 0.05, 0.8, 9.81, np.sqrt(2 * 0.95 / 9.81)
        count = {"few": 3, "no_impact": 8}.get(kind, 40)
        times = np.sort(rng.uniform(0, fall if kind == "no_impact" else 0.9, count))
        after = times - fall
        height = np.where(after < 0, 1 - gravity * times**2 / 2, radius + restitution * gravity * fall * after - gravity * after**2 / 2)
        position = np.stack([0 * times, height], axis=1) + 1e-3 * rng.normal(size=(count, 2))
        if kind == "outliers":
            position[rng.random(count) < 0.3] += 0.1
        if kind == "millimetres":
            position *= 1000
        rows = {"time": times, "body": ["ball"] * count, "position": position}
        if kind in ("sigma", "large_sigma", "outliers", "no_impact"):
            rows["sigma"] = 0.05 if kind == "large_sigma" else 1e-3
        return rows

    @pytest.mark.parametrize("kind", KINDS)
    def test_fits(self, tmp_path, kind):
        scene = saltus.Scene({
            "name": "drop", "duration": 1.0, "steps": 60, "gravity": [0, -9.81], "optimize": "none", "objective": {"terminal": []},
            "bodies": [disc("ball", (0, 1), radius=0.15 if kind == "wrong_radius" else 0.05)], "contact": {"restitution": 0.5},
            "planes": [{"name": "floor", "point": [0, 0], "normal": [0, 1]}]})
        scene_path, path = tmp_path / "scene.yaml", tmp_path / "ball.csv"
        scene_path.write_text(scene.to_yaml(), encoding="utf-8")
        for seed in range(2):
            rows = self.recording(kind, seed)
            sigma = f",{rows['sigma']!r}" if "sigma" in rows else ""
            lines = [f"{time!r},ball,{x!r},{y!r}{sigma}" for time, (x, y) in zip(rows["time"].tolist(), rows["position"].tolist())]
            path.write_text("\n".join(["time,body,x,y" + (",sigma" if sigma else ""), *lines]), encoding="utf-8")
            (expected,) = run_program("saltus_identify", f"--scene={scene_path}", f"--recording={path}", "--unknown=restitution")["fits"]
            fit = saltus.identify(scene, rows, "restitution")
            assert (fit["verdict"], fit.reason) == (expected["verdict"], expected.get("reason", ""))
            assert fit.remarks == expected.get("remarks", [])
            assert self.KINDS[kind] in (None, fit["verdict"]), fit.reason
            for text in [fit.reason, *fit.remarks]:
                assert text in repr(fit)


class TestFeedback:
    SIGMA = 1e-3

    def compare(self, problem, expected, size, controls):
        """The remark, the warning and the risks of a plan with errors of the initial state and of the control."""
        noise = {"initial": self.SIGMA**2 * np.eye(size), "control": self.SIGMA**2 * np.eye(controls) if controls else None}
        covariance = saltus.propagate(problem, **noise)
        assert covariance.remark == expected.get("remark", "")
        assert covariance.warning == expected["open"].get("warning", "")
        assert [tuple(risk.values()) for risk in expected["open"]["risks"]] == [tuple(risk) for risk in covariance.risks]
        assert saltus.noisy_runs(problem, **noise, samples=2).remark == covariance.remark
        if controls:
            regulator = saltus.track(problem, np.eye(size), np.eye(controls), np.eye(size))
            assert regulator.remark == covariance.remark
        return covariance

    def test_scenes(self, tmp_path):
        path = tmp_path / "scene.yaml"
        together = box_of([disc("a", (1, 1), (1, 0)), disc("b", (1.4, 1), (1, 0))])
        for scene in [struck_pair(1), crossed_pairs(2), flat_corner(0), together, box_of([disc("a", (1, 0.2), (1, 0))])]:
            path.write_text(saltus.Scene(scene).to_yaml(), encoding="utf-8")
            expected = run_program("saltus_solve", f"--scene={path}", "--contact=event", "--solver=none", "--feedback",
                                   "--feedback_samples=0", f"--feedback_noise=state={self.SIGMA},force={self.SIGMA}")["runs"][0]["feedback"]
            self.compare(saltus.Scene(scene), expected, 4 * len(scene["bodies"]), 0)

    def test_hybrid_systems(self):
        for height in np.linspace(1, 6, 6):
            document = run_program("bouncing_ball", f"--set=y={height}", "--solver=none", "--feedback", "--feedback_samples=0",
                                   f"--feedback_noise=y={self.SIGMA},v={self.SIGMA}")
            guess = document["guess"]
            problem = TestHybridSystems.problem(
                initial=guess["initial"], parameters=guess["parameters"], duration=guess["duration"])
            self.compare(problem, document["feedback"], 2, 0)


def test_remarks_are_shown():
    with pytest.warns(RuntimeWarning, match="steps use the time-stepping fallback"):
        motion = saltus.rollout(saltus.Scene(settling_bag(0)))
    assert "steps use the time-stepping fallback" in repr(motion) and motion.remarks[0]["kind"] == "fallback"
    assert SOURCE.exists()


def test_a_reset_onto_a_guard_that_rises_is_remarked():
    """Motions nearby have the event of the guard at once: x(2) jumps from 0.5 to 0 as v falls below 0."""
    system = saltus.HybridSystem(
        states={k: ["x", "v"] for k in "abc"},
        flow={"a": lambda: [0, 0], "b": lambda x: [x[1], 1], "c": lambda: [0, 0]},
        guards={"a": {"start": lambda t: 1 - t}, "b": {"halt": lambda x: x[1]}},
        resets={"a": {"start": lambda x: ("b", x)}, "b": {"halt": lambda x: ("c", x)}})
    ends = {}
    for v in (0.0, 1e-9, -1e-9):
        motion = saltus.rollout(saltus.HybridProblem(system, mode="a", initial=[0, v], duration=2.0))
        ends[v] = motion.final[0]
        assert motion.remark == ("the reset at t = 1 leads onto guard 'halt'" if v == 0 else "")
    assert abs(ends[1e-9] - 0.5) < 1e-8 and abs(ends[-1e-9]) < 1e-8


def test_a_gradient_at_a_graze_says_of_which_motions_it_is():
    # The apex of a throw at 4 m/s is at the ceiling: slower throws pass by, and faster ones hit.
    def texts(speed):
        scene = {
            "name": "throw", "duration": 1.0, "steps": 10, "gravity": [0, -8], "contact": {"restitution": 0.5},
            "bodies": [disc("ball", (0, 0), (1, speed), radius=0.25)], "optimize": "velocity",
            "planes": [{"name": "ceiling", "point": [0, 1.25], "normal": [0, -1]}],
            "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [0, 2], "weight": 1}]}}
        return [remark["text"] for remark in saltus.loss_and_gradient(saltus.Scene(scene))["remarks"]]

    assert texts(3.999) == texts(4.001) == []
    assert texts(4) == ["ball grazes ceiling at t = 0.5: the derivatives are those of motions that pass by, and not of those that hit"]


def _pass(kind, steps, miss):
    """A ball that passes exactly tangent to something at t = 0.4 or 0.5, and that far off it in addition."""
    ball = disc("ball", (-0.6, 0.2 + miss), (1.5, 0), radius=0.1)
    scene = {"name": "pass", "duration": 1.0, "steps": steps, "contact": {"restitution": 0.8}, "optimize": "velocity", "bodies": [ball],
             "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [0, 2], "weight": 1}]}}
    if kind == "disc":
        scene["bodies"] += [disc("other", (0.2, 0), (-0.5, 0), radius=0.1)]
    if kind == "post":
        scene["bodies"] += [{"name": "post", "radius": 0.1, "fixed": True, "position": [0, 0]}]
    if kind == "end":
        scene["segments"] = [{"name": "wall", "from": [0, 0.1], "to": [0, -1]}]
    if kind == "ceiling":
        scene["gravity"] = [0, -8]
        scene["bodies"] = [disc("ball", (0, 0), (1, 4), radius=0.25)]
        scene["planes"] = [{"name": "ceiling", "point": [0, 1.25 + miss], "normal": [0, -1]}]
    if kind == "after a bounce":  # at (0.1, 0), from where x - y = 0.1
        ball["position"], ball["velocity"] = [-0.6, 0.7], [1, -1]
        side = 0.2 * math.sqrt(0.5) + miss
        scene["planes"] = [{"name": "floor", "point": [0, -0.1], "normal": [0, 1]}]
        scene["contact"] = {"restitution": 1}
        scene["bodies"] += [{"name": "post", "radius": 0.1, "fixed": True, "position": [0.35 + side, 0.25 - side]}]
    return saltus.Scene(scene)


@pytest.mark.parametrize("kind, other, time", [("disc", "other", 0.4), ("post", "post", 0.4), ("end", "wall.a", 0.4),
                                               ("ceiling", "ceiling", 0.5), ("after a bounce", "post", 0.95)])
def test_a_graze_has_its_remark_whatever_the_number_of_steps(kind, other, time):
    for steps in range(10, 201):
        texts = [remark["text"] for remark in saltus.loss_and_gradient(_pass(kind, steps, 0))["remarks"]]
        assert texts == [f"ball grazes {other} at t = {time:g}: the derivatives are those of motions that pass by, and not of those that hit"]
        if steps % 20 == 0:
            assert all(saltus.loss_and_gradient(_pass(kind, steps, miss))["remarks"] == [] for miss in (1e-6, -1e-6, 1e-3))


def _pass_between_impacts(between, steps, angle, miss):
    """A ball that has met a floor passes tangent to a post before it meets the ceiling, or to a disc that meets the ceiling
    after that, and that far off in addition; all turned by an angle."""
    c, s = math.cos(angle), math.sin(angle)
    turned = lambda x, y: [c * x - s * y, s * x + c * y]
    if between == "impacts of one disc":
        side = math.sqrt(0.5) * (0.2 + miss)
        bodies = [disc("ball", turned(0, 0.2), turned(1, -1), radius=0.1),
                  {"name": "other", "radius": 0.1, "fixed": True, "position": turned(0.45 + side, 0.25 - side)}]
        top = 0.6
    else:
        bodies = [disc("ball", turned(-0.1, 0.3), turned(1, -1), radius=0.1),
                  disc("other", turned(0.9, -0.1 + miss), turned(-1, 1), radius=0.1)]
        top = 0.7 + miss
    return saltus.Scene({
        "name": "between", "duration": 1.0, "steps": steps, "contact": {"restitution": 1}, "optimize": "velocity", "bodies": bodies,
        "planes": [{"name": "ceiling", "point": turned(0, top), "normal": turned(0, -1)}],
        "segments": [{"name": "floor", "from": turned(-1, -0.1), "to": turned(0.5, -0.1)}],
        "objective": {"terminal": [{"body": "ball", "quantity": "position", "target": [0, 2], "weight": 1}]}})


@pytest.mark.parametrize("between, time", [("impacts of one disc", 0.45), ("impacts of each", 0.5)])
def test_a_graze_between_two_impacts_of_one_step_has_its_remark(between, time):
    for angle in np.linspace(0.1, 6, 40):
        for steps in (1, 2, 3, 5, 8):
            texts = [remark["text"] for remark in saltus.loss_and_gradient(_pass_between_impacts(between, steps, angle, 0))["remarks"]]
            assert texts == [f"ball grazes other at t = {time:g}: the derivatives are those of motions that pass by, and not of those that hit"]
        assert all(saltus.loss_and_gradient(_pass_between_impacts(between, 1, angle, miss))["remarks"] == [] for miss in (1e-6, -1e-6, 1e-3))
