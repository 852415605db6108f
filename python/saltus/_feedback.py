"""Feedback and uncertainty along a motion of a hybrid problem or of a scene."""

from __future__ import annotations

from typing import Any, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from . import _saltus
from ._hybrid import HybridProblem, HybridRun, HybridSystem, System
from ._own import as_contact
from ._progress import Progress
from ._results import Result, Run
from ._scene import SceneLike, as_scene, of_run
from ._types import expect, expect_int, expect_none_of, Floats, Remade


class Regulator(Result):
    """Feedback about a motion, du = -K dx: ``gains``, ``cost_to_go`` (one more) and ``closed_loop``, a list of matrices for
    each control interval; ``events`` of a regulator in continuous time, with ``time``, ``saltation``, ``gain_before``,
    ``gain_after``, ``cost_before`` and ``cost_after``. ``remark`` as of a rollout."""

    _kind = "regulator"


class Covariance(Result):
    """``covariances`` of the state at the beginning of each control interval and at the end; ``event_times``, the standard
    deviations of the times of the events; ``risks``, a list of (what, time, probability) of changes of the sequence of
    events, and ``change_probability``, a bound on their sum; ``warning``, empty if that is below 0.01."""

    _kind = "covariance"


class NoisyRuns(Result):
    """Of simulated runs with noise: ``mean`` and ``covariance`` of the final state, ``final_error``, the root mean square of
    its difference from the plan, and the numbers of runs that are ``counted`` in these, have ``failed``, or went
    ``otherwise`` than planned: with other events. ``remark`` as of a rollout of the plan, and why there are fewer runs than samples or
    no covariance, which then is NaN."""

    _kind = "noisy runs"


def _matrix(name: str, value: ArrayLike | None) -> Any:
    if value is None:
        return np.zeros((0, 0))
    matrix = np.asarray(value, dtype=float)
    if matrix.ndim != 2:
        raise ValueError(f"{name}: found shape {matrix.shape}, expected a matrix")
    return matrix


def _covariances(**given: ArrayLike | None) -> list[Any]:
    return [_matrix(name, value) for name, value in given.items()]


def _along(problem: HybridProblem, plan: Any, durations: ArrayLike | None) -> HybridProblem:
    """The problem whose motion is followed: that of a run, if one is given."""
    if durations is not None:
        raise ValueError("durations: found some for a HybridProblem, which has its own")
    if plan is None:
        return problem
    if not isinstance(plan, HybridRun):
        raise ValueError("plan: found no run for a HybridProblem, which has its control; expected a run or none")
    return problem._from(plan)


def _planned(
    problem: HybridProblem | SceneLike, plan: Any, durations: ArrayLike | None, contact: Any = "event"
) -> Any:
    if isinstance(problem, HybridProblem):
        expect_none_of(_planned, contact=contact)
        return _along(problem, plan, durations)._call("planned")
    scene: Any = as_scene(problem)
    if isinstance(plan, Mapping):
        if durations is not None:
            raise ValueError("durations: found some with a run, which has its own")
        scene, plan, durations = of_run(scene, plan)
    elif durations is None:
        durations = getattr(plan, "durations", None)
    plain = None if plan is None else np.asarray(plan)
    return _saltus.PlannedMotion(scene, plain, durations, as_contact(contact))


def _gains(regulator: Regulator | None) -> Any:
    if regulator is not None and not isinstance(regulator, Regulator):
        raise TypeError(f"regulator: found {type(regulator).__name__}, expected a Regulator, as track returns it, or None")
    if regulator is not None and regulator.events:
        raise ValueError("regulator: found one in continuous time, expected one with du constant in each interval")
    return [] if regulator is None else regulator.gains


