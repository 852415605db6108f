# A simulator without contact, to test engines/protocol.py with.
import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "engines"))

from protocol import serve


class Drift:
    def __init__(self, scene, initial):
        self.scene = scene
        self.states = [list(row) for row in initial]
        self.forces = [[0, 0] for _ in initial]

    def push(self, disc, fx, fy):
        self.forces[disc] = [fx, fy]

    def step(self, h):
        print("a simulator that prints")
        for disc, state, force in zip(self.scene.discs, self.states, self.forces):
            for axis in range(2):
                state[2 + axis] += h * (force[axis] / disc.mass + self.scene.gravity[axis])
                state[axis] += h * state[2 + axis]
            force[:] = [0, 0]

    def get(self, disc):
        return self.states[disc]


serve("drift", lambda scene, initial, h: Drift(scene, initial),
      lambda scene: "this simulator knows no planes" if scene.planes else "")
