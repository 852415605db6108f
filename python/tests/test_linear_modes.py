"""Modes whose flow is affine with constant coefficients, which step by a closed form, against exponentials of scipy."""
import numpy as np
import pytest
import saltus
from numpy.testing import assert_allclose
from scipy.linalg import expm

A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-3, 1, -0.2, 0.1], [1, -1, 0.1, -0.3]])
B = np.array([[0], [0], [1.0], [-0.5]])
C = np.array([0, 0, -9.81, 0.5])  # by the parameter
T = np.array([0, 0, 0.3, 0])  # by the time
INITIAL = np.array([0.3, -0.2, 0.5, 0.1])
DURATION, K = 2.0, 7


def flow(t, x, u, p):
    return A @ x + B @ u + C * p[0] + T * t + np.array([0, 0, 0, 0.25])


def exact(control, initial=INITIAL, p=1.0, duration=DURATION):
    """The state at the end, with [x t 1] as the state of a linear system on each interval."""
    z = np.r_[initial, 0, 1]
    for u in control:
        m = np.zeros((6, 6))
        m[:4] = np.c_[A, T, B @ u + C * p + [0, 0, 0, 0.25]]
        m[4, 5] = 1
        z = expm(m * duration / len(control)) @ z
    return z[:4]


def problem_of(control, **changes):
    system = saltus.HybridSystem(states={"m": ["a", "b", "c", "d"]}, controls=["u"], parameters=["p"], flow={"m": flow})
    return saltus.HybridProblem(system, **{**dict(mode="m", initial=INITIAL, parameters=[1.0], duration=DURATION,
                                                  control=control), **changes})


def difference(function, at, width=1e-4):
    """Central differences of the fourth order, a row for each number of `at`."""
    rows = []
    for i in range(at.size):
        values = []
        for step in (1, -1, 2, -2):
            moved = at.copy()
            moved.flat[i] += step * width
            values.append(function(moved))
        rows.append((8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * width))
    return np.array(rows)


def test_motion_and_derivatives():
    control = np.random.default_rng(1).normal(size=(K, 1))
    problem = problem_of(control)
    assert_allclose(saltus.rollout(problem).final, exact(control), rtol=0, atol=1e-12)
    found = saltus.final_derivatives(problem)
    assert_allclose(found.by_initial, difference(lambda x: exact(control, initial=x), INITIAL).T, atol=1e-9)
    assert_allclose(np.asarray(found.by_control).reshape(4, K), difference(exact, control).T, atol=1e-9)
    assert_allclose(np.ravel(found.by_parameters), difference(lambda p: exact(control, p=p[0]), np.ones(1))[0], atol=1e-9)
    by_duration = difference(lambda d: exact(control, duration=d[0]), np.array([DURATION]))[0]
    assert_allclose(found.by_duration, by_duration, atol=1e-9)


def test_stiff_modes_need_no_short_steps():
    """A fast current that follows a voltage, and a slow speed: an explicit method would need 1e9 steps."""
    fast, slow = 1e9, 2.0
    system = saltus.HybridSystem(states={"m": ["i", "v"]}, controls=["u"],
                                 flow={"m": lambda x, u: [-fast * (x[0] - u[0]), x[0] - slow * x[1]]})
    control = np.array([[1.0], [-0.5], [2.0]])
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0, 0], duration=1.5, control=control))
    i, v, h = 0.0, 0.0, 0.5
    for (u,) in control:
        v = v * np.exp(-slow * h) + u * -np.expm1(-slow * h) / slow + (i - u) * np.exp(-slow * h) / (fast - slow)
        i = u  # up to exp(-fast h), which is zero
    assert_allclose(motion.final, [i, v], rtol=1e-11)


def test_events_are_located_within_long_steps():
    """A weight on a spring strikes a stop at -0.5: x'' = -x, from rest at 1; it returns at 0.8 of its speed."""
    system = saltus.HybridSystem(
        states={"m": ["x", "v"]}, flow={"m": lambda x: [x[1], -x[0]]}, guards={"m": {"stop": lambda x: x[0] + 0.5}},
        resets={"m": {"stop": lambda x: ("m", [x[0], -0.8 * x[1]])}})
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[1, 0], duration=4.0))
    first = np.arccos(-0.5)
    v = 0.8 * np.sin(first)
    s = 4.0 - first  # without another strike: it would come after 4.39
    assert [event[1:] for event in motion.events] == [("m", "stop", "m")]
    assert_allclose(motion.events[0][0], first, rtol=1e-13)
    assert_allclose(motion.final, [-0.5 * np.cos(s) + v * np.sin(s), 0.5 * np.sin(s) + v * np.cos(s)], atol=1e-12)