def track(
    problem: HybridProblem | SceneLike,
    Q: ArrayLike | Mapping[str, ArrayLike],
    R: ArrayLike,
    QT: ArrayLike,
    *,
    plan: Run | HybridRun | ArrayLike | None = None,
    durations: ArrayLike | None = None,
    continuous: bool = False,
) -> Regulator:
    """The linear-quadratic regulator with jumps about the motion of a hybrid problem, or about the exact motion of a scene,
    whose gains pass events by saltation matrices.

    Minimises the sum over the control intervals of dx' Q dx + du' R du, plus dx' QT dx at the end, with du constant in
    each interval; or with ``continuous``, the integral, with du continuous in time, of a hybrid problem. ``Q``: a matrix,
    or one for each mode by name. The state dx is that at the beginning of the interval; in a scene, the state of all
    discs in one row. In du, a torque is divided by the radius of its disc and stands after all forces.

    ``plan``: a run of ``solve``, whose initial state, control, intervals and duration are followed; or the control of a
    scene, (K, C, 2) or (K, C, 3), on K = steps equal intervals or on intervals that last ``durations``, (K,) in s; None: that
    of the scene or of the problem.
    """
    if isinstance(Q, Mapping):
        if not isinstance(problem, HybridProblem):
            raise ValueError("Q: a scene has no modes, expected one matrix")
        system = problem.system
        if not isinstance(system, HybridSystem):
            raise ValueError("Q: the modes of a mechanical system have one state, expected one matrix")
        if set(Q) != set(system.modes):
            raise ValueError(f"Q: expected a matrix for each of the modes {', '.join(system.modes)}")
        weights = [_matrix(f"Q of mode {mode!r}", Q[mode]) for mode in system.modes]
    else:
        weights = [_matrix("Q", Q)]
    if not continuous:
        gains, cost, closed, events, remark = _planned(problem, plan, durations).track(weights, _matrix("R", R), _matrix("QT", QT))
    elif isinstance(problem, HybridProblem):
        gains, cost, closed, events, remark = _along(problem, plan, durations)._call(
            "track_continuously", weights, _matrix("R", R), _matrix("QT", QT)
        )
    else:
        raise ValueError("continuous: expected a HybridProblem")
    names = ("time", "saltation", "gain_before", "gain_after", "cost_before", "cost_after")
    return Regulator({
        "gains": gains, "cost_to_go": cost, "closed_loop": closed,
        "events": [Result(dict(zip(names, event))) for event in events], "remark": remark,
    })


def propagate(
    problem: HybridProblem | SceneLike,
    initial: ArrayLike | None = None,
    *,
    control: ArrayLike | None = None,
    process: ArrayLike | None = None,
    measurement: ArrayLike | None = None,
    regulator: Regulator | None = None,
    plan: Run | HybridRun | ArrayLike | None = None,
    durations: ArrayLike | None = None,
) -> Covariance:
    """The covariance of the error of a motion, to first order through its events, in open loop or with a regulator whose
    du is constant in each interval.

    Covariance matrices: of the ``initial`` state; of the ``control`` in each interval; of the ``process``, added to the
    state at the end of each interval; of the ``measurement`` of the state at its beginning. None: no error. ``plan`` and
    ``durations`` as in track.
    """
    matrices = _covariances(initial=initial, control=control, process=process, measurement=measurement)
    nodes, times, risks, probability, warning, remark = _planned(problem, plan, durations).propagate(matrices, _gains(regulator))
    return Covariance({
        "covariances": nodes, "event_times": np.array(times), "risks": risks, "change_probability": probability,
        "warning": warning, "remark": remark,
    })


def noisy_runs(
    problem: HybridProblem | SceneLike,
    initial: ArrayLike | None = None,
    *,
    control: ArrayLike | None = None,
    process: ArrayLike | None = None,
    measurement: ArrayLike | None = None,
    regulator: Regulator | None = None,
    plan: Run | HybridRun | ArrayLike | None = None,
    durations: ArrayLike | None = None,
    contact: Any = "event",
    samples: int = 1000,
    seed: int = 1,
    threads: int = 0,
    seconds: float = 0,
    progress: bool | None = None,
) -> NoisyRuns:
    """Simulates a plan with noise, in open loop or with a regulator, which compares states with equally many events behind
    them (reference spreading).

    Covariance matrices, ``regulator``, ``plan`` and ``durations`` as in propagate. ``contact``: the contact model of a scene. ``threads``:
    0 is one for each core; results do not depend on it. ``seconds``: limit of time, s, after which the result is of the runs until
    then, as its remark states; 0 is no limit. ``progress``: whether a line on stderr shows the progress after two seconds; default:
    on terminals and in notebooks.
    """
    expect_int(samples=samples, threads=threads)
    expect("a whole number", seed=seed)
    expect("a number", seconds=seconds)
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed: found {seed}, expected a whole number from 0 to {2**64 - 1}")
    matrices = _covariances(initial=initial, control=control, process=process, measurement=measurement)
    with Progress("noisy runs", progress):
        mean, covariance, planned, counted, failed, otherwise, remarks = _planned(problem, plan, durations, contact).noisy_runs(
            matrices, _gains(regulator), samples, seed, threads, float(seconds)
        )
    error = float(np.sqrt(np.trace(covariance) + np.sum((mean - planned) ** 2)))
    return NoisyRuns({
        "mean": mean, "covariance": covariance, "final_error": error, "counted": counted, "failed": failed,
        "otherwise": otherwise, "remark": "; ".join(remarks),
    })


