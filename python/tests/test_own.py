"""Simulators and contact models in Python."""

import collections
import math
import os
import signal
import sys
import threading
import time

import numpy as np
import pytest
from conftest import BIN, SOURCE, run_program

import saltus


def simulate_step_boundary(scene, initial, control, dt):
    """Semi-implicit Euler with the impulse at the end of the step in which two discs overlap: the usual engine.

    Plain floats, which are ten times as fast as small arrays.
    """
    a, b = scene.to_dict()["bodies"]
    reach = a["radius"] + b["radius"]
    (px, py, vx, vy), (qx, qy, wx, wy) = initial.tolist()
    forces = control[:, 0].tolist() if len(scene.controlled) else [(0.0, 0.0)] * len(control)
    for fx, fy in forces:
        vx, vy = vx + dt * fx / a["mass"], vy + dt * fy / a["mass"]
        gx, gy = px - qx + dt * (vx - wx), py - qy + dt * (vy - wy)
        squared = gx * gx + gy * gy
        if squared < reach * reach:
            closing = (vx - wx) * gx + (vy - wy) * gy  # times the distance
            if closing < 0:  # equal masses, elastic
                ix, iy = -closing * gx / squared, -closing * gy / squared
                vx, vy, wx, wy = vx + ix, vy + iy, wx - ix, wy - iy
        px, py, qx, qy = px + dt * vx, py + dt * vy, qx + dt * wx, qy + dt * wy
    return [[px, py, vx, vy], [qx, qy, wx, wy]]


@pytest.fixture
def coarse(two_balls):
    """Few steps, as each is Python's."""
    return two_balls.replace(steps=32)


class Lent:
    """A built-in model, as if it were somebody else's simulator."""

    def __init__(self, contact="event"):
        self.contact, self.scene, self.steps, self.dt = contact, None, 0, 0.0

    def end_of(self, scene, control, dt):
        if (self.scene, self.steps, self.dt) != (scene, len(control), dt):
            self.scene, self.steps, self.dt = scene, len(control), dt
            self.end = saltus.EndState(scene.replace(duration=dt * len(control), steps=len(control)), self.contact)
        return self.end

    def simulate(self, scene, initial, control, dt):
        return self.end_of(scene, control, dt)(initial, control)

    def vjp(self, scene, initial, control, dt, cotangent):
        return self.end_of(scene, control, dt).vjp(initial, control, cotangent)

    def gradient(self, scene, initial, control, dt):
        """Of the loss, by another way than vjp."""
        over = scene.replace(duration=dt * len(control), steps=len(control))
        found = saltus.loss_and_gradient(
            over, self.contact, control=control, position=initial[:, :2], velocity=initial[:, 2:]
        ).gradient
        return np.hstack([found.position, found.velocity]), found.control


