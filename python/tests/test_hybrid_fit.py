"""Parameters of hybrid systems from data: intervals, what data leave open, outliers, contradictions, several experiments."""

import json
import math
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose

import saltus

G, E, SIGMA = 9.6, 0.72, 2e-3


def ball_system():
    return saltus.HybridSystem(
        states={"flight": ["y", "v"]}, parameters=["g", "e"], flow={"flight": lambda x, p: [x[1], -p[0]]},
        guards={"flight": {"ground": lambda x: x[0]}},
        resets={"flight": {"ground": lambda x, p: ("flight", [x[0], -p[1] * x[1]])}})


def height(t, e=E, g=G, y0=1.0):
    """The closed form of a ball that falls from rest."""
    y, v = y0, 0.0
    while True:
        fall = (v + math.sqrt(v * v + 2 * g * y)) / g
        if fall > t:
            return y + v * t - g * t * t / 2
        t, v, y = t - fall, -e * (v - g * fall), 0.0


def bounces(count, e=E, g=G, y0=1.0):
    first = math.sqrt(2 * y0 / g)
    return [first + sum(2 * first * e**k for k in range(1, n + 1)) for n in range(count)]


def experiment(times, values, sigma=SIGMA, y0=1.0, states=("y",), **changes):
    """A ball with heights, or other data, at given times."""
    durations = np.diff([0.0, *times, max(times) + 0.1])
    given = {"mode": "flight", "initial": [y0, 0.0], "parameters": [9.0, 0.8], "durations": durations,
             "control": np.zeros((len(durations), 0)), "costs": [saltus.measurements(times, values, states, sigma=sigma)], **changes}
    return saltus.HybridProblem(given.pop("system", None) or ball_system(), **given)


def noisy(times, seed, **motion):
    noise = SIGMA * np.random.default_rng(seed).normal(size=len(times))
    return np.array([height(t, **motion) for t in times]) + noise


TIMES = np.linspace(0.05, 1.4, 24)


def of(fit, name):
    return next(item for item in fit.parameters if item["name"] == name)


def test_the_standard_errors_are_those_of_least_squares():
    fit = saltus.identify(experiment(TIMES, noisy(TIMES, 4)), parameters=["e", "g"], bounds={"e": (0, 1)}, loss="none")
    assert fit.verdict == "fits" and fit.system == "hybrid system" and fit.samples == 24 and fit.events == 2

    def column(**step):
        (name, width), = step.items()
        at = {"e": E, "g": G}
        ends = [[height(t, **{**at, name: at[name] + sign * width}) for t in TIMES] for sign in (-1, 1)]
        return np.subtract(ends[1], ends[0]) / (2 * width)

    jacobian = np.column_stack([column(e=1e-6), column(g=1e-6)])
    errors = SIGMA * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    for name, truth, error in zip(("e", "g"), (E, G), errors):
        found = of(fit, name)
        assert abs(found["value"] - truth) < 3 * error
        assert 0.7 * error < found["standard_error"] < 1.4 * error  # the scatter counts beside the stated sigma
        low, high = found["interval"]
        assert low < truth < high and 3.8 * found["standard_error"] < high - low < 4.3 * found["standard_error"]


def test_experiments_have_common_and_own_unknowns():
    heights = (1.0, 1.3)
    problems = [experiment(TIMES, noisy(TIMES, seed, y0=y0), y0=1.1) for seed, y0 in enumerate(heights)]
    fit = saltus.identify(problems, parameters=["e", "g"], own=["y"])
    assert fit.verdict == "fits" and list(fit.estimates) == ["e", "g", "y[0]", "y[1]"]
    for name, truth in {"e": E, "g": G, "y[0]": heights[0], "y[1]": heights[1]}.items():
        assert abs(of(fit, name)["value"] - truth) < 4 * of(fit, name)["standard_error"] < 0.1
    for problem, y0, given in zip(fit.problems, heights, problems):
        assert_allclose(problem.parameters, [fit.estimates["g"], fit.estimates["e"]])
        assert abs(problem.initial[0] - y0) < 0.01 and problem.initial[1] == 0
        assert saltus.loss_and_gradient(problem).loss < 60 < saltus.loss_and_gradient(given).loss
    alone = saltus.identify(problems[0], parameters="e,g".split(","), own=["y"])
    assert of(fit, "e")["standard_error"] < of(alone, "e")["standard_error"] and "y" in alone.estimates


def test_without_sigma_the_scatter_is_estimated():
    fit = saltus.identify(experiment(TIMES, noisy(TIMES, 5), sigma=None), parameters=["e", "g"])
    assert fit.verdict == "fits" and 0.6 * SIGMA < fit.sigma["y"] < 1.6 * SIGMA
    assert any("sigma was estimated" in remark and "of y" in remark for remark in fit.remarks)
    stated = saltus.identify(experiment(TIMES, noisy(TIMES, 5)), parameters=["e", "g"])
    assert "sigma" not in stated and abs(stated.estimates["g"] - fit.estimates["g"]) < of(fit, "g")["standard_error"]


