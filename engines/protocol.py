# Makes a simulator a command for `saltus_audit --simulate=COMMAND`: copy this file, write a world, call serve. The
# protocol is described at the top of protocol.h.
#
# A world is an object with push(disc, fx, fy): a force in N on the centre of a disc, in the next step only; step(h), in
# s; and get(disc), which returns [px, py, vx, vy]. Discs do not turn.
import json
import math
import os
import sys


# A scene that the simulator cannot take: the reason.
class NotApplicable(Exception):
    pass


class Disc:
    def __init__(self, body):
        refuse_unknown(body, "a body", {"name", "radius", "mass", "fixed", "position", "velocity"})
        self.radius = body["radius"]
        self.fixed = bool(body.get("fixed"))
        self.mass = 1 if self.fixed else body["mass"]


# Discs stay on the side of point that normal, of length 1, points to.
class Plane:
    def __init__(self, plane):
        refuse_unknown(plane, "a plane", {"name", "point", "normal"})
        length = math.hypot(*plane["normal"])
        self.point = plane["point"]
        self.normal = [x / length for x in plane["normal"]]


class Scene:
    def __init__(self, scene):
        refuse_unknown(scene, "scene", {"name", "duration", "steps", "gravity", "bodies", "planes", "contact",
                                        "control", "objective", "optimize", "free", "no_contact"})
        contact = scene.get("contact") or {}
        refuse_unknown(contact, "contact", {"restitution", "friction", "stiffness", "damping"})
        names = [body["name"] for body in scene["bodies"]]
        self.gravity = scene.get("gravity", [0, 0])
        self.discs = [Disc(body) for body in scene["bodies"]]
        self.planes = [Plane(plane) for plane in scene.get("planes", [])]
        self.restitution = contact.get("restitution", 1)
        self.friction = contact.get("friction", 0)
        self.controlled = [names.index(name) for name in (scene.get("control") or {}).get("bodies", [])]


# What is not among `known` must be empty, 0 or false: else it may act on the motion.
def refuse_unknown(thing, where, known):
    for key, value in thing.items():
        if key not in known and value:
            raise NotApplicable(f'{where}: this driver does not support "{key}"')


# All states of the world; raises if one is not finite.
def states(world, scene, initial):
    result = [row if disc.fixed else [float(x) for x in world.get(i)]
              for i, (disc, row) in enumerate(zip(scene.discs, initial))]
    for i, row in enumerate(result):
        if not all(map(math.isfinite, row)):
            raise ValueError(f"the state of disc {i} is not finite")
    return result


# The answer to one "simulate", without its id.
def simulate(make, scene, request):
    steps, initial, control = request["steps"], request["initial"], request.get("control", [])
    if not (steps > 0 and request["duration"] > 0):
        raise ValueError("steps and duration must be positive")
    if len(initial) != len(scene.discs):
        raise ValueError(f"initial: expected {len(scene.discs)} rows, one a body")
    if scene.controlled and len(control) not in (1, steps):
        raise ValueError(f"control: expected 1 or {steps} rows, not {len(control)}")
    if any(len(row) != len(scene.controlled) for row in control):
        raise ValueError(f"control: expected {len(scene.controlled)} forces a row")
    h = request["duration"] / steps
    world = make(scene, initial, h)
    passed = [initial]
    for k in range(steps):
        for disc, force in zip(scene.controlled, control[0 if len(control) == 1 else k] if control else []):
            world.push(disc, *force)
        world.step(h)
        if request.get("states"):
            passed.append(states(world, scene, initial))
    answer = {"final": states(world, scene, initial)}
    if request.get("states"):
        answer["states"] = passed
    return answer


# Answers standard input until it ends. make(scene, initial, h) returns a new world, with nothing left of an earlier
# one; refusal(scene) says why a scene cannot be taken, "" if it can. What the simulator itself prints goes to standard
# error.
def serve(name, make, refusal=lambda scene: ""):
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    scene = None
    for line in sys.stdin:
        answer = {}
        try:
            request = json.loads(line)
            if "id" in request:
                answer["id"] = request["id"]
            if "saltus" in request:
                answer = {"name": name, "can": ["states"]}
                if "hybrid" in request:
                    raise NotApplicable("this driver has discs that do not turn only")
                scene = Scene(request["scene"])
                reason = refusal(scene)
                if reason:
                    raise NotApplicable(reason)
            elif "simulate" in request:
                answer.update(simulate(make, scene, request["simulate"]))
            else:
                raise ValueError('expected "saltus" or "simulate"')
        except NotApplicable as reason:
            answer["not_applicable"] = str(reason)
        except Exception as error:  # whatever the simulator raises is an answer
            answer["error"] = f"{type(error).__name__}: {error}"
        print(json.dumps(answer), file=answers, flush=True)
