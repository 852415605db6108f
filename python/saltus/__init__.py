"""Trajectory optimization and optimal control through rigid contact, with exact and audited gradients.

    >>> import saltus
    >>> scene = saltus.load_scene("problems/two_balls.yaml")
    >>> exact = saltus.loss_and_gradient(scene, "event")
    >>> exact.gradient.position.round(4)
    array([[-0.3987, -0.3987],
           [-0.3213, -0.3213]])
    >>> saltus.audit(scene, ["direct_toi", "toi_velocity"]).verdicts
    {'direct_toi': 'wrong', 'toi_velocity': 'consistent'}
    >>> run = saltus.solve(scene, "event", "hmp")
    >>> f"{run.exact_loss:.4f}", run.certificate.verdict
    ('1.3965', 'stationary')

Scenes          load_scene, Scene, SceneError
Motions         rollout, loss_and_gradient, linearize: each takes a Scene, a dict or the path of a scene file
Repeated use    Simulation (one scene, evaluated many times), Batch and HybridBatch (many points, on all cores)
Optimisation    solve, solvers, bound_globally
Sweeps          sweep: many points of some options, on all cores or with a distributed.Client of Dask
Identification  identify: parameters from recordings of a motion
Audits          audit, contact_models, WrongGradient
Hybrid systems  HybridSystem, MechanicalSystem with Contact, load_bodies, HybridProblem, hybrid_problem (of a scene); where,
                interp, spline; terminal, effort, final_time, residuals, cost, maximise, measurements, event_times; rollout,
                final_derivatives, loss_and_gradient, solve, hybrid_solvers, audit
Feedback        track (gives a Regulator), propagate (a Covariance) and noisy_runs (NoisyRuns), of a HybridProblem or
                a scene; SaltedKalmanFilter
Your own models audit(scene, simulate=...), and ContactModel for a contact model in Python
Other packages  EndState and HybridEndState (for automatic differentiation), saltus.torch, saltus.jax, saltus.plot
                (matplotlib); scipy.optimize takes Simulation.loss_and_gradient with jac=True
Results         Result: the keys of the programs' JSON; save, load_result

Units are SI units and radians. The world is planar: every vector is [x, y]. A scene has B discs, of which C are
controlled, and a contact model takes K steps. A state is (B, 4): [p_x p_y v_x v_y] of each disc. In scenes with discs
that have rotational inertia it is (B, 6), with angle and angular velocity at the end. A control is (K, C, 2): forces in
N, constant over each step. In scenes with torques it is (K, C, 3), with the torque in N m at the end, and 0 for discs
without a torque control.

Results are those of the programs saltus_solve, saltus_audit and saltus_identify, bit by bit. A wrong argument raises
ValueError (SceneError in scenes) or TypeError, which names the argument and what was expected. A rollout that fails
raises RuntimeError, which names the step. The interpreter lock is released while C++ computes, and Ctrl-C ends the
computation.
"""

from ._expression import interp, spline, where
from ._feedback import Covariance, NoisyRuns, Regulator, SaltedKalmanFilter, noisy_runs, propagate, track
from ._hybrid import (
    HybridAudit,
    HybridBatch,
    HybridEndState,
    HybridGradient,
    HybridProblem,
    HybridRollout,
    HybridRun,
    HybridSystem,
    cost,
    effort,
    event_times,
    final_derivatives,
    final_time,
    hybrid_problem,
    hybrid_solvers,
    maximise,
    measurements,
    residuals,
    terminal,
)
from ._identify import identify
from ._mechanical import Contact, MechanicalSystem, load_bodies
from ._own import ContactModel
from ._results import Audit, Fit, Gradient, Result, Rollout, Run, WrongGradient, load_result
from ._saltus import __version__
from ._scene import Scene, SceneError, load_scene
from ._simulate import Batch, EndState, Simulation, linearize, loss_and_gradient, rollout
from ._solve import audit, bound_globally, contact_models, solve, solvers
from ._sweep import sweep

__all__ = [
    "Audit",
    "Batch",
    "Contact",
    "ContactModel",
    "Covariance",
    "EndState",
    "Fit",
    "Gradient",
    "HybridAudit",
    "HybridBatch",
    "HybridEndState",
    "HybridGradient",
    "HybridProblem",
    "HybridRollout",
    "HybridRun",
    "HybridSystem",
    "MechanicalSystem",
    "NoisyRuns",
    "Regulator",
    "Result",
    "Rollout",
    "Run",
    "SaltedKalmanFilter",
    "Scene",
    "SceneError",
    "Simulation",
    "WrongGradient",
    "__version__",
    "audit",
    "bound_globally",
    "contact_models",
    "cost",
    "effort",
    "event_times",
    "final_derivatives",
    "final_time",
    "hybrid_problem",
    "hybrid_solvers",
    "identify",
    "interp",
    "linearize",
    "load_bodies",
    "load_result",
    "load_scene",
    "loss_and_gradient",
    "maximise",
    "measurements",
    "noisy_runs",
    "propagate",
    "residuals",
    "rollout",
    "solve",
    "solvers",
    "spline",
    "sweep",
    "terminal",
    "track",
    "where",
]
