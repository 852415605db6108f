"""Calls every public function of the Python module with wrong shapes, NaN, infinity, zero, negative and huge values.

A call may return or raise an exception of Python; it must not end the interpreter. The calls run in child processes; a
child that a signal ends is reported with the call, and another one goes on with the next. Usage, with the module on
PYTHONPATH and the folder of scenes in SALTUS_SOURCE:

    python_calls.py --count=100000 [--seed=1] [--first=0] [--only=NAME]
"""

import argparse
import copy
import mmap
import os
import pathlib
import pickle
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import time

import numpy as np

import saltus

PROBLEMS = pathlib.Path(os.environ["SALTUS_SOURCE"]) / "problems"
EXPECTED = (ValueError, TypeError, RuntimeError, MemoryError, ArithmeticError, LookupError, AttributeError, OSError)
SECONDS = 2.0  # after which a call is asked to end
STALL = 30.0  # after which a child is ended
MEMORY = 6 << 30
NUMBERS = [np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 1e-300, 5e-324, 1e-9, 1e9, -1e9, 1e150, -1e150, 1e300, 1.7e308, -1.7e308]
WHOLE = [0, -1, 1, 2, 3, 7, 2**31 - 1, 2**31, -(2**31), 2**63, -(2**63), 2**70]
OTHERS = [None, "", "text", "auto", b"bytes", True, False, [], {}, (), [None], ["a"], {"a": 1}, object(), 1j, len, lambda *a: a[0],
          float, np.float32(2), np.int8(3), np.array([]), np.zeros((0, 3)), range(3), {1, 2}, Ellipsis, np.datetime64("2020")]


class Ended(BaseException):  # no call below catches it
    """The call has taken too long."""


def pick(rng, values):
    return values[int(rng.integers(len(values)))]


def hostile(rng, value):
    """A value in the place of `value`."""
    chance = rng.random()
    if isinstance(value, dict) and value and chance < 0.7:
        changed = dict(value)
        key = pick(rng, list(changed))
        if rng.random() < 0.15:
            del changed[key]
        else:
            changed[key] = hostile(rng, changed[key])
        return changed
    if isinstance(value, list) and value and chance < 0.6 and not isinstance(value[0], (int, float)):
        changed = list(value)
        i = int(rng.integers(len(changed)))
        changed[i] = hostile(rng, changed[i])
        return changed if rng.random() < 0.8 else changed * 2
    if isinstance(value, (np.ndarray, list, tuple)) and chance < 0.8:
        return hostile_array(rng, value)
    if isinstance(value, str) and chance < 0.5:
        return pick(rng, ["", "x", value + "x", value * 2, value[:-1], value.upper(), "\0", "é" * 5, value + ":", ":" + value, "1e999"])
    if isinstance(value, bool) or callable(value) or value is None:
        return pick(rng, OTHERS + NUMBERS)
    if isinstance(value, int) and chance < 0.7:
        return pick(rng, WHOLE)
    return pick(rng, NUMBERS if chance < 0.75 else OTHERS if chance < 0.95 else WHOLE)


def hostile_array(rng, value):
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        return pick(rng, OTHERS)
    kind = int(rng.integers(12))
    if kind == 0:
        return array.T if array.ndim > 1 else array[None]
    if kind == 1:
        return array.ravel()[: max(0, array.size - 1)]
    if kind == 2:
        return np.concatenate([array.ravel(), [1.0]])
    if kind == 3:
        return array[..., None]
    if kind == 4:
        return array.astype(pick(rng, [complex, object, str, bool, np.int32, np.float32, np.float16, np.int8]), copy=True)
    if kind == 5:
        return pick(rng, NUMBERS)
    if kind == 6:
        return np.full(array.shape, pick(rng, NUMBERS))
    if kind == 7:
        return array * pick(rng, NUMBERS)
    if kind == 8:
        return np.zeros(rng.integers(0, 4, size=int(rng.integers(0, 4))))
    if kind == 9:
        return (np.ones(array.shape + (2,)) * array[..., None])[..., 0]  # not contiguous
    if array.size:
        with np.errstate(all="ignore"):
            array.flat[int(rng.integers(array.size))] = pick(rng, NUMBERS)
    return array if kind != 10 else array.tolist()