class SaltedKalmanFilter(Remade):
    """An extended Kalman filter whose mean flows through the events of a hybrid or mechanical system or of a scene, and whose
    covariance passes them by saltation matrices.

    The estimate may be in another mode than the truth: see docs/how-to/feedback.md.

    Args:
        system: a HybridSystem, or a MechanicalSystem, whose state is [q v]; or a Scene, a dict or the path of a scene file,
            whose state is that of all discs in one row.
        mean, covariance: the estimate, (n,) and (n, n).
        time: its time, s.
        mode: its mode, of a system; default: the first of a HybridSystem, and of a MechanicalSystem that in which a motion
            from the mean starts without a control.
        parameters: of a system.
    """

    def __init__(
        self,
        system: System | SceneLike,
        mean: ArrayLike,
        covariance: ArrayLike,
        *,
        time: float = 0.0,
        mode: str | None = None,
        parameters: Sequence[float] = (),
    ):
        expect("a number", time=time)
        estimate = (np.ravel(mean), np.asarray(covariance))
        self._system: Any = system if isinstance(system, System) else as_scene(system)
        self._parameters = np.array(parameters)
        if isinstance(system, System):
            first = system.modes[0] if mode is None and isinstance(system, HybridSystem) else mode
            number = system._mode_number(first)
            self._filter = _saltus.SaltedKalmanFilter(system._system, parameters, time, number, *estimate)
        else:
            if mode is not None or len(self._parameters) > 0:
                raise ValueError("mode and parameters: found some with a scene, which has its own; leave them out")
            scene = self._system.to_dict()
            if any(body.get("path") for body in scene["bodies"]) or any(plane.get("motion") for plane in scene["planes"]):
                raise ValueError(
                    "system: found a scene with a prescribed motion, which would begin anew with each prediction; expected one without. "
                    "Take the system of the scene's hybrid problem: saltus.hybrid_problem(scene).system"
                )
            self._filter = _saltus.SaltedKalmanFilter(self._system, time, *estimate)

    @property
    def _arguments(self) -> dict[str, Any]:  # type: ignore[override]
        """Those of a filter with the estimate of now."""
        estimate = {"mean": self.mean, "covariance": self.covariance, "time": self.time, "mode": self.mode or None}
        return {"system": self._system, **estimate, "parameters": self._parameters}

    def predict(self, time: float, control: ArrayLike | None = None, process: ArrayLike | None = None) -> None:
        """To a later time under a constant control, None: zero; of a scene forces [x, y] of each controlled disc, and then
        each torque divided by the radius. ``process``: covariance that is added. Raises RuntimeError if the mean has no
        motion."""
        expect("a number", time=time)
        self._filter.predict(time, None if control is None else np.ravel(control), process)

    def update(self, z: ArrayLike, C: ArrayLike, V: ArrayLike, h: ArrayLike | None = None) -> float:
        """A measurement z = h(x) + error, given the Jacobian C of h at the mean, the covariance V of the error, and h at the
        mean; None: C times the mean. Returns the log likelihood of the innovation. Raises ValueError, and keeps the
        estimate, if C P C' + V is not positive definite for the covariance P."""
        return self._filter.update(np.ravel(z), None if h is None else np.ravel(h), C, V)

    @property
    def time(self) -> float:
        return self._filter.time

    @property
    def mode(self) -> str:
        """The name of the mode; empty in a scene."""
        return self._filter.mode

    @property
    def mean(self) -> Floats:
        """A copy of the mean, (n,)."""
        return self._filter.mean

    @property
    def covariance(self) -> Floats:
        """A copy of the covariance, (n, n)."""
        return self._filter.covariance
