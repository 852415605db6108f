#!/usr/bin/python3
# Siconos: discs and half-planes as unilateral constraints on one system of all coordinates. Impulses on a time grid
# (Moreau and Jean), or, with --events, at located impacts.
import math
import sys

import numpy
import siconos.kernel as sk

from protocol import serve

THETA = 0.5  # of Moreau and Jean's scheme
STATES = 1e-13  # tolerances of the integrator between impacts


# The distance of two discs; i and j are the places of their coordinates, None for a fixed disc, which stands at `at`.
class DiscDisc(sk.LagrangianScleronomousR):
    def __init__(self, i, j, at, reach, q):
        super().__init__()
        self.i, self.j, self.at, self.reach = i, j, at, reach
        self.jacobian = sk.SimpleMatrix(1, len(q))  # kept: Siconos does not hold what Python gives it
        self.jacobian.zero()
        self.setJachqPtr(self.jacobian)

    def apart(self, q):
        b = self.at if self.j is None else (q[self.j], q[self.j + 1])
        return q[self.i] - b[0], q[self.i + 1] - b[1]

    def computeh(self, q, z, y):
        y[0] = math.hypot(*self.apart(q)) - self.reach

    def computeJachq(self, q, z):
        dx, dy = self.apart(q)
        length = math.hypot(dx, dy)
        for place, sign in ((self.i, 1), (self.j, -1)):
            if place is not None:
                self.jacobian.setValue(0, place, sign * dx / length)
                self.jacobian.setValue(0, place + 1, sign * dy / length)

    def C(self):
        return self.jacobian  # itself: a copy would be gone when Moreau and Jean's scheme looks at it

    def computeDotJachq(self, q, z, velocity):
        pass  # of contacts that last, which no impact needs


class World:
    def __init__(self, scene, initial, h, events):
        self.places, q, v, masses = [], [], [], []
        for disc, state in zip(scene.discs, initial):
            self.places.append(None if disc.fixed else len(q))
            if not disc.fixed:
                q += state[:2]
                v += state[2:]
                masses += [disc.mass] * 2
        self.weight = numpy.array(masses) * numpy.tile(scene.gravity, len(masses) // 2)
        self.system = sk.LagrangianLinearTIDS(q, v, numpy.diag(masses))
        self.system.setFExtPtr(self.weight)
        self.force = self.system.fExt()  # its memory
        self.model = sk.NonSmoothDynamicalSystem(0, 1e9)
        self.model.insertDynamicalSystem(self.system)
        self.relations = []
        self.link_all(scene, initial)
        self.start(h, events)

    def link_all(self, scene, initial):
        size = len(self.force)
        for i, disc in enumerate(scene.discs):
            place = self.places[i]
            for j in range(len(scene.discs)):
                if place is None or (j <= i and self.places[j] is not None):
                    continue
                reach = disc.radius + scene.discs[j].radius
                self.link(DiscDisc(place, self.places[j], initial[j][:2], reach, self.system.q()), scene)
            for plane in scene.planes:
                if place is not None:
                    row = numpy.zeros((1, size))
                    row[0, place:place + 2] = plane.normal
                    height = numpy.dot(plane.normal, plane.point)
                    self.link(sk.LagrangianLinearTIR(row, [-height - disc.radius]), scene)

    def link(self, relation, scene):
        law = sk.NewtonImpactNSL(scene.restitution)
        self.relations.append((relation, law))
        self.model.link(sk.Interaction(law, relation), self.system)

    def start(self, h, events):
        grid = sk.TimeDiscretisation(0, h)
        if events:
            self.integrator = sk.LsodarOSI()
            self.simulation = sk.EventDriven(self.model, grid)
            self.simulation.insertIntegrator(self.integrator)
            self.simulation.insertNonSmoothProblem(sk.LCP(), sk.SICONOS_OSNSP_ED_IMPACT)
            self.simulation.insertNonSmoothProblem(sk.LCP(), sk.SICONOS_OSNSP_ED_SMOOTH_ACC)
        else:
            self.simulation = sk.TimeStepping(self.model, grid, sk.MoreauJeanOSI(THETA), sk.LCP())
        self.simulation.initialize()
        if events:
            self.integrator.setTol(1, STATES, STATES)
        self.events, self.h, self.steps = events, h, 0

    def push(self, disc, fx, fy):
        self.force[self.places[disc]:self.places[disc] + 2] += (fx, fy)

    def step(self, h):
        self.steps += 1
        if self.events:
            end = self.steps * self.h
            while self.simulation.nextTime() < end + h / 2 and self.simulation.startingTime() < end - h / 2:
                self.simulation.advanceToEvent()
                self.simulation.processEvents()
        else:
            self.simulation.computeOneStep()
            self.simulation.nextStep()
        self.force[:] = self.weight

    def get(self, disc):
        place = self.places[disc]
        return [*self.system.q()[place:place + 2], *self.system.velocity()[place:place + 2]]


def refusal(scene):
    return "this driver has no friction" if scene.friction > 0 else ""


def main():
    events = "--events" in sys.argv
    serve("Siconos, " + ("located events" if events else "Moreau-Jean"), lambda *given: World(*given, events), refusal)


if __name__ == "__main__":
    main()
