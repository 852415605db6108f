"""Three engines that Debian packages, as simulators for saltus.audit: ODE (python3-pyode), DART (python3-dartpy) and
Siconos (python3-siconos).

    report = saltus.audit(scene, simulate=engines.ode(), name="ode")

As they are shipped, with restitution and friction of the scene; discs are spheres in a plane. Each question is answered in
a new world, as engines keep contacts from step to step.
"""

import pathlib
import sys

import numpy as np

DRIVERS = pathlib.Path(__file__).resolve().parents[2] / "engines"


def _discs(scene):
    """(radius, mass) of each disc, and the indices of those that are pushed."""
    data = scene.to_dict()
    if data["planes"] or any(body.get("fixed") for body in data["bodies"]):
        raise ValueError("expected a scene of moving discs without planes")
    pushed = [scene.bodies.index(name) for name in scene.controlled]
    return data["contact"], [(body["radius"], body["mass"]) for body in data["bodies"]], pushed


def ode():
    """Open Dynamics Engine, `step`."""
    import ode as engine

    def simulate(scene, initial, control, dt):
        contact, discs, pushed = _discs(scene)
        world, space, joints = engine.World(), engine.SimpleSpace(), engine.JointGroup()
        bodies = []
        for (radius, mass), (px, py, vx, vy) in zip(discs, initial.tolist()):
            body, sphere = engine.Body(world), engine.Mass()
            sphere.setSphere(1.0, radius)
            sphere.adjust(mass)  # pyode's setSphereTotal takes a density
            body.setMass(sphere)
            body.setPosition((px, py, 0))
            body.setLinearVel((vx, vy, 0))
            geom = engine.GeomSphere(space, radius)
            geom.setBody(body)
            bodies.append((body, geom))

        def collide(_, a, b):
            for point in engine.collide(a, b):
                point.setMu(contact["friction"])
                point.setBounce(contact["restitution"])
                engine.ContactJoint(world, joints, point).attach(a.getBody(), b.getBody())

        for forces in control.tolist():
            for place, (fx, fy) in zip(pushed, forces):
                bodies[place][0].addForce((fx, fy, 0))
            space.collide(None, collide)
            world.step(dt)
            joints.empty()
        return np.array([[*body.getPosition()[:2], *body.getLinearVel()[:2]] for body, _ in bodies])

    return simulate


def dart():
    """DART with its own collision detector."""
    import dartpy as engine

    def simulate(scene, initial, control, dt):
        contact, discs, pushed = _discs(scene)
        world = engine.simulation.World()
        world.setGravity([0, 0, 0])
        world.setTimeStep(dt)
        world.getConstraintSolver().setCollisionDetector(engine.collision.DARTCollisionDetector())
        skeletons = []
        for i, ((radius, mass), state) in enumerate(zip(discs, initial)):
            skeleton = engine.dynamics.Skeleton(f"disc{i}")
            _, body = skeleton.createTranslationalJointAndBodyNodePair()
            inertia = body.getInertia()
            inertia.setMass(mass)
            body.setInertia(inertia)
            shape = body.createShapeNode(engine.dynamics.SphereShape(radius))
            shape.createCollisionAspect()
            shape.createDynamicsAspect()
            shape.getDynamicsAspect().setRestitutionCoeff(contact["restitution"])
            shape.getDynamicsAspect().setFrictionCoeff(contact["friction"])
            skeleton.setPositions([*state[:2], 0])
            skeleton.setVelocities([*state[2:], 0])
            world.addSkeleton(skeleton)
            skeletons.append(skeleton)
        for forces in control:
            for place, force in zip(pushed, forces):
                skeletons[place].setForces([*force, 0])
            world.step()
        return np.array([[*s.getPositions()[:2], *s.getVelocities()[:2]] for s in skeletons])

    return simulate


def siconos(events=False):
    """Siconos by its driver for the command line: Moreau's and Jean's scheme, or located impacts. Any driver in Python
    will do like this."""
    if str(DRIVERS) not in sys.path:
        sys.path.append(str(DRIVERS))
    import protocol
    import siconos_drive

    def simulate(scene, initial, control, dt):
        read = protocol.Scene(scene.to_dict())
        reason = siconos_drive.refusal(read)
        if reason:
            raise ValueError(reason)
        request = {"steps": len(control), "duration": dt * len(control), "initial": initial.tolist(),
                   "control": control.tolist()}
        return protocol.simulate(lambda *given: siconos_drive.World(*given, events), read, request)["final"]

    return simulate
