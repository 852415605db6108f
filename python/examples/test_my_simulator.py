"""A test suite with a line for the gradient: pytest python/examples/test_my_simulator.py

The simulator is of a ball above the ground, y = 0, as somebody might have written it: each step flies to the impact in
it, if there is one, bounces, and flies on.
"""

import math

import pytest

import saltus

SCENE = saltus.Scene(
    name="bounce", duration=1, steps=48, gravity=[0, -9.81], optimize="velocity",
    bodies=[{"name": "ball", "radius": 0.1, "mass": 1, "position": [0, 1], "velocity": [1, -0.5]}],
    planes=[{"name": "ground", "point": [0, 0], "normal": [0, 1]}],
    contact={"restitution": 0.8},
    objective={"terminal": [{"body": "ball", "quantity": "position", "target": [2, 0.5]}]},
)


def time_of_impact(height, speed, acceleration, dt):
    """When a height becomes zero; None if it does not within dt."""
    if height + dt * speed + dt**2 / 2 * acceleration >= 0:
        return None
    root = math.sqrt(speed**2 - 2 * acceleration * height)
    return max(0.0, 2 * height / (root - speed))


def end_of_step(height, speed, acceleration, dt):
    """What most engines take for the time of impact: the end of the step that would end inside the ground."""
    return None if height + dt * speed + dt**2 / 2 * acceleration >= 0 else 0.0


def simulator(find_impact):
    def simulate(scene, initial, control, dt):
        data = scene.to_dict()
        (ball,) = data["bodies"]
        [[x, y, vx, vy]] = initial.tolist()
        for forces in control.tolist():
            ax, ay = [g + f / ball["mass"] for g, f in zip(data["gravity"], forces[0] if forces else (0, 0))]
            time = find_impact(y - ball["radius"], vy, ay, dt)
            for part in (dt,) if time is None else (time, dt - time):
                x, y = x + part * vx + part**2 / 2 * ax, y + part * vy + part**2 / 2 * ay
                vx, vy = vx + part * ax, vy + part * ay
                if time is not None and part == time:
                    vy, time = -data["contact"]["restitution"] * vy, None
        return [[x, y, vx, vy]]

    return simulate


def test_gradient():
    report = saltus.audit(SCENE, simulate=simulator(time_of_impact))
    report.raise_if_wrong()


def test_that_the_line_above_finds_what_it_should():
    report = saltus.audit(SCENE, simulate=simulator(end_of_step))
    with pytest.raises(saltus.WrongGradient, match="the gradient has the wrong sign.*impulse at a step boundary"):
        report.raise_if_wrong()