def scene_of(name, **changes):
    return saltus.load_scene(PROBLEMS / f"{name}.yaml").replace(steps=8, **changes)


SCENES = [scene_of("two_balls"), scene_of("back_spin"), scene_of("ground_wall"), scene_of("bounce_once")]
MODELS = list(saltus.contact_models())
BALL = {
    "states": {"flight": ["y", "v"], "rest": ["y"]}, "controls": ["f"], "parameters": ["g", "e"],
    "flow": {"flight": lambda t, x, u, p: [x[1], u[0] - p[0]], "rest": lambda t, x, u, p: [0 * x[0]]},
    "guards": {"flight": {"ground": lambda t, x, p: x[0], "stop": lambda t, x, p: x[1] + 50}},
    "resets": {"flight": {"ground": lambda t, x, p: ("flight", [x[0], -p[1] * x[1]]), "stop": lambda t, x, p: ("rest", [x[0]])}},
}
SYSTEM = saltus.HybridSystem(**BALL)
FLAT = saltus.HybridSystem(
    states={"m": ["y", "v"]}, controls=["u"], parameters=["g"], flow={"m": lambda t, x, u, p: [x[1], u[0] - p[0]]})
PROBLEM = {
    "system": SYSTEM, "mode": "flight", "initial": [1.0, 0.3], "parameters": [9.8, 0.7], "duration": 0.8,
    "control": np.zeros((4, 1)), "costs": [saltus.terminal([1, 0], mode="flight"), saltus.effort(0.1)], "tolerance": 1e-8,
    "steps_per_interval": 0, "wait_behind_guards": False,
}
FLOWS = [
    lambda t, x, u, p: [x[1], u[0] / x[0]], lambda t, x, u, p: [np.sqrt(x[0]), 1 / u[0]], lambda t, x, u, p: [x[0] ** 3, np.exp(x[1])],
    lambda t, x, u, p: [np.log(x[1]), x[0] ** p[0]], lambda t, x, u, p: [1e300 * x[0], x[1]], lambda t, x, u, p: [x[1]],
    lambda t, x, u, p: [float("nan"), x[1]], lambda t, x, u, p: [saltus.where(x[0] > 0, 1, -1), x[1] / t], lambda: 1, lambda *a: a,
    lambda t, x, u, p: None, lambda t, x, u, p: x, lambda t, x, u, p: [u, x], lambda t, x, u, p: 1 / 0,
]
RESETS = [
    lambda t, x, p: ("flight", [x[0], x[1] / (x[0] - x[0])]), lambda t, x, p: ("rest", [x[0], x[1]]), lambda t, x, p: ("none", x),
    lambda t, x, p: ("flight", [x[0], x[1]]), lambda t, x, p: ("flight", [1e308 * x[1], 1e308]), lambda t, x, p: "flight",
    lambda t, x, p: ("flight", [x[0] - 1, x[1]]), lambda t, x, p: (1, 2, 3), lambda t, x, p: ("rest", [np.log(x[1])]),
]
SOLVERS, HYBRID_SOLVERS = list(saltus.solvers()), list(saltus.hybrid_solvers())


class Penalty(saltus.ContactModel):
    name = "penalty"

    def step(self, x, u, h):
        x[:, 2:4] += h * u
        x[:, :2] += h * x[:, 2:4]
        return x


def starts(scene):
    return {"position": scene.position, "velocity": scene.velocity, "angle": None, "angular_velocity": None}


def of_scene(rng, function):
    scene = pick(rng, SCENES)
    contact = pick(rng, MODELS) if rng.random() < 0.8 else Penalty
    options = {"control": None, **starts(scene), "precision": "double"}
    if scene.controlled and rng.random() < 0.5:
        options["control"] = np.ones((8, len(scene.controlled), 3 if scene.turned else 2))
    return function, {"scene": scene, "contact": contact, **options}


def of_simulation(rng):
    scene = pick(rng, SCENES)
    simulation = saltus.Simulation(scene, pick(rng, ["event", "direct_toi", "compliant_brax"]))
    z, size = simulation.initial_guess, 6 if scene.spins else 4
    state = simulation.rollout()["states"][0]
    method = pick(rng, ["loss", "loss_and_gradient", "residuals", "rollout", "step", "linearize"])
    arguments = {"z": z}
    if method in ("step", "linearize"):
        arguments = {"state": state, "force": np.ones((len(scene.controlled), 3 if scene.turned else 2))}
    if method == "loss_and_gradient":
        arguments["out"] = np.zeros(simulation.shape)
    if method == "rollout":
        arguments["out"] = np.zeros((9, len(scene.bodies), size))
    return getattr(simulation, method), arguments


