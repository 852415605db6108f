"""usage: check_wheel.py SCENE [FOLDER]

Runs examples of the documentation with the module saltus that Python finds, which has to be in the folder if one is given. SCENE is
problems/two_balls.yaml.
"""

import sys

import saltus

if len(sys.argv) > 2:
    assert saltus.__file__.startswith(sys.argv[2]), saltus.__file__
scene = saltus.load_scene(sys.argv[1])
verdicts = dict(saltus.audit(scene, ["direct", "toi_velocity", "event"]).verdicts)
assert verdicts == {"direct": "wrong", "toi_velocity": "consistent", "event": "right"}, verdicts
run = saltus.solve(scene, "event", "ceres_event")
assert f"{run.exact_loss:.9f}" == "1.396542489", run.exact_loss

ball = saltus.HybridSystem(
    states={"flight": ["y", "v"]}, controls=["f"], parameters=["g", "e"],
    flow={"flight": lambda t, x, u, p: [x[1], -p[0] + u[0]]},
    guards={"flight": {"ground": lambda t, x, p: x[0]}},
    resets={"flight": {"ground": lambda t, x, p: ("flight", [x[0], -p[1] * x[1]])}})
problem = saltus.HybridProblem(ball, mode="flight", initial=[1.3, 0.4], parameters=[9.81, 0.8], duration=2.0)
times = [time for time, *_ in saltus.rollout(problem).events]
impact = (0.4 + (0.4**2 + 2 * 9.81 * 1.3) ** 0.5) / 9.81  # 1.3 + 0.4 t - 9.81 t^2 / 2 = 0
assert abs(times[0] - impact) < 1e-12, times

line = saltus.HybridSystem(states={"m": ["x", "v"]}, controls=["u"], flow={"m": lambda t, x, u, p: [x[1], u[0]]})
problem = saltus.HybridProblem(line, mode="m", initial=[1, 0], duration=3.0, control=[[0.0]] * 20)
problem.costs = [saltus.final_time(1), saltus.residuals(lambda x: [x[0], x[1]], role="equality")]
fastest = saltus.solve(problem, optimize=["control", "duration"], bounds={"u": (-1, 1), "duration": (0.5, 10)})
assert fastest.termination == "converged" and abs(fastest.duration - 2) < 1e-6, fastest.reason  # by IPOPT
print(verdicts, f"{run.exact_loss:.9f}", times)