class TestSimulators:
    def test_the_usual_engine_is_wrong(self, coarse):
        report = saltus.audit(coarse, simulate=simulate_step_boundary, name="mine")
        found = report.of("mine")
        assert found["black_box"] and found["class"] == "impulse at a step boundary"
        assert report.verdicts["mine"] in ("wrong", "wrong sign")
        with pytest.raises(saltus.WrongGradient, match="mine: the gradient is wrong"):
            report.raise_if_wrong()

    def test_the_exact_one_is_right(self, coarse):
        exact = Lent()
        for vjp in (None, exact.vjp):
            report = saltus.audit(coarse, simulate=exact.simulate, vjp=vjp)
            report.raise_if_wrong()
            assert report.of("simulate")["precision_found"] == 53
        assert report.of("simulate")["own_gradient"]

    @pytest.mark.parametrize("contact", ["event", "compliant_warp"])
    def test_a_vjp_that_contradicts_its_simulator_is_told_first(self, coarse, contact):
        """Whatever the class of its contact."""
        own = Lent(contact)

        def vjp(scene, initial, control, dt, cotangent):
            by_initial, by_control = own.vjp(scene, initial, control, dt, cotangent)
            return by_initial, 1.5 * by_control

        report = saltus.audit(coarse, simulate=own.simulate, vjp=vjp)
        found = report.of("simulate")
        assert found["agrees_with_differences"] is False
        with pytest.raises(saltus.WrongGradient, match="its gradient contradicts its own simulator") as error:
            report.raise_if_wrong()
        text = str(error.value)
        assert found["class"] not in text.split("its gradient contradicts")[0]

    def test_a_gradient_of_the_loss(self, coarse):
        """As audited from a vjp: effort is taken off, and nothing else."""
        exact = Lent()
        found = [
            saltus.audit(coarse, simulate=exact.simulate, **own).of("simulate")
            for own in ({"gradient": exact.gradient}, {"vjp": exact.vjp})
        ]
        assert found[0]["verdict"] == found[1]["verdict"] == "right"
        assert found[0]["agrees_with_differences"] and found[0]["own_gradient"]
        for key in ("position", "velocity", "control"):
            np.testing.assert_allclose(found[0]["gradient"][key], found[1]["gradient"][key], rtol=1e-12, atol=1e-14)

    def test_a_gradient_beside_the_exact_one_and_beside_differences(self, coarse):
        """That of the simulator's own motion agrees with differences, and is wrong; the exact one does not agree."""
        boundary = Lent("direct")
        found = saltus.audit(coarse, simulate=boundary.simulate, gradient=boundary.gradient).of("simulate")
        assert found["verdict"] in ("wrong", "wrong sign") and found["agrees_with_differences"]
        assert any("agrees with differences, and is wrong" in finding for finding in found["findings"])
        found = saltus.audit(coarse, simulate=boundary.simulate, gradient=Lent().gradient).of("simulate")
        assert found["agrees_with_differences"] is False

    def test_beside_built_in_models(self, coarse):
        report = saltus.audit(coarse, ["direct"], simulate=simulate_step_boundary)
        assert list(report.verdicts) == ["direct", "simulate"]
        assert report.of("direct")["class"] == report.of("simulate")["class"]

    @pytest.mark.parametrize(
        "rubbish, error, words",
        [
            (lambda *_: None, TypeError, "final state: found"),
            (lambda *_: np.zeros((2, 3)), ValueError, r"final state: found shape \(2, 3\), expected \(2, 4\)"),
            (lambda *_: np.full((2, 4), np.nan), ValueError, r"final state\[0, 0\]: found nan"),
            (lambda *_: 1 / 0, ZeroDivisionError, "division"),
            (lambda: None, TypeError, "positional argument"),
            ("text", TypeError, "simulate: found str, expected a callable"),
        ],
    )
    def test_rubbish(self, coarse, rubbish, error, words):
        with pytest.raises(error, match=words):
            saltus.audit(coarse, simulate=rubbish)

    def test_gradients_of_the_wrong_shape(self, coarse):
        exact = Lent()
        with pytest.raises(ValueError, match="vjp: found"):
            saltus.audit(coarse, simulate=exact.simulate, vjp=lambda *_: np.zeros(8))
        with pytest.raises(ValueError, match="gradient by the control: found shape"):
            saltus.audit(coarse, simulate=exact.simulate, vjp=lambda *_: (np.zeros((2, 4)), np.zeros((3, 1, 2))))
        with pytest.raises(ValueError, match="jacobian by the initial state: found shape"):
            saltus.audit(coarse, simulate=exact.simulate, jacobian=lambda *_: (np.zeros((2, 2)), np.zeros((2, 2))))
        with pytest.raises(ValueError, match=r"gradient by the control: found shape \(3,\), expected \(32, 1, 2\)"):
            saltus.audit(coarse, simulate=exact.simulate, gradient=lambda *_: (np.zeros((2, 4)), np.zeros(3)))
        with pytest.raises(ValueError, match="gradient: found float, expected a pair"):
            saltus.audit(coarse, simulate=exact.simulate, gradient=lambda *_: 0.0)

    def test_gradients_beside_each_other(self, coarse):
        exact = Lent()
        with pytest.raises(ValueError, match="vjp: found beside gradient, expected one of them"):
            saltus.audit(coarse, simulate=exact.simulate, gradient=exact.gradient, vjp=exact.vjp)
        with pytest.raises(ValueError, match="step: found beside gradient"):
            saltus.audit(coarse, simulate=exact.simulate, gradient=exact.gradient, step=lambda *_: None)
        with pytest.raises(ValueError, match="simulate: expected a callable beside gradient"):
            saltus.audit(coarse, gradient=exact.gradient)

    def test_cost(self, two_balls):
        """An audit of task 3 takes less than 20 s on one core if a rollout of its 480 steps takes 1 ms."""
        lent, steps = Lent("direct"), []

        def simulate(scene, initial, control, dt):
            steps.append(len(control))
            return lent.simulate(scene, initial, control, dt)

        saltus.audit(two_balls, simulate=simulate)
        assert 1e-3 * sum(steps) / 480 < 20

    def test_interrupts(self, two_balls):
        def slow(scene, initial, control, dt):
            return simulate_step_boundary(scene, initial, control, dt)

        timer = threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT))
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            saltus.audit(two_balls.replace(steps=48_000), simulate=slow)
        timer.join()