def of_batch(rng):
    batch = saltus.Batch(pick(rng, SCENES), pick(rng, ["event", "direct_toi"]), threads=pick(rng, [1, 2]))
    points = np.ones((3, batch.num_variables))
    if rng.random() < 0.5:
        return batch.loss, {"points": points, "losses": np.zeros(3)}
    return batch.loss_and_gradient, {"points": points, "losses": np.zeros(3), "gradients": np.zeros(points.shape)}


def of_end_state(rng):
    end = saltus.EndState(pick(rng, SCENES), pick(rng, ["event", "direct_toi", Penalty]))
    arguments = {"initial": end.initial, "control": end.control}
    if rng.random() < 0.5:
        return end, arguments
    return end.vjp, {**arguments, "cotangent": end.initial}


def of_constructors(rng):
    kind = pick(rng, [saltus.Simulation, saltus.Batch, saltus.EndState])
    arguments = {"scene": pick(rng, SCENES), "contact": pick(rng, MODELS), "precision": "double"}
    if kind is saltus.Simulation:
        arguments["memory_limit"] = 10.0
    if kind is saltus.Batch:
        arguments["threads"] = 2
    return kind, arguments


def of_scene_data(rng):
    data = pick(rng, SCENES).to_dict()

    def use(data):
        scene = saltus.Scene(data)
        if scene.steps <= 1000:
            saltus.loss_and_gradient(scene, "event")

    return use, {"data": data}


def of_solve(rng):
    scene = pick(rng, SCENES)
    return saltus.solve, {
        "scene": scene, "contact": pick(rng, ["event", "direct_toi"]), "solver": pick(rng, SOLVERS), "iterations": 2,
        "learning_rate": 0.01, "sequence": "auto", "surrogate": None, "threads": 1, "memory_limit": 50.0, "callback": None}


def of_identify(rng):
    scene = SCENES[3]
    times = np.linspace(0, 0.9, 12)
    recording = {"time": times, "body": np.zeros(12, dtype=int), "position": np.stack([times, 1 - times], 1), "sigma": np.full(12, 0.01)}
    return saltus.identify, {
        "scene": scene, "recordings": recording, "unknown": "restitution", "contact": "event", "loss": "huber", "loss_scale": 2.0,
        "segment": 0.0, "known_start": False, "starts": 1, "threads": 1}


def simulate(scene, initial, control, dt):
    final = initial.copy()
    final[:, :2] += dt * len(control) * final[:, 2:4]
    return final


def of_audit(rng):
    scene = SCENES[0]
    if rng.random() < 0.5:
        return saltus.audit, {"scene": scene, "simulate": simulate, "gradient": None, "step": None, "name": "mine", "threads": 1}
    return saltus.audit, {"scene": scene, "contact": pick(rng, ["event", "direct"]), "threads": 1, "width_sweep": False}


def of_hybrid_system(rng):
    arguments = copy.copy(BALL)
    if rng.random() < 0.5:
        arguments["flow"] = {**BALL["flow"], "flight": pick(rng, FLOWS)}
    if rng.random() < 0.5:
        arguments["resets"] = {"flight": {**BALL["resets"]["flight"], "ground": pick(rng, RESETS)}}
    if rng.random() < 0.2:
        arguments["on_accumulation"] = {"flight": {"ground": "flight"}}

    def use(**given):
        system = saltus.HybridSystem(**given)
        problem = saltus.HybridProblem(**{**PROBLEM, "system": system})
        for function in (saltus.rollout, saltus.loss_and_gradient, saltus.final_derivatives):
            try:
                function(problem)
            except RuntimeError:
                pass
        pickle.loads(pickle.dumps(problem))

    return use, arguments


def of_hybrid_problem(rng):
    function = pick(rng, [saltus.rollout, saltus.loss_and_gradient, saltus.final_derivatives, copy.deepcopy])

    def use(**given):
        problem = saltus.HybridProblem(**{**given, "duration": 0.5, "steps_per_interval": 0})
        for name in given:
            setattr(problem, name, given[name])
        return function(problem)

    return (use if rng.random() < 0.5 else lambda **given: function(saltus.HybridProblem(**given))), dict(PROBLEM)


