"""A small policy that plays task 3 from random starts, learned with the gradients of several contact models.

    python3 learn_policy.py [--steps=300] [--starts=32]

The policy is a linear function of features of the start: the initial positions of both discs give the force at five times,
between which it is interpolated. It is learned by Adam on random starts, with the gradient of one contact model through
every impact, and is then judged on other starts in exact dynamics, beside the mean optimum of these (minimum principle).
"""

import argparse

import numpy as np

import saltus

KNOTS = 5


def interpolation(steps):
    """The weights of the forces at KNOTS times in the force on each step."""
    at = np.linspace(0, KNOTS - 1, steps)
    return np.maximum(0, 1 - np.abs(at[:, None] - np.arange(KNOTS)))


def features(starts):
    """1, the positions of the discs less those of the scene, and their products, of each start."""
    away = starts[:, :, :2].reshape(len(starts), -1)
    products = away[:, :, None] * away[:, None, :]
    return np.hstack([np.ones((len(starts), 1)), away, products[:, *np.triu_indices(away.shape[1])]])


def optimum(scene, moved):
    """The mean optimal loss over some starts."""
    data, losses = scene.to_dict(), []
    for start in moved:
        for body, by, at in zip(data["bodies"], start, saltus.EndState(scene).initial):
            body["position"] = (at + by)[:2].tolist()
        losses.append(saltus.solve(data, "event", "hmp")["exact_loss"])
    return np.mean(losses)


class Task:
    """Task 3 from starts that differ from the scene's by up to `spread` m."""

    def __init__(self, scene, contact, spread=0.1):
        self.end = saltus.EndState(scene, contact)
        self.effort = 0.1 * scene.dt
        self.spread = spread
        self.weights = interpolation(scene.steps)

    def starts(self, count, random):
        moved = np.zeros((count, *self.end.initial.shape))
        moved[:, :, :2] = random.uniform(-self.spread, self.spread, moved[:, :, :2].shape)
        return moved

    def control(self, policy, features):
        return self.weights @ (features @ policy).reshape(KNOTS, 2)

    def loss(self, policy, moved):
        """The mean loss over some starts."""
        return np.mean([self._play(policy, start, row)[0] for start, row in zip(moved, features(moved))])

    def loss_and_gradient(self, policy, moved):
        """The same, and its derivative by the policy."""
        total, gradient = 0.0, np.zeros_like(policy)
        for start, row in zip(moved, features(moved)):
            loss, control, target = self._play(policy, start, row)
            cotangent = np.zeros_like(self.end.initial)
            cotangent[1, :2] = 2 * target
            by_control = self.end.vjp(self.end.initial + start, control[:, None, :], cotangent)[1][:, 0]
            by_control = by_control + 2 * self.effort * control
            total += loss
            gradient += np.outer(row, self.weights.T @ by_control)
        return total / len(moved), gradient / len(moved)

    def _play(self, policy, start, row):
        control = self.control(policy, row)
        target = self.end(self.end.initial + start, control[:, None, :])[1, :2]
        return target @ target + self.effort * np.sum(control**2), control, target


def learn(task, steps, starts, seed=1, rate=0.1):
    """The policy after some steps of Adam, whose rate falls to zero."""
    random = np.random.default_rng(seed)
    policy = np.zeros((features(task.starts(1, random)).shape[1], 2 * KNOTS))
    policy[0] = 3  # the scene's guess
    mean, square = np.zeros_like(policy), np.zeros_like(policy)
    for step in range(1, steps + 1):
        _, gradient = task.loss_and_gradient(policy, task.starts(starts, random))
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.999 * square + 0.001 * gradient**2
        by = mean / (1 - 0.9**step) / (np.sqrt(square / (1 - 0.999**step)) + 1e-8)
        policy -= rate * (1 - step / steps) * by
    return policy


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="problems/two_balls.yaml")
    parser.add_argument("--steps", type=int, default=300, help="of Adam")
    parser.add_argument("--starts", type=int, default=32, help="random starts in each step")
    parser.add_argument("--contact", nargs="+", default=["event", "toi_velocity", "direct_toi", "direct"])
    flags = parser.parse_args()
    scene = saltus.load_scene(flags.scene)
    exact = Task(scene, "event")
    others = exact.starts(200, np.random.default_rng(0))
    print(f"{'optimum':<14}{optimum(scene, others):>10.4f}")
    for contact in flags.contact:
        policy = learn(Task(scene, contact), flags.steps, flags.starts)
        print(f"{contact:<14}{exact.loss(policy, others):>10.4f}", flush=True)


if __name__ == "__main__":
    main()
