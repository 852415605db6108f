"""Arrays that are kept, objects that are copied, pickled and used from several threads, and functions that are recorded
while others use math."""

import copy
import functools
import math
import pickle
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from conftest import scene_of
from numpy.testing import assert_allclose, assert_array_equal

import saltus

ERRORS_OF_MEASUREMENTS = [[1e-4]]


@pytest.fixture(name="often")
def switch_often():
    """Threads take turns as often as Python can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def bounce(t, x, p):
    return "flight", [0, -0.7 * x[1]]


def ball_system(**changes):
    return saltus.HybridSystem(**{
        "states": {"flight": ["y", "v"]}, "controls": ["u"], "flow": {"flight": lambda t, x, u, p: [x[1], u[0] - 9.8]},
        "guards": {"flight": {"ground": lambda t, x, p: x[0]}}, "resets": {"flight": {"ground": bounce}}, **changes})


def ball_problem(**changes):
    return saltus.HybridProblem(**{
        "system": ball_system(), "mode": "flight", "initial": [4, 0], "duration": 1.0, "control": np.zeros((4, 1)),
        "costs": [saltus.terminal([1, 0]), saltus.effort(0.1), saltus.residuals(lambda x: [x[0] * x[1]])], **changes})


def final_height(duration, restitution=0.7, height=4.0, g=9.8):
    """Height and speed of a ball that falls from rest and hits the ground once."""
    fall = math.sqrt(2 * height / g)
    up, rest = restitution * g * fall, duration - fall
    return (height - g * duration**2 / 2, -g * duration) if rest < 0 else (up * rest - g * rest**2 / 2, up - g * rest)


class TestArrays:
    def test_estimates_of_a_filter_are_kept(self):
        """A list of means is a list of different arrays, whatever the filter does later."""
        estimate = saltus.SaltedKalmanFilter(ball_system(), [1.0, 0.0], np.eye(2) * 0.01)
        means, covariances, copies = [], [], []
        for k in range(1, 9):
            estimate.predict(0.05 * k)
            estimate.update([1.0 - 4.9 * (0.05 * k) ** 2], [[1, 0]], ERRORS_OF_MEASUREMENTS)
            means.append(estimate.mean)
            covariances.append(estimate.covariance)
            copies.append((estimate.mean.copy(), estimate.covariance.copy()))
        other = saltus.SaltedKalmanFilter(ball_system(), [7.0, 3.0], np.eye(2))
        del estimate
        other.predict(0.5)
        for k, (mean, covariance, (of_mean, of_covariance)) in enumerate(zip(means, covariances, copies), 1):
            assert mean.flags.owndata or mean.base is not None
            assert_array_equal(mean, of_mean)
            assert_array_equal(covariance, of_covariance)
            # The motion of the truth is that of the mean: every innovation is zero.
            assert_allclose(mean, [1.0 - 4.9 * (0.05 * k) ** 2, -9.8 * 0.05 * k], atol=1e-12)

    def test_writing_to_an_estimate_changes_a_copy(self):
        estimate = saltus.SaltedKalmanFilter(ball_system(), [1.0, 0.0], np.eye(2) * 0.01)
        estimate.mean[0] = 77
        estimate.covariance[0, 0] = 77
        assert_array_equal(estimate.mean, [1.0, 0.0])
        assert_array_equal(estimate.covariance, np.eye(2) * 0.01)

    def test_results_outlive_what_computed_them(self, two_balls):
        """Arrays of every object of the extension module, kept after it is gone and others have been made."""
        scene = two_balls.replace(steps=8)
        simulation, batch, end = saltus.Simulation(scene), saltus.Batch(scene, threads=2), saltus.EndState(scene)
        z, problem = simulation.initial_guess, ball_problem()
        kept = [
            simulation.initial_guess, *simulation.loss_and_gradient()[1:], *simulation.residuals(),
            *[value for value in simulation.rollout().values() if isinstance(value, np.ndarray)],
            simulation.step(np.array([[-1, -1, 1, 1], [-0.5, -0.5, 0, 0]], float)),
            *simulation.linearize(np.array([[-1, -1, 1, 1], [-0.5, -0.5, 0, 0]], float)),
            batch.loss(np.stack([z, 1.1 * z])), *batch.loss_and_gradient(np.stack([z, 1.1 * z])),
            end.initial, end.control, end(end.initial, end.control), *end.vjp(end.initial, end.control, end.initial),
            scene.position, scene.velocity, *saltus.rollout(problem).states,
            *saltus.loss_and_gradient(problem)["gradient"].values(), saltus.final_derivatives(problem)["by_initial"],
            *saltus.track(problem, np.eye(2), np.eye(1), np.eye(2)).gains,
            *saltus.propagate(problem, 0.01 * np.eye(2)).covariances,
            saltus.noisy_runs(problem, 0.01 * np.eye(2), samples=4).covariance,
        ]
        kept = [value for value in kept if isinstance(value, np.ndarray)]
        assert len(kept) > 30
        before = [value.copy() for value in kept]
        del simulation, batch, end, problem, scene
        for _ in range(3):
            other = saltus.Simulation(two_balls.replace(steps=8))
            other.loss_and_gradient(other.initial_guess * 3)
            saltus.loss_and_gradient(ball_problem(duration=1.7))
        for value, same in zip(kept, before):
            assert_array_equal(value, same)


def pushed_apart(x, u, h):
    """A step of two discs with a penalty, which writes to its arguments."""
    difference = x[0, :2] - x[1, :2]
    distance = np.hypot(*difference)
    force = 500 * (0.4 - distance) * difference / distance if distance < 0.4 else np.zeros(2)
    x[:, 2:4] += h * u
    x[0, 2:4] += h * force
    x[1, 2:4] -= h * force
    x[:, :2] += h * x[:, 2:4]
    return x


class Copying(saltus.ContactModel):
    name = "copying"

    def step(self, x, u, h):
        return pushed_apart(x.copy(), u, h)


class InPlace(saltus.ContactModel):
    name = "in_place"

    def step(self, x, u, h):
        moved = pushed_apart(x, u, h)
        u[:] = np.nan
        return moved


class OneBuffer(saltus.ContactModel):
    """Returns the same array from every step."""

    name = "one_buffer"

    def __init__(self, scene):
        super().__init__(scene)
        self.buffer = np.zeros((2, 4))

    def step(self, x, u, h):
        self.buffer[:] = pushed_apart(x.copy(), u, h)
        return self.buffer


@pytest.mark.parametrize("model", [InPlace, OneBuffer])
def test_a_contact_model_may_write_to_its_arguments(two_balls, model):
    scene = two_balls.replace(steps=20)
    expected, found = (saltus.rollout(scene, kind).states for kind in (Copying, model))
    assert_array_equal(found, expected)
    expected, found = (saltus.loss_and_gradient(scene, kind).gradient for kind in (Copying, model))
    for key in ("position", "velocity", "control"):
        assert_array_equal(found[key], expected[key])
    # The derivative of the loss by differences of the loss.
    simulation = saltus.Simulation(scene, model)
    z = simulation.initial_guess.ravel()
    gradient, width = simulation.loss_and_gradient(z)[1], 1e-4
    for i in (0, 7, 21):
        step = width * np.eye(len(z))[i]
        assert_allclose(gradient[i], (simulation.loss(z + step) - simulation.loss(z - step)) / (2 * width), atol=1e-7)


def copies_of(value):
    return [copy.copy(value), copy.deepcopy(value), pickle.loads(pickle.dumps(value)), copy.copy(copy.deepcopy(value))]


class TestCopies:
    def test_problems(self):
        problem = ball_problem()
        expected = saltus.loss_and_gradient(problem).to_dict()
        for other in copies_of(problem):
            assert saltus.loss_and_gradient(other).to_dict() == expected
            other.duration = 0.5
            height, speed = final_height(0.5)
            assert_allclose(saltus.rollout(other).final, [height, speed], atol=1e-12)
            assert_allclose(saltus.loss_and_gradient(other).loss, (height - 1) ** 2 + speed**2 + (height * speed) ** 2)
            assert saltus.loss_and_gradient(problem).to_dict() == expected
            again = pickle.loads(pickle.dumps(other))
            assert saltus.loss_and_gradient(again).loss == saltus.loss_and_gradient(other).loss

    def test_copies_change_alone(self):
        problem = ball_problem()
        other = copy.copy(problem)
        other.costs.append(saltus.final_time())
        assert saltus.loss_and_gradient(other).loss == pytest.approx(saltus.loss_and_gradient(problem).loss + 1.0)
        # The record of a cost is of a state of two numbers.
        with pytest.raises(ValueError, match="terminal cost: found a state of 2 numbers, which no mode has"):
            problem = pickle.loads(pickle.dumps(problem))
            problem.system = ball_system(
                states={"flight": ["y", "v", "w"]}, flow={"flight": lambda t, x, u, p: [x[1], u[0] - 9.8, 0]},
                resets={"flight": {"ground": lambda t, x, p: ("flight", [0, -0.7 * x[1], 0])}})
            problem.initial = [4, 0, 0]
            saltus.loss_and_gradient(problem)

    def test_a_problem_keeps_its_own_arrays(self):
        """A caller goes on with the arrays that it has passed or assigned, and a copy of a problem with its own."""
        initial, parameters, control, durations = np.array([1.0, 0.0]), np.array([9.8]), np.zeros((2, 1)), np.array([0.25, 0.75])
        system = saltus.HybridSystem(states={"m": ["y", "v"]}, controls=["f"], parameters=["g"],
                                     flow={"m": lambda x, u, p: [x[1], u[0] - p[0]]})
        problem = saltus.HybridProblem(system, mode="m", initial=initial, parameters=parameters, control=control, durations=durations)
        right = [1 - 4.9, -9.8]
        problem.initial = initial
        for array in (initial, parameters, control, durations):
            array += 1
        assert_allclose(saltus.rollout(problem).final, right, rtol=1e-14)
        for other in copies_of(problem):
            other.initial[0] += 7
            assert_allclose(saltus.rollout(other).final, [right[0] + 7, right[1]], rtol=1e-14)
            assert_allclose(saltus.rollout(problem).final, right, rtol=1e-14)

    def test_the_control_of_a_run_keeps_its_durations(self):
        system = saltus.HybridSystem(states={"m": ["x"]}, controls=["u"], flow={"m": lambda x, u: [u[0]]})
        problem = saltus.HybridProblem(system, mode="m", initial=[0], control=[[1.0], [3.0]], durations=[0.25, 0.75],
                                       costs=[saltus.terminal([2.5])])
        run = saltus.solve(problem, solver="ceres_phases", optimize=["control"])
        problem.control, problem.durations = run.control, None
        for other in [problem, *copies_of(problem)]:
            assert_allclose(saltus.rollout(other).final, [2.5], rtol=1e-6)
        for other in copies_of(run.control):
            assert_array_equal(other.durations, [0.25, 0.75])

    def test_systems(self):
        for system in copies_of(ball_system()):
            problem = ball_problem(system=system)
            assert_allclose(saltus.rollout(problem).final, final_height(1.0), atol=1e-12)
            assert repr(system) == repr(ball_system())

    def test_simulations_batches_and_end_states(self, two_balls):
        scene = two_balls.replace(steps=20)
        for contact in ("event", "direct_toi", Copying):
            simulation = saltus.Simulation(scene, contact, memory_limit=64)
            for other in copies_of(simulation):
                assert other.loss() == simulation.loss() and other.scene == scene
            batch, points = saltus.Batch(scene, contact, threads=2), np.stack([simulation.initial_guess] * 3)
            for other in copies_of(batch):
                assert_array_equal(other.loss(points), batch.loss(points))
            end = saltus.EndState(scene, contact)
            for other in copies_of(end):
                assert_array_equal(other(end.initial, end.control), end(end.initial, end.control))

    @pytest.mark.parametrize("scene", [False, True])
    def test_filters(self, two_balls, scene):
        if scene:
            estimate = saltus.SaltedKalmanFilter(two_balls, [-2, -2, 1, 1, -1, -1, 0, 0], 0.01 * np.eye(8))
        else:
            estimate = saltus.SaltedKalmanFilter(ball_system(), [1.0, 0.0], np.eye(2) * 0.01, mode="flight")
        estimate.predict(0.3)
        for other in copies_of(estimate):
            assert (other.time, other.mode) == (estimate.time, estimate.mode)
            other.predict(0.6)
            assert_array_equal(estimate.mean, copy.copy(estimate).mean)
            estimate_later = copy.copy(estimate)
            estimate_later.predict(0.6)
            assert_array_equal(other.mean, estimate_later.mean)
            assert_array_equal(other.covariance, estimate_later.covariance)


class TestThreads:
    def test_copies_of_a_problem(self, often):
        problem = ball_problem()

        def vary(i, problem=problem):
            other = copy.copy(problem)
            other.duration = 0.5 + 0.1 * (i % 7)
            return i % 7, saltus.loss_and_gradient(other).loss

        right = dict(vary(i) for i in range(7))
        for i, loss in right.items():
            height, speed = final_height(0.5 + 0.1 * i)
            assert_allclose(loss, (height - 1) ** 2 + speed**2 + (height * speed) ** 2, rtol=1e-11)
        with ThreadPoolExecutor(8) as pool:
            assert all(right[i] == loss for i, loss in pool.map(vary, range(600)))

    def test_one_problem(self, often):
        problem = ball_problem()
        calls = [
            lambda: saltus.loss_and_gradient(problem).loss, lambda: saltus.rollout(problem).final.tolist(),
            lambda: saltus.final_derivatives(problem)["by_initial"].tolist(),
            lambda: saltus.track(problem, np.eye(2), np.eye(1), np.eye(2)).gains[0].tolist(),
            lambda: saltus.noisy_runs(problem, 0.01 * np.eye(2), samples=3, threads=1)["mean"].tolist(),
            lambda: saltus.solve(problem, solver="gd", iterations=1).loss,
        ]
        expected = [call() for call in calls]
        with ThreadPoolExecutor(8) as pool:
            found = list(pool.map(lambda i: calls[i % 6](), range(300)))
        assert all(value == expected[i % 6] for i, value in enumerate(found))

    def test_one_filter(self, often):
        """Predictions and what is read of them, at the same time: a mean that is read is that of some time."""
        estimate = saltus.SaltedKalmanFilter(ball_system(guards=None, resets=None), [1e6, 0.0], np.eye(2) * 0.01)
        stop = threading.Event()

        def read():
            while not stop.is_set():
                height, speed = estimate.mean
                assert_allclose(height, 1e6 - speed**2 / 19.6, rtol=1e-9)

        with ThreadPoolExecutor(4) as pool:
            readers = [pool.submit(read) for _ in range(3)]
            for k in range(1, 300):
                estimate.predict(0.01 * k)
            stop.set()
            for reader in readers:
                reader.result()

    def test_one_simulation_with_torques(self, often):
        scene = scene_of("back_spin").replace(steps=20)
        simulation = saltus.Simulation(scene)
        points = [simulation.initial_guess * factor for factor in (0.9, 1.0, 1.1)]
        expected = [simulation.loss_and_gradient(point)[1] for point in points]
        with ThreadPoolExecutor(6) as pool:
            for i, (_, gradient) in enumerate(pool.map(lambda i: simulation.loss_and_gradient(points[i % 3]), range(300))):
                assert_array_equal(gradient, expected[i % 3])

    def test_contact_models_in_python(self, two_balls, often):
        scenes = [two_balls.replace(steps=steps) for steps in (5, 6, 7)]
        expected = [saltus.rollout(scene, Copying).states for scene in scenes]
        with ThreadPoolExecutor(6) as pool:
            found = pool.map(lambda i: saltus.rollout(scenes[i % 3], Copying).states, range(60))
            for i, states in enumerate(found):
                assert_array_equal(states, expected[i % 3])


class Spring:
    """A model of a user's, with functions of math in methods."""

    def __init__(self, stiffness):
        self.stiffness = stiffness

    def force(self, x):
        return -self.stiffness * math.sin(x) + self.rest(x)

    def rest(self, x):
        return math.exp(-x)

    def __call__(self, t, x, u, p):
        return [self.force(x[0])]