def test_a_flow_that_decides_is_not_affine():
    """The derivative of the flow is the same on both sides of the jump, at which the motion still turns."""
    system = saltus.HybridSystem(states={"m": ["x", "v"]},
                                 flow={"m": lambda x: [x[1], saltus.where(x[0] > 0, -1.0, 2.0)]})
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=[0.5, 0], duration=1.5))
    assert_allclose(motion.final, [-0.5 + 0.25, -1 + 1], atol=1e-12)  # at zero after 1 s, at a speed of -1


def test_optimum_of_a_double_integrator(K=20):
    """From 1 at rest to 0 at rest in 1 s with least effort: 12 in continuous time, 12 / (1 - 1 / K^2) with held forces."""
    system = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"], flow={"m": lambda x, u: [x[1], u[0]]})
    problem = saltus.HybridProblem(system, mode="m", initial=[1, 0], duration=1.0, control=np.zeros((K, 1)))
    problem.costs = [saltus.effort(1.0), saltus.residuals(lambda x: [x[0], x[1]], role="equality")]
    run = saltus.solve(problem, solver="ceres_phases", optimize=["control"])
    assert run.termination == "converged"
    assert_allclose(run.loss, 12 / (1 - 1 / K**2), rtol=1e-9)


@pytest.mark.parametrize("rate, size", [(1, 6), (1, 8), (1e3, 5), (1e3, 12), (1e6, 8), (1, 20)])
def test_chains(rate, size):
    """Resistors and capacitors in a row, whose far ends change by next to nothing at first, from 5 V at the beginning."""
    chain = rate * (np.eye(size, k=1) - 2 * np.eye(size) + np.eye(size, k=-1))
    chain[-1, -1] = -rate
    source = np.r_[5.0 * rate, np.zeros(size - 1)]
    system = saltus.HybridSystem(states={"m": [f"x{i}" for i in range(size)]},
                                 flow={"m": lambda t, x, u, p: chain @ x + source})
    motion = saltus.rollout(saltus.HybridProblem(system, mode="m", initial=np.zeros(size), duration=20 / rate))
    z = expm(np.block([[chain, source[:, None]], [np.zeros((1, size + 1))]]) * 20 / rate) @ np.r_[np.zeros(size), 1]
    assert_allclose(motion.final, z[:-1], rtol=1e-9)


def carts(**keys):
    """A pushed cart hits a second one, which drifts by a parameter; a third one is stopped at a given time."""
    flow = lambda t, x, u, p: [x[1], u[0], x[3], p[0], x[5], 0.3 * t + 0.1]
    hit = lambda x, p: [x[0], x[3], x[2], x[1], x[4], x[5]]
    system = saltus.HybridSystem(
        states={"m": ["x", "v", "y", "w", "z", "s"], "late": ["x", "v", "y", "w", "z", "s"]}, controls=["u"], parameters=["g"],
        flow={"m": flow, "late": flow},
        guards={"m": {"hit": lambda x: x[2] - x[0], "stop": lambda t: 0.6 - t}, "late": {"hit": lambda x: x[2] - x[0]}},
        resets={"m": {"hit": lambda x, p: ("m", hit(x, p)), "stop": lambda x: ("late", [x[0], x[1], x[2], x[3], x[4], 0.0])},
                "late": {"hit": lambda x, p: ("late", hit(x, p))}})
    return saltus.HybridProblem(system, **{**dict(
        mode="m", initial=[0, 0, 0.3, 0, 1, -0.2], parameters=[0.1], duration=1.0, control=np.full((8, 1), 2.0),
        costs=[saltus.terminal([0.1, 0.2, 0.9, 0.4, 0.7, 0.3]), saltus.effort(0.01)], optimize=["control", "g"]), **keys})


def test_parts_of_linear_modes_have_the_optimum_of_the_whole():
    """A shooting function takes all states together; the third cart has the state z'' = 0.3 t + 0.1 until it is stopped."""
    motion = saltus.rollout(carts())
    at_stop = [1 - 0.2 * 0.6 + 0.05 * 0.36 + 0.05 * 0.216, 0.0]
    final = [at_stop[0] + 0.05 * 0.4**2 + 0.15 * 0.6 * 0.4**2 + 0.05 * 0.4**3, 0.1 * 0.4 + 0.15 * (1 - 0.36)]
    assert np.allclose(motion.final[4:], final, rtol=0, atol=1e-12)
    divided, whole = saltus.solve(carts(), solver="ceres_phases"), saltus.solve(carts(), solver="ceres_lm")
    assert divided.termination == "converged" and divided.certificate.in_words.startswith("minimum")
    assert divided.loss <= whole.loss + 1e-9
    same_grid = carts(control=divided.control, parameters=divided.parameters, durations=divided.durations)
    assert len(saltus.rollout(same_grid).events) == 2
    assert abs(saltus.loss_and_gradient(same_grid).loss - divided.loss) < 1e-10
