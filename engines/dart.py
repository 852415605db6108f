#!/usr/bin/python3
# DART: discs as spheres on two slides, half-planes as large boxes. --detector=fcl takes its default detector of
# contacts, which makes meshes of spheres.
import sys

import dartpy as dart
import numpy

from protocol import serve

FAR = 100  # m, the size of a box


class World:
    def __init__(self, scene, initial, h, detector):
        self.world = dart.simulation.World()
        self.world.setGravity([*scene.gravity, 0])
        self.world.setTimeStep(h)
        if detector == "dart":
            self.world.getConstraintSolver().setCollisionDetector(dart.collision.DARTCollisionDetector())
        self.scene = scene
        self.discs = [self.add_disc(disc, state) for disc, state in zip(scene.discs, initial)]
        for plane in scene.planes:
            self.add_plane(plane)

    def add_disc(self, disc, state):
        skeleton = dart.dynamics.Skeleton()
        if disc.fixed:
            joint, body = skeleton.createWeldJointAndBodyNodePair()
            joint.setTransformFromParentBodyNode(translation(state[:2]))
        else:
            joint, body = skeleton.createTranslationalJoint2DAndBodyNodePair()
            inertia = body.getInertia()
            inertia.setMass(disc.mass)
            body.setInertia(inertia)
            joint.setPositions(state[:2])
            joint.setVelocities(state[2:])
        self.add_shape(body, dart.dynamics.SphereShape(disc.radius))
        self.world.addSkeleton(skeleton)
        return joint

    def add_plane(self, plane):
        skeleton = dart.dynamics.Skeleton()
        joint, body = skeleton.createWeldJointAndBodyNodePair()
        normal = numpy.array(plane.normal)
        place = translation(numpy.array(plane.point) - normal * FAR / 2)
        nx, ny = normal
        place.set_rotation(numpy.array([[nx, -ny, 0], [ny, nx, 0], [0, 0, 1]]))
        joint.setTransformFromParentBodyNode(place)
        self.add_shape(body, dart.dynamics.BoxShape([FAR, FAR, FAR]))
        self.world.addSkeleton(skeleton)

    def add_shape(self, body, shape):
        node = body.createShapeNode(shape)
        node.createCollisionAspect()
        surface = node.createDynamicsAspect()
        # Of two bodies, the product of restitutions counts.
        surface.setRestitutionCoeff(self.scene.restitution**0.5)
        surface.setFrictionCoeff(self.scene.friction)

    def push(self, disc, fx, fy):
        self.discs[disc].setForces([fx, fy])

    def step(self, _):
        self.world.step()

    def get(self, disc):
        return [*self.discs[disc].getPositions(), *self.discs[disc].getVelocities()]


def translation(at):
    place = dart.math.Isometry3()
    place.set_translation([*at, 0])
    return place


def main():
    detector = "fcl" if "--detector=fcl" in sys.argv else "dart"
    name = "default" if detector == "fcl" else "own"
    serve(f"DART, {name} detector", lambda *given: World(*given, detector))


main()