def of_hybrid_batch(rng):
    """Points of a batch, or what makes it; with one and with two threads, progress and given steps."""
    optimize, size = pick(rng, [(["control"], 4), (["y", "g"], 2), (["duration", "control", "initial", "parameters"], 9)])

    def use(points, optimize, threads, progress, with_gradient, **given):
        batch = saltus.HybridBatch(saltus.HybridProblem(**given), optimize=optimize, threads=threads, progress=progress)
        return batch.loss_and_gradient(points) if with_gradient else batch.loss(points)

    points = np.tile(np.array([0.1, 0.3, 9.8, 0.7, 0.1, 0.2, 0.3, 0.4, 0.8])[:size], (3, 1))
    given = {**PROBLEM, "steps_per_interval": pick(rng, [0, 10])}
    return use, {"points": points, "optimize": optimize, "threads": pick(rng, [1, 2]), "progress": False, "with_gradient": True, **given}


def of_hybrid_fit(rng):
    times = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])

    def use(times, values, sigma, durations, gravity, unknown, own, bounds, starts, **given):
        data = [saltus.measurements(times, values, ["y"], sigma=sigma)]
        problem = saltus.HybridProblem(**given, parameters=gravity, costs=data, durations=durations)
        fit = saltus.identify([problem, problem], parameters=unknown, own=own, bounds=bounds, starts=starts, threads=1)
        repr(fit)
        return [saltus.rollout(fitted) for fitted in fit.problems]

    return use, {"times": times, "values": 1 - 5 * times**2, "sigma": pick(rng, [None, 0.01]), "durations": np.diff([0, *times]),
                 "unknown": ["g"], "own": pick(rng, [[], ["v"], ["y", "v"]]), "bounds": pick(rng, [None, {"g": (1, 20)}]), "starts": 2,
                 "system": FLAT, "mode": "m", "initial": [1.0, 0.3], "gravity": [9.8], "control": np.zeros((6, 1))}


def of_hybrid_solve(rng):
    problem = saltus.HybridProblem(**PROBLEM)
    return saltus.solve, {
        "scene": problem, "solver": pick(rng, HYBRID_SOLVERS), "optimize": pick(rng, [["control"], ["y", "g"], ["duration", "control"]]),
        "bounds": pick(rng, [{}, {"control": (-1.0, 1.0)}, {"duration": (0.1, 2.0)}]), "iterations": 2, "learning_rate": 0.01}


def of_hybrid_audit(rng):
    problem = saltus.HybridProblem(**PROBLEM)

    def step(mode, x, u, p, h):
        return mode, [x[0] + h * x[1], x[1] - h * 9.8]

    return saltus.audit, {"scene": problem, "step": step, "jacobian": None, "steps": 10, "name": "mine"}


def of_costs(rng):
    make = pick(rng, [
        (saltus.terminal, {"target": [1.0, 0.0], "weight": 1.0, "mode": "flight"}), (saltus.effort, {"weight": 1.0}),
        (saltus.final_time, {"weight": 1.0}),
        (saltus.residuals, {"function": lambda x: [x[0] / x[1]], "at": "end", "role": "cost", "mode": "flight"}),
        (saltus.residuals, {"function": lambda x, u, h: [np.log(u[0]) * h], "at": "steps", "mode": "flight"}),
        (saltus.residuals, {"function": lambda x: [x[1]], "at": "event", "mode": "flight", "guard": "ground", "before": True}),
        (saltus.residuals, {"function": lambda x: [x[0] - 1], "role": "equality", "mode": "flight"}),
    ])

    def use(**given):
        problem = saltus.HybridProblem(**{**PROBLEM, "costs": [make[0](**given)]})
        saltus.loss_and_gradient(problem)
        saltus.solve(problem, solver=pick(rng, HYBRID_SOLVERS), iterations=2)

    return use, make[1]


