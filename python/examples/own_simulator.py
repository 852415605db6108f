"""Is the gradient of my simulator right? In four parts, to be run whole or cell by cell.

    PYTHONPATH=build/release/python python3 python/examples/own_simulator.py
"""

# %% [markdown]
# ## 1. What contact models make of one task
# A striker is pushed so that it strikes another ball towards the origin. All models simulate nearly the same motion; their
# gradients differ, and gradient descent ends where they lead.

# %%
import os

import numpy as np

import saltus

scene = saltus.load_scene(os.path.join(os.environ.get("SALTUS_SOURCE", "."), "problems", "two_balls.yaml"))
models = ["lcp", "convex", "convex_toi", "direct", "direct_toi", "pbd_warp", "toi_velocity"]
verdicts = saltus.audit(scene, models).verdicts
runs = {model: saltus.solve(scene, model, "gd") for model in models}
print(f"{'contact':<14}{'gradient':<12}{'own loss':>10}{'exact loss':>12}")
for model, run in runs.items():
    print(f"{model:<14}{verdicts[model]:<12}{run['final_loss']:>10.4f}{run['exact_loss']:>12.4f}")
optimum = saltus.solve(scene, "event", "hmp")
print(f"{'event, hmp':<26}{optimum['final_loss']:>10.4f}{optimum['exact_loss']:>12.4f}")

# %% [markdown]
# ## 2. A simulator of my own
# Semi-implicit Euler, and an impulse at the end of the step in which the discs overlap: what most engines do. The audit
# asks for final states alone. (Vectors in the plane are complex numbers here: they are fast in Python.)


# %%
def to_complex(initial, control):
    (p, v), (q, w) = [(complex(*disc[:2]), complex(*disc[2:])) for disc in initial]
    return p, v, q, w, [complex(*forces[0]) if len(forces) else 0j for forces in control]


def to_array(p, v, q, w):
    return np.array([[p.real, p.imag, v.real, v.imag], [q.real, q.imag, w.real, w.imag]])


def dot(a, b):
    return a.real * b.real + a.imag * b.imag


REACH = 0.4  # m, at which the discs touch; both have a mass of 1 kg


def simulate(scene, initial, control, dt):
    p, v, q, w, forces = to_complex(initial, control)
    for force in forces:
        v += dt * force
        gap = p - q + dt * (v - w)
        if abs(gap) < REACH and dot(v - w, gap) < 0:
            impulse = -dot(v - w, gap) * gap / abs(gap) ** 2
            v, w = v + impulse, w - impulse
        p, q = p + dt * v, q + dt * w
    return to_array(p, v, q, w)


coarse = scene.replace(steps=32)
report = saltus.audit(coarse, simulate=simulate, name="mine")
print(report)
try:
    report.raise_if_wrong()  # this line makes a test of it
except saltus.WrongGradient as error:
    print("wrong:", error)

# %% [markdown]
# ## 3. The same, mended
# The impulse acts where and when the discs touch, and the rest of the step comes after it.


# %%
def flight(p, v, a, time):
    return p + time * v + time**2 / 2 * a, v + time * a


def located(scene, initial, control, dt):
    p, v, q, w, forces = to_complex(initial, control)
    for force in forces:
        left = dt
        end, speed = flight(p - q, v - w, force, dt)
        if abs(end) < REACH and dot(speed, end) < 0:
            time = 0.0
            for _ in range(20):  # Newton's method, on the squared distance
                gap, speed = flight(p - q, v - w, force, time)
                time -= (abs(gap) ** 2 - REACH**2) / (2 * dot(speed, gap))
            (p, v), q = flight(p, v, force, time), q + time * w
            impulse = -dot(v - w, p - q) * (p - q) / abs(p - q) ** 2
            v, w, left = v + impulse, w - impulse, dt - time
        (p, v), q = flight(p, v, force, left), q + left * w
    return to_array(p, v, q, w)


report = saltus.audit(coarse, simulate=located, name="mended")
report.raise_if_wrong()
print(report)

# %% [markdown]
# ## 4. Optimise with it
# As a contact model it goes wherever a built-in one does.


# %%
class Located(saltus.ContactModel):
    name = "mended"

    def step(self, x, u, h):
        return located(self.scene, x, u[None, :1], h)


run = saltus.solve(coarse, Located, "gd", iterations=30)
print(run)
assert run["exact_loss"] < run["initial_loss"]