class Direct(saltus.ContactModel):
    """The built-in model `direct`, in numpy: for two discs of mass 1."""

    name = "direct_in_python"

    def step(self, x, u, h):
        v = x[:, 2:]
        gap = x[0, :2] - x[1, :2] + h * (v[0] - v[1])
        distance = np.hypot(*gap)
        closing = (v[0] - v[1]) @ gap / distance
        v = v + h * u
        if distance < 0.4 and closing < 0:
            impulse = -closing * gap / distance  # equal masses, elastic
            v += [impulse, -impulse]
        return np.hstack([x[:, :2] + h * v, v])


class TestContactModels:
    def test_is_the_built_in_one(self, two_balls):
        scene = two_balls.replace(steps=96)
        own, built_in = saltus.rollout(scene, Direct), saltus.rollout(scene, "direct")
        np.testing.assert_allclose(own.states, built_in.states, rtol=0, atol=1e-13)
        assert own["loss"] == pytest.approx(built_in["loss"], rel=1e-13)
        mine = saltus.loss_and_gradient(scene, Direct).gradient
        theirs = saltus.loss_and_gradient(scene, "direct").gradient
        for key in ("control", "position", "velocity"):  # by differences of steps: to 1e-10 in each of 96
            np.testing.assert_allclose(getattr(mine, key), getattr(theirs, key), rtol=1e-8, atol=1e-8)

    def test_solvers(self, two_balls):
        scene = two_balls.replace(steps=48)
        for solver in ("gd", "ceres_lbfgs"):
            own = saltus.solve(scene, Direct, solver, iterations=5)
            built_in = saltus.solve(scene, "direct", solver, iterations=5)
            np.testing.assert_allclose(own.losses, built_in.losses, rtol=1e-6)
            assert own["contact"] == "direct_in_python"

    def test_audits(self, two_balls):
        found = saltus.audit(two_balls.replace(steps=8), Direct)
        assert found.verdicts["direct_in_python"] in ("wrong", "wrong sign")
        assert found.of("direct_in_python")["class"] == "impulse at a step boundary"

    def test_a_jacobian_of_its_own(self, two_balls):
        calls = []

        class Free(saltus.ContactModel):
            name = "free"

            def step(self, x, u, h):
                return np.hstack([x[:, :2] + h * x[:, 2:], x[:, 2:] + h * u])

            def jacobian(self, x, u, h):
                calls.append(h)
                a, b = np.eye(8), np.zeros((8, 4))
                for body in range(2):
                    for j in range(2):
                        a[4 * body + j, 4 * body + 2 + j] = h
                        b[4 * body + 2 + j, 2 * body + j] = h
                return a, b

        scene = two_balls.replace(steps=10)
        gradient = saltus.loss_and_gradient(scene, Free).gradient
        assert calls == [0.1] * 10
        # Nothing touches: the loss is |p + T v|^2 of the target, and the effort.
        np.testing.assert_allclose(gradient.position, [[0, 0], [-2, -2]], atol=1e-14)
        np.testing.assert_allclose(gradient.velocity, [[0, 0], [-2, -2]], atol=1e-14)
        np.testing.assert_allclose(gradient.control, np.full((10, 1, 2), 2 * 0.1 * 0.1 * 3), atol=1e-14)

    def test_refusals(self, two_balls):
        class Wrong(saltus.ContactModel):
            name = "wrong"

            def step(self, x, u, h):
                return x[:1]

        with pytest.raises(ValueError, match=r"wrong: step: found shape \(1, 4\), expected \(2, 4\)"):
            saltus.rollout(two_balls, Wrong)

        class Pair(Direct):
            name = "pair"

            def step(self, x, u, h):
                return x, u

        with pytest.raises(TypeError, match=r"pair: step: found tuple, expected numbers \(2, 4\)"):
            saltus.rollout(two_balls, Pair)
        with pytest.raises(NotImplementedError, match=r"step\(x, u, h\)"):
            saltus.rollout(two_balls, saltus.ContactModel)
        with pytest.raises(TypeError, match="expected the class itself"):
            saltus.rollout(two_balls, Direct(two_balls))
        with pytest.raises(TypeError, match="expected the class itself"):
            saltus.audit(two_balls, Direct(two_balls))