def test_measured_functions_are_named():
    def seen(x):
        return [2 * x[0], x[0] ** 2]

    heights = noisy(TIMES, 18)
    values = np.column_stack([2 * heights, heights**2 + 1e-3 * np.cos(70 * TIMES)])
    fit = saltus.identify(experiment(TIMES, values, sigma=None, states=seen), parameters=["e", "g"])
    assert list(fit.sigma) == ["seen 1", "seen 2"] and fit.samples == 48
    assert abs(of(fit, "g")["value"] - G) < 4 * of(fit, "g")["standard_error"]


def test_event_times_alone_and_values_that_are_missing():
    seen = np.array(bounces(5)) + 1e-4 * np.array([1, -1, 1, -1, 1])
    seen[2] = np.nan
    problem = saltus.HybridProblem(ball_system(), mode="flight", initial=[1.0, 0.0], parameters=[9.3, E], duration=2.35,
                                   costs=[saltus.event_times("ground", seen, sigma=1e-4)])
    fit = saltus.identify(problem, parameters=["g"])
    assert fit.samples == 4 and "3 degrees of freedom remain" in fit.reason
    seen = np.array(bounces(8)) + 1e-4 * np.random.default_rng(0).normal(size=8)
    problem.costs, problem.duration, problem.parameters = [saltus.event_times("ground", seen, sigma=1e-4)], 2.6, [9.0, 0.8]
    fit = saltus.identify(problem, parameters=["g", "e"], bounds={"e": (0, 1)})
    assert fit.verdict == "fits" and fit.samples == 8, fit.reason
    for name, truth in (("g", G), ("e", E)):
        assert abs(of(fit, name)["value"] - truth) < 4 * of(fit, name)["standard_error"] < 0.01


def test_heights_and_event_times_together():
    """Fits begin with the first part of all data, in the order of time: of the event times that stand behind the heights, too."""
    seen = np.array(bounces(3)) + 1e-3 * np.array([0.5, -1, 1])
    problem = experiment(TIMES, noisy(TIMES, 16))
    problem.costs = [*problem.costs, saltus.event_times("ground", seen[:2], sigma=1e-3)]
    fit = saltus.identify(problem, parameters=["e", "g"], bounds={"e": (0, 1)})
    assert fit.verdict == "fits" and fit.samples == 26 and not fit.outliers, fit.reason
    for name, truth in (("g", G), ("e", E)):
        assert abs(of(fit, name)["value"] - truth) < 4 * of(fit, name)["standard_error"]
    seen[1] += 0.05
    problem.costs = [problem.costs[0], saltus.event_times("ground", seen[:2], sigma=1e-3)]
    fit = saltus.identify(problem, parameters=["e", "g"], bounds={"e": (0, 1)})
    assert [(one["quantity"], one["time"]) for one in fit.outliers] == [("times of 'ground'", seen[1])]


def test_a_guess_whose_motion_has_fewer_events_than_the_data():
    """It bounces twice in the time of six bounces; the first part of the data, in the order of time, leads on."""
    problem = experiment(TIMES, noisy(TIMES, 17), parameters=[4.0, E])
    problem.durations, problem.duration = np.append(np.diff([0, *TIMES]), 2.35 - TIMES[-1]), 2.35
    problem.costs = [saltus.event_times("ground", bounces(6), sigma=1e-3), *problem.costs]
    fit = saltus.identify(problem, parameters=["g", "e"], bounds={"e": (0, 1)}, starts=1)
    assert fit.verdict == "fits" and fit.events == 6 and fit.samples == 30, fit.reason
    for name, truth in (("g", G), ("e", E)):
        assert abs(of(fit, name)["value"] - truth) < 4 * of(fit, name)["standard_error"]


def test_times_of_data_are_anywhere():
    """Without durations, intervals begin at the times of the data."""
    heights = noisy(TIMES, 4)
    fits = [saltus.identify(problem, parameters=["e", "g"], bounds={"e": (0, 1)}, loss="none")
            for problem in (experiment(TIMES, heights), experiment(TIMES, heights, durations=None, duration=1.5, control=None))]
    for name in ("e", "g"):
        assert_allclose(of(fits[1], name)["value"], of(fits[0], name)["value"], rtol=1e-9)