def fall(x):
    return math.cos(x) + rise(x, 2)


def rise(x, times):
    return x if times == 0 else math.atan(rise(x, times - 1))


COUNTED = 0


def counted(x):
    global COUNTED  # pylint: disable=global-statement
    COUNTED += 1
    return math.sin(x)


class TestRecording:
    """Functions of math take symbols in functions that are recorded, and math stays as it is."""

    @staticmethod
    def flow_at(flow, x):
        """The rate of a system of one state at x, from the derivative of a short motion by its duration."""
        system = saltus.HybridSystem(states={"m": ["a"]}, flow={"m": flow})
        problem = saltus.HybridProblem(system, mode="m", initial=[x], duration=1e-9, steps_per_interval=1)
        return saltus.final_derivatives(problem)["by_duration"][0]

    def test_where_a_function_finds_math(self):
        spring, local = Spring(3.0), math

        def imports(t, x, u, p):
            import math as here  # pylint: disable=import-outside-toplevel,reimported
            from math import tan  # pylint: disable=import-outside-toplevel

            return [here.sin(x[0]) + tan(x[0]) + inner(x[0])]

        def inner(x):
            return local.sqrt(x)

        of_spring = -3 * math.sin(0.4) + math.exp(-0.4)
        cases = [
            (lambda t, x, u, p: [math.sin(x[0])], math.sin(0.4)),
            (imports, math.sin(0.4) + math.tan(0.4) + math.sqrt(0.4)),
            (lambda t, x, u, p: [fall(x[0])], math.cos(0.4) + math.atan(math.atan(0.4))),
            (lambda t, x, u, p: [spring.force(x[0])], of_spring),
            (spring, of_spring),
            (functools.partial(lambda k, t, x, u, p: [k * math.log(x[0])], 2), 2 * math.log(0.4)),
            (lambda t, x, u, p, f=math.tanh: [f(x[0])], math.tanh(0.4)),
            (lambda t, x, u, p: [sum(f(x[0]) for f in (math.sin, math.cos, fall))],
             math.sin(0.4) + math.cos(0.4) + fall(0.4)),
        ]
        table = {"a": fall}
        cases.append((lambda t, x, u, p: [table["a"](x[0])], fall(0.4)))
        for flow, expected in cases:
            assert_allclose(self.flow_at(flow, 0.4), expected, rtol=1e-8)

    def test_variables_that_a_function_assigns(self):
        before, calls = COUNTED, 0

        def flow(t, x, u, p):
            nonlocal calls
            calls += 1
            return [counted(x[0])]

        saltus.HybridSystem(states={"m": ["a"]}, flow={"m": flow})
        assert (COUNTED, calls) == (before + 1, 1)

    def test_a_function_that_is_not_reached(self):
        class Model:
            @staticmethod
            def force(x):
                return math.sin(x)

        with pytest.raises(TypeError, match="flow of mode 'm': .*numpy.sin in place of math.sin"):
            saltus.HybridSystem(states={"m": ["a"]}, flow={"m": lambda t, x, u, p: [Model.force(x[0])]})

    def test_math_stays_as_it_is(self, often):
        before = dict(vars(math))
        names = dict(globals())
        seen = []

        def build(i):
            saltus.HybridSystem(states={"m": ["a"]}, flow={"m": lambda t, x, u, p: [math.sin(x[0]) + fall(x[0])]})
            seen.append(math.sin is before["sin"])

        with ThreadPoolExecutor(8) as pool:
            list(pool.map(build, range(300)))
        assert all(seen) and vars(math) == before and pickle.loads(pickle.dumps(math.sin)) is math.sin
        assert {name for name, value in globals().items() if value is not names.get(name)} <= {"COUNTED"}

    def test_math_stays_as_it_is_while_a_function_is_recorded(self):
        """What another thread sees of math and of this module in the middle of a recording."""
        sines, inside, leave = [], threading.Event(), threading.Event()

        def flow(t, x, u, p):
            inside.set()
            leave.wait(10)
            return [math.sin(x[0])]

        def look():
            inside.wait(10)
            sines.append((math.sin, fall))
            leave.set()

        other = threading.Thread(target=look)
        before = (math.sin, fall)
        other.start()
        saltus.HybridSystem(states={"m": ["a"]}, flow={"m": flow})
        other.join()
        assert sines == [before] and type(math.sin(0.5)) is float