class TestEngines:
    """Engines that Debian packages, beside what was measured of them elsewhere: losses to the digits that are known."""

    @pytest.fixture(params=[("ode", "ode", 2.0581), ("dart", "dartpy", 2.0567)], ids=["ode", "dart"])
    def engine(self, request, monkeypatch):
        name, package, loss = request.param
        pytest.importorskip(package, reason=f"python3-{'pyode' if name == 'ode' else package} is not installed")
        monkeypatch.syspath_prepend(os.path.join(os.path.dirname(__file__), os.pardir, "examples"))
        import engines

        return name, getattr(engines, name)(), loss

    def test_applies_impulses_at_step_boundaries(self, two_balls, coarse, engine):
        name, simulate, loss = engine
        end = saltus.EndState(two_balls)
        final = simulate(two_balls, end.initial, end.control, two_balls.dt)
        assert final[1, 0] ** 2 + final[1, 1] ** 2 + 0.1 * 18 == pytest.approx(loss, abs=5e-5)
        found = saltus.audit(coarse, simulate=simulate, name=name).of(name)
        assert found["class"] == "impulse at a step boundary"
        assert found["verdict"] in ("wrong", "wrong sign")
        assert found["keep"] == pytest.approx(1, abs=0.05) and found["e"] == pytest.approx(1, abs=0.05)

    @pytest.mark.parametrize(
        "package, driver, flag",
        [("ode", "ode", ""), ("dartpy", "dart", ""), ("siconos", "siconos", ""), ("siconos", "siconos", "--events")],
    )
    def test_verdicts_are_those_of_the_command_line(self, two_balls, tmp_path, monkeypatch, package, driver, flag):
        pytest.importorskip(package, reason=f"python3-{'pyode' if package == 'ode' else package} is not installed")
        program = {"ode": str(BIN.parent / "engines" / "ode"), "dart": f"{sys.executable} {SOURCE}/engines/dart.py",
                   "siconos": f"{sys.executable} {SOURCE}/engines/siconos_drive.py"}[driver]
        if driver == "ode" and not os.path.exists(program):
            pytest.skip("the driver engines/ode.cc is not built (SALTUS_BUILD_ENGINES)")
        monkeypatch.syspath_prepend(os.path.join(os.path.dirname(__file__), os.pardir, "examples"))
        import engines

        scene = two_balls.replace(steps=12)
        scene.save(tmp_path / "scene.yaml")
        simulate = engines.siconos(bool(flag)) if driver == "siconos" else getattr(engines, driver)()
        found = saltus.audit(scene, simulate=simulate, name=driver).of(driver)
        command = f"{driver}={program} {flag}".strip()
        there = run_program("saltus_audit", f"--scene={tmp_path / 'scene.yaml'}", f"--simulate={command}")["audits"][0]
        assert (found["verdict"], found["class"], found["motion"]) == (there["verdict"], there["class"], there["motion"])
        assert found["loss"] == pytest.approx(there["loss"], rel=1e-9)
        assert (found["verdict"] == "right") == (flag == "--events")