def test_what_data_leave_open():
    times = np.linspace(0.02, 0.4, 16)  # before the first bounce
    fit = saltus.identify(experiment(times, noisy(times, 6)), parameters=["e", "g"], bounds={"e": (0, 1)})
    assert of(fit, "e")["determination"] == "not determined" and of(fit, "g")["determination"] == "determined"
    assert math.isnan(fit.estimates["e"]) and fit.problems[0].parameters[1] == 0.8
    product = saltus.HybridSystem(states={"m": ["x"]}, parameters=["a", "b"], flow={"m": lambda x, p: [-p[0] * p[1] * x[0]]})
    times = np.linspace(0.1, 2, 12)
    data = saltus.measurements(times, np.exp(-0.6 * times) + 1e-3 * (-1) ** np.arange(12), ["x"], sigma=1e-3)
    problem = saltus.HybridProblem(product, mode="m", initial=[1.0], parameters=[1.0, 1.0], control=np.zeros((12, 0)),
                                   durations=np.diff([0, *times]), costs=[data])
    fit = saltus.identify(problem, parameters=["a", "b"])
    assert fit.verdict == "not determined"
    assert of(fit, "a")["determination"] == "only in combination" and of(fit, "a")["with"] == ["b"]


def test_outliers_are_named():
    values = noisy(TIMES, 7)
    values[[3, 15]] += [0.08, -0.05]
    fit = saltus.identify(experiment(TIMES, values), parameters=["e", "g"])
    assert fit.verdict == "fits"
    named = [(one["experiment"], one["quantity"], one["time"]) for one in fit.outliers]
    assert named == [("problem 0", "y", TIMES[3]), ("problem 0", "y", TIMES[15])]
    for name, truth in (("g", G), ("e", E)):
        assert abs(of(fit, name)["value"] - truth) < 4 * of(fit, name)["standard_error"]


@pytest.mark.parametrize("sigma", [SIGMA, None])
def test_data_that_contradict_the_model(sigma):
    values = noisy(TIMES, 8) + 0.1 * np.sin(9 * TIMES)
    fit = saltus.identify(experiment(TIMES, values, sigma=sigma), parameters=["e", "g"])
    assert fit.verdict == "contradicted" and "the flow, guards and resets of the system" in fit.reason, fit.reason


def test_a_parameter_at_its_bound():
    values = noisy(TIMES, 9, e=1.0)
    fit = saltus.identify(experiment(TIMES, values), parameters=["e", "g"], bounds={"e": (0.1, 0.9)})
    assert of(fit, "e")["determination"] == "at its bound" and of(fit, "e")["value"] == 0.9
    assert of(fit, "e")["standard_error"] is None


def test_too_few_samples_are_not_judged():
    times = TIMES[[2, 12, 20]]
    fit = saltus.identify(experiment(times, noisy(times, 10)), parameters=["e", "g"])
    assert fit.verdict == "not judged" and fit.reason.startswith("too few samples to judge")
    assert all(math.isnan(value) for value in fit.estimates.values())


def test_restitution_and_friction_of_a_mechanical_system():
    def puck(**data):
        system = saltus.MechanicalSystem(
            coordinates=["x", "y"], parameters=["e", "mu"], mass=lambda q: [[1, 0], [0, 1]], force=lambda q: [0, -9.81],
            contacts={"floor": saltus.Contact(gap=lambda q: q[1], slide=lambda q: q[0], restitution="e", friction="mu")})
        return saltus.HybridProblem(system, initial=[0, 0.5, 2, 0], parameters=[0.9, 0.05], **data)

    times = np.linspace(0.05, 1.2, 24)
    durations = np.diff([0, *times])
    truth = puck(durations=durations, control=np.zeros((24, 0)))
    truth.parameters = [0.6, 0.2]
    motion = saltus.rollout(truth)
    at = [np.flatnonzero(np.abs(motion.times - t) < 1e-12)[-1] for t in times]
    noise = 1e-3 * np.random.default_rng(1).normal(size=(24, 2))
    values = np.array([motion.states[i][:2] for i in at]) + noise
    data = saltus.measurements(times, values, ["x", "y"], sigma=1e-3)
    fit = saltus.identify(puck(durations=durations, control=np.zeros((24, 0)), costs=[data]), parameters=["e", "mu"])
    assert fit.verdict == "fits" and fit.system == "mechanical system" and fit.samples == 48, fit.reason
    for name, value in (("e", 0.6), ("mu", 0.2)):
        found = of(fit, name)
        assert abs(found["value"] - value) < 4 * found["standard_error"] < 0.05
        assert found["interval"][0] >= 0  # by what a restitution and a friction are


def test_a_pickled_problem_has_its_data():
    problem = experiment(TIMES, noisy(TIMES, 11))
    copied = pickle.loads(pickle.dumps(problem))
    assert saltus.identify(copied, parameters=["g"]).estimates == saltus.identify(problem, parameters=["g"]).estimates