def of_feedback(rng):
    name = pick(rng, ["track", "propagate", "noisy_runs"])
    if rng.random() < 0.6:
        problem, n, m = saltus.HybridProblem(**PROBLEM), 2, 1
    else:
        problem, n, m = SCENES[0], 8, 2
    if name == "track":
        return saltus.track, {"problem": problem, "Q": np.eye(n), "R": np.eye(m), "QT": np.eye(n),
                              "continuous": rng.random() < 0.3 and n == 2}
    regulator = None
    if rng.random() < 0.6:
        regulator = saltus.track(problem, np.eye(n), np.eye(m), np.eye(n))
    arguments = {"problem": problem, "initial": 0.01 * np.eye(n), "control": 0.01 * np.eye(m), "process": 0.01 * np.eye(n),
                 "measurement": 0.01 * np.eye(n), "gains": [] if regulator is None else regulator.gains}

    def use(gains, **given):
        changed = None if regulator is None else saltus.Regulator({**regulator, "gains": gains})
        return getattr(saltus, name)(regulator=changed, **given)

    if name == "noisy_runs":
        arguments |= {"samples": 5, "seed": 1, "threads": 1}
        if n == 8:
            arguments |= {"contact": "event", "plan": np.ones((8, 1, 2))}
    return use, arguments


def of_filter(rng):
    if rng.random() < 0.7:
        system = pick(rng, [SYSTEM, FLAT])
        given = {"system": system, "mean": [1.0, 0.3], "covariance": np.eye(2) * 0.01, "time": 0.0,
                 "parameters": [9.8, 0.7][: len(system.parameters)]}
        n, m = 2, 1
    else:
        given = {"system": SCENES[0], "mean": [-2, -2, 1, 1, -1, -1, 0, 0], "covariance": np.eye(8) * 0.01, "time": 0.0}
        n, m = 8, 2
    measured = {"z": [0.9], "C": np.eye(n)[:1], "V": [[1e-3]], "h": None}
    if rng.random() < 0.3:
        measured = {"z": [0.9, 0.1], "C": np.eye(n)[:2], "V": np.eye(2), "h": [1.0, 0.0]}

    def use(later, control, process, z, C, V, h, **given):
        estimate = saltus.SaltedKalmanFilter(**given)
        for call in (lambda: estimate.predict(later, control, process), lambda: estimate.update(z, C, V, h),
                     lambda: estimate.predict(2 * later, control)):
            try:
                call()
            except EXPECTED:
                pass
            if not (np.all(np.isfinite(estimate.mean)) and np.all(np.isfinite(estimate.covariance))):
                raise AssertionError("the estimate is not finite")
        pickle.loads(pickle.dumps(estimate))

    return use, {**given, "later": 0.2, "control": np.zeros(m), "process": np.eye(n) * 1e-4, **measured}


def of_results(rng):
    result = pick(rng, [saltus.rollout(SCENES[0]), saltus.loss_and_gradient(SCENES[0])])

    def use(path, data):
        if isinstance(path, int):  # a file that is open, such as standard output
            raise TypeError("path")
        if isinstance(path, (str, bytes)):
            name = os.path.basename(os.fsdecode(path))
            path = os.path.join(tempfile.gettempdir(), f"saltus_fuzz_{os.getpid()}_{name}")
        type(result)(data).save(path)
        saltus.load_result(path)
        os.remove(path)

    return use, {"path": "result.json", "data": result.to_dict()}


def of_where(rng):
    return saltus.where, {"condition": np.array([True, False]), "a": [1.0, 2.0], "b": 3.0}


ENTRIES = {
    "rollout": (6, lambda rng: of_scene(rng, saltus.rollout)),
    "loss_and_gradient": (6, lambda rng: of_scene(rng, saltus.loss_and_gradient)),
    "linearize": (3, lambda rng: of_scene(rng, saltus.linearize)),
    "simulation": (10, of_simulation), "batch": (6, of_batch), "end_state": (6, of_end_state), "constructors": (3, of_constructors),
    "scene": (8, of_scene_data), "solve": (3, of_solve), "identify": (2, of_identify), "audit": (0.2, of_audit),
    "hybrid_system": (10, of_hybrid_system), "hybrid_problem": (14, of_hybrid_problem), "hybrid_solve": (4, of_hybrid_solve),
    "hybrid_batch": (8, of_hybrid_batch), "hybrid_fit": (1, of_hybrid_fit), "hybrid_audit": (1, of_hybrid_audit), "costs": (5, of_costs), "feedback": (14, of_feedback), "filter": (14, of_filter),
    "results": (1, of_results), "where": (1, of_where),
}