class TestCalls:
    """How often an audit calls a simulator."""

    @staticmethod
    def counted(sign, restitution):
        """Discs with an impulse at the boundary of a step; with the wrong sign they are pulled together for ever."""
        counts = collections.Counter()

        def simulate(scene, initial, control, dt):
            counts[len(control)] += 1
            bodies = scene.to_dict()["bodies"][:2]
            (m, n), (r, s) = ([b[key] for b in bodies] for key in ("mass", "radius"))
            ax, ay, au, av, bx, by, bu, bv = map(float, np.ravel(initial[:2]))
            fx, fy = map(float, control[0][0][:2]) if control.size else (0.0, 0.0)
            for _ in range(len(control)):
                au, av = au + dt * fx / m, av + dt * fy / m
                nx, ny = ax - bx, ay - by
                distance = math.hypot(nx, ny)
                nx, ny = nx / distance, ny / distance
                w = nx * (au - bu) + ny * (av - bv)
                if distance < r + s and w < 0:
                    impulse = -sign * (1 + restitution) * w / (1 / m + 1 / n)
                    au, av = au + impulse * nx / m, av + impulse * ny / m
                    bu, bv = bu - impulse * nx / n, bv - impulse * ny / n
                ax, ay, bx, by = ax + dt * au, ay + dt * av, bx + dt * bu, by + dt * bv
            return [[ax, ay, au, av], [bx, by, bu, bv], *initial[2:]]

        return simulate, counts

    @pytest.fixture
    def shot(self):
        return saltus.Scene({
            "name": "shot", "duration": 1.0, "steps": 32,
            "bodies": [
                {"name": "cue", "radius": 0.15, "mass": 1, "position": [-1.1, -0.1], "velocity": [1.6, 0.1]},
                {"name": "obj", "radius": 0.2, "mass": 2, "position": [0, 0]},
            ],
            "contact": {"restitution": 0.8},
            "objective": {"terminal": [{"body": "obj", "quantity": "position", "target": [0.6, 0.2]}]},
            "optimize": "velocity", "free": ["cue"],
        })

    @pytest.mark.parametrize("sign", [1, -1])
    def test_at_most_2000(self, shot, sign):
        simulate, counts = self.counted(sign, 0.8)
        report = saltus.audit(shot, simulate=simulate)
        assert sum(counts.values()) <= 2000
        assert report.verdicts["simulate"] in ("wrong", "wrong sign")

    def test_a_reason_where_it_takes_more(self, shot):
        data = shot.to_dict()
        data["bodies"] += [{"name": f"d{i}", "radius": 0.1, "mass": 1, "position": [3 + i, 3]} for i in range(18)]
        simulate, counts = self.counted(1, 0.8)
        report = saltus.audit(saltus.Scene({**data, "steps": 8}), simulate=simulate)
        assert sum(counts.values()) > 2000
        findings = report.of("simulate")["findings"]
        assert any("more than 2000 runs" in remark for remark in findings)
        assert all(f"remark    {finding}" in str(report) for finding in findings)

    def test_a_limit_of_time(self, shot):
        simulate, counts = self.counted(1, 0.8)

        def slow(*arguments):
            time.sleep(0.02)
            return simulate(*arguments)

        begin = time.monotonic()
        saltus.audit(shot, simulate=slow, audit_seconds=4)
        assert time.monotonic() - begin < 20
        assert sum(counts.values()) < 600
        with pytest.raises(ValueError, match="audit_seconds"):
            saltus.audit(shot, simulate=simulate, audit_seconds=-1)


def test_steps_that_do_not_resolve_a_spring_are_named():
    """The error of a stiff spring falls with the steps and is still large: the cause says what to do."""
    scene = saltus.Scene(
        name="drop", duration=1.0, steps=40, gravity=[0, -9.8], contact={"restitution": 1.0}, optimize="velocity",
        bodies=[{"name": "ball", "radius": 0.1, "mass": 1.0, "position": [0, 1.1], "velocity": [2, -2]}],
        planes=[{"name": "ground", "point": [0, 0], "normal": [0, 1]}],
        objective={"terminal": [{"body": "ball", "quantity": "position", "target": [1, 0.6]}]})

    def simulate(scene, initial, control, dt):
        """Semi-implicit Euler with a spring of 5000 N/m."""
        x, y, vx, vy = np.asarray(initial, float)[0]
        mass = scene.to_dict()["bodies"][0]["mass"]
        for fx, fy in np.asarray(control)[:, 0] if len(scene.controlled) else np.zeros((len(control), 2)):
            vx += dt * fx / mass
            vy += dt * (fy / mass + scene.to_dict()["gravity"][1] + 5000 / mass * max(0.0, 0.1 - y))
            x, y = x + dt * vx, y + dt * vy
        return [[x, y, vx, vy]]

    found = saltus.audit(scene, simulate=simulate)
    assert found.verdicts["simulate"] == "unknown"
    assert "begin with more steps" in found.of("simulate")["why"]