def test_the_page_of_a_fit(tmp_path):
    values = noisy(TIMES, 12)
    values[5] += 0.1
    fit = saltus.identify(experiment(TIMES, values), parameters=["e", "g"])
    fit.save_page(tmp_path)
    page = (tmp_path / "report.html").read_text()
    for words in ("hybrid system", "measured", "Outliers", '"label":"y"'):
        assert words in page, words
    assert json.loads((tmp_path / "result.json").read_text())["parameters"][0]["name"] == "e"
    assert "hybrid system" in repr(fit)


def test_exceptions_of_the_callback_have_the_fit():
    def stop(text):
        raise KeyError(text)

    with pytest.raises(KeyError) as error:
        saltus.identify(experiment(TIMES, noisy(TIMES, 13)), parameters=["e", "g"], status=stop)
    assert error.value.fit.verdict == "interrupted"


@pytest.mark.parametrize("arguments, options, kind, message", [
    ((lambda p: p,), {}, ValueError, "parameters: found none, expected some of g, e, y, v, or own="),
    ((lambda p: p,), {"parameters": ["mu"]}, ValueError, "parameters: found 'mu', expected some of g, e, y, v"),
    ((lambda p: p,), {"parameters": ["e"], "own": ["e"]}, ValueError, "own: found 'e' twice"),
    ((lambda p: p,), {"parameters": 3}, TypeError, "parameters: found int, expected text"),
    ((lambda p: p,), {"parameters": ["e"], "bounds": {"e": (0.9, 1)}}, ValueError, "e: found the start 0.8 with the bounds 0.9 and 1"),
    ((lambda p: p,), {"parameters": ["e"], "bounds": {"g": (9, 10)}}, ValueError, "bounds: found 'g', expected some of .*: e"),
    ((lambda p: p,), {"parameters": ["e"], "segment": 1.0}, ValueError, "segment: found 1.0, expected none"),
    ((lambda p: p, ["a.csv"]), {"parameters": ["e"]}, ValueError, "recordings: found list, expected none"),
    ((lambda p: [p, 3],), {"parameters": ["e"]}, TypeError, "found int as problem 1, expected a HybridProblem"),
    ((lambda p: p,), {"parameters": ["e"], "loss": "square"}, ValueError, "loss: found 'square', expected none, huber or cauchy"),
])
def test_wrong_requests_are_refused(arguments, options, kind, message):
    given, *rest = arguments
    with pytest.raises(kind, match=message):
        saltus.identify(given(experiment(TIMES, noisy(TIMES, 14))), *rest, **options)


def test_problems_without_data_alone_are_refused():
    problem = experiment(TIMES, noisy(TIMES, 15))
    with pytest.raises(ValueError, match="problem 1: found the term 'effort' among its costs, expected data alone"):
        other = experiment(TIMES, noisy(TIMES, 15))
        other.costs = [*other.costs, saltus.effort()]
        saltus.identify([problem, other], parameters=["e"])
    other.costs = []
    with pytest.raises(ValueError, match="problem 0: found no data among its costs"):
        saltus.identify(other, parameters=["e"])
    without = experiment(TIMES, noisy(TIMES, 15), sigma=None)
    with pytest.raises(ValueError, match="problem 1: found sigma of some numbers only, expected it of all or of none"):
        saltus.identify([problem, without], parameters=["e"])
    with pytest.raises(ValueError, match="parameters, own and bounds: found some with a scene"):
        saltus.identify("scene.yaml", "a.csv", parameters=["e"])
    with pytest.raises(TypeError, match="recordings: found none"):
        saltus.identify("scene.yaml")


@pytest.mark.parametrize("solver", ["ceres_phases", "auto"])
def test_a_control_that_is_not_free_stays_as_it_is(solver):
    ball = saltus.HybridSystem(
        states={"flight": ["y", "v"]}, controls=["u"], parameters=["g", "e", "d"],
        flow={"flight": lambda x, u, p: [x[1], -p[0] - p[2] * x[1] + u[0]]},
        guards={"flight": {"ground": lambda x: x[0]}}, resets={"flight": {"ground": lambda x, p: ("flight", [0, -p[1] * x[1]])}})

    def motion(parameters, duration, intervals, costs=()):
        return saltus.HybridProblem(ball, mode="flight", initial=[1, 0], parameters=parameters, duration=duration,
                                    control=np.zeros((intervals, 1)), costs=list(costs))

    times = np.arange(1, 21) / 10
    heights = [saltus.rollout(motion([9.7, 0.75, 0.1], time, 1)).final[0] for time in times]
    heights += 0.005 * np.random.default_rng(0).normal(size=20)
    data = saltus.measurements(list(times), list(heights), ["y"], sigma=0.005)
    run = saltus.solve(motion([9.81, 0.8, 0.1], 2, 20, [data]), solver=solver, optimize=["g", "e", "d"])
    assert not run.control.any()
    fitted = motion(run.parameters, 2, 20, [data])
    assert saltus.loss_and_gradient(fitted).loss == pytest.approx(run.loss, rel=1e-9)