def make_call(seed, number, only):
    rng = np.random.default_rng([seed, number])
    names = [name for name in ENTRIES if not only or name == only]
    weights = np.array([ENTRIES[name][0] for name in names], dtype=float)
    name = names[int(rng.choice(len(names), p=weights / weights.sum()))]
    function, arguments = ENTRIES[name][1](rng)
    for key in rng.choice(list(arguments), size=min(len(arguments), pick(rng, [1, 1, 1, 2, 3])), replace=False):
        arguments[str(key)] = hostile(rng, arguments[str(key)])
    return name, function, arguments


def end_call(number, frame):
    raise Ended


def run_child(options):
    """Makes the calls from `first` on; writes the number of each into the file before it begins."""
    if "libasan" not in os.environ.get("LD_PRELOAD", "") and "libtsan" not in os.environ.get("LD_PRELOAD", ""):
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.signal(signal.SIGALRM, end_call)
    np.seterr(all="ignore")
    with open(options.place, "r+b") as file:
        place = mmap.mmap(file.fileno(), 32)
    counts = {"returned": 0, "raised": 0, "too long": 0}
    for number in range(options.first, options.first + options.count):
        place[:8] = struct.pack("q", number)
        outcome = "too long"
        try:
            signal.setitimer(signal.ITIMER_REAL, SECONDS)
            name, function, arguments = make_call(options.seed, number, options.only)
            if options.verbose:
                print(number, name, arguments, file=sys.stderr, flush=True)
            function(**arguments)
            outcome = "returned"
        except Ended:
            pass
        except EXPECTED:
            outcome = "raised"
        except Exception as error:  # pylint: disable=broad-exception-caught
            print(f"unexpected: call {number} ({name}): {type(error).__name__}: {error}", flush=True)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
        counts[outcome] += 1
        place[8:32] = struct.pack("3q", *counts.values())


def start_child(options, first, count, place):
    command = [sys.executable, "-W", "ignore", __file__, "--child", f"--seed={options.seed}", f"--first={first}", f"--count={count}",
               f"--place={place}", f"--only={options.only}"]
    return subprocess.Popen(command + (["--verbose"] if options.verbose else []))


def run(options):
    """Returns the numbers of calls that a signal has ended."""
    ended, totals, stalled = [], np.zeros(3, dtype=int), []
    number, last = options.first, options.first + options.count
    with tempfile.NamedTemporaryFile() as file:
        while number < last:
            file.seek(0)
            file.write(struct.pack("4q", number, 0, 0, 0))
            file.flush()
            child = start_child(options, number, min(options.batch, last - number), file.name)
            at, since = (number, 0, 0, 0), time.monotonic()
            while child.poll() is None:
                time.sleep(0.05)
                file.seek(0)
                now = struct.unpack("4q", file.read(32))
                if now != at:
                    at, since = now, time.monotonic()
                elif time.monotonic() - since > STALL:
                    child.kill()
                    child.wait()
            file.seek(0)
            at = struct.unpack("4q", file.read(32))
            totals += at[1:]
            if child.returncode == 0:
                number += min(options.batch, last - number)
                continue
            name = make_call(options.seed, at[0], options.only)[0]
            if child.returncode == -signal.SIGKILL:
                stalled.append(at[0])
                print(f"no end within {STALL:g} s: call {at[0]} ({name})", flush=True)
            else:
                ended.append(at[0])
                print(f"ended by {child.returncode}: call {at[0]} ({name})", flush=True)
            number = at[0] + 1
    returned, raised, late = totals
    print(f"{options.count} calls, seed {options.seed}: {returned} returned, {raised} raised, {late} ended after {SECONDS:g} s, "
          f"{len(stalled)} did not end, {len(ended)} ended the interpreter")
    return ended


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--batch", type=int, default=2000, help="calls of one child")
    parser.add_argument("--only", default="", help=f"one of {', '.join(ENTRIES)}")
    parser.add_argument("--verbose", action="store_true", help="print every call before it is made")
    parser.add_argument("--child", action="store_true")
    parser.add_argument("--place")
    options = parser.parse_args()
    if options.child:
        run_child(options)
        return 0
    return 1 if run(options) else 0


if __name__ == "__main__":
    sys.exit(main())
